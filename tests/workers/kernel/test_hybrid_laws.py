"""Laws of the solver of machines whose law changes: neighbours, tables, mirrors, elements that do nothing, one stop."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.oracle.piecewise import (
    HarmonicForce,
    PiecewiseContact,
    PiecewiseFriction,
    PiecewiseMachine,
    PiecewisePhase,
)
from tests.support.oracle.piecewise.random_machines import random_machine, random_state
from tests.support.solver_bridge import Array, built, follow, machines_of
from workers import Settings
from workers.cell.cell_batch import CellBatch, Results
from workers.cell.interval import begin, sections_from
from workers.cell.solve import solve
from workers.kernel.motion import RUNNING
from workers.model.mode_table import build_hybrid, code_of
from workers.model.oscillator import Oscillator
from workers.model.system import find_system
from workers.results import PERIODIC, result_variables
from workers.tile import initial_state, result_arrays

SETTINGS = Settings(exponents="spectrum", max_periods=2000, survival=0, section_samples=2)


def solved(machines: list[PiecewiseMachine], states: list[list[float]], settings: Settings = SETTINGS) -> Results:
    """Cells of machines of one kind through their whole course."""
    oscillators, reasons = build_hybrid(machines_of(machines))
    found = result_arrays(result_variables(settings), settings, len(machines), len(states[0]))
    solve(CellBatch(oscillators, reasons, np.array(states), settings, found))  # type: ignore[arg-type]
    return found


# Neighbours


def rubbed(omega: float) -> PiecewiseMachine:
    """Two masses: friction on one of them, a soft and a rigid stop, a load that is switched."""
    return PiecewiseMachine(
        [[1.0, 0.0], [0.0, 2.0]], [[0.2, -0.1], [-0.1, 0.1]], [[2.0, -1.0], [-1.0, 1.5]], [0.0, 0.2], omega,
        (HarmonicForce(1, [0.0, 1.0], [0.5, 0.0]),),
        (PiecewiseContact([1.0, 0.0], 0.4, None, restitution=0.6), PiecewiseContact([-1.0, 1.0], None, -0.3,
        stiffness=20.0, damping=0.1,
                                                                    preload=0.05, release="force")),
        (PiecewiseFriction([0.0, 1.0], 0.2, 0.3),), (PiecewisePhase(0.0), PiecewisePhase(0.4, load=[0.1, -0.1])),
    )  # fmt: skip


def test_a_cell_does_not_depend_on_the_cells_beside_it() -> None:
    machines = [rubbed(omega) for omega in np.linspace(0.6, 2.2, 12).tolist()]
    states = [[0.0, 0.1 * k, 0.0, 0.3] for k in range(len(machines))]
    together, backward = solved(machines, states), solved(machines[::-1], states[::-1])
    for name, values in together.items():
        np.testing.assert_array_equal(backward[name][::-1], values, err_msg=name)
    for i in (0, 5, 11):
        alone = solved([machines[i]], [states[i]])
        for name, values in together.items():
            np.testing.assert_array_equal(alone[name][0], values[i], err_msg=name)


# Tables


def codes(hybrid: Oscillator) -> list[int]:
    return [int(number) for number in hybrid.table.codes[0] if number >= 0]


def with_modes(machine: PiecewiseMachine, numbers: list[int]) -> Oscillator:
    """A machine with these modes built beforehand, in their order."""
    hybrid = built(machine)
    for number in numbers:
        hybrid.table.missing[0, 0] = number
        hybrid.table.build_missing(np.zeros(1, dtype=np.int64))
    assert codes(hybrid) == numbers
    return hybrid


@pytest.mark.parametrize("seed", [2, 7, 11, 19, 26, 30])
def test_the_order_in_which_modes_are_built_does_not_matter(seed: int) -> None:
    machine = random_machine(seed)
    start, lazy = random_state(machine, seed), built(machine)
    expected = follow(lazy, start, periods=3)
    assert expected.status == RUNNING
    for numbers in (codes(lazy), codes(lazy)[::-1]):
        found = follow(with_modes(machine, numbers), start, periods=3)
        np.testing.assert_array_equal(found.state, expected.state)
        np.testing.assert_array_equal(found.jacobian, expected.jacobian)
        np.testing.assert_array_equal(found.tally, expected.tally)
        assert found.events == expected.events


def test_the_number_of_a_mode_says_which_it_is() -> None:
    for seed in range(30):
        machine = random_machine(seed)
        hybrid = built(machine)
        follow(hybrid, random_state(machine, seed))
        for number in codes(hybrid):
            assert code_of(number, len(machine.contacts), len(machine.friction)).number == number


# Mirrors


def mirrored(machine: PiecewiseMachine) -> PiecewiseMachine:
    """The machine in which -z(t) moves where z(t) moves in this one."""

    def law(phase: PiecewisePhase) -> PiecewisePhase:
        return replace(phase, load=None if phase.load is None else [-value for value in phase.load])

    def negative(value: float | None) -> float | None:
        return None if value is None else -value

    return replace(
        machine,
        load=[-value for value in machine.load],
        forces=tuple(HarmonicForce(f.order, [-a for a in f.sin], [-a for a in f.cos]) for f in machine.forces),
        contacts=tuple(replace(c, upper=negative(c.lower), lower=negative(c.upper)) for c in machine.contacts),
        friction=tuple(replace(f, belt=-f.belt) for f in machine.friction),
        phases=tuple(law(phase) for phase in machine.phases),
    )


@pytest.mark.parametrize("seed", range(24))
def test_a_mirrored_machine_moves_as_the_mirror_image(seed: int) -> None:
    machine = random_machine(seed)
    start = random_state(machine, seed)
    expected = follow(built(machine), start, periods=2)
    found = follow(built(mirrored(machine)), [-value for value in start], periods=2)
    np.testing.assert_allclose(-found.state, expected.state, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(found.jacobian, expected.jacobian, rtol=0.0, atol=1e-12)
    sides = [(e.element, e.index, -e.side if not e.force else e.side) for e in found.events]
    assert sides == [(e.element, e.index, e.side) for e in expected.events]


# Elements that do nothing


def close(found: Oscillator, expected: Oscillator, start: list[float]) -> None:
    a, b = follow(found, start, periods=3), follow(expected, start, periods=3)
    np.testing.assert_allclose(a.state, b.state, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(a.jacobian, b.jacobian, rtol=0.0, atol=1e-11)


SEEDS = [seed for seed in range(40) if not random_machine(seed).friction][:12]


@pytest.mark.parametrize("seed", SEEDS)
def test_friction_of_no_strength_changes_nothing(seed: int) -> None:
    machine = random_machine(seed)
    row = [1.0, *[0.0] * (machine.n - 1)]
    idle = replace(machine, friction=(PiecewiseFriction(row, 0.0, 0.0, 0.1),))
    close(built(idle), built(machine), random_state(machine, seed))


@pytest.mark.parametrize("release", ["displacement", "force"])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_soft_contact_without_stiffness_changes_nothing(seed: int, release: str) -> None:
    machine = random_machine(seed)
    row = [1.0, *[0.5] * (machine.n - 1)]
    idle = replace(machine, contacts=(*machine.contacts, PiecewiseContact(row, 0.1, -0.2, release=release)))
    close(built(idle), built(machine), random_state(machine, seed))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_phase_that_changes_nothing_changes_nothing(seed: int) -> None:
    machine = random_machine(seed)
    if len(machine.phases) == 1:
        split = replace(machine, phases=(PiecewisePhase(0.0), PiecewisePhase(0.3), PiecewisePhase(0.71)))
        close(built(split), built(machine), random_state(machine, seed))


# One rigid contact: what the solver without modes solves


def two_mass(**params: list[float]) -> tuple[Oscillator, Oscillator, Array]:
    """The package's system both ways, and section states where its cells begin."""
    record = find_system("two-mass")
    values = record.complete(params)
    rigid, reasons = record.build_many(values)
    hybrid, others = build_hybrid(record.definition.machines(values))
    assert not reasons.any()
    assert not others.any()
    return rigid, hybrid, initial_state(record, values)


