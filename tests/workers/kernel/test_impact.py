"""Impacts: restitution, saltation, complete chatter, motion on a stop, release."""

import math

import numpy as np
import pytest
from mpmath import mp

from tests import naive
from tests.oscillators import mass_spring
from tests.support.oracle import piecewise, simulate
from tests.support.oracle.model import pieces_of
from workers.kernel.chatter import chatter_left
from workers.kernel.contact import (
    LEAVE,
    REBOUND,
    REST,
    kick,
    outcome,
    rest_projection,
    saltation,
    stop_position,
)
from workers.kernel.coordinates import blocks_to_physical
from workers.kernel.flow import guard_of, guard_rate_of
from workers.kernel.hybrid.state import harmonics_at
from workers.kernel.motion import FLIGHT, motion_at
from workers.kernel.sticking import from_sticking, load_on_stop, stay_on_stop, to_sticking
from workers.model.hybrid_modes import ON
from workers.model.oscillator import Oscillator


def three_masses(R: float = 0.7) -> Oscillator:
    """A chain of three masses whose impacts are between the first two; its gap is not symmetric."""
    stiffness = np.array([[3.0, -1.0, 0.0], [-1.0, 2.5, -1.0], [0.0, -1.0, 4.0]])
    return mass_spring(
        mass=np.diag([1.0, 0.7, 2.0]), damping=0.1 * stiffness, stiffness=stiffness, gap_row=np.array([1.0, -1.0, 0.0]),
        force=np.array([0.0, 0.3, 1.0]), omega=1.3, tau=0.4, b_upper=0.3, b_lower=0.2, R=R,
    )  # fmt: skip


OSCILLATORS = {"two masses": naive.two_mass(**naive.FIGURES[3])[0], "three masses": three_masses()}


@pytest.fixture(params=OSCILLATORS)
def osc(request: pytest.FixtureRequest) -> Oscillator:
    return OSCILLATORS[request.param]


def through(osc: Oscillator, V: np.ndarray, ratio: float) -> None:
    saltation(osc.gap.blocks, osc.R, V, ratio)


def as_matrix(osc: Oscillator, act) -> np.ndarray:
    """The matrix (2n, 2n) by which ``act`` carries tangent vectors, in block coordinates."""
    size = 2 * len(osc.gap.kick)
    V = np.eye(size).reshape(size, -1, 2).copy()
    act(V)
    return V.reshape(size, size).T


def flat(rows) -> np.ndarray:
    return np.array(rows).ravel()


def test_the_kick_column_changes_the_gap_velocity_alone(osc: Oscillator) -> None:
    """c.k = 0, cA.k = 1, cA.(A k) = cA^2.k."""
    k, Ak = flat(osc.gap.kick), flat(osc.gap.kick1)
    c, cA, cA2 = flat(osc.gap.row), flat(osc.gap.row1), flat(osc.gap.row2)
    assert c @ k == pytest.approx(0.0, abs=1e-15)
    assert cA @ k == pytest.approx(1.0, rel=1e-14)
    assert c @ Ak == pytest.approx(1.0, rel=1e-14)
    assert cA @ Ak == pytest.approx(osc.cA2k, rel=1e-13)
    assert cA2 @ k == pytest.approx(osc.cA2k, rel=1e-13)


def test_a_kick_leaves_the_other_masses_momentum_to_the_contact() -> None:
    """Impact on one mass: the other's velocity stays. Impact between two: their total momentum stays."""
    for osc, momentum in (
        (OSCILLATORS["two masses"], np.array([0.0, 1.0])),
        (OSCILLATORS["three masses"], np.array([1.0, 0.7, 0.0])),
    ):
        n = len(osc.gap.kick)
        h = np.zeros((n, 2))
        kick(osc.gap.blocks, h, -0.6)
        velocities = (np.array(osc.to_physical) @ h.ravel())[len(h) :]
        assert np.array(osc.gap_row) @ velocities == pytest.approx(-0.6, rel=1e-14)
        assert momentum @ velocities == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize("ratio", [-7.0, 0.0, 3.0, 1e4])
def test_the_saltation_matrix_has_the_restitution_squared_as_determinant(osc: Oscillator, ratio: float) -> None:
    S = as_matrix(osc, lambda V: through(osc, V, ratio))
    assert np.linalg.det(S) == pytest.approx(osc.R**2, rel=1e-12 * (1 + abs(ratio)))


def test_without_restitution_the_saltation_matrix_loses_one_direction() -> None:
    inelastic = three_masses(R=0.0)
    S = as_matrix(inelastic, lambda V: through(inelastic, V, 2.0))
    assert np.linalg.matrix_rank(S, tol=1e-12) == 5


