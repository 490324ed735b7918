"""Machines of every kind, the solver against the independent simulator: section states, Jacobians, volumes.

Any number of masses, general damping, rigid modes, loads, several harmonics, unequal and missing stops.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from tests.oscillators import RIGID, build_one, rigid_machines
from tests.support.oracle import OracleMachine, section_jacobian, simulate
from tests.support.oracle.machines import random_machine
from workers.kernel.coordinates import blocks_to_physical, motion_from
from workers.kernel.motion import LOWER, RUNNING, STATUS, STUCK, UPPER, Motion, motion_at
from workers.kernel.period import propagate
from workers.kernel.tangent import reset_frame
from workers.model.oscillator import Oscillator

pytestmark = pytest.mark.slow

EPS = float(np.finfo(np.float64).eps)
COMPARABLE = 1e-4
"""eps times the Jacobian's norm up to which two orbits are still one."""
PERIODS = 5
SIZES = (1, 2, 3, 8)


# The solver's side


@dataclass(frozen=True)
class Sections:
    """Of each period: state (2n,) at its end, Jacobian (2n, 2n) and ln |its determinant|; totals of all of them."""

    states: list[np.ndarray]
    jacobians: list[np.ndarray]
    log_volumes: list[float]
    upper: list[int]
    lower: list[int]
    stuck: list[float]


def solver_sections(machine: OracleMachine, state: np.ndarray, periods: int) -> Sections:
    """What the solver makes of a machine from a section state."""
    osc = solver_of(machine)
    size = len(state)
    found = Sections([], [], [], [], [], [])
    motion = motion_from(osc, state, vectors=size)
    for _ in range(periods):
        motion = motion_at(motion.h, int(motion.mode[0]), vectors=size)._replace(triangle=np.eye(size))
        propagate(osc, motion, osc.period)
        assert motion.tally[STATUS] == RUNNING
        reset_frame(osc.gap.blocks, motion)
        frame = motion.V.reshape(size, size).T
        P = physical_directions(osc, motion)
        J = P @ frame @ (np.exp(motion.growth)[:, None] * motion.triangle) @ np.linalg.inv(P)
        volume = float(np.linalg.slogdet(frame)[1] + motion.growth.sum() + np.linalg.slogdet(motion.triangle)[1])
        found.states.append(blocks_to_physical(osc, motion))
        found.jacobians.append(J)
        found.log_volumes.append(volume)
        for total, entry in ((found.upper, UPPER), (found.lower, LOWER)):
            total.append(int(motion.tally[entry]))
        found.stuck.append(float(motion.tally[STUCK]))
    return found


def solver_jacobian(machine: OracleMachine, state: np.ndarray) -> np.ndarray:
    """d(section state after one period) / d(section state), by the solver."""
    return solver_sections(machine, state, 1).jacobians[0]


def solver_of(machine: OracleMachine) -> Oscillator:
    return build_one(rigid_machines(**{name: np.asarray(getattr(machine, name))[None] for name in RIGID}))


def physical_directions(osc: Oscillator, motion: Motion) -> np.ndarray:
    """Matrix (2n, 2n) from flat block coordinates to (x..., v...): what a change of each of them changes."""
    flight = motion_at(np.zeros_like(motion.h))
    zero = blocks_to_physical(osc, flight)
    columns = []
    for i in np.ndindex(flight.h.shape):
        flight.h[i] = 1.0
        columns.append(blocks_to_physical(osc, flight) - zero)
        flight.h[i] = 0.0
    return np.column_stack(columns)


# Random machines


def drawn(seed: int, n: int, **kind: Any) -> OracleMachine:
    return random_machine(np.random.default_rng([20, seed, n]), n, **kind)