def sections(oscillators: Any, states: Array, periods: int) -> Array:
    count = len(states)
    motions, _ = begin(oscillators, np.zeros(count, dtype=np.int8), states)
    return sections_from(oscillators, motions, np.full(count, periods + 1))


def test_one_rigid_contact_moves_as_without_modes() -> None:
    omega = np.linspace(1.5, 4.5, 13).tolist()
    rigid, hybrid, states = two_mass(omega=omega, b=[0.3] * 13)
    expected, found = sections(rigid, states, 20), sections(hybrid, states, 20)
    assert np.isfinite(expected).all()
    settled = np.abs(found - expected).max(axis=(1, 2))
    assert np.median(settled) < 1e-13
    assert settled.max() < 1e-6  # chaos has let rounding grow for twenty periods


def test_one_rigid_contact_has_the_exponents_that_it_has_without_modes() -> None:
    settings = Settings(exponents="spectrum", max_periods=4000, survival=0)
    rigid, hybrid, states = two_mass(omega=np.linspace(1.8, 3.3, 16).tolist(), b=[0.4] * 16)
    found = []
    for oscillators in (rigid, hybrid):
        results = result_arrays(result_variables(settings), settings, 16, 4)
        solve(CellBatch(oscillators, np.zeros(16, dtype=np.int8), states, settings, results))
        found.append(results)
    expected, other = found
    np.testing.assert_array_equal(other["regime"], expected["regime"])
    periodic = expected["regime"] == PERIODIC
    assert periodic.sum() >= 8
    for name in ("period", "impacts_upper", "impacts_lower"):
        np.testing.assert_array_equal(other[name][periodic], expected[name][periodic], err_msg=name)
    for name in ("largest", "spectrum"):
        np.testing.assert_allclose(other[name][periodic], expected[name][periodic], rtol=0.0, atol=1e-10, err_msg=name)
