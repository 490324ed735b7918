"""Curves of bifurcations and grazes in two parameters: closed forms along whole curves, points of codimension two."""

import math
from typing import Any

import numpy as np
import pytest

from tests.reference_machines import (
    CURVES,
    amplitude,
    bouncing_ball,
    impact_pair,
    reference_event,
    reference_name,
    upper_peak,
)
from tests.workers.continuation.test_branches import (
    ball_doubling,
    ball_fold,
    ball_orbit,
    pair_breaking,
    pair_fold,
    pair_orbit,
)
from workers.continuation.branches import BUDGET, CLOSED, EDGE, branch
from workers.continuation.curves import curve
from workers.continuation.events import Event, SolutionPoint
from workers.continuation.extended_system import GRAZE, Condition
from workers.continuation.families import Family, family_of
from workers.continuation.itinerary import Itinerary, Orbit
from workers.model.system import find_system

pytestmark = pytest.mark.slow

TWO_MASS = find_system("two-mass")

ONE_CONDITION = [record for record in CURVES if record["kind"] != "codimension_two" and record["times"]]


def ball_event(kind: str, R: float) -> Event:
    run = branch(bouncing_ball(("A",), R=R), ball_orbit(1.3, R), 1.3, (0.5, 3.0), resolution=0.05)
    return next(event for event in run.events if event.kind == kind)


def pair_event(kind: str, R: float) -> Event:
    run = branch(impact_pair(("alpha",), R=R), pair_orbit(0.3, R), 0.3, (0.03, 0.6), resolution=0.05)
    return next(event for event in run.events if event.kind == kind)


@pytest.mark.parametrize(("kind", "exact"), [("fold", ball_fold), ("period_doubling", ball_doubling)])
def test_a_whole_curve_of_the_bouncing_ball_is_its_closed_form(kind: str, exact: Any) -> None:
    event = ball_event(kind, 0.5)
    family, window = bouncing_ball(("R", "A")), {"R": (0.1, 0.9), "A": (0.01, 5.0)}
    run = curve(family, event, np.array([0.5, event.point.values[0]]), window)
    assert run.ends == (EDGE, EDGE)
    assert {run.points[0].values[0], run.points[-1].values[0]} == {0.1, 0.9}
    assert max(abs(point.values[1] - exact(point.values[0])) for point in run.points) < 1e-12
    assert not run.events


@pytest.mark.parametrize(("kind", "exact"), [("fold", pair_fold), ("symmetry_breaking", pair_breaking)])
def test_a_whole_curve_of_the_impact_pair_is_its_closed_form(kind: str, exact: Any) -> None:
    event = pair_event(kind, 0.6)
    family, window = impact_pair(("R", "alpha")), {"R": (0.2, 0.9), "alpha": (0.001, 3.0)}
    run = curve(family, event, np.array([0.6, event.point.values[0]]), window)
    assert run.ends == (EDGE, EDGE)
    assert max(abs(point.values[1] - exact(point.values[0])) for point in run.points) < 1e-12


def test_a_closed_curve_is_told_and_ends() -> None:
    """The fold of the bouncing ball with A = x^2 + y^2 is a circle."""
    event = ball_event("fold", 0.5)
    ball = bouncing_ball(("A",), R=0.5)
    circle = Family(("x", "y"), lambda rows: ball.model(np.sum(rows**2, axis=1, keepdims=True)), certified=False)
    radius = math.sqrt(ball_fold(0.5))
    window = {"x": (-2.0, 2.0), "y": (-2.0, 2.0)}
    run = curve(circle, event, np.array([0.6 * radius, 0.8 * radius]), window)
    assert run.ends == (CLOSED, CLOSED)
    assert max(abs(math.hypot(*point.values) - radius) for point in run.points) < 1e-12
    angles = np.unwrap([math.atan2(point.values[1], point.values[0]) for point in run.points])
    assert np.ptp(angles) == pytest.approx(2.0 * math.pi, abs=0.2)


@pytest.mark.parametrize("record", ONE_CONDITION, ids=reference_name)
def test_every_curve_of_a_plane_of_b_and_f2_is_b_over_the_amplitude_constant(record: dict[str, Any]) -> None:
    """Without a static load stops see b / |Y(f2)| only."""
    family, event, values = reference_event(record, ("b", "f2"))
    lows = {"b": (0.5 * values[0], 2.0 * values[0]), "f2": (-0.4, 0.4)}
    run = curve(family, event, values, lows, resolution=0.05)
    assert run.ends == (EDGE, EDGE)
    ratios = []
    for point in run.points:
        lin = family.model(point.values[None])
        ratios.append(lin.elements.stops[0, 0, 1] / amplitude(lin)[0])
    assert np.ptp(ratios) < 1e-11 * ratios[0]


def test_the_graze_of_motion_without_impact_is_b_equal_to_the_amplitude() -> None:
    given = {"tau": 0.0}
    family = family_of(TWO_MASS, given, ("omega", "b"))
    lin = family.model(np.array([[1.5, 0.5]]))
    values = np.array([1.5, amplitude(lin)[0]])
    orbit = Orbit(Itinerary((), 1, symmetric=True), np.zeros(0), np.zeros(0))
    point = SolutionPoint(values, orbit, np.array([upper_peak(family, values)]), np.zeros(0, dtype=np.complex128), 0)
    event = Event("graze", (Condition(GRAZE, side=1),), point)
    run = curve(family, event, values, {"omega": (1.0, 3.0), "b": (0.01, 3.0)})
    assert run.ends == (EDGE, EDGE)
    for point in run.points:
        assert point.values[1] == pytest.approx(amplitude(family.model(point.values[None]))[0], abs=1e-12)