def assert_sections_agree(
    machine: OracleMachine, periods: int = PERIODS, rounding: float = 1e-12, most: float = COMPARABLE / EPS
) -> int:
    """Rounding may grow as the Jacobians do; over how many periods the orbits are compared until it has grown too far.

    Jumping to rest neglects what is of third order in the last 1e-4 of the chatter.
    """
    true = simulate(machine, periods, digits=30)
    found = solver_sections(machine, np.asarray(machine.start), periods)
    exact = [np.array([float(value) for value in state]) for state in true.sections]
    partial: list[np.ndarray] = []
    growth, size = 1.0, float(np.max(np.abs(exact[0])))
    T = 2 * math.pi / machine.omega
    for k in range(periods):
        partial = [found.jacobians[k] @ earlier for earlier in [*partial, np.eye(len(exact[0]))]]
        growth = max(growth, *(float(np.linalg.norm(J, 2)) for J in partial))
        if not growth < most:
            return k
        size = max(size, float(np.max(np.abs(exact[k + 1]))))
        rested = any(float(stay.start) < (k + 1) * T for stay in true.stuck)
        bound = (1e-10 if rested else rounding) * growth * max(size, 1.0)
        assert found.states[k] == pytest.approx(exact[k + 1], abs=bound)
        if not rested:
            during = [impact.side for impact in true.impacts if float(impact.t) < (k + 1) * T]
            assert (sum(found.upper[: k + 1]), sum(found.lower[: k + 1])) == (during.count(1), during.count(-1))
    stuck = sum(float(stay.end - stay.start) for stay in true.stuck)
    assert sum(found.stuck) == pytest.approx(stuck, abs=5e-3 * stuck)
    return periods


def assert_jacobians_agree(machine: OracleMachine) -> None:
    """Truth: differences of orbits that follow a chatter to 1e-14 of a time scale; the solver leaves it earlier."""
    true = np.array([[float(value) for value in row] for row in section_jacobian(machine, 1, 40)])
    rested = bool(simulate(machine, 1, digits=25).stuck)
    bound = (5e-4 if rested else 1e-9) * np.abs(true).max() + 1e-12  # one mass that rested has no Jacobian left
    assert solver_jacobian(machine, np.asarray(machine.start)) == pytest.approx(true, abs=bound)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("n", SIZES)
def test_section_states_of_a_random_machine_are_the_simulated_ones(n: int, seed: int) -> None:
    assert_sections_agree(drawn(seed, n))


@pytest.mark.parametrize("seed", range(2, 77))
@pytest.mark.parametrize("n", SIZES)
def test_section_states_of_many_random_machines_are_the_simulated_ones(n: int, seed: int) -> None:
    assert_sections_agree(drawn(seed, n))


KINDS: dict[str, dict[str, Any]] = {
    "undamped rigid mode": {"rigid": True, "damping": "none", "R": 0.8},
    "rigid mode that no dashpot feels": {"rigid": True, "damping": "internal", "R": 0.7},
    "damped rigid mode": {"rigid": True, "damping": "general", "R": 0.7},
    "rigid mode, one stop": {"rigid": True, "one_sided": True, "R": 0.5},
    "general damping": {"rigid": False, "damping": "general", "R": 0.9},
    "elastic, undamped": {"rigid": False, "damping": "none", "R": 1.0},
    "inelastic": {"R": 0.0},
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("n", [1, 3])
def test_section_states_of_machines_of_every_kind_are_the_simulated_ones(n: int, kind: str) -> None:
    assert_sections_agree(drawn(100, n, **KINDS[kind]))


@pytest.mark.parametrize("n", SIZES)
def test_the_jacobian_of_a_random_machine_is_that_of_simulated_orbits(n: int) -> None:
    assert_jacobians_agree(drawn(0, n))


@pytest.mark.parametrize("seed", range(1, 6))
@pytest.mark.parametrize("n", SIZES)
def test_jacobians_of_many_random_machines_are_those_of_simulated_orbits(n: int, seed: int) -> None:
    assert_jacobians_agree(drawn(seed, n))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("n", SIZES)
def test_volumes_shrink_by_the_dampings_trace_and_by_restitution_squared_an_impact(n: int, seed: int) -> None:
    """ln |det| = -trace(M^-1 C) T + 2 ln R per impact, period by period where nothing rests."""
    machine = drawn(seed, n, R=0.7)
    found = solver_sections(machine, np.asarray(machine.start), PERIODS)
    T = 2 * math.pi / machine.omega
    contraction = float(np.trace(np.linalg.solve(machine.mass, machine.damping))) * T
    free = [k for k in range(PERIODS) if found.stuck[k] == 0.0]
    laws = [-contraction + 2 * (found.upper[k] + found.lower[k]) * math.log(0.7) for k in free]
    assert [found.log_volumes[k] for k in free] == pytest.approx(laws, abs=1e-9 * (1.0 + contraction))
