"""Curves of events of machines with modes in two parameters: closed forms, and values of tests/data/piecewise.json."""

import json
import math

import numpy as np
import pytest

from atlas.orbits.curves.to_json import orbit_as_json, orbit_from_json
from tests.workers.continuation.test_hybrid_branches import RECORDS, TWO_STOPS, rubbing, soft
from workers.continuation import BranchRun, Event, branch, curve, family_of, orbit_from_state
from workers.model.system import System

pytestmark = pytest.mark.slow


def followed(
    system: System, name: str, kind: str, window: dict[str, tuple[float, float]], **given: float
) -> tuple[Event, BranchRun]:
    """The first event of a kind on the branch in omega through a record's orbit, and its curve over a window."""
    values = {p.name: given.get(p.name, p.default) for p in system.parameters}
    orbit = orbit_from_state(system, values, np.array(RECORDS[name]["state"]), RECORDS[name]["periods"])
    along = branch(family_of(system, values, ("omega",)), orbit, values["omega"], window["omega"])
    event = next(event for event in along.events if event.kind == kind)
    place = np.array([event.point.values[0], *(values[other] for other in window if other != "omega")])
    return event, curve(family_of(system, values, tuple(window)), event, place, window)


def test_a_contact_is_lost_along_the_curve_on_which_the_linear_answer_grazes() -> None:
    """|x| = a omega^2 / |1 - omega^2 + i d omega| = 1 for any damping d, whatever the stiffness of the stop."""
    window = {"omega": (0.7, 0.96), "d": (0.005, 0.2)}
    _, run = followed(soft(), "row 2", "contact_lost", window, omega=0.95)
    assert len(run.points) > 10
    for point in run.points:
        omega, d = point.values
        amplitude = 0.8 / 1.26 * omega**2 / abs(1.0 - omega**2 + 1j * d * omega)
        assert amplitude == pytest.approx(1.0, abs=1e-12)


def test_doublings_of_a_soft_contact_are_those_of_branches() -> None:
    window = {"omega": (0.85, 0.98), "k": (15.0, 40.0)}
    event, run = followed(soft(), "row 2", "period_doubling", window, omega=0.95)
    assert min(abs(point.values[0] - event.point.values[0]) + abs(point.values[1] - 29.0) for point in run.points) < 0.1
    for point in run.points:
        assert np.min(np.abs(point.multipliers + 1.0)) < 1e-9
    values = {p.name: p.default for p in soft().parameters} | {"k": float(run.points[3].values[1])}
    other = branch(
        family_of(soft(), values, ("omega",)), run.points[3].orbit, float(run.points[3].values[0]), (0.85, 0.98)
    )
    at = [event.point.values[0] for event in other.events if event.kind == "period_doubling"]
    assert at == pytest.approx([run.points[3].values[0]], abs=1e-12)


def test_the_onset_of_stick_is_that_of_branches_along_its_curve() -> None:
    """Its first point is known from the oracle."""
    window, lower = {"omega": (0.4, 3.0), "s": (1.01, 1.4)}, RECORDS["row 14, lower"]["machine"]["omega"]
    event, run = followed(rubbing(), "row 14, lower", "stick_onset", window, omega=1.001 * lower, A=1.8, s=1.05)
    assert event.point.values[0] == pytest.approx(lower, abs=1e-12)
    omega, s = run.points[3].values
    values = {p.name: p.default for p in rubbing().parameters} | {"A": 1.8, "s": float(s)}
    other = branch(
        family_of(rubbing(), values, ("omega",)), run.points[3].orbit, 1.001 * omega, (0.9 * omega, 1.1 * omega)
    )
    assert [event.point.values[0] for event in other.events] == pytest.approx([omega], abs=1e-12)


def test_symmetry_breaks_along_a_curve_through_the_oracles_point() -> None:
    system = System.from_mapping(TWO_STOPS.table() | {"stiffness": [["w"]], "parameters": {
        **TWO_STOPS.table()["parameters"], "w": {"default": 1.0, "low": 0.0}}})  # fmt: skip
    window = {"omega": (0.9, 2.0), "w": (0.8, 1.2)}
    event, run = followed(system, "row 9", "symmetry_breaking", window, omega=1.4)
    assert event.point.values[0] == pytest.approx(RECORDS["row 10, SB"]["bifurcation"]["value"], abs=1e-12)
    exact = np.array([event.point.values[0], 1.0])
    assert min(np.max(np.abs(point.values - exact)) for point in run.points) < 1e-10
    assert all(np.min(np.abs(point.multipliers + 1.0)) < 1e-9 for point in run.points)


@pytest.mark.parametrize("name", ["row 12", "row 16"])
def test_an_orbit_comes_back_from_json_as_it_was(name: str) -> None:
    system, values = rubbing(), {"omega": 0.9 if name == "row 12" else 0.4, "s": 1.2 if name == "row 12" else 1.0}
    orbit = orbit_from_state(system, values, np.array(RECORDS[name]["state"]), 1)
    again = orbit_from_json(json.loads(json.dumps(orbit_as_json(orbit))))
    assert again.itinerary == orbit.itinerary
    assert again.times.tolist() == orbit.times.tolist()
    assert math.isfinite(again.speeds[0])
