"""Claims about a coordinate that drifts: what it advances by, and that nothing else knows where it is."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

from tests.support.solver_bridge import built, follow, machines_of
from tests.workers.cell.test_hybrid_cells import exponents_in
from tests.workers.kernel.test_hybrid_orbits import RECORDS, machine_in, number_in
from workers import Settings, System, solve_tile, trace
from workers.cell.cell_batch import CellBatch, Results
from workers.cell.solve import solve
from workers.continuation.families import family_of
from workers.model.entries import DefinitionError
from workers.model.mode_table import build_hybrid
from workers.model.system import find_system
from workers.results import (
    CHAOTIC,
    FAILED,
    INVALID,
    NO_IMPACT,
    NO_OSCILLATOR,
    NO_REASON,
    PERIODIC,
    REASONS,
    RUNS_AWAY,
    result_variables,
)
from workers.results import DRIFT_PER_PERIOD as ADVANCE
from workers.tile import result_arrays

SPECTRUM = Settings(exponents="spectrum", survival=0, max_periods=3000)
ROW = RECORDS["row 29"]
DRIFTS = ROW["drift"]
PROGRESS = ROW["measures"]["progress"][DRIFTS]
ROW_IN_UNITS_OF_FRICTION = {"omega": 0.9, "alpha": 2.0, "delta": 0.04, "xi": 0.05, "tau": 0.5 * math.pi}
OUT_OF_REACH = 100.0
"""A clearance that the mass in the capsule never takes up."""

BLOCK = """
[system]
name = "block"
coordinates = ["x"]
mass = [[2.0]]
damping = [[0.3]]
force = ["A"]
load = [1.0]
drift = "x"
[[system.friction]]
name = "slope"
row = [1.0]
kinetic = "f"
[system.parameters]
A = { default = 0.5 }
f = { default = 0.4 }
"""


@functools.cache
def cell_of_row(off: float) -> Results:
    """The cell of row 29, from a start so far off the oracle's orbit."""
    machine, state = machine_in(ROW), np.array(ROW["state"])
    oscillators, reasons = build_hybrid(machines_of([machine], DRIFTS))
    variables = (*result_variables(SPECTRUM), ADVANCE)
    found = result_arrays(variables, SPECTRUM, 1, len(state), exponents=len(state) - 1)
    solve(CellBatch(oscillators, reasons, (state - off)[None], SPECTRUM, found))  # type: ignore[arg-type]
    return found


@functools.cache
def capsule(settings: Settings = SPECTRUM, **values: float) -> Results:
    return solve_tile("capsule", values, settings)


def test_the_capsule_of_the_oracle_advances_in_each_period_by_what_the_oracle_says() -> None:
    cell = cell_of_row(1e-3)
    assert (cell["regime"][0], cell["period"][0]) == (PERIODIC, 1)
    assert cell["drift_per_period"][0] == pytest.approx(PROGRESS, abs=1e-13)
    assert cell["stuck_fraction"][0] == pytest.approx(ROW["measures"]["stick_fraction"][0], abs=1e-12)


def test_its_exponents_are_those_of_the_oracle_but_for_the_zero_of_the_drift() -> None:
    known = exponents_in("row 29")
    assert known[0] == 0.0
    np.testing.assert_allclose(cell_of_row(1e-3)["spectrum"][0], known[1:], rtol=0.0, atol=1e-11)


def test_its_state_is_that_of_the_oracle_with_the_capsule_at_zero() -> None:
    np.testing.assert_allclose(cell_of_row(1e-3)["state"][0], ROW["state"], rtol=0.0, atol=1e-12)
    assert cell_of_row(1e-3)["state"][0, DRIFTS] == 0.0


def test_where_a_motion_begins_does_not_matter() -> None:
    for name, values in cell_of_row(1e-3).items():
        if name not in ("periods_used", "error"):
            np.testing.assert_allclose(cell_of_row(0.5)[name], values, rtol=0.0, atol=1e-11, err_msg=name)


def test_the_packaged_capsule_is_that_of_the_oracle_in_units_of_its_friction() -> None:
    assert capsule(**ROW_IN_UNITS_OF_FRICTION)["drift_per_period"] == pytest.approx(2.0 * PROGRESS, abs=1e-12)


