"""Branches of periodic orbits in one parameter: closed forms of folds, doublings and symmetry breakings; both ways."""

import math
from itertools import cycle

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.reference_machines import (
    CURVES,
    bouncing_ball,
    impact_pair,
    reference_event,
    reference_orbit,
    reference_values,
)
from tests.support.oracle.free_mass import (
    bouncing_ball_doubling,
    bouncing_ball_fold,
    impact_pair_fold,
    impact_pair_symmetry_breaking,
)
from workers.continuation.branches import BUDGET, EDGE, BranchRun, branch, switch_branch
from workers.continuation.families import family_of
from workers.continuation.floquet import multipliers
from workers.continuation.itinerary import Itinerary, Orbit
from workers.continuation.orbits import orbit_from_state
from workers.continuation.shooting import OrbitMotion
from workers.model.system import find_system
from workers.settings import Settings
from workers.tile import solve_tile

pytestmark = pytest.mark.slow

TWO_MASS = find_system("two-mass")


def ball_fold(R: float) -> float:
    return float(bouncing_ball_fold(R))


def ball_doubling(R: float) -> float:
    return float(bouncing_ball_doubling(R))


def pair_fold(R: float) -> float:
    """alpha, where the distance of the stops is 1."""
    return float(1 / impact_pair_fold(R))


def pair_breaking(R: float) -> float:
    return float(1 / impact_pair_symmetry_breaking(R))


def ball_orbit(A: float, R: float) -> Orbit:
    """The orbit of period 1 with A cos t = pi (1 - R)/(1 + R)."""
    t = math.acos(math.pi * (1.0 - R) / (1.0 + R) / A)
    v = -2.0 * math.pi / (1.0 + R)
    return Orbit(Itinerary((-1,), 1), np.array([t]), np.array([v]))


def pair_orbit(alpha: float, R: float) -> Orbit:
    """The symmetric orbit with 2 sin t + pi rho cos t = -1 / alpha for the phase t of the upper impact."""
    rho = (1.0 + R) / (1.0 - R)
    size, angle = math.hypot(2.0, math.pi * rho), math.atan2(2.0, math.pi * rho)
    t = angle + math.acos(-1.0 / (alpha * size))
    speed = 2.0 * alpha * abs(math.cos(t)) / (1.0 - R)
    return Orbit(Itinerary((1,), 1, symmetric=True), np.array([t]), np.array([speed]))


def kinds(run: BranchRun) -> list[str]:
    return [event.kind for event in run.events]


@pytest.mark.parametrize("R", [0.2, 0.5, 0.85])
def test_the_bouncing_ball_folds_and_doubles_where_its_closed_form_does(R: float) -> None:
    fold, doubling = ball_fold(R), ball_doubling(R)
    middle = 0.5 * (fold + doubling)
    run = branch(bouncing_ball(("A",), R=R), ball_orbit(middle, R), middle, (0.5 * fold, 2.0 * doubling))
    assert run.ends == (EDGE, EDGE)
    assert sorted(kinds(run)) == ["fold", "period_doubling"]
    found = {event.kind: event.point for event in run.events}
    assert found["fold"].values[0] == pytest.approx(fold, abs=1e-12)
    assert found["period_doubling"].values[0] == pytest.approx(doubling, abs=1e-12)
    assert found["period_doubling"].multipliers == pytest.approx([-1.0, -(R**2)], abs=1e-11)
    assert sorted(abs(found["fold"].multipliers)) == pytest.approx([R**2, 1.0], abs=1e-6)
    assert {point.unstable for point in run.points} == {0, 1}


