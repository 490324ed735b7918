"""The thirty rows of tests/data/piecewise.json through a cell's whole course, from states near the oracle's orbits."""

import functools
import math

import numpy as np
import pytest

from tests.support.oracle.piecewise import PiecewiseMachine
from tests.support.solver_bridge import machines_of
from tests.workers.kernel.test_hybrid_orbits import RECORDS, machine_in
from workers import Settings
from workers.cell.cell_batch import CellBatch, Results
from workers.cell.solve import solve
from workers.model.mode_table import build_hybrid
from workers.results import NO_IMPACT, PERIODIC, QUASIPERIODIC, REASONS, result_variables
from workers.tile import result_arrays

NEAR = 1e-3
"""How far off the orbit cells begin."""

FOUND = [
    name
    for name, record in RECORDS.items()
    if record["periods"] and record["drift"] is None and abs(complex(*record["multipliers"][0])) < 1.0 - 1e-6
    and record.get("bifurcation", {}).get("kind") != "graze"
]  # fmt: skip
"""Stable orbits that a forcing closes."""

each_found = pytest.mark.parametrize("name", FOUND)


@functools.cache
def cell_of(name: str) -> Results:
    """The cell of a record, as arrays of one; none of its masses begins on a stop or sticking."""
    record, settings = RECORDS[name], Settings(exponents="spectrum")
    machine = machine_in(record) if record["periods"] else PiecewiseMachine.of(record["machine"])
    state = np.array(record["state"])
    oscillators, reasons = build_hybrid(machines_of([machine]))
    found = result_arrays(result_variables(settings), settings, 1, len(state))
    solve(CellBatch(oscillators, reasons, (state - NEAR)[None], settings, found))  # type: ignore[arg-type]
    return found


def exponents_in(name: str) -> list[float]:
    record = RECORDS[name]
    moduli = [abs(complex(*pair)) for pair in record["multipliers"]]
    return [math.log(modulus) / record["periods"] if modulus else -math.inf for modulus in moduli]


@each_found
def test_the_cell_is_periodic_with_the_period_of_the_orbit(name: str) -> None:
    """Where phases are all that happens there is nothing to strike or to rub on."""
    cell, machine = cell_of(name), machine_in(RECORDS[name])
    regime = PERIODIC if machine.contacts or machine.friction else NO_IMPACT
    assert cell["regime"][0] == regime, REASONS[cell["reason"][0]].text
    assert cell["period"][0] == RECORDS[name]["periods"]


@each_found
def test_its_exponents_are_logarithms_of_the_multipliers(name: str) -> None:
    np.testing.assert_allclose(cell_of(name)["spectrum"][0], exponents_in(name), rtol=0.0, atol=1e-10)
    assert cell_of(name)["largest"][0] == pytest.approx(exponents_in(name)[0], abs=1e-10)


@each_found
def test_its_exponents_obey_the_sum_law(name: str) -> None:
    defect = cell_of(name)["sum_law_defect"][0]
    assert math.isnan(defect) if "sum" not in RECORDS[name] else abs(defect) < 1e-12


def rests_in(name: str) -> list[tuple[float, float]]:
    """When a mass comes to rest on a stop and when it leaves: the solver rests from where a chatter is sure to end."""
    events = RECORDS[name]["events"]
    rests, leaves = ([t for t, kind, *_ in events if kind == which] for which in ("rest", "leave"))
    return list(zip(rests, leaves, strict=True))


def stuck_in(name: str) -> float:
    """Share of time for which friction sticks or, where there is none, a mass rests."""
    machine = machine_in(RECORDS[name])
    period = 2.0 * math.pi / float(machine.omega)
    resting = sum((b - a) % period for a, b in rests_in(name)) / period
    return float(sum(RECORDS[name]["measures"]["stick_fraction"])) if machine.friction else resting


@each_found
def test_it_sticks_for_the_share_of_time_that_the_oracle_says(name: str) -> None:
    assert cell_of(name)["stuck_fraction"][0] == pytest.approx(stuck_in(name), abs=1e-10)


@each_found
def test_it_counts_the_contacts_of_the_orbit(name: str) -> None:
    """Impacts and hits of soft contacts on either side; -1 where a mass rests on a stop."""
    record, cell = RECORDS[name], cell_of(name)
    assert cell["sticks"][0] == ("sum" not in record)
    if rests_in(name):
        assert (cell["impacts_upper"][0], cell["impacts_lower"][0]) == (-1, -1)
        return
    speeds = [value for _, kind, _, value in record["events"] if kind in ("impact", "hit")]
    assert cell["impacts_upper"][0] == sum(value > 0.0 for value in speeds)
    assert cell["impacts_lower"][0] == sum(value < 0.0 for value in speeds)


@each_found
def test_its_state_is_one_of_the_orbit(name: str) -> None:
    """Of an orbit of several periods the cell may end at another section."""
    record = RECORDS[name]
    if record["periods"] == 1:
        np.testing.assert_allclose(cell_of(name)["state"][0], record["state"], rtol=0.0, atol=1e-12)


def test_a_graze_without_penetration_is_motion_without_impact() -> None:
    cell = cell_of("row 1, omega 1.655")
    assert cell["regime"][0] == NO_IMPACT
    np.testing.assert_allclose(cell["spectrum"][0], exponents_in("row 1, omega 1.655"), rtol=0.0, atol=1e-12)


def test_an_unforced_cycle_looks_like_a_torus_to_a_section_at_another_period() -> None:
    cell = cell_of("row 17")
    assert cell["regime"][0] == QUASIPERIODIC
    assert cell["largest"][0] == pytest.approx(0.0, abs=1e-4)
    assert cell["spectrum"][0, 1] == -math.inf
