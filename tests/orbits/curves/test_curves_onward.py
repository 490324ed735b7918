"""Curves of machines with modes through continuous changes of their contacts and slides."""

import json
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import atlas
from atlas.orbits.curves.following import FollowedCurve, PlaneEvent, follow_event, lies_on, with_own_ends
from atlas.orbits.curves.passages import CurvePassage, find_passed_edges, orbits_beside
from atlas.orbits.curves.search_result import as_curve
from atlas.orbits.curves.to_json import curve_as_json, curve_from_json
from tests.orbits.branches.test_branches_onward import along_amplitude, pushed
from tests.oscillators import cosine_mass
from workers.continuation import BranchRun, Condition, Event, SolutionPoint, branch, curve, family_of
from workers.continuation.branches import follow_both_ways
from workers.continuation.extended_system import UNIT, ExtendedSystem, solve
from workers.continuation.orbits import refine_orbit
from workers.model.system import System

pytestmark = pytest.mark.slow

WINDOW = {"omega": (0.75, 1.0), "a": (0.6, 0.9)}


def forced(**stop: Any) -> System:
    """x'' + .02 x' + x + 29 (x - 1 beyond 1) = a omega^2 / 1.26 cos omega t."""
    return cosine_mass(
        damping=[[0.02]], force=["a * omega**2 / 1.26"], parameters={"a": {"default": 0.9}},
        contacts=[{"name": "stop", "gap": [1.0], "upper": 1.0, "stiffness": 29.0} | stop],
    )  # fmt: skip


def values_of(system: System, **given: float) -> dict[str, float]:
    return {p.name: p.default for p in system.parameters} | given


def doubling(system: System) -> tuple[Event, np.ndarray]:
    """The doubling of the orbit of two periods and one contact at a = .79."""
    found = atlas.branch({"omega": 0.91, "a": 0.79}, along="omega", window=(0.905, 0.9149), system=system)
    event = next(event for event in found.traced[0].run.events if event.kind == "period_doubling")
    return event, np.array([event.point.values[0], 0.79])


def on(system: System, event: Event, start: np.ndarray, window: Any = WINDOW) -> BranchRun:
    return curve(family_of(system, values_of(system), tuple(window)), event, start, window)


@pytest.fixture(scope="module")
def doublings() -> BranchRun:
    system = forced()
    return on(system, *doubling(system))


def contacts(point: SolutionPoint) -> int:
    return point.orbit.itinerary.impacts(1)


def inside(run: BranchRun) -> list[SolutionPoint]:
    """The points of a curve that are neither its events nor its ends."""
    events = [id(event.point) for event in run.events]
    return [point for point in run.points[1:-1] if id(point) not in events]


def at(system: System, point: SolutionPoint, kind: str, names: tuple[str, str] = ("omega", "a")) -> float:
    """Where the branch of the orbit of a point, in the first parameter, has its event nearby: another computation."""
    family = family_of(system, values_of(system, **dict(zip(names, point.values, strict=True))), names[:1])
    here = float(point.values[0])
    for away in (1e-3, -1e-3, 1e-4, -1e-4, 1e-5, -1e-5):
        try:
            orbit = refine_orbit(family, point.orbit, np.array([here + away]))
            run = branch(family, orbit, here + away, (here - 3.0 * abs(away), here + 3.0 * abs(away)))
        except ValueError:
            continue
        found = [float(event.point.values[0]) for event in run.events if event.kind == kind]
        if found:
            return min(found, key=lambda value: abs(value - here))
    raise AssertionError(f"no {kind} near {here}")


def test_a_curve_of_doublings_goes_on_through_grazes_of_a_soft_contact_both_ways(doublings: BranchRun) -> None:
    assert doublings.ends == ("edge", "edge")
    assert [event.kind for event in doublings.events] == ["graze_period_doubling"] * 2
    assert [event.last for event in doublings.events] == ["graze"] * 2
    counts = [contacts(point) for point in inside(doublings)]
    changes = np.flatnonzero(np.diff(counts))
    assert [counts[0], counts[changes[0] + 1], counts[-1]] == [2, 1, 2]
    assert len(changes) == 2
    assert all(np.min(np.abs(point.multipliers + 1.0)) < 1e-7 for point in doublings.points)