@pytest.mark.parametrize("R", [0.3, 0.6, 0.8])
def test_the_impact_pair_folds_and_breaks_its_symmetry_where_its_closed_form_does(R: float) -> None:
    fold, breaking = pair_fold(R), pair_breaking(R)
    middle = 0.5 * (fold + breaking)
    run = branch(impact_pair(("alpha",), R=R), pair_orbit(middle, R), middle, (0.5 * fold, 2.0 * breaking))
    found = {event.kind: event.point for event in run.events}
    assert found["fold"].values[0] == pytest.approx(fold, abs=1e-12)
    assert found["symmetry_breaking"].values[0] == pytest.approx(breaking, abs=1e-12)
    for point in run.points:
        product = np.prod(point.multipliers).real
        assert product == pytest.approx(R**2, abs=1e-12 * max(1.0, abs(point.multipliers[0]) ** 2))


def test_the_asymmetric_branch_leaves_and_comes_back_at_the_symmetry_breaking() -> None:
    family = impact_pair(("alpha",), R=0.6)
    run = branch(family, pair_orbit(0.3, 0.6), 0.3, (0.2, 0.6))
    event = next(event for event in run.events if event.kind == "symmetry_breaking")
    start = switch_branch(family, event, 0.4)
    assert len(start.orbit.itinerary.sides) == 2
    side = branch(family, start.orbit, start.value, (0.2, 0.6))
    assert "symmetry_breaking" in side.ends
    met = next(event for event in side.events if event.kind == "symmetry_breaking")
    assert met.point.values[0] == pytest.approx(pair_breaking(0.6), abs=1e-12)


