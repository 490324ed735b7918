"""Claims about curves in two parameters of machines without a force. Truth: closed forms, and branches across them."""

import math
from typing import Any

import numpy as np
import pytest

from tests.workers.continuation.test_cycle_branches import belt, flutter, followed
from tests.workers.continuation.test_equilibria import chords_of, machine
from workers import System
from workers.continuation import BranchRun, curve, family_of
from workers.continuation.equilibria import equilibria, equilibrium_of
from workers.continuation.hopf import hopf_curve

E = np.exp


def values_of(run: BranchRun) -> np.ndarray:
    return np.array([point.values for point in run.points])


def test_the_curve_at_which_the_cycle_on_the_belt_ends_is_that_of_its_closed_form() -> None:
    """Row 18 at any damping: u = x - .4 slips from 1 - c V - .4 at V and comes back to V as its acceleration is 0."""
    run, _ = followed(belt(), "u", (0.3, 1.2), x=1.5)
    window = {"u": (0.2, 2.5), "c": (0.05, 0.3)}
    family = family_of(belt(), {"x": 1.5}, ("u", "c"))
    found = curve(family, run.events[0], np.array([run.events[0].point.values[0], 0.1]), window)
    assert found.ends == ("edge", "edge")
    V, c = values_of(found).T
    assert np.ptp(c) == pytest.approx(0.25, rel=1e-9)
    slip = np.array([float(p.orbit.length) - p.orbit.times[1] for p in found.points])
    eta = 0.5 * c
    w, u = np.sqrt(1.0 - eta**2), 0.6 - c * V
    cos, sin, decay = np.cos(w * slip), np.sin(w * slip) / w, E(-eta * slip)
    place, speed = decay * (cos * u + sin * (V + eta * u)), decay * (cos * V - sin * (eta * V + u))
    np.testing.assert_allclose(speed, V, atol=1e-10)
    np.testing.assert_allclose(place + c * speed, 0.0, atol=1e-10)


@pytest.mark.slow
def test_a_curve_of_folds_passes_the_folds_of_branches_across_it() -> None:
    system = flutter(lower=-0.5)
    run, _ = followed(system, "P", (1.6, 1.9))
    fold = next(event for event in run.events if event.kind == "fold" and event.point.values[0] > 1.645)
    family = family_of(system, {}, ("P", "d"))
    window = {"P": (1.5, 1.8), "d": (0.45, 0.55)}
    found = curve(family, fold, np.array([fold.point.values[0], 0.5]), window)
    assert all(np.min(np.abs(point.multipliers - 1.0)) < 1e-7 for point in found.points)
    at = min(found.points, key=lambda point: abs(point.values[1] - 0.52))
    across, _ = followed(system, "P", (1.6, 1.9), d=float(at.values[1]))
    folds = [float(event.point.values[0]) for event in across.events if event.kind == "fold"]
    assert min(abs(fold - at.values[0]) for fold in folds) < 1e-9


def hopf_of(system: System, along: str, other: str, window: dict[str, tuple[float, float]], **given: float) -> Any:
    """The curve of the only Hopf point along a parameter."""
    values = {parameter.name: parameter.default for parameter in system.parameters} | given
    orbit = equilibrium_of(system, values, np.array([values[name] for name in system.states]))
    (event,) = equilibria(family_of(system, values, (along,)), orbit, values[along], window[along]).run.events
    start = np.array([event.point.values[0], values[other]])
    family = family_of(system, values, (along, other))
    return hopf_curve(family, event.point.orbit, start, window, resolution=0.05)


def test_the_curve_of_flutter_is_its_closed_form() -> None:
    """A6: P = 41/28 + c^2/2, at the frequency sqrt(2/7) everywhere."""
    system = System.from_mapping({
        "name": "flutter", "coordinates": ["x1", "x2"], "mass": [[3.0, 1.0], [1.0, 1.0]],
        "damping": [["2*c", "-c"], ["-c", "c"]], "stiffness": [["2 - P", "P - 1"], [-1.0, 1.0]],
        "contacts": [{"name": "rub", "gap": [0.0, 1.0], "upper": 0.5, "lower": -0.5, "stiffness": 10.0}],
        "parameters": {"P": 1.3, "c": 0.2},
    })  # fmt: skip
    found = hopf_of(system, "P", "c", {"P": (1.3, 1.7), "c": (0.1, 0.5)})
    P, c = values_of(found).T
    assert found.ends == ("edge", "edge")
    assert {float(np.min(c)), float(np.max(c))} == {0.1, 0.5}
    np.testing.assert_allclose(P, 41.0 / 28.0 + 0.5 * c**2, atol=1e-9)
    periods = [float(point.orbit.length) for point in found.points]
    np.testing.assert_allclose(periods, 2.0 * math.pi / math.sqrt(2.0 / 7.0), rtol=1e-6)


def test_the_curve_of_a_law_in_segments_goes_round_its_corners() -> None:
    """Sliding is stable where the slope of the segment exceeds -c: each point is at a vertex, or at such a c."""
    h = 0.25
    system = machine(damping=[["c"]], friction=[chords_of(h)], parameters={"u": 1.3, "c": 0.1, "x": 0.55})
    found = hopf_of(system, "u", "c", {"u": (0.3, 1.9), "c": (0.05, 0.3)})
    u, c = values_of(found).T
    slopes = 0.5 * np.diff(E(-2.0 * h * np.arange(17))) / h
    at_vertex = np.abs(u / h - np.round(u / h)) < 1e-9
    at_slope = np.min(np.abs(c[:, None] + slopes), axis=1) < 1e-9
    assert np.all(at_vertex | at_slope)
    assert np.any(at_vertex & ~at_slope)
    assert np.any(at_slope & ~at_vertex)
    assert found.ends == ("edge", "edge")
