"""Claims about what machines whose law changes do in rare moments: each has its smallest machine."""

import math

import numpy as np
import pytest

from tests.support.oracle.piecewise import (
    HarmonicForce,
    PiecewiseContact,
    PiecewiseFriction,
    PiecewiseMachine,
    PiecewisePhase,
    monodromy,
    simulate,
)
from tests.support.oracle.piecewise.random_machines import random_machine, random_state
from tests.support.solver_bridge import built, follow, machines_of
from workers import Settings, System, solve_tile
from workers.cell.cell_batch import CellBatch, Results
from workers.cell.solve import solve
from workers.kernel.motion import RUNNING
from workers.model.mode_table import build_hybrid
from workers.results import INVALID, PERIODIC, REASONS, result_variables
from workers.tile import result_arrays


def one(
    omega: float = 1.0, damping: float = 0.1, load: float = 0.0, force: float = 0.0, **elements
) -> PiecewiseMachine:
    return PiecewiseMachine(
        [[1.0]], [[damping]], [[1.0]], [load], omega, (HarmonicForce(1, [force], [0.0]),), **elements
    )


def agree(machine: PiecewiseMachine, start: list[float], duration: float | None = None, periods: int = 1) -> None:
    found = follow(built(machine), start, periods=periods, duration=duration)
    assert found.status == RUNNING
    expected = simulate(machine, start, periods, span=duration, digits=30, rest=1e-8).sections[-1]
    np.testing.assert_allclose(found.state, np.array(expected, float), rtol=0.0, atol=1e-9)


def cell(machine: PiecewiseMachine, start: list[float]) -> Results:
    settings = Settings(exponents="spectrum")
    oscillators, reasons = build_hybrid(machines_of([machine]))
    found = result_arrays(result_variables(settings), settings, 1, len(start))
    solve(CellBatch(oscillators, reasons, np.array([start]), settings, found))
    return found


# R = 0 and friction that the impact turns or stops: the load is taken with the friction of before


@pytest.mark.parametrize("seed", [143, 260])
def test_dead_impacts_with_friction(seed: int) -> None:
    machine = random_machine(seed, switched_elements=seed % 2 == 1)
    agree(machine, random_state(machine, seed))


def test_friction_that_slows_the_approach_does_not_pull_the_mass_off_the_stop() -> None:
    """Load .35 presses at x = .5 with friction off; on the way there the spring and friction take more than that."""
    machine = one(
        load=0.85,
        contacts=(PiecewiseContact([1.0], 0.5, None, restitution=0.0),),
        friction=(PiecewiseFriction([1.0], 0.4, 0.4),),
    )
    found = follow(built(machine), [0.0, 1.5], duration=2.0)
    assert [e.element for e in found.events] == ["contact"]


# A rest that a jump of the load ends has a first derivative: order 2, not 3


def test_a_mass_that_starts_on_a_stop_comes_back_to_it() -> None:
    machine = one(force=1.0, load=0.49, contacts=(PiecewiseContact([1.0], 0.5, None, restitution=0.5),))
    agree(machine, [0.5, 0.0], duration=0.05)


def test_a_rest_that_a_switch_ends_may_begin_again_at_once() -> None:
    machine = one(
        force=1.0,
        load=0.8,
        contacts=(PiecewiseContact([1.0], 0.5, None, restitution=0.5),),
        phases=(PiecewisePhase(0.0), PiecewisePhase(0.01, load=[0.42])),
    )
    agree(machine, [0.5, 0.0], duration=0.15)


# R = 0 with a load that pulls away: a direction is lost


def test_a_dead_impact_loses_a_direction() -> None:
    machine = one(omega=1.6, load=-0.4, force=1.0, contacts=(PiecewiseContact([1.0], 0.1, None, restitution=0.0),))
    found = cell(machine, [0.0, 0.0])
    assert found["impacts_upper"][0] == 1 and found["stuck_fraction"][0] == 0.0
    assert found["spectrum"][0, 1] == -math.inf
    assert math.isfinite(found["error"][0]) and math.isnan(found["sum_law_defect"][0])