def test_a_doubling_curve_ends_at_its_reference_graze() -> None:
    """Truth: the codimension-two point of curves.json, on the doubling through a point beside it."""
    record = next(record for record in CURVES if record.get("conditions") == ["graze 1", "period_doubling"])
    family, both, values = reference_event(record, ("omega", "zeta"))
    run = None
    for kind in ("period_doubling", "graze"):
        condition = both.conditions[0 if kind == "graze" else 1]
        point = both.point if kind == "graze" else both.point._replace(contacts=np.zeros(0))
        near = values + np.array([1e-3, 1e-3 if kind == "graze" else 0.0])
        for sign in (1.0, -1.0):
            try:
                run = curve(
                    family,
                    Event(kind, (condition,), point),
                    values + sign * (near - values),
                    {"omega": (2.2, 2.35), "zeta": (0.1, 0.14)},
                    resolution=0.1,
                )
            except ValueError:
                continue
            found = [event.point.values for event in run.events if event.kind == "graze_period_doubling"]
            if found:
                assert min(np.abs(value - values).max() for value in found) < 1e-11
                break
        else:
            pytest.fail(f"the curve of the {kind} does not meet the point")


def test_a_neimark_sacker_curve_ends_at_two_strong_resonances_where_doublings_meet_it() -> None:
    """The doubling of the same orbit passes the same points 1:2, where a second multiplier is -1."""
    window = {"omega": (0.5, 4.5), "b": (0.02, 1.5)}
    pairs = next(record for record in CURVES if record["kind"] == "neimark_sacker" and not record["half_map"])
    family, event, values = reference_event(pairs, ("omega", "b"))
    run = curve(family, event, values, window)
    assert run.ends == ("resonance_1_2", "resonance_1_2")
    doublings = next(record for record in CURVES if record["point"]["omega"] == "3.3343080214883709")
    family, event, values = reference_event(doublings, ("omega", "b"))
    met = [e.point.values for e in curve(family, event, values, window).events if e.kind == "resonance_1_2"]
    for end in run.events:
        assert min(np.abs(end.point.values - other).max() for other in met) < 1e-10


def test_a_resonance_of_order_three_is_passed() -> None:
    record = next(record for record in CURVES if record["kind"] == "neimark_sacker" and record["half_map"])
    family, event, values = reference_event(record, ("omega", "b"))
    run = curve(family, event, values, {"omega": (2.8, 4.5), "b": (0.02, 1.5)})
    third = next(event for event in run.events if event.kind == "resonance_1_3")
    mu = third.point.multipliers
    assert np.min(np.abs(mu - np.exp(2j * np.pi / 3))) < 1e-10


def test_the_other_way_of_a_pair_starts_with_the_pair_of_the_start() -> None:
    """At the far end of the first way another pair is nearer: both ways must reach the window's edge."""
    record = next(record for record in CURVES if record["kind"] == "neimark_sacker" and record["half_map"])
    family, event, values = reference_event(record, ("omega", "R"))
    run = curve(family, event, values, {"omega": (0.5, 4.5), "R": (0.2, 0.999)})
    assert run.ends == (EDGE, EDGE)
    for point in run.points:
        assert np.min(np.abs(np.abs(point.multipliers) - 1.0)) < 1e-11


def test_a_symmetry_breaking_with_a_fold_is_a_fold_flip() -> None:
    record = next(record for record in CURVES if record["point"]["b"] == "0.33")
    family, event, values = reference_event(record, ("omega", "zeta"))
    run = curve(family, event, values, {"omega": (0.5, 4.5), "zeta": (0.005, 0.1)})
    both = next(event for event in run.events if event.kind == "fold_flip")
    mu = both.point.multipliers
    assert np.min(np.abs(mu - 1.0)) < 1e-9
    assert np.min(np.abs(mu + 1.0)) < 1e-9


def test_a_graze_passes_the_reference_fold_of_a_long_orbit() -> None:
    """Truth: the codimension-two point of curves.json with eight impacts in three periods."""
    record = next(record for record in CURVES if record.get("conditions") == ["graze 1", "fold"])
    family, both, values = reference_event(record, ("omega", "R"))
    graze = Event("graze", both.conditions[:1], both.point)
    window = {"omega": (2.43, 2.435), "R": (0.417, 0.42)}
    for shift in (1e-5, -1e-5):
        run = curve(family, graze, values * (1.0 + shift), window, resolution=0.1)
        met = [event.point.values for event in run.events if event.kind == "graze_fold"]
        assert min(np.abs(value - values).max() for value in met) < 1e-11


def test_a_spent_budget_is_told() -> None:
    event = ball_event("fold", 0.5)
    window = {"R": (0.1, 0.9), "A": (0.01, 5.0)}
    run = curve(bouncing_ball(("R", "A")), event, np.array([0.5, event.point.values[0]]), window, budget=4)
    assert run.ends == (BUDGET, BUDGET)


def test_newton_takes_about_two_steps_a_point() -> None:
    record = CURVES[4]
    family, event, values = reference_event(record, ("omega", "b"))
    run = curve(family, event, values, {"omega": (2.2, 2.9), "b": (0.1, 0.2)})
    assert run.newton_steps <= 2.5 * len(run.points)


def test_a_window_without_width_is_refused_in_one_line() -> None:
    record = CURVES[4]
    family, event, values = reference_event(record, ("omega", "b"))
    with pytest.raises(ValueError, match=r"window of b: found \(0\.2, 0\.1\)"):
        curve(family, event, values, {"omega": (2.2, 2.9), "b": (0.2, 0.1)})
