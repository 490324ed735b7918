"""The stroboscopic map and its Jacobian: against multiprecision orbits and finite differences."""

import math

import numpy as np
import pytest

from tests import naive
from tests.support.oracle.simulate import section_jacobian, simulate
from workers.cell.interval import run_periods
from workers.kernel.coordinates import blocks_to_physical, motion_from
from workers.kernel.motion import EVALUATIONS, FLIGHT, LOST, LOWER, RUNNING, STATUS, STUCK, UPPER
from workers.kernel.period import advance, step
from workers.kernel.tangent import reset_frame
from workers.model.hybrid_modes import DETACHED, ON
from workers.model.oscillator import Oscillator
from workers.orbit.map import map_with_jacobian


def after(osc: Oscillator, state: np.ndarray, periods: int) -> np.ndarray:
    """Physical section state so many periods after another."""
    motion = motion_from(osc, state)
    assert run_periods(osc, motion, periods) == periods
    return blocks_to_physical(osc, motion)


def physical(osc: Oscillator) -> np.ndarray:
    """Matrix (2n, 2n) from flat block coordinates (h_1, h_1', h_2, ...) to (x..., v...)."""
    return np.asarray(osc.to_physical)


def jacobian(osc: Oscillator, state: np.ndarray, periods: int, half: bool = False) -> np.ndarray:
    """d(physical state after so many steps) / d(physical state)."""
    start = motion_from(osc, state)
    motion, J = map_with_jacobian(osc, start.h, int(start.mode[0]), periods, half)
    assert motion.tally[STATUS] == RUNNING
    P = physical(osc)
    return P @ J @ np.linalg.inv(P)


def on_attractor(osc: Oscillator, state: np.ndarray, periods: int = 300) -> np.ndarray:
    return after(osc, state, periods)


def test_the_jacobian_agrees_with_multiprecision_orbits() -> None:
    """Truth: differences of 50-digit orbits over two periods of Fig. 5."""
    osc, start = naive.two_mass(**naive.FIGURES[5])
    state = on_attractor(osc, start, 50)
    named = dict(zip(("x1", "x2", "v1", "v2"), state.tolist(), strict=True))
    true = np.array([[float(v) for v in row] for row in section_jacobian(naive.FIGURES[5] | named, 2)])
    assert jacobian(osc, state, 2) == pytest.approx(true, abs=1e-11 * np.abs(true).max())


# Orbits against the independent simulator

KINDS: dict[str, dict[str, float]] = {
    "Fig. 3": naive.FIGURES[3],
    "Fig. 4": naive.FIGURES[4],
    "no damping": naive.FIGURES[3] | {"zeta": 0.0},
    "no damping, elastic": naive.FIGURES[3] | {"zeta": 0.0, "R": 1.0},
    "overdamped": naive.FIGURES[3] | {"zeta": 2.0, "b": 0.01},
    "one critically damped mode": naive.FIGURES[3] | {"zeta": 1.0 / math.sqrt(2.0 - math.sqrt(1.5)), "b": 0.02},
    "sticks": naive.STICKING,
    "sticks, R = 0": naive.STICKING | {"R": 0.0},
    "leaves at once, R = 0": naive.FIGURES[3] | {"R": 0.0, "omega": 1.93, "b": 0.52},
    "long chatter": naive.STICKING | {"R": 0.6, "omega": 0.7},
    "held at the section": naive.STICKING | {"tau": math.pi + 2.2},
    "heavy second mass": naive.FIGURES[3] | {"mu_m": 300.0},
    "light second mass": naive.FIGURES[3] | {"mu_m": 0.01},
    "impact at once": naive.FIGURES[3] | {"x1": 0.1, "v1": 0.3, "x2": 0.05},
    "leaves the stop": naive.FIGURES[3] | {"x1": 0.1, "v1": -0.3, "x2": 0.05},
    "pressed on the stop": naive.FIGURES[3] | {"x1": 0.1, "x2": 1.5, "v2": 0.2},
    "pulled off the stop": naive.FIGURES[3] | {"x1": 0.1, "x2": -0.5},
    "pressed on the lower stop": naive.FIGURES[3] | {"x1": -0.1, "x2": -1.5},
}


