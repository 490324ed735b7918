"""Flight: closed-form blocks and the certified next crossing."""

import math

import numpy as np
import pytest
from mpmath import mp

from tests import naive
from workers.kernel.crossing import next_crossing, safe_step
from workers.kernel.flow import block_flow
from workers.kernel.signal import derivative_bounds
from workers.model.oscillator import COLUMN, OF_FLOW, OF_GUARD, GuardedFlow, make_blocks


def flow(eta: float, lam: float, s: float) -> np.ndarray:
    return np.array(block_flow(make_blocks(np.float64(eta), np.float64(lam)), s)).reshape(2, 2)


def distance(found: np.ndarray, true: np.ndarray, lam: float) -> float:
    """Relative to the exact flow's largest entry, in the units that make h and h' / sqrt(lam) comparable."""
    scale = np.array([[1.0, math.sqrt(lam)], [1.0 / math.sqrt(lam), 1.0]])
    return float(np.max(np.abs(found - true) * scale) / np.max(np.abs(true) * scale))


DAMPINGS = [0.0, 1e-6, 0.05, 0.5, 0.999, 1.0 - 1e-9, 1.0, 1.0 + 1e-9, 1.001, 1.5, 5.0, 30.0, 300.0]


@pytest.mark.parametrize("ratio", DAMPINGS)
def test_block_flow_is_the_exponential_at_any_damping(ratio: float) -> None:
    """Truth: 60-digit matrix exponential. A rate r costs eps r s, as the argument itself is rounded."""
    for lam in (0.3, 1.0, 40.0):
        omega = math.sqrt(lam)
        for s in (1e-9, 1e-3, 0.02, 0.3, 2.0, 9.0):
            found, true = flow(ratio * omega, lam, s / omega), naive.block_flow(ratio * omega, lam, s / omega)
            assert distance(found, true, lam) < 2e-14 * (1.0 + (ratio + 1.0) * s / 10.0)


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["decays", "grows"])
def test_the_flow_is_continuous_where_its_formula_changes(sign: float) -> None:
    """d s^2 = -0.1 separates the series from the exponentials, d = 0 from sine and cosine. Truth: 60 digits."""
    for d in (*(sign * 0.1 * (1 + side * 1e-12) for sign in (1, -1) for side in (1, -1)), 1e-15, -1e-15):
        eta = sign * math.sqrt(1.0 - d)
        assert distance(flow(eta, 1.0, 1.0), naive.block_flow(eta, 1.0, 1.0), 1.0) < 4e-15


# Random signals


def random_signal(rng: np.random.Generator, n: int, damping: tuple[float, float] = (0.01, 3.0)) -> GuardedFlow:
    lam = np.exp(rng.uniform(np.log(0.2), np.log(40.0), n))
    eta = np.sqrt(lam) * np.exp(rng.uniform(*np.log(damping), n))
    row = rng.normal(size=(n, 2)) * [1.0, 0.2]
    row1 = np.column_stack([-lam * row[:, 1], row[:, 0] - 2 * eta * row[:, 1]])
    row2 = np.column_stack([-lam * row1[:, 1], row1[:, 0] - 2 * eta * row1[:, 1]])
    sin_part, cos_part = rng.normal(size=2) * 0.3
    omega, size = float(np.exp(rng.uniform(np.log(0.3), np.log(5.0)))), math.hypot(sin_part, cos_part)
    blocks = make_blocks(eta, lam)
    blocks[:, OF_FLOW:OF_GUARD] = np.hstack([row, row1, np.zeros((n, 4)), row2])
    numbers = np.array([omega, *(size * omega**k for k in (0, 2, 3, 4))])
    return GuardedFlow(blocks, np.array([[sin_part, cos_part]]), numbers, np.zeros((n, 2, 1, 2)))


def without_force(signal: GuardedFlow) -> GuardedFlow:
    return signal._replace(waves=np.zeros((1, 2)), numbers=np.array([signal.omega, 0.0, 0.0, 0.0, 0.0]))