def test_branches_across_a_curve_double_on_it_on_both_sides_of_a_change(doublings: BranchRun) -> None:
    system, points = forced(), inside(doublings)
    for count in (1, 2):
        own = [point for point in points if contacts(point) == count]
        point = own[len(own) // 2 if count == 1 else len(own) // 6]
        assert at(system, point, "period_doubling") == pytest.approx(point.values[0], abs=1e-9)


def test_beyond_a_graze_a_curve_of_doublings_leaves_along_the_curve_of_grazes(doublings: BranchRun) -> None:
    """The multipliers change with the square root of the depth: depth ~ distance^2. Truth: the corner's own graze."""
    event = doublings.events[-1]
    grazing = Event("graze", event.conditions[-1:], event.point)
    grazes = np.array([p.values for p in on(forced(), grazing, event.point.values).points])
    beyond = doublings.points[[id(p) for p in doublings.points].index(id(event.point)) + 1 :]
    away = np.array([point.values - event.point.values for point in beyond])
    distance = np.hypot(*away.T)
    nearest = [
        float(abs(p.values[0] - np.interp(p.values[1], *grazes[np.argsort(grazes[:, 1])].T[::-1]))) for p in beyond
    ]
    near = (distance > 0.0) & (distance < 0.03)
    assert np.count_nonzero(near) > 1
    assert np.all(np.array(nearest)[near] < 0.05 * distance[near])


@pytest.fixture(scope="module")
def folds() -> BranchRun:
    """The curve of folds through a graze_fold on the curve of grazes, from beside it."""
    system, window = forced(), {"omega": (0.7, 0.95), "a": (0.7, 1.0)}
    found = atlas.branch({"omega": 0.85}, along="omega", window=(0.76, 0.9), system=system)
    event = next(event for event in found.traced[0].run.events if event.kind == "graze")
    grazes = on(system, event, np.array([event.point.values[0], 0.9]), window)
    corner = next(event for event in grazes.events if event.kind == "graze_fold")
    fold = Event("fold", (Condition(UNIT),), corner.point._replace(contacts=np.zeros(0)))
    return on(system, fold, corner.point.values + np.array([2e-4, 1.2e-3]), window)


def test_a_curve_of_folds_goes_on_through_a_graze_and_may_turn_back_there(folds: BranchRun) -> None:
    assert folds.ends == ("edge", "edge")
    assert [event.kind for event in folds.events] == ["graze_fold", "cusp"]
    counts = [contacts(point) for point in inside(folds)]
    assert (counts[0], counts[-1], np.count_nonzero(np.diff(counts))) == (2, 1, 1)
    assert folds.points[0].values[1] == folds.points[-1].values[1] == 1.0


def test_branches_across_a_curve_fold_on_it_on_both_sides_of_a_change(folds: BranchRun) -> None:
    """Each from an orbit beside that of the fold: along the direction in which it is not unique."""
    points = inside(folds)
    for point in (points[5], points[-5]):
        here, width = point.values[:1], np.array([0.01])
        family = family_of(forced(), values_of(forced(), a=float(point.values[1])), ("omega",))
        fold = ExtendedSystem(family, point.orbit, (Condition(UNIT),), here, width)
        X, free = fold.pack(point.orbit, np.zeros(0), here), ExtendedSystem(family, point.orbit, (), here, width)
        along = np.append(fold.critical(X), 0.0)
        beside = solve(free, X + 1e-3 * along * free.scale, along / free.scale)
        assert beside.converged
        run = follow_both_ways(free, beside.X, np.array([here - width, here + width]), 0.02, 100, None)
        found = [float(event.point.values[0]) for event in run.events if event.kind == "fold"]
        assert min(found, key=lambda value: abs(value - here[0])) == pytest.approx(here[0], abs=1e-9)


def test_a_damped_contact_that_opens_where_it_closed_ends_no_curve() -> None:
    system = forced(damping=0.05)
    run = on(system, *doubling(system))
    assert run.ends == ("edge", "edge")
    assert {contacts(point) for point in run.points} == {1, 2}


def test_a_damped_contact_that_its_force_releases_ends_a_curve_of_doublings_at_its_graze() -> None:
    system = forced(damping=0.05, release="force")
    run = on(system, *doubling(system))
    assert run.ends == ("graze_period_doubling",) * 2
    assert {contacts(point) for point in run.points} == {1}


@pytest.mark.parametrize("c", [0.5, 8.0])
def test_multipliers_jump_at_the_graze_of_a_damped_contact_that_its_force_releases(c: float) -> None:
    """The damper acts at the beginning alone, S = I - c k r: the trace of DP jumps by -c (exp A T)_xv."""
    run, omega, beta = along_amplitude(pushed(c)), 0.8, 0.01
    (graze,) = (event for event in run.events if event.kind == "graze")
    T, w = 2.0 * math.pi / omega, math.sqrt(1.0 - beta**2)
    jump = -c * math.exp(-beta * T) * math.sin(w * T) / w
    beyond = [point for point in run.points if contacts(point) == 1]
    nearest = min(beyond, key=lambda point: abs(point.values[0] - graze.point.values[0]))
    found = float(np.sum(nearest.multipliers - graze.point.multipliers).real)
    assert found == pytest.approx(jump, rel=0.05)


@pytest.mark.parametrize("release", ["displacement", "force"])
def test_a_curve_of_grazes_goes_on_through_the_graze_of_another_contact(release: str) -> None:
    """The lower stop is touched where the linear answer has amplitude 1, until the upper one is touched too."""
    stops = {"upper": "u", "lower": -1.0, "damping": 0.5, "release": release}
    system = cosine_mass(
        damping=[[0.02]], force=["0.1"], parameters={"u": {"default": 1.2}},
        contacts=[{"name": "stop", "gap": [1.0], "stiffness": 29.0} | stops],
    )  # fmt: skip
    found = atlas.branch({"omega": 0.93}, along="omega", window=(0.9, 1.0), system=system)
    event = next(event for event in found.traced[0].run.events if event.kind == "graze")
    run = on(system, event, np.array([event.point.values[0], 1.2]), {"omega": (0.8, 1.0), "u": (0.7, 1.3)})
    assert [event.kind for event in run.events] == ["double_graze"]
    assert run.ends == ("edge", "edge")
    exact = math.sqrt(1.0 - 2e-4 - math.sqrt((1.0 - 2e-4) ** 2 - 0.99))
    for point in run.points:
        if contacts(point) == 0:
            assert abs(complex(1.0 - point.values[0] ** 2, 0.02 * point.values[0])) == pytest.approx(0.1, abs=1e-12)
    assert run.events[0].point.values == pytest.approx([exact, 1.0], abs=1e-10)
    with_contact = [point for point in inside(run) if contacts(point) == 1]
    point = with_contact[len(with_contact) // 2]
    assert at(system, point, "graze", ("omega", "u")) == pytest.approx(point.values[0], abs=1e-9)


class Plane:
    """What ``follow_event`` and ``lies_on`` ask of a plane."""

    window = WINDOW
    width = np.array([high - low for low, high in WINDOW.values()])


class Orbits:
    """What they ask of the orbits of cells."""

    def __init__(self) -> None:
        self.plane, self.family = Plane, family_of(forced(), values_of(forced()), ("omega", "a"))

    def omega(self, values: np.ndarray) -> np.ndarray:
        return values[:, 0]


def located(event: Event, values: np.ndarray) -> PlaneEvent:
    point = event.point
    return PlaneEvent(event.kind, event.conditions[0], point.orbit, point.contacts, values, event.kappa)


@pytest.fixture(scope="module")
def followed() -> FollowedCurve:
    event, start = doubling(forced())
    found = follow_event(Orbits(), located(event, start), 0.02, 1000)  # type: ignore[arg-type]
    assert isinstance(found, FollowedCurve)
    return found


def test_a_curve_with_changes_is_kept_to_the_bit(followed: FollowedCurve) -> None:
    again = curve_from_json(json.loads(json.dumps(curve_as_json(followed))))
    assert [orbit.itinerary for orbit in again.orbits] == [orbit.itinerary for orbit in followed.orbits]
    assert again.conditions == followed.conditions
    for one, other in zip(again.orbits, followed.orbits, strict=True):
        assert np.array_equal(one.times, other.times)
    assert np.array_equal(again.values, followed.values)


def test_an_end_at_which_the_orbit_becomes_another_one_counts_as_its_neighbour(doublings: BranchRun) -> None:
    k = next(k for k, point in enumerate(doublings.points) if point is doublings.events[-1].point)
    ended = with_own_ends(doublings.points[k : k + 4])
    assert contacts(doublings.points[k]) == 1
    assert [contacts(point) for point in ended] == [2, 2, 2, 2]


def test_a_curve_has_the_impacts_of_each_of_its_points(followed: FollowedCurve) -> None:
    made = as_curve(followed, mirrored=False)
    assert made.label == "2-2-0, 2-1-0"
    assert len(made.impacts_upper) == len(made.points)
    assert [corner.kind for corner in made.corners] == ["graze_period_doubling"] * 2


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9])
def test_an_event_beyond_a_change_lies_on_the_curve(followed: FollowedCurve, part: float) -> None:
    k = int(part * len(followed.orbits))
    there = followed.event._replace(
        orbit=followed.orbits[k], contact_times=followed.contact_times[k], values=followed.values[k]
    )
    assert lies_on(Orbits(), there, followed)  # type: ignore[arg-type]
    assert not lies_on(Orbits(), there._replace(values=there.values + 1e-4), followed)  # type: ignore[arg-type]