@pytest.mark.parametrize("kind", KINDS)
def test_ten_periods_agree_with_the_independent_simulator(kind: str) -> None:
    """Truth: a 30-digit Taylor simulation. Rounding may grow as the Jacobian of the orbit does."""
    params = KINDS[kind]
    true = simulate(params, 10, digits=30)
    osc, state = naive.two_mass(**params)
    motion = motion_from(osc, state, vectors=4)
    sticks = bool(true.stuck)
    growth = 0.0
    for k in range(1, 11):
        advance(osc, motion)
        reset_frame(osc.gap.blocks, motion)
        assert motion.tally[STATUS] == RUNNING
        growth = max(growth, float(motion.growth[0]))
        exact = np.array([float(value) for value in true.sections[k]])
        found = blocks_to_physical(osc, motion)
        # Jumping to rest neglects what is of third order in the last 1e-4 of the chatter.
        assert found == pytest.approx(exact, abs=(1e-11 if sticks else 1e-13) * math.exp(growth) * 10)
    if not sticks:
        assert motion.tally[UPPER] == sum(impact.side > 0 for impact in true.impacts)
        assert motion.tally[LOWER] == sum(impact.side < 0 for impact in true.impacts)
    stuck = sum(float(stay.end - stay.start) for stay in true.stuck)
    assert motion.tally[STUCK] == pytest.approx(stuck, abs=5e-3 * stuck)


def test_the_kinds_include_what_their_names_say() -> None:
    for kind, params in KINDS.items():
        osc, state = naive.two_mass(**params)
        motion = motion_from(osc, state)
        state = int(motion.mode[0]) - FLIGHT
        run_periods(osc, motion, 10)
        assert ("stick" in kind or "held" in kind or "chatter" in kind or "pressed" in kind) == (
            motion.tally[STUCK] > 0
        ), kind
        assert (motion.tally[LOST] == 1) == ("leaves at once" in kind), kind
        assert (abs(state) == ON) == ("pressed" in kind), kind
        assert (abs(state) == DETACHED) == ("pulled" in kind), kind
        assert (abs(int(motion.mode[0]) - FLIGHT) == ON) == ("held" in kind), kind
        damping = np.array(osc.gap.eta) ** 2 - osc.gap.lam
        assert ("overdamped" in kind) == bool(np.all(damping > 0)), kind
        assert ("critical" in kind) == bool(np.any(np.abs(damping) < 1e-12)), kind


# The half-period map


@pytest.mark.parametrize("kind", ["Fig. 3", "Fig. 4", "overdamped", "sticks", "held at the section"])
def test_the_half_period_map_twice_is_the_period_map(kind: str) -> None:
    osc, start = naive.two_mass(**KINDS[kind])
    state = on_attractor(osc, start, 17)
    whole, twice = motion_from(osc, state), motion_from(osc, state)
    advance(osc, whole)
    step(osc, twice, True)
    step(osc, twice, True)
    assert twice.h == pytest.approx(whole.h, abs=1e-13)
    assert twice.mode[0] == whole.mode[0]
    assert (twice.tally[UPPER] + twice.tally[LOWER]) == (whole.tally[UPPER] + whole.tally[LOWER])


@pytest.mark.parametrize("figure", [3, 4, 5])
def test_the_half_period_jacobians_multiply_to_the_period_jacobian(figure: int) -> None:
    osc, start = naive.two_mass(**naive.FIGURES[figure])
    state = on_attractor(osc, start, 17)
    middle = motion_from(osc, state)
    step(osc, middle, True)
    product = jacobian(osc, blocks_to_physical(osc, middle), 1, half=True) @ jacobian(osc, state, 1, half=True)
    J = jacobian(osc, state, 1)
    assert product == pytest.approx(J, abs=1e-11 * np.abs(J).max())


# The frame does not depend on how often it is orthonormalised; the state does not depend on the frame


def test_tangent_vectors_do_not_disturb_the_motion() -> None:
    for params in KINDS.values():
        osc, state = naive.two_mass(**params)
        bare, framed = motion_from(osc, state), motion_from(osc, state, vectors=4)
        for motion in (bare, framed):
            run_periods(osc, motion, 5)
        # A heavily damped flight is taken in pieces for the frame, which rounds differently.
        assert framed.h == pytest.approx(bare.h, abs=1e-13)


def test_evaluations_per_flight_stay_few_over_whole_orbits() -> None:
    for figure in (3, 4, 5):
        osc, state = naive.two_mass(**naive.FIGURES[figure])
        motion = motion_from(osc, state)
        run_periods(osc, motion, 1000)
        flights = 1000 + motion.tally[UPPER] + motion.tally[LOWER]
        assert motion.tally[EVALUATIONS] < 7 * flights
