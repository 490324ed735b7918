"""Random machines with contacts, friction and phases: the solver against the oracle, and against itself.

A share of them the solver stops at, and says why.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import pytest

from tests.support.oracle.piecewise import PiecewiseMachine, simulate
from tests.support.oracle.piecewise.random_machines import random_machine, random_state
from tests.support.solver_bridge import Array, SolverMotion, built, follow
from workers.kernel.motion import CONTRACTION, LOST, MODE_MISSING, RUNNING
from workers.model.oscillator import Oscillator

SENSITIVE = 1e5
"""Growth of errors beyond which states are not compared any more."""

STEP = 1e-6
"""Of central differences."""

STOPPED = 0.08
"""Share of machines at most that go through more modes than the solver has room for, where it stops."""


class Drawn(NamedTuple):
    """A machine as the solver has it and as the oracle has it, and a state to start from."""

    solver: Oscillator
    oracle: PiecewiseMachine
    start: list[float]


def drawn(seed: int, machine: PiecewiseMachine | None = None) -> Drawn:
    """A random machine, or a given one, and a random state of it."""
    machine = machine or random_machine(seed, switched_elements=seed % 2 == 1)
    return Drawn(built(machine), machine, random_state(machine, seed))


Draw = Callable[[int], Drawn]


def by_period(hybrid: Oscillator, start: list[float], periods: int) -> Iterator[SolverMotion]:
    """The motion period by period, each with the derivative over it alone; the last one may have stopped."""
    state, number = np.array(start), None
    for _ in range(periods):
        found = follow(hybrid, state, number)
        yield found
        if found.status != RUNNING:
            return
        state, number = found.state, found.number


def compare(seed: int, periods: int, draw: Draw = drawn) -> int:
    """Hold states after each period against the oracle while errors do not grow too far; the status at the end."""
    hybrid, machine, start = draw(seed)
    expected = simulate(machine, start, periods, digits=30, rest=1e-8).sections
    later: list[Array] = []  # derivatives of the state by that at each earlier section
    status = RUNNING
    for k, found in enumerate(by_period(hybrid, start, periods), start=1):
        status = found.status
        if status != RUNNING:
            break
        later = [found.jacobian @ product for product in [*later, np.eye(2 * machine.n)]]
        growth = max(1.0, *(float(np.linalg.norm(product, 2)) for product in later))
        if growth > SENSITIVE:
            break
        there = np.array(expected[k], dtype=float)
        np.testing.assert_allclose(found.state, there, rtol=0.0, atol=1e-9 * growth, err_msg=f"seed {seed}, period {k}")
    return status


def assert_few_stop(statuses: list[int], reason: int = MODE_MISSING, share: float = STOPPED) -> None:
    stopped = [status for status in statuses if status != RUNNING]
    assert set(stopped) <= {reason}
    assert len(stopped) <= share * len(statuses)


def test_random_machines_go_where_the_oracle_takes_them() -> None:
    assert_few_stop([compare(seed, 2) for seed in range(30)])


@pytest.mark.slow
@pytest.mark.parametrize("block", range(5))
def test_many_random_machines_go_where_the_oracle_takes_them(block: int) -> None:
    assert_few_stop([compare(seed, 4) for seed in range(100 + 50 * block, 150 + 50 * block)])


@pytest.mark.slow
def test_twenty_periods_of_random_machines_are_those_of_the_oracle() -> None:
    assert_few_stop([compare(seed, 20) for seed in range(600, 650)])


def differences(hybrid: Oscillator, start: Array, itinerary: list[tuple[str, int, int]]) -> Array | None:
    """The derivative of the state after a period by central differences; None where a neighbour's events are others."""
    columns = []
    for j in range(len(start)):
        ends = []
        for sign in (1.0, -1.0):
            moved = start.copy()
            moved[j] += sign * STEP
            found = follow(hybrid, moved, frame=np.zeros((0, len(start))))
            if found.status != RUNNING or itinerary_of(found) != itinerary:
                return None
            ends.append(found.state)
        columns.append((ends[0] - ends[1]) / (2.0 * STEP))
    return np.stack(columns, axis=1)


def itinerary_of(found: SolverMotion) -> list[tuple[str, int, int]]:
    return [(e.element, e.index, e.side) for e in found.events]


def check_derivative(seed: int, draw: Draw = drawn) -> bool:
    """Hold the derivative over a period against differences; whether there are any to compare."""
    hybrid, _, state = draw(seed)
    start = np.array(state)
    found = follow(hybrid, start)
    if found.status != RUNNING:
        return False
    expected = differences(hybrid, start, itinerary_of(found))
    if expected is None:
        return False
    size = max(1.0, np.abs(found.jacobian).max())
    np.testing.assert_allclose(found.jacobian, expected, rtol=0.0, atol=1e-5 * size**2, err_msg=f"seed {seed}")
    return True


def test_derivatives_of_random_machines_are_those_of_their_motions() -> None:
    assert sum(check_derivative(seed) for seed in range(60)) >= 45


@pytest.mark.slow
def test_derivatives_of_many_random_machines_are_those_of_their_motions() -> None:
    assert sum(check_derivative(seed) for seed in range(100, 600)) >= 375


def check_volume(seed: int, draw: Draw = drawn) -> bool:
    """The sum law over a period, by the derivative and by orthonormal frames; whether no direction was lost."""
    hybrid, _, start = draw(seed)
    found, framed = follow(hybrid, start), follow(hybrid, start, framed=True)
    if found.status != RUNNING or found.tally[LOST] > 0.0:
        return False
    expected = found.tally[CONTRACTION]
    rounding = 1e-14 * max(10.0, float(np.linalg.cond(found.jacobian)))
    assert math.log(abs(np.linalg.det(found.jacobian))) == pytest.approx(expected, abs=rounding), seed
    grown = np.sum(framed.growth) + math.log(abs(np.linalg.det(framed.jacobian)))
    assert grown == pytest.approx(expected, abs=1e-11), seed
    assert framed.tally[CONTRACTION] == pytest.approx(expected, abs=1e-12)
    return True


def test_volumes_of_random_machines_change_by_the_sum_law() -> None:
    assert sum(check_volume(seed) for seed in range(100)) >= 50


@pytest.mark.slow
def test_volumes_of_many_random_machines_change_by_the_sum_law() -> None:
    assert sum(check_volume(seed) for seed in range(100, 900)) >= 400


def test_frames_do_not_change_the_motion() -> None:
    for seed in range(40):
        hybrid, _, start = drawn(seed)
        bare = follow(hybrid, start, periods=2, frame=np.zeros((0, len(start))))
        framed = follow(hybrid, start, periods=2, framed=True)
        np.testing.assert_array_equal(framed.state, bare.state)
        assert framed.events == bare.events