def test_a_place_on_a_chord_over_a_change_has_the_orbit_of_the_nearer_end(followed: FollowedCurve) -> None:
    k = next(k for k, (a, b) in enumerate(zip(followed.orbits, followed.orbits[1:], strict=False))
             if a.itinerary != b.itinerary)  # fmt: skip
    orbits, values = orbits_beside([CurvePassage(followed, k, 0.2), CurvePassage(followed, k, 0.8)])
    assert [orbit.itinerary for orbit in orbits] == [followed.orbits[j].itinerary for j in (k, k + 1)]
    assert np.array_equal(values, followed.values[k : k + 2])


def test_a_curve_passes_the_edges_within_one_cell_of_it_and_no_others() -> None:
    """A diagonal: the point (5, 5 - 2 d) is d cells away along either axis, nearest at the middle between them."""
    line = SimpleNamespace(places=lambda values: values)
    away = np.array([0.0, 0.9, 1.1, 1.9])
    edges, chords, shares = find_passed_edges(line, np.array([[0.0, 0.0], [4.5, 4.5], [10.0, 10.0]]),
                                   np.stack([np.full(4, 5.0), 5.0 - 2.0 * away], axis=1))  # type: ignore[arg-type]  # fmt: skip
    assert (edges.tolist(), chords.tolist()) == ([0, 1], [1, 0])
    assert shares == pytest.approx([0.5 / 5.5, 4.1 / 4.5])