# R = 0, rest, and another friction that turns in the same event: its jump is missing in the derivative


def test_the_derivative_through_a_rest_that_turns_another_friction() -> None:
    machine = PiecewiseMachine(
        [[1.0, 0.0], [0.0, 1.0]], [[0.1, 0.0], [0.0, 0.1]], [[1.0, 0.0], [0.0, 1.0]], [2.0, 0.0], 1.0,
        (HarmonicForce(1, [0.0, 1.0], [0.0, 0.0]),), (PiecewiseContact([1.0, 0.0], 0.5, None, restitution=0.0),),
        (PiecewiseFriction([-1.0, 1.0], 0.5, 0.5),),
    )  # fmt: skip
    start = [0.0, 0.0, 2.0, 1.5]
    found = follow(built(machine), start, duration=1.5).jacobian
    expected = np.array(monodromy(machine, start, span=1.5).tolist(), dtype=float)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9)


# static = kinetic in the phase of now, not in another: endless stick and slip at one time, NaN in the derivative


@pytest.mark.parametrize(("seed", "periods"), [(701, 4), (715, 4)])
def test_friction_that_a_phase_changes(seed: int, periods: int) -> None:
    machine = random_machine(seed, switched_elements=True)
    start = random_state(machine, seed)
    agree(machine, start, periods=periods)
    assert np.isfinite(follow(built(machine), start, periods=periods).jacobian).all()


def test_friction_even_in_one_phase_breaks_away_once() -> None:
    machine = one(
        force=1.0,
        friction=(PiecewiseFriction([1.0], 0.4, 0.4),),
        phases=(PiecewisePhase(0.0), PiecewisePhase(0.9, friction={0: {"kinetic": 0.2}})),
    )
    found = follow(built(machine), [0.0, 0.0], duration=1.0)
    assert len(found.events) == 1 and np.isfinite(found.jacobian).all()


# A free mass beside one that sticks on the ground, coupled by a damper: b multiplies u = 0


def test_a_free_mass_moves_on_while_another_one_sticks() -> None:
    machine = PiecewiseMachine(
        [[1.0, 0.0], [0.0, 1.0]], [[0.5, -0.2], [-0.2, 0.3]], [[0.0, 0.0], [0.0, 4.0]], [0.0, 0.0], 1.0,
        (HarmonicForce(1, [1.0, 0.1], [0.0, 0.0]),), (), (PiecewiseFriction([0.0, 1.0], 0.8, 0.9),),
    )  # fmt: skip
    agree(machine, [0.0, 0.0, 0.1, 0.2], periods=2)


# ROOM: 24 modes are too few for machines of three phases


@pytest.mark.parametrize("seed", [35, 75, 104, 138, 184])
def test_machines_of_many_modes(seed: int) -> None:
    machine = random_machine(seed, switched_elements=seed % 2 == 1)
    assert follow(built(machine), random_state(machine, seed), periods=4).status == RUNNING


# What a definition or a cell cannot have, and what it can


def sliding(row: object, slope: float = 0.0, damping: float = 0.1) -> dict[str, object]:
    """A mass with a stop and friction on this row."""
    return {
        "name": "rubs", "coordinates": ["x"], "mass": [[1.0]], "damping": [[damping]], "stiffness": [[1.0]],
        "force": [1.2], "gap": [0.3], "upper": 0.24, "restitution": 0.6,
        "friction": [{"name": "ground", "row": [row], "kinetic": "f", "static": "1.2 * f", "slope": "q"}],
        "parameters": {
            "omega": {"default": 0.9}, "f": {"default": 3.0}, "q": {"default": slope}, "p": {"default": 0.3},
        },
    }  # fmt: skip