def random_state(rng: np.random.Generator, signal: GuardedFlow) -> np.ndarray:
    lam = np.array(signal.lam)
    return rng.normal(size=(len(lam), 2)) * np.column_stack([np.ones_like(lam), np.sqrt(lam)])


def crossing(signal, h, phase, upper, lower, H, start=0, offset=0.0):
    return next_crossing(signal, h, phase, offset, upper, lower, start, H, np.zeros_like(h))


def test_the_bounds_hold_for_all_later_times_at_any_damping() -> None:
    """Truth: the signal as a sum of exponentials, sampled densely."""
    rng = np.random.default_rng(1)
    for _ in range(300):
        signal = random_signal(rng, 2, damping=(0.001, 60.0))
        h, phase = random_state(rng, signal), rng.uniform(0, 2 * math.pi)
        exact = naive.Exponentials.of(signal, h, phase)
        times = np.concatenate([[0.0], np.geomspace(1e-4, 30.0, 600)])
        for order, bound in zip((0, 2, 3, 4), derivative_bounds(signal.blocks, signal.numbers, h, np.inf), strict=True):
            assert np.max(np.abs(exact.at(times, order))) <= bound * (1 + 1e-9)


def test_no_gap_closes_within_a_safe_step() -> None:
    """Truth: the signal as a sum of exponentials, sampled densely over the step."""
    rng = np.random.default_rng(2)
    for _ in range(500):
        signal = random_signal(rng, 2)
        h, phase = random_state(rng, signal), rng.uniform(0, 2 * math.pi)
        exact = naive.Exponentials.of(signal, h, phase)
        y, v, a, j3 = (float(exact.at(np.zeros(1), k)[0]) for k in range(4))
        g = abs(rng.normal()) * 10.0 ** rng.uniform(-6, 0)
        _, M2, M3, M4 = derivative_bounds(signal.blocks, signal.numbers, h, np.inf)
        step = safe_step(g, v, a, j3, M2, M3, M4, 20.0)
        assert 0.0 < step <= 20.0
        assert np.max(exact.at(np.linspace(0.0, step, 400))) <= y + g + 1e-12


def agrees(exact: naive.Exponentials, found: tuple[float, int, int], true: tuple[float, int], scale: float) -> bool:
    """Same stop, and a time within what rounding of y leaves open: 1e-14 scale / v, or its root at a graze."""
    if found[1] != true[1]:
        return False
    if found[1] == 0:
        return True
    t = np.array([true[0]])
    v, a = abs(float(exact.at(t, 1)[0])), abs(float(exact.at(t, 2)[0]))
    blur = 2e-14 * scale
    return abs(found[0] - true[0]) <= 1e-13 * (1 + true[0]) + blur / max(v, math.sqrt(2.0 * blur * a))


@pytest.mark.parametrize(
    ("blocks", "flights", "seed"),
    [(1, 500, 3), pytest.param(2, 4000, 4, marks=pytest.mark.slow), (2, 400, 5), (3, 500, 5)],
)
def test_no_impact_is_missed_or_invented_on_random_flights(blocks: int, flights: int, seed: int) -> None:
    """Truth: dense sampling, turning points and bisection of a sum of exponentials."""
    rng = np.random.default_rng(seed)
    hits, evaluations = 0, []
    for _ in range(flights):
        signal = random_signal(rng, blocks)
        h, phase, H = random_state(rng, signal), rng.uniform(0, 2 * math.pi), rng.uniform(0.5, 6.0)
        exact = naive.Exponentials.of(signal, h, phase)
        y = float(exact.at(np.zeros(1))[0])
        upper, lower = y + rng.exponential(0.7) + 1e-9, y - rng.exponential(0.7) - 1e-9
        found = crossing(signal, h, phase, upper, lower, H)
        true = naive.first_crossing(exact, H, upper, lower)
        scale = float(np.sum(np.abs(exact.weights))) + abs(upper) + abs(lower)
        assert agrees(exact, found, true, scale)
        hits += found[1] != 0
        evaluations.append(found[2])
    assert 0.3 * flights < hits < 0.97 * flights
    assert np.mean(evaluations) < 6.0
    assert max(evaluations) < 30