def test_a_history_shows_how_far_it_has_crept() -> None:
    """Against the loop through modes, which resets nothing."""
    machine, state = machine_in(ROW), np.add(ROW["state"], [-0.3, 7.0, 0.1, 0.2])
    kept = follow(built(machine), state, number_in(ROW), 20)
    start = dict(zip(("r", "x2", "v", "v2"), (2.0 * state).tolist(), strict=True))
    history = trace("capsule", ROW_IN_UNITS_OF_FRICTION | start, 20)
    np.testing.assert_allclose(history.states, 2.0 * np.array(kept.sections), rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("omega", [0.5, 0.9, 1.4])
def test_a_capsule_whose_mass_pushes_less_than_friction_stays_where_it_is(omega: float) -> None:
    """The largest force on it, where the stop is out of reach: alpha sqrt((1 + d^2) / ((1 - omega^2)^2 + d^2))."""
    d = 2.0 * 0.05 * omega
    most = math.sqrt(((1.0 - omega**2) ** 2 + d**2) / (1.0 + d**2))
    below = capsule(omega=omega, alpha=most - 1e-6, delta=OUT_OF_REACH)
    above = capsule(omega=omega, alpha=most + 1e-6, delta=OUT_OF_REACH)
    assert below["stuck_fraction"] == pytest.approx(1.0, abs=1e-12)
    assert below["drift_per_period"] == pytest.approx(0.0, abs=1e-14)
    assert 0.9 < above["stuck_fraction"] < 1.0
    rate = -0.05 * 2.0 * math.pi / omega  # stuck, the mass in it is an oscillator of its own
    np.testing.assert_allclose(below["spectrum"], [rate, rate, -math.inf], rtol=0.0, atol=1e-12)


def test_a_capsule_with_a_mirror_symmetry_slides_and_goes_nowhere() -> None:
    cell = capsule(omega=0.9, alpha=1.6, delta=OUT_OF_REACH)
    assert cell["regime"] == NO_IMPACT
    assert cell["stuck_fraction"] == 0.0
    assert cell["drift_per_period"] == pytest.approx(0.0, abs=1e-12)


def test_its_mirror_image_goes_the_other_way() -> None:
    machine = machine_in(ROW)
    (stop,) = machine.contacts
    other = replace(machine, contacts=(replace(stop, row=tuple(-g for g in stop.row)),))
    oscillators, reasons = build_hybrid(machines_of([other], DRIFTS))
    found = result_arrays((*result_variables(SPECTRUM), ADVANCE), SPECTRUM, 1, 4, exponents=3)
    solve(CellBatch(oscillators, reasons, np.zeros((1, 4)), SPECTRUM, found))  # type: ignore[arg-type]
    assert found["drift_per_period"][0] == pytest.approx(-PROGRESS, abs=1e-12)


@pytest.mark.parametrize("values", [{"omega": 1.5, "alpha": 3.0}, ROW_IN_UNITS_OF_FRICTION], ids=["slides", "sticks"])
def test_frames_of_a_long_average_know_the_exponents_of_the_orbit(values: dict[str, float]) -> None:
    fixed = Settings(method="fixed", exponents="spectrum", transient_periods=200, periods=2000)
    cell = capsule(fixed, **values)
    assert cell["regime"] == PERIODIC
    finite = np.isfinite(cell["spectrum"])
    np.testing.assert_array_equal(np.isfinite(cell["average"]), finite)
    np.testing.assert_allclose(cell["average"][finite], cell["spectrum"][finite], rtol=0.0, atol=5e-3)


def test_an_orbit_that_slides_on_obeys_the_sum_law() -> None:
    cell = capsule(omega=1.5, alpha=3.0)
    assert cell["regime"] == PERIODIC and not cell["sticks"]
    assert cell["spectrum"].shape == (3,)
    assert abs(cell["sum_law_defect"]) < 1e-12


def test_chaos_advances_by_its_mean_over_the_time_that_it_was_followed() -> None:
    """Against as many periods of a history, to some standard errors of both."""
    values = {"omega": 0.7, "alpha": 2.4}
    cell = capsule(Settings(exponents="largest", survival=0, max_periods=6000, tolerance=0.02), **values)
    assert cell["regime"] == CHAOTIC, REASONS[int(cell["reason"])].text
    steps = np.diff(trace("capsule", values, 4000, Settings(exponents="none")).states[100:, 1])
    blocks = steps[: 39 * 100].reshape(39, 100).mean(axis=1)
    error = blocks.std(ddof=1) / math.sqrt(39)
    assert cell["drift_per_period"] == pytest.approx(steps.mean(), abs=6.0 * error)


def test_a_block_slides_down_at_the_speed_that_its_damper_allows() -> None:
    """Load - friction = damping v in the mean, as long as it never stops; its one exponent is -c T / m."""
    found = solve_tile(System.from_toml(BLOCK), {"omega": 1.3, "v": 2.0}, SPECTRUM)
    period = 2.0 * math.pi / 1.3
    assert found["regime"] == PERIODIC
    assert found["drift_per_period"] == pytest.approx(period * (1.0 - 0.4) / 0.3, abs=1e-12)
    np.testing.assert_allclose(found["spectrum"], [-0.3 / 2.0 * period], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("method", ["adaptive", "fixed"])
def test_a_block_that_its_load_pushes_ever_faster_has_no_result(method: str) -> None:
    """Without a damper it slides down for good where the load exceeds friction; else it comes to a stop."""
    free = System.from_toml(BLOCK.replace("damping = [[0.3]]", ""))
    settings = Settings(method=method, exponents="spectrum", survival=0, max_periods=3000, periods=200)
    found = solve_tile(free, {"omega": 1.3, "f": [0.9, 1.1, 1.6], "v": [0.0, 60.0, 60.0], "A": 0.3}, settings)
    assert found["reason"].tolist() == [RUNS_AWAY, NO_REASON, NO_REASON]
    assert found["regime"].tolist() == [FAILED, PERIODIC, PERIODIC]
    assert found["drift_per_period"][1] > 0.0
    assert found["drift_per_period"][2] == 0.0


def test_a_capsule_that_runs_away_is_no_torus() -> None:
    """A load of its own adds up, whatever the mass in it does."""
    table = find_system("capsule").table() | {"name": "pushed", "load": [0.0, "P"]}
    table["parameters"] |= {"P": {"default": 1.2}}
    found = solve_tile(System.from_mapping(table), {"omega": 0.9, "alpha": [0.1, 2.0]}, SPECTRUM)
    assert found["reason"].tolist() == [RUNS_AWAY] * 2


def test_a_block_that_sticks_on_its_way_loses_its_only_direction() -> None:
    found = solve_tile(System.from_toml(BLOCK), {"omega": 1.3, "f": 1.2, "A": 1.0}, SPECTRUM)
    assert found["regime"] == PERIODIC and found["sticks"]
    assert found["drift_per_period"] > 0.0
    np.testing.assert_array_equal(found["spectrum"], [-np.inf])


def test_branches_of_what_drifts_are_refused_in_one_line() -> None:
    with pytest.raises(ValueError, match="branches and curves do not exist if a coordinate drifts"):
        family_of(find_system("capsule"), {}, ("omega",))


def test_a_measure_of_the_displacement_that_drifts_is_refused() -> None:
    table = find_system("capsule").table() | {"name": "measured"}
    table |= {"measures": {"way": {"displacement": [0, 1], "report": ["rms"]}}}
    with pytest.raises(DefinitionError, match=r"way\.displacement: found x2, which drifts"):
        System.from_mapping(table)


def test_nothing_drifts_where_none_is_declared() -> None:
    assert "progress" not in solve_tile("stick-slip", {}, SPECTRUM)


def test_parameters_that_tie_down_what_drifts_make_no_machine() -> None:
    tied = System.from_toml(BLOCK.replace("damping", 'stiffness = [["k"]]\ndamping') + "k = { default = 0.0 }\n")
    found = solve_tile(tied, {"k": [0.0, 0.1], "v": 2.0}, SPECTRUM)
    assert found["regime"].tolist() == [PERIODIC, INVALID]
    assert found["reason"][1] == NO_OSCILLATOR
