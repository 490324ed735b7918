"""Laws of the solver of machines whose law changes: neighbours, tables, mirrors, elements that do nothing, one stop."""

from collections.abc import Callable
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


SEEDS = [seed for seed in range(40) if not random_machine(seed).friction][:12]


def idle_contact(machine: PiecewiseMachine, release: str) -> PiecewiseMachine:
    contact = PiecewiseContact([1.0, *[0.5] * (machine.n - 1)], 0.1, -0.2, release=release)
    return replace(machine, contacts=(*machine.contacts, contact))


IDLE: dict[str, Callable[[PiecewiseMachine], PiecewiseMachine]] = {
    "friction of no strength": lambda machine: replace(
        machine, friction=(PiecewiseFriction([1.0, *[0.0] * (machine.n - 1)], 0.0, 0.0, 0.1),)
    ),
    "a soft contact without stiffness": lambda machine: idle_contact(machine, "displacement"),
    "the same, released by force": lambda machine: idle_contact(machine, "force"),
    "phases that change nothing": lambda machine: replace(
        machine, phases=(machine.phases[1:] and machine.phases) or tuple(map(PiecewisePhase, (0.0, 0.3, 0.71)))
    ),
}


@pytest.mark.parametrize("element", IDLE)
@pytest.mark.parametrize("seed", SEEDS)
def test_an_element_that_does_nothing_changes_nothing(seed: int, element: str) -> None:
    machine = random_machine(seed)
    start = random_state(machine, seed)
    found, expected = (follow(built(of), start, periods=3) for of in (IDLE[element](machine), machine))
    np.testing.assert_allclose(found.state, expected.state, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(found.jacobian, expected.jacobian, rtol=0.0, atol=1e-11)


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