@pytest.mark.parametrize(
    ("eta", "q1", "load", "reach"),
    [
        (0.2, 0.6, 0.0, 1.0 + 0.6 / 0.4),  # from 1 to 1 + q' / (2 eta)
        (0.2, -0.6, 0.0, 1.0),
        (0.0, 0.0, 0.0, 1.0),
        (0.0, 0.6, 0.0, math.inf),
        (0.2, 0.0, 0.3, math.inf),
    ],
)
def test_a_mode_without_stiffness_reaches_as_far_as_its_damper_lets_it(
    eta: float, q1: float, load: float, reach: float
) -> None:
    blocks = make_blocks(np.array([eta]), np.zeros(1))
    blocks[0, OF_FLOW:OF_GUARD] = [1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -2.0 * eta]
    blocks[0, COLUMN.load] = load
    bounds = derivative_bounds(blocks, np.array([1.0, 0.0, 0.0, 0.0, 0.0]), np.array([[1.0, q1]]), np.inf)
    assert bounds[0] == pytest.approx(reach, rel=1e-14)


@pytest.mark.parametrize("count", [500, pytest.param(5000, marks=pytest.mark.slow)])
def test_grazes_from_both_sides_are_distinguished_down_to_rounding(count: int) -> None:
    """Peaks, found by bisection of y', put a clearance of 1e-12 ... 1e-3 of the gap short of or past the stop."""
    rng = np.random.default_rng(6)
    evaluations: list[int] = []
    while len(evaluations) < count:
        signal = random_signal(rng, 2)
        h, phase, H = random_state(rng, signal), rng.uniform(0, 2 * math.pi), rng.uniform(3.0, 8.0)
        exact = naive.Exponentials.of(signal, h, phase)
        times, y, _ = naive.peaks(exact, H, samples=24)
        top = int(np.argmax(y))
        if top in (0, len(y) - 1):
            continue
        gap = y[top] - y[0]
        clearance = 10.0 ** rng.uniform(-12, -3) * gap
        past = len(evaluations) % 2 == 0
        scale = float(np.sum(np.abs(exact.weights))) + abs(y[top])
        if gap <= 0.05 * scale:
            continue
        upper = y[top] - clearance if past else y[top] + clearance
        t, side, taken = crossing(signal, h, phase, upper, -math.inf, H)
        evaluations.append(taken)
        assert side == (1 if past else 0)
        if past:
            assert y[0] < upper
            assert t <= times[top]
            assert abs(float(exact.at(np.array([t]))[0]) - upper) < 2e-14 * scale
    assert np.mean(evaluations) < 12.0
    assert max(evaluations) < 40


def test_a_stop_that_the_bound_excludes_costs_no_evaluation() -> None:
    rng = np.random.default_rng(7)
    signal = random_signal(rng, 2)
    h = random_state(rng, signal)
    reach = derivative_bounds(signal.blocks, signal.numbers, h, np.inf)[0]
    assert crossing(signal, h, 0.4, 1.001 * reach, -1.001 * reach, 9.0) == (9.0, 0, 0)


def test_a_stop_at_infinity_is_never_reached() -> None:
    """Truth: the mirror image of the flight, whose one stop is the other one."""
    rng = np.random.default_rng(8)
    for _ in range(200):
        signal = random_signal(rng, 2)
        h, phase = random_state(rng, signal), rng.uniform(0, 2 * math.pi)
        y = float(naive.Exponentials.of(signal, h, phase).at(np.zeros(1))[0])
        up = crossing(signal, h, phase, y + 0.2, -math.inf, 5.0)
        down = crossing(signal, -h, phase + math.pi, math.inf, -y - 0.2, 5.0)
        assert up[1] in (0, 1)
        assert down[1] == -up[1]
        assert down[0] == pytest.approx(up[0], rel=1e-9)


def test_no_motion_at_all_reaches_nothing() -> None:
    signal = without_force(random_signal(np.random.default_rng(9), 2))
    assert crossing(signal, np.zeros((2, 2)), 0.0, 1e-3, -1e-3, 5.0) == (5.0, 0, 0)