@pytest.mark.parametrize("factor", ["p", "0.1 * 3", "-p", "2 * p", "1e-3 * p", 5.0])
def test_friction_on_a_multiple_of_the_row_of_a_contact_is_the_friction_along_it(factor: object) -> None:
    """Truth: the same force along x is made by a row a times as large with friction 1 / a times as large."""
    scale = {"p": 1.0, "0.1 * 3": 1.0, "-p": 1.0, "2 * p": 2.0, "1e-3 * p": 1e-3, 5.0: 5.0 / 0.3}[factor]
    found = solve_tile(System.from_mapping(sliding(factor)), {"f": 3.0 / scale})
    expected = solve_tile(System.from_mapping(sliding(0.3)), {})
    assert expected["regime"] == PERIODIC and expected["sticks"]
    for name in ("regime", "period", "impacts_upper", "sticks"):
        assert found[name] == expected[name]
    for name in ("largest", "stuck_fraction", "ground_stuck", "ground_loss", "stop_fraction", "peak_to_peak"):
        assert found[name] == pytest.approx(expected[name], rel=1e-9, abs=1e-9), name
    np.testing.assert_allclose(found["state"], expected["state"], rtol=0.0, atol=1e-10)


def test_a_slope_that_outweighs_the_damping_makes_a_machine() -> None:
    """With -2 a half turn of the free motion grows e^9.6 times, which the stop's R = 0.6 does not hold."""
    found = solve_tile(System.from_mapping(sliding(1.0, slope=-2.0)), {"q": [-2.0, -0.2, -0.1, -0.05], "f": 0.3})
    assert [REASONS[int(code)].name for code in found["reason"]] == ["runs_away", "none", "none", "none"]
    assert found["regime"][1:].tolist() == [PERIODIC] * 3 and np.isnan(found["largest"][0])


@pytest.mark.parametrize("more", [{}, {"phases": [{"start": 0.0}, {"start": 0.4}]}], ids=["plain", "with modes"])
def test_a_forcing_period_of_too_many_turns_is_refused_in_every_machine(more: dict[str, object]) -> None:
    machine = {
        "name": "mass", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.1]], "stiffness": [[1.0]], "force": [1.0],
        "gap": [1.0], "upper": 0.5, "restitution": 0.6, "parameters": {"omega": {"default": 1.0}},
    }  # fmt: skip
    found = solve_tile(System.from_mapping(machine | more), {"omega": 1e-8})
    assert (found["regime"], REASONS[int(found["reason"])].name) == (INVALID, "long_period")


# Friction that turns in an instant and sticks in the same one: what begins then is a stick


def test_one_friction_that_sticks_as_another_slips_off_does_not_slip_at_once() -> None:
    """Truth: the orbit and its multipliers by an independent simulator, and by trying all nine pairs of slips there."""
    definition = {
        "name": "pair", "coordinates": ["x1", "x2"], "mass": [[1, 0], [0, 1]], "damping": [[0.1, 0], [0, 0.1]],
        "stiffness": [[2, 0], [0, 0.9]], "force": [0, 1.7], "load": [0.3, -0.3],
        "friction": [
            {"name": "pair", "row": [-1, 1], "kinetic": 0.5}, {"name": "ground", "row": [1, 0], "kinetic": 0.3}
        ],
    }  # fmt: skip
    found = solve_tile(System.from_mapping(definition), {"omega": 0.6}, Settings(exponents="spectrum"))
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    np.testing.assert_allclose(found["state"], [0.60709954, -1.75971489, 0.17369369, 1.43800252], rtol=0.0, atol=1e-8)
    exact = [math.log(0.54262087), math.log(0.22823832), math.log(0.22823832), -math.inf]
    np.testing.assert_allclose(found["spectrum"], exact, rtol=1e-7)


@pytest.mark.parametrize("seed", [4711000278, 4711000389, 4712001881, 4713001040])
def test_frictions_that_change_in_one_instant(seed: int) -> None:
    """Machines whose second friction turned and stuck at once; one of them changed its modes without end."""
    machine = random_machine(seed, switched_elements=seed % 2 == 1)
    agree(machine, random_state(machine, seed))