def test_the_stability_of_a_branch_changes_at_its_events_alone_though_multipliers_beside_them_flicker(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Towards a symmetry breaking the multiplier of an asymmetric orbit is 1 to rounding, on either side of it."""
    signs = cycle((1.0, -1.0))

    def flickering(motion: OrbitMotion) -> NDArray[np.complex128]:
        exact = multipliers(motion)
        return np.where(np.abs(np.abs(exact) - 1.0) < 1e-6, exact * (1.0 + 2e-6 * next(signs)), exact)

    monkeypatch.setattr("workers.continuation.events.multipliers", flickering)
    state = solve_tile("two-mass", {"omega": 2.97}, Settings(max_periods=2000, survival=0))["state"]
    orbit = orbit_from_state(TWO_MASS, {"omega": 2.97}, state, 1)
    family = family_of(TWO_MASS, {}, ("omega",))
    (event,) = branch(family, orbit, 2.97, (2.95, 3.05)).events
    value = float(event.point.values[0]) - 3e-6
    beside = branch(family, orbit, 2.97, (2.95, value)).points[-1]
    run = branch(family, beside.orbit, value, (value - 2e-6, value + 6e-6))
    assert kinds(run) == ["symmetry_breaking"]
    near = [point for point in run.points if np.min(np.abs(point.multipliers - 1.0)) < 1e-5]
    assert len(near) > 10
    assert {point.unstable for point in run.points} == {0}


def test_branches_of_the_two_mass_system_join_at_their_events() -> None:
    """R = 0.917, b = 0.15: the asymmetric orbit is born at a symmetry breaking, doubles, and ends at a graze."""
    record = CURVES[4]
    family = family_of(TWO_MASS, reference_values(record), ("omega",))
    run = branch(family, reference_orbit(record), float(record["params"]["omega"]) + 0.1, (1.5, 4.0))
    assert sorted(kinds(run)) == ["graze", "period_doubling", "symmetry_breaking"]
    assert sorted(run.ends) == ["graze", "symmetry_breaking"]
    doubling = next(event for event in run.events if event.kind == "period_doubling")
    assert doubling.point.values[0] == pytest.approx(float(record["point"]["omega"]), abs=1e-12)
    start = switch_branch(family, doubling, 2.5)
    assert start.orbit.itinerary.periods == 2
    doubled = branch(family, start.orbit, start.value, (1.5, 4.0))
    assert "period_doubling" in doubled.ends
    back = next(
        event
        for event in doubled.events
        if event.kind == "period_doubling" and event.point.orbit.itinerary.periods == 1
    )
    assert back.point.values[0] == pytest.approx(doubling.point.values[0], abs=1e-11)


@pytest.mark.parametrize(
    "index", [k for k, record in enumerate(CURVES) if record["times"] and record["kind"] != "codimension_two"]
)
def test_a_branch_passes_the_reference_event(index: int) -> None:
    """Started beside it where it exists, the branch finds the event by itself to 1e-10."""
    record = CURVES[index]
    name = record["free"][0]
    family, event, values = reference_event(record, (name,))
    exact = values[0]
    for shift in (1e-3, -1e-3):
        try:
            run = branch(family, event.point.orbit, exact * (1.0 + shift), (0.95 * exact, 1.05 * exact), budget=60)
        except ValueError:
            continue  # beyond the fold or the graze there is no orbit
        found = [e.point.values[0] for e in run.events if e.kind == record["kind"]]
        if found and min(abs(value - exact) for value in found) < 1e-10:
            return
    pytest.fail("the event is not on the branch")


@pytest.mark.parametrize("index", [k for k, record in enumerate(CURVES) if record["kind"] == "period_doubling"])
def test_a_branch_stays_in_a_window_of_neighbouring_doubles(index: int) -> None:
    """A step of the walk changes no unknown there by more than rounding, and leads nowhere."""
    record = CURVES[index]
    family, event, values = reference_event(record, ("omega",))
    for start in (1.0 + np.linspace(-1e-3, 1e-3, 20)) * values[0]:
        window = float(start), float(np.nextafter(start, 9.0))
        try:
            run = branch(family, event.point.orbit, window[0], window)
        except ValueError:
            continue  # the orbit is the halved or the doubled one there
        assert all(window[0] <= point.values[0] <= window[1] for point in run.points)


def test_a_start_outside_of_the_window_is_refused_in_one_line() -> None:
    with pytest.raises(ValueError, match=r"^A: found 1\.2, must be in 0\.5\.\.1$"):
        branch(bouncing_ball(("A",), R=0.5), ball_orbit(1.2, 0.5), 1.2, (0.5, 1.0))


def test_a_spent_budget_is_told() -> None:
    run = branch(bouncing_ball(("A",), R=0.5), ball_orbit(1.2, 0.5), 1.2, (0.5, 3.0), budget=3)
    assert run.ends == (BUDGET, BUDGET)
    assert len(run.points) == 7


def test_newton_takes_about_two_steps_a_point_away_from_a_graze() -> None:
    record = CURVES[4]
    family = family_of(TWO_MASS, reference_values(record), ("omega",))
    run = branch(family, reference_orbit(record), float(record["params"]["omega"]) + 0.1, (2.2, 4.0))
    assert run.newton_steps <= 3 * len(run.points)


def test_a_symmetric_orbit_given_as_asymmetric_is_refused_in_one_line() -> None:
    whole, orbit = impact_pair(("alpha",), R=0.6), pair_orbit(0.2, 0.6)
    times = np.concatenate([orbit.times, orbit.times + np.pi])
    twice = Orbit(Itinerary((1, -1), 1), times, np.concatenate([orbit.speeds, -orbit.speeds]))
    with pytest.raises(ValueError, match="repeats a shorter or symmetric orbit"):
        branch(whole, twice, 0.2, (0.1, 0.6))


@pytest.mark.parametrize("resolution", [0.02, 0.1, 0.25, 0.5, 1.0])
def test_a_pair_that_leaves_the_unit_circle_and_returns_through_minus_one_within_a_step_is_seen(
    resolution: float,
) -> None:
    """Both may change no sign together: the pair is real when it returns, and its product is below 1 again."""
    given = {"omega": 3.6764705882352944, "b": 0.09231481481481482, "R": 0.8, "tau": 0.0}
    values = {p.name: given.get(p.name, p.default) for p in TWO_MASS.parameters}
    arrays = solve_tile(TWO_MASS, values, Settings())
    orbit = orbit_from_state(TWO_MASS, values, arrays["state"][()], 1)
    run = branch(family_of(TWO_MASS, values, ("b",)), orbit, values["b"], (0.05, 0.0924), resolution=resolution)
    assert kinds(run) == ["graze", "period_doubling", "neimark_sacker"]