def on_stop(rng: np.random.Generator, zero: int) -> tuple[GuardedFlow, np.ndarray, float, naive.Exponentials]:
    """A flight whose first ``zero`` derivatives vanish and whose next one points away from the upper stop at y(0)."""
    signal = random_signal(rng, 2)
    phase = rng.uniform(0, 2 * math.pi)
    h = random_state(rng, signal)
    unit = np.eye(4).reshape(4, 2, 2)
    still = without_force(signal)
    columns = [naive.Exponentials.of(still, e, phase) for e in unit]
    zeros = np.zeros(1)
    response = np.array([[float(c.at(zeros, k)[0]) for c in columns] for k in range(1, 4)])
    now = np.array([float(naive.Exponentials.of(signal, h, phase).at(zeros, k)[0]) for k in range(1, 4)])
    target = now.copy()
    target[:zero] = 0.0
    target[zero] = -abs(now[zero])
    change = np.linalg.lstsq(response[: zero + 1], (target - now)[: zero + 1], rcond=None)[0]
    h = h + np.tensordot(change, unit, axes=1)
    return signal, h, phase, naive.Exponentials.of(signal, h, phase)


@pytest.mark.parametrize("zero", [0, 1, 2], ids=["after an impact", "from rest", "after a release"])
def test_a_flight_that_starts_on_its_stop_leaves_it_before_it_returns(zero: int) -> None:
    """Truth: dense sampling from just after the start, where the flight is off the stop already."""
    rng = np.random.default_rng(11 + zero)
    returns = 0
    for _ in range(400):
        signal, h, phase, exact = on_stop(rng, zero)
        stop = float(exact.at(np.zeros(1))[0])
        other = stop - rng.exponential(2.0)
        leading = abs(float(exact.at(np.zeros(1), zero + 1)[0]))
        start = 1e-3 / exact.fastest()
        if leading < 0.1 * float(np.sum(np.abs(exact.weights * exact.rates ** (zero + 1)))):
            continue
        later = naive.Exponentials(exact.weights * np.exp(exact.rates * start), exact.rates)
        true = naive.first_crossing(later, 5.0 - start, stop, other)
        found = crossing(signal, h, phase, stop, other, 5.0, start=1 + zero)
        assert found[1] == true[1]
        if true[1]:
            scale = float(np.sum(np.abs(exact.weights)))
            v = abs(float(exact.at(np.array([found[0]]), 1)[0]))
            assert found[0] == pytest.approx(true[0] + start, abs=1e-12 + 1e-13 * scale / v)
        returns += true[1] == 1
    assert returns > 20


def test_the_march_is_bounded_in_heavily_damped_flight() -> None:
    """eta / omega_j = 300: the two exponentials' moduli keep the bounds tight."""
    rng = np.random.default_rng(11)
    for _ in range(100):
        signal = random_signal(rng, 2, damping=(100.0, 300.0))
        h, phase = random_state(rng, signal), rng.uniform(0, 2 * math.pi)
        exact = naive.Exponentials.of(signal, h, phase)
        y = float(exact.at(np.zeros(1))[0])
        assert crossing(signal, h, phase, y + 1e-3, y - 1e-3, 5.0)[2] < 100


def test_the_naive_twin_agrees_with_multiprecision() -> None:
    """The oracle of this file, checked itself: y of one flight from 40-digit flows."""
    rng = np.random.default_rng(12)
    signal = random_signal(rng, 2)
    h = random_state(rng, signal)
    exact = naive.Exponentials.of(signal, h, 0.3)
    for t in (0.1, 2.0):
        with mp.workdps(40):
            angle = mp.mpf(0.3) + mp.mpf(signal.omega) * mp.mpf(t)
            true = mp.mpf(signal.sin_part[0]) * mp.sin(angle) + mp.mpf(signal.cos_part[0]) * mp.cos(angle)
        for eta, lam, row, start in zip(signal.eta, signal.lam, signal.row, h, strict=True):
            true += float(np.array(row) @ naive.block_flow(eta, lam, t) @ start)
        assert float(exact.at(np.array([t]))[0]) == pytest.approx(float(true), rel=1e-13)