def test_the_projection_to_rest_loses_the_two_contact_directions(osc: Oscillator) -> None:
    """P k = P A k = 0, c P = cA P = 0, P P = P."""
    P = as_matrix(osc, lambda V: rest_projection(osc.gap.blocks, osc.cA2k, V))
    for zero in (
        P @ flat(osc.gap.kick),
        P @ flat(osc.gap.kick1),
        flat(osc.gap.row) @ P,
        flat(osc.gap.row1) @ P,
        P @ P - P,
    ):
        assert np.max(np.abs(zero)) < 1e-13
    assert np.linalg.matrix_rank(P, tol=1e-12) == 2 * len(osc.gap.kick) - 2


def test_rest_forgets_the_impacts_before_it(osc: Oscillator) -> None:
    """P S = P for every impact of the chatter."""
    P = as_matrix(osc, lambda V: rest_projection(osc.gap.blocks, osc.cA2k, V))
    for ratio in (-3.0, 0.5, 40.0):
        S = as_matrix(osc, lambda V, r=ratio: through(osc, V, r))
        assert np.max(np.abs(P @ S - P)) < 1e-12 * (1 + abs(ratio))


# What an impact leads to


def next_motion(R: float, v: float, load: float) -> int:
    """Of a signal whose terms add up to 0.5 in size: a hop of 1e-12 is ten thousand units of its rounding."""
    return int(outcome(load, v, R, 0.5, 2.0 * math.pi))


@pytest.mark.parametrize(("load", "expected"), [(0.3, REST), (-0.3, LEAVE)])
def test_an_inelastic_impact_rests_where_it_is_pressed_and_leaves_else(load: float, expected: int) -> None:
    assert next_motion(0.0, 0.4, load) == expected


def test_an_elastic_impact_never_comes_to_rest() -> None:
    assert next_motion(1.0, 1e-12, 1.0) == REBOUND


def test_an_impact_under_a_load_that_pulls_away_rebounds() -> None:
    assert next_motion(0.5, 1e-9, -1.0) == REBOUND


def test_an_impact_rebounds_as_long_as_its_hop_can_be_seen() -> None:
    assert next_motion(0.5, 0.1, 1.0) == REBOUND
    assert next_motion(0.5, 1e-5, 1.0) == REBOUND
    assert next_motion(0.5, 1e-6, 1.0) == REST


@pytest.mark.parametrize("R", [0.0, 0.3, 0.7, 0.95])
def test_what_is_left_of_a_chatter_takes_the_sum_of_its_hops_to_second_order(R: float) -> None:
    """Truth: hops under a load 2 + 5 t and a drag of 3 y' off the stop, each in closed form; errors are cubic."""
    load, rate, drag, left = 2.0, 5.0, 3.0, []
    for w in (1e-3, 1e-4):
        t, u = 0.0, w if R > 0.0 else 0.0
        while u > 1e-18:
            step = solve_hop(load + rate * t, rate, drag, u)
            t, u = t + step[0], R * step[1]
        left.append(abs(chatter_left(load, rate - drag * load, -drag, w if R > 0.0 else 0.0, R) - t))
    assert left[1] <= 2e-3 * left[0] + 1e-18


def solve_hop(load: float, rate: float, drag: float, w: float) -> tuple[float, float]:
    """How long a hop at speed w off a stop lasts where y'' = -load - rate t - drag y', and the speed at its end."""
    with mp.workdps(40):
        c, j, a, u = (mp.mpf(value) for value in (drag, rate, load, w))
        # y' + (a + j t) / c - j / c^2 decays as e^(-c t)
        start = u + a / c - j / c**2
        place = lambda t: start * -mp.expm1(-c * t) / c - (a / c - j / c**2) * t - j * t**2 / (2 * c)  # noqa: E731
        speed = lambda t: start * mp.exp(-c * t) - a / c + j / c**2 - j * t / c  # noqa: E731
        t = mp.findroot(place, 2 * u / a, tol=1e-60)
        return float(t), float(-speed(t))


def test_a_hop_below_rounding_ends_at_rest_even_close_to_elastic() -> None:
    assert next_motion(1 - 1e-9, 1e-9, 1.0) == REST


# On a stop


def forced(osc: Oscillator, phase: float) -> tuple[float, float, float]:
    """Y of one harmonic and its first two derivatives at a phase."""
    sin_part, cos_part, w = float(osc.gap.sin_part[0]), float(osc.gap.cos_part[0]), osc.gap.omega
    Y = sin_part * math.sin(phase) + cos_part * math.cos(phase)
    return Y, w * (sin_part * math.cos(phase) - cos_part * math.sin(phase)), -(w**2) * Y


def onto_stop(osc: Oscillator, u: np.ndarray, phase: float, side: int) -> np.ndarray:
    """The block state in flight of a state u (n - 1, 2) of the blocks that move while y is on a stop."""
    n = len(u) + 1
    h, V, room = np.zeros((n, 2)), np.zeros((0, n, 2)), (np.empty(2 * n), np.empty((0, 2 * n)))
    turn = harmonics_at(phase, len(osc.gap.waves))
    from_sticking(osc, np.append(u, [[0.0, 0.0]], axis=0), V, turn, side, *room, h, V)
    return h


