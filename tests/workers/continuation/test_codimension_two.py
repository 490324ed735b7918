"""Points of codimension two on curves, against closed forms: a cusp of folds, two grazes at once."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from workers.continuation import Condition, Event, Itinerary, Orbit, SolutionPoint, curve, family_of
from workers.continuation.branches import branch
from workers.continuation.extended_system import GRAZE, UNIT
from workers.continuation.families import Family
from workers.model.system import System, find_system

R, PHI = 0.5, 1.0
"""Restitution of the ball on a table that shakes in two harmonics, and the phase of the second one."""


def two_tones() -> Family:
    """A ball above a table, y'' = -1 + A sin t + 2 B sin(2 t + PHI): then Y' = -A cos t - B cos(2 t + PHI)."""
    tones = {
        "name": "two-tones", "coordinates": ["y"], "mass": [[1.0]], "force": ["A"], "load": [-1.0], "gap": [1.0],
        "lower": 0.0, "restitution": R, "harmonics": [{"order": 2, "force": ["2 * B"], "phase": [PHI]}],
        "parameters": {"omega": {"default": 1.0}, "A": {"default": 1.0}, "B": {"default": 1.0}},
    }  # fmt: skip
    return family_of(System.from_mapping(tones), {}, ("A", "B"))._replace(certified=False)


def fold(t: float) -> tuple[float, float]:
    """(A, B) where the orbit of one impact a period, at time t, folds.

    Balance gives (1 + R) |v| = 2 pi; between kicks that are alike y' is (1 - R) v / 2 off Y', so that
    -Y'(t) = pi (1 - R) / (1 + R); two orbits meet where Y''(t) = 0.
    """
    rows = [[math.cos(t), math.cos(2.0 * t + PHI)], [math.sin(t), 2.0 * math.sin(2.0 * t + PHI)]]
    A, B = np.linalg.solve(rows, [math.pi * (1.0 - R) / (1.0 + R), 0.0])
    return float(A), float(B)


def bend(t: float) -> float:
    """Y three times differentiated at the fold of time t, up to a factor: zero where three orbits meet."""
    return math.sin(2.0 * t + PHI) * math.cos(t) - 2.0 * math.cos(2.0 * t + PHI) * math.sin(t)


def test_two_folds_meet_at_the_cusp_of_a_ball_on_a_table_of_two_tones() -> None:
    at = float(brentq(bend, 1.9, 2.0, xtol=1e-15))
    exact = np.array(fold(at))
    v, start = -2.0 * math.pi / (1.0 + R), np.array(fold(0.0))
    orbit = Orbit(Itinerary((-1,), 1), np.zeros(1), np.array([v]))
    event = Event(
        "fold", (Condition(UNIT),), SolutionPoint(start, orbit, np.zeros(0), np.zeros(0, dtype=np.complex128), 0)
    )
    run = curve(two_tones(), event, start, {"A": (-5.0, 1.5), "B": (-3.0, 1.0)})
    cusps = [met.point for met in run.events if met.kind == "cusp"]
    assert [point.values for point in cusps] == [pytest.approx(exact, abs=1e-9)]
    assert math.remainder(float(cusps[0].orbit.times[0]) - at, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-6)
    distances = [float(np.linalg.norm(point.values - fold(float(point.orbit.times[0])))) for point in run.points]
    assert max(distances) < 1e-11


def test_motion_without_impact_grazes_both_stops_at_once_where_these_are_alike() -> None:
    """In the plane of s, upper clearance over lower one, and b: the upper stop is grazed along b = |Y| up to s = 1."""
    system, given = find_system("single-mass"), {"omega": 0.8, "A": 0.4, "zeta": 0.02}
    amplitude = given["A"] / abs(complex(1.0 - given["omega"] ** 2, 2.0 * given["zeta"] * given["omega"]))
    free, still = ("s", "b"), Orbit(Itinerary((), 1), np.zeros(0), np.zeros(0))
    down = branch(family_of(system, given | {"s": 0.5}, ("b",)), still, 1.5 * amplitude, (0.5, 2.0))
    (graze,) = down.events
    assert graze.conditions == (Condition(GRAZE, side=1),)
    start = np.array([0.5, graze.point.values[0]])
    run = curve(family_of(system, given, free), graze, start, {"s": (0.2, 1.5), "b": (0.5, 2.0)})
    assert run.ends == ("edge", "double_graze")
    (both,) = run.events
    assert both.point.values == pytest.approx([1.0, amplitude], abs=1e-10)
    apart = math.remainder(float(np.diff(both.point.contacts)[0]) * given["omega"], 2.0 * math.pi)
    assert abs(apart) == pytest.approx(math.pi, abs=1e-9)