@pytest.mark.parametrize("side", [1, -1])
def test_held_coordinates_give_a_state_on_the_stop_at_rest(osc: Oscillator, side: int) -> None:
    rng = np.random.default_rng(1)
    n = len(osc.gap.kick)
    for _ in range(20):
        u, phase, back = rng.normal(size=(n - 1, 2)), rng.uniform(0, 7), np.zeros((n, 2))
        h, V = onto_stop(osc, u, phase, side), np.zeros((0, n, 2))
        room = np.empty(2 * n), np.empty((0, 2 * n))
        Y, dY, _ = forced(osc, phase)
        rounding = 2e-15 * (1 + np.abs(u).max())
        assert guard_of(osc.gap.blocks, h) + Y == pytest.approx(stop_position(osc, side), abs=rounding)
        assert guard_rate_of(osc.gap.blocks, h) + dY == pytest.approx(0.0, abs=4 * rounding)
        to_sticking(osc, h, V, harmonics_at(phase, len(osc.gap.waves)), *room, back, V)
        assert back[:-1] == pytest.approx(u, abs=1e-14)
        assert not back[-1].any()


@pytest.mark.parametrize("side", [1, -1])
def test_the_load_gives_the_gap_mass_its_free_acceleration_toward_the_stop(osc: Oscillator, side: int) -> None:
    rng = np.random.default_rng(2)
    n = len(osc.gap.kick)
    for _ in range(20):
        u, phase = rng.normal(size=(n, 2)), rng.uniform(0, 7)
        u[-1] = 0.0
        h = onto_stop(osc, u[:-1], phase, side)
        _, _, ddY = forced(osc, phase)
        free = float(np.sum(osc.gap.row2 * h)) + ddY
        load = load_on_stop(osc, u, harmonics_at(phase, len(osc.gap.waves)), side)
        assert load == pytest.approx(osc.gap_mass * side * free, abs=1e-13)


@pytest.mark.parametrize("side", [1, -1])
def test_motion_on_a_stop_is_that_of_the_constrained_system(side: int) -> None:
    """Truth: the oracle, which holds x1 on the stop until its load there is gone."""
    p = naive.FIGURES[4] | {"f2": 0.6}
    osc, _ = naive.two_mass(**p)
    wall = side * p["b"]
    begin = [wall + side * 1.0, 0.1]
    cell = p | {"x1": wall, "x2": begin[0], "v2": begin[1]}
    (stay, *_) = simulate(cell, 1).stuck
    assert stay.start == 0 and stay.side == side
    *_, exact = piecewise.simulate(pieces_of(cell), [wall, begin[0], 0.0, begin[1]], span=stay.end).sections

    h = (np.array(osc.to_blocks) @ [wall, begin[0], 0.0, begin[1]]).reshape(2, 2)
    h = h - np.array(osc.gap.forced)[:, :, 0] @ [math.sin(p["tau"]), math.cos(p["tau"])]
    frame = (np.zeros((0, 2, 2)), np.zeros(0), np.zeros((0, 0)))
    time, released, evaluations = stay_on_stop(osc, h, *frame, p["tau"], side, 6.0)
    assert released == 1
    assert evaluations < 30
    assert time == pytest.approx(float(stay.end), rel=1e-10)
    angle = p["tau"] + time * p["omega"]
    full = h + np.array(osc.gap.forced)[:, :, 0] @ [math.sin(angle), math.cos(angle)]
    x1, x2, v1, v2 = np.array(osc.to_physical) @ full.ravel()
    assert (x1, v1) == pytest.approx((wall, 0.0), abs=1e-15)
    assert (x2, v2) == pytest.approx((float(exact[1]), float(exact[3])), abs=1e-10)


def test_a_section_state_on_a_stop_lies_there_exactly_at_rest() -> None:
    osc, _ = naive.two_mass(**naive.STICKING)
    h = onto_stop(osc, np.array([[0.123, -0.456]]), osc.tau, 1)
    state = blocks_to_physical(osc, motion_at(h, mode=FLIGHT + ON))
    assert state[0] == osc.b_upper
    assert state[2] == 0.0


def test_tangent_vectors_of_held_motion_stay_on_the_stop() -> None:
    """c.V = cA.V = 0 after a stay."""
    osc, _ = naive.two_mass(**naive.STICKING)
    rng = np.random.default_rng(3)
    h = onto_stop(osc, np.array([[0.6, 0.2]]), 1.0, 1)
    V = rng.normal(size=(4, 2, 2))
    rest_projection(osc.gap.blocks, osc.cA2k, V)
    stay_on_stop(osc, h, V, np.zeros(4), np.zeros((0, 0)), 1.0, 1, 0.2)
    for v in V:
        assert guard_of(osc.gap.blocks, v) == pytest.approx(0.0, abs=1e-14)
        assert guard_rate_of(osc.gap.blocks, v) == pytest.approx(0.0, abs=1e-14)
