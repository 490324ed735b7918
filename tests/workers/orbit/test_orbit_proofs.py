"""What a proof of an orbit takes: each of its tests from both sides, on motions that are put where it decides."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from tests import naive
from tests.oscillators import mass_spring
from tests.workers.orbit.test_attraction import naive_norm
from tests.workers.orbit.test_stroboscopic import KINDS
from workers.attractors.matching import KnownOrbits, orbits_reached
from workers.cell.interval import run_periods
from workers.kernel.cell_loops import scale_of
from workers.kernel.coordinates import motion_from
from workers.kernel.motion import EVALUATIONS, FLIGHT, motion_at, motions_at
from workers.model.hybrid_modes import ModeCode
from workers.model.oscillator import Oscillator, make_blocks, many_of, take_one
from workers.model.system import find_system
from workers.orbit.attraction import shrinking_norm
from workers.orbit.map import iterate, iterate_alone, jacobian_of
from workers.orbit.newton import (
    PeriodicOrbits,
    far_from_closing,
    is_hopeless,
    newton,
    no_orbits,
    recurrence,
    settle_cells,
)
from workers.orbit.section import SHIFT, motion_after
from workers.tile import solve_tile


class Proof(NamedTuple):
    """Whether a motion was shown to fall into an orbit, that orbit, and the periods it took."""

    found: bool
    orbits: PeriodicOrbits
    spent: int


def proof(
    osc: Oscillator, h: np.ndarray, lag: int = 1, mode: int = FLIGHT, budget: int = 1000, away: float = 0.0
) -> Proof:
    """The proof for a motion at block state h that seems to have returned, so far away, after ``lag`` periods."""
    sections = np.full((1, lag + 1, *h.shape), 1e9)
    sections[0, 0] = sections[0, lag] = h
    sections[0, 0, 0, 1] += away
    orbits, spent = no_orbits(1, len(h)), np.zeros(1, dtype=np.int64)
    found = settle_cells(
        many_of(osc), motions_at(h[None], np.array([[mode]])), sections, np.array([lag + 1]), np.array([1e-2]), 64,
        np.array([budget]), np.arange(1), orbits, spent,
    )  # fmt: skip
    return Proof(bool(found[0]), orbits, int(spent[0]))


def machine(
    omega: float = 3.0,
    b: float = 0.1,
    R: float = 0.95,
    zeta: float = 0.01,
    lower: float = math.inf,
    force: float = 1.0,
) -> Oscillator:
    """x'' + 2 zeta x' + 4 x = force sin(omega t), stops at b and -lower."""
    return mass_spring(
        mass=[[1.0]], damping=[[2.0 * zeta]], stiffness=[[4.0]], gap_row=[1.0], force=[force],
        omega=omega, tau=0.0, b_upper=b, b_lower=lower, R=R,
    )  # fmt: skip


def path(osc: Oscillator, h: np.ndarray, steps: int, half: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Block states (steps + 1, n, 2) from h on, after each step of the map, and the Jacobian of all of them."""
    states, motion = [h], motion_at(h, vectors=h.size)
    for _ in range(steps):
        motion = iterate(osc, motion.h, int(motion.mode[0]), motion.V, np.zeros(0), np.zeros((0, 0)), 1, half)
        states.append(motion.h)
    return np.array(states), jacobian_of(motion.V)


def after(osc: Oscillator, h: np.ndarray, periods: int) -> np.ndarray:
    """The block state of a motion so many periods after h."""
    motion = motion_at(h)
    run_periods(osc, motion, periods)
    return motion.h.copy()


def attractor(osc: Oscillator) -> np.ndarray:
    """The block state that motion from rest comes to."""
    return after(osc, motion_from(osc, np.zeros(2 * len(osc.gap_row))).h, 3000)


def weights(osc: Oscillator) -> np.ndarray:
    """(2n,): the energy norm of a block state is the plain norm of it times these."""
    return np.array([factor for metric in osc.gap.metric for factor in (math.sqrt(metric), 1.0)])


WEAK = machine()
"""Falls into an orbit of period 1 with one impact, slowly: multipliers of modulus .93."""

HELD = naive.two_mass(**KINDS["held at the section"])[0]
"""Rests on the lower stop at the section."""

LINEAR = machine(b=5.0)
"""Never reaches its stop: the map is linear, and h = 0 its fixed point."""


# Falling into an orbit


@pytest.mark.parametrize(("missed", "falls"), [(0.46, True), (0.54, False)])
@pytest.mark.parametrize("angle", [0.4, 1.9, 3.5, 5.1])
def test_motion_falls_into_an_orbit_where_the_linear_map_misses_less_than_half_of_the_contraction(
    angle: float, missed: float, falls: bool
) -> None:
    """Truth: |F(h) - h* - J (h - h*)| / ((1 - |mu|) |h - h*|) on the section of the proof: J from differences of the
    map, mu from numpy, the norm as it is defined.
    """
    begin, w, e = attractor(WEAK), weights(WEAK), 1e-6
    h = motion_after(WEAK, begin, FLIGHT, SHIFT).h
    there = WEAK._replace(tau=WEAK.tau + 2.0 * math.pi * SHIFT)
    steps = e * np.eye(2).reshape(2, 1, 2)
    J = np.column_stack([(after(there, h + d, 1) - after(there, h - d, 1)).ravel() / (2.0 * e) for d in steps])
    contraction = 1.0 - np.abs(np.linalg.eigvals(J)).max()
    P = naive_norm(WEAK.gap.metric, J, contraction)

    def beside(distance: float) -> np.ndarray:
        return begin + (distance * np.array([math.cos(angle), math.sin(angle)]) / w).reshape(1, 2)

    def share(distance: float) -> float:
        """The largest of the turns that it takes to come nearer for good, and one more."""
        at = motion_after(WEAK, beside(distance), FLIGHT, SHIFT).h
        begun, worst, nearer = np.linalg.norm(w * (at - h).ravel()), 0.0, False
        while True:
            image = after(there, at, 1)
            d = (at - h).ravel()
            r = (image - h).ravel() - J @ d
            worst = max(worst, float(np.sqrt(r @ P @ r) / (contraction * np.sqrt(d @ P @ d))))
            if worst > 0.6 or nearer:
                return worst
            coming = [w * (np.linalg.matrix_power(J, k) @ (image - h).ravel()) for k in range(256)]
            nearer = max(np.linalg.norm(deviation) for deviation in coming) < begun
            at = image

    low, high = 0.003, 0.3
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if share(middle) < missed else (low, middle)
    assert share(low) == pytest.approx(missed, abs=1e-6)
    seen = proof(WEAK, beside(low))
    assert seen.orbits.shift[0] == (SHIFT if falls else 0.0)
    assert seen.found == falls
    assert seen.orbits.near[0] != falls


BALL = {"A": 1.4793659576198743, "R": 0.7218461298343304, "v": 4.440624081034672}
"""Falls into an orbit of period 4 with |mu| = .52, whose Jacobian has the energy norm 10 at the section."""


def test_nothing_is_shown_to_fall_into_an_orbit_that_it_leaves() -> None:
    """Truth: each motion itself, 1600 periods later; results are of the section after that from which a proof begins.
    Motions reach known orbits by the same test, on the sections that are kept.
    """
    ball = find_system("bouncing-ball")
    osc = ball.build({p.name: BALL.get(p.name, p.default) for p in ball.parameters})
    cell = solve_tile(ball, BALL)
    h, period = motion_from(osc, cell["state"]).h, int(cell["period"])
    w = weights(osc)
    scale = float(np.linalg.norm(w * h.ravel()) + np.linalg.norm(w * osc.gap.swing.ravel()))
    J = path(osc, h, period)[1]
    contraction = 1.0 - np.abs(np.linalg.eigvals(J)).max()
    assert (period, contraction) == (4, pytest.approx(0.479, abs=1e-3))
    assert np.linalg.norm(w[:, None] * J / w, 2) > 10.0
    norm = shrinking_norm(osc.gap.blocks, J, contraction)
    known = KnownOrbits(
        np.zeros(1, dtype=np.int64), np.ones(1, dtype=np.int64), h[None], np.array([period]), J[None],
        np.array([contraction]), norm[None],
    )  # fmt: skip
    own = np.zeros(1, dtype=np.int64)
    seen = []
    for distance in np.geomspace(1e-4, 0.03, 10):
        for angle in np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False):
            d = distance * scale * np.array([math.cos(angle), math.sin(angle)]) / w
            start = h + d.reshape(1, 2)
            sections = path(osc, start, 3 * period)[0][None]
            told = orbits_reached(osc.gap.blocks[None], sections, np.array([len(sections[0])]), own, own, known)
            shown = proof(osc, start, period)
            own_end, end = after(osc, start, 400 * period), after(osc, start, 400 * period + 1)
            falls = float(np.linalg.norm(w * (own_end - h).ravel())) < 1e-6 * scale
            assert falls or told[0] < 0
            assert not shown.found or np.linalg.norm(w * (end - shown.orbits.h[0]).ravel()) < 1e-6 * scale
            seen.append((falls, shown.found, told[0] == 0))
    assert sum(falls for falls, _, _ in seen) < len(seen) - 10
    assert sum(shown for _, shown, _ in seen) > 100
    assert sum(known for _, _, known in seen) > 100


def test_newton_stops_where_the_residual_no_longer_falls() -> None:
    """On an unstable orbit of two periods of the chaos of Fig. 5, whose multiplier of 13.6 keeps residuals above 1e-15
    of the motion: from 1e-8 beside it two steps reach rounding, and a few more show that it is."""
    osc = naive.two_mass(**naive.FIGURES[5])[0]
    there = osc._replace(tau=osc.tau + 2.0 * math.pi * SHIFT)
    start = motion_after(osc, attractor(osc), FLIGHT, SHIFT).h
    scale, rng = float(scale_of(osc.gap.blocks, start)), np.random.default_rng(1)
    h, whole = start, np.bool_(False)
    for _ in range(40):
        orbit, _ = newton(there, h, FLIGHT, 2, whole, scale, 12)
        if 13.0 < np.abs(np.linalg.eigvals(orbit.jacobian)).max() < 14.0:
            break
        h = after(there, h, 1)
    assert orbit.residual < 1e-13 * scale
    starts = orbit.h + 1e-8 * scale * rng.normal(size=(16, *start.shape))
    spent = [newton(there, one, FLIGHT, 2, whole, scale, 12)[1] for one in starts]
    assert 3 <= max(spent) <= 7


# Which orbit it is


@pytest.mark.parametrize("lag", [2, 3, 4, 9])
@pytest.mark.parametrize("lower", [math.inf, 0.3], ids=["one stop", "symmetric"])
def test_an_orbit_that_is_seen_to_return_after_several_turns_is_proved_as_one(lower: float, lag: int) -> None:
    osc = machine(2.2, 0.3, 0.7, 0.05, lower)
    h = attractor(osc)
    for turns in (1, lag):
        seen = proof(osc, h, turns)
        assert seen.found and seen.orbits.period[0] == 1
        assert seen.orbits.symmetric[0] == math.isfinite(lower)


def test_a_symmetric_machine_has_orbits_that_are_not_symmetric() -> None:
    """Truth: half a period later the motion is not the mirror image of what it was, but its twin's."""
    osc = machine(lower=0.1)
    h = attractor(osc)
    seen = proof(osc, h)
    assert seen.found and seen.orbits.period[0] == 1 and not seen.orbits.symmetric[0]
    states, _ = path(osc, h, 2, half=True)
    assert np.abs(states[1] - h).max() > 0.01
    assert states[2] == pytest.approx(h, abs=1e-12)
    twin = proof(osc, states[1])
    assert twin.found and twin.orbits.exponents == pytest.approx(seen.orbits.exponents, rel=1e-9)


def test_near_a_symmetric_orbit_nothing_is_proved_that_is_not_symmetric() -> None:
    """Farther away motion is sooner shown to fall into an orbit of whole periods than into one of half periods."""
    osc = machine(2.2, 0.3, 0.7, 0.05, 0.3)
    h, w = attractor(osc), weights(osc)
    found = 0
    for angle in np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False):
        for distance in np.geomspace(0.1, 2.0, 24):
            start = h + (distance * np.array([math.cos(angle), math.sin(angle)]) / w).reshape(1, 2)
            seen = proof(osc, start)
            assert not seen.found or seen.orbits.symmetric[0]
            found += seen.found
    assert 100 < found < 500


def test_an_orbit_that_rests_on_a_stop_at_the_section_is_found_also_from_beside_the_stop() -> None:
    """A motion that lies there but for rounding comes to rest before the section of the proof."""
    motion = motion_from(HELD, np.zeros(4))
    run_periods(HELD, motion, 500)
    side = int(motion.mode[0])
    assert side != FLIGHT
    for mode in (side, FLIGHT):
        seen = proof(HELD, motion.h, mode=mode)
        assert seen.found and seen.orbits.mode[0, 0] == side


# Near the limit of stability


def test_undamped_motion_without_impact_is_no_stable_orbit_nor_near_one() -> None:
    osc = machine(b=5.0, zeta=0.0)
    for start in (0.0, 1e-3):
        seen = proof(osc, np.full((1, 2), start))
        assert not seen.found and not seen.orbits.near[0]


@pytest.mark.parametrize(("zeta", "stable"), [(3e-16, False), (1e-14, True)])
def test_an_exponent_counts_as_negative_only_beyond_its_rounding_error(zeta: float, stable: bool) -> None:
    """The exponent is -zeta T exactly, T = 2 pi / 3, and its rounding error 1e-15."""
    assert proof(machine(b=5.0, zeta=zeta), np.zeros((1, 2))).found == stable


@pytest.mark.parametrize(("lower", "error"), [(math.inf, 1e-15), (5.0, 2e-15)], ids=["whole", "half"])
def test_the_rounding_error_of_a_turn_is_told_per_period(lower: float, error: float) -> None:
    """1e-15 a turn where all multipliers are near one; of a symmetric orbit a turn takes half a period."""
    seen = proof(machine(b=5.0, zeta=1e-6, lower=lower), np.zeros((1, 2)))
    assert seen.found
    assert seen.orbits.error[0] == pytest.approx(error, rel=1e-4, abs=0.0)


@pytest.mark.parametrize(("modulus", "hopeless"), [(29.9, False), (30.1, True)])
def test_only_multipliers_decide_that_there_is_no_hope_of_a_stable_orbit(modulus: float, hopeless: bool) -> None:
    """The norm of this Jacobian is above a thousand either way."""
    J = np.diag([0.5, -modulus, 0.1, 0.0]) + np.diag([1e3, 1e3, 1e3], 1)
    assert is_hopeless(J) == hopeless


def test_small_jacobians_leave_hope() -> None:
    assert not is_hopeless(np.diag([29.0, 1.0]))
    assert is_hopeless(np.full((2, 2), math.nan))


# What it costs


def test_the_periods_of_a_proof_are_all_counted() -> None:
    """On the fixed point of a linear map: one period to the section of the proof and back, one turn of Newton's, two of
    the frame, one for the error. Beside it one more of Newton's and two of the motion; that two turns are one is seen
    by a turn of Newton's, twice as long, and one of its own.
    """
    on, beside = np.zeros((1, 2)), np.full((1, 2), 1e-3)
    assert proof(LINEAR, on).spent == 5
    assert proof(LINEAR, beside).spent == 8
    assert proof(LINEAR, on, 2).spent == 2 + 1 + 5


def test_a_proof_by_half_periods_is_counted_in_periods() -> None:
    """The same period and four turns, or seven, of half a period each."""
    symmetric = machine(b=5.0, lower=5.0)
    assert proof(symmetric, np.zeros((1, 2))).spent == 1 + 2
    assert proof(symmetric, np.full((1, 2), 1e-3)).spent == 1 + 4


def test_a_proof_takes_no_more_than_its_budget_and_none_without_multipliers() -> None:
    """Beside the period to the section and back seven turns are kept for the tests after Newton's method and the frame,
    which take two each."""
    seen = [proof(LINEAR, np.full((1, 2), 1e-3), budget=budget) for budget in range(6, 13)]
    assert [s.spent for s in seen] == [0, 0, 1, 2, 3, 3, 8]
    assert [s.found for s in seen] == [False] * 6 + [True]


# Near returns


@pytest.mark.parametrize("unit", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize(("near", "seen"), [(0.99e-2, True), (1.01e-2, False)])
def test_a_return_is_near_within_a_hundredth_of_the_motions_scale_in_any_unit(
    unit: float, near: float, seen: bool
) -> None:
    """At h = 0 that scale is the energy norm of the forced response: sqrt(k + omega^2) |Y|."""
    osc = machine(b=5.0 * unit, force=unit)
    scale = math.sqrt(4.0 + 3.0**2) * unit / math.hypot(4.0 - 3.0**2, 2.0 * 0.01 * 3.0)
    assert proof(osc, np.zeros((1, 2)), away=near * scale).found == seen


def returns_of(metric: np.ndarray, sections: np.ndarray, near: float, longest: int) -> list[int]:
    """The naive twin of ``recurrence``."""
    found, record = [], near
    for p in range(1, min(len(sections) - 1, longest) + 1):
        apart = sections[-1] - sections[-1 - p]
        here = math.sqrt(np.sum(metric * apart[:, 0] ** 2 + apart[:, 1] ** 2))
        if record >= 1e-10 * near and here < record:
            found, record = [p, *found], 0.1 * here
    return found[:3]


def test_near_returns_are_those_ten_times_closer_than_shorter_ones() -> None:
    """Truth: the naive twin, on distances spread over six decades."""
    rng = np.random.default_rng(1)
    metric, longest = np.array([0.5, 3.0]), 30
    blocks = make_blocks(np.zeros(2), metric)
    seen = []
    for _ in range(300):
        sections = rng.normal(size=(rng.integers(1, 50), 2, 2)) * 10.0 ** rng.uniform(-6, 0, size=(1, 1, 1))
        sections *= 10.0 ** rng.uniform(-6, 0, size=(len(sections), 1, 1))
        sections[-1] = 0.0
        found = recurrence(blocks, sections, 1e-1, longest).tolist()
        assert found == returns_of(metric, sections, 1e-1, longest)
        seen.append(len(found))
    assert set(seen) == {0, 1, 2, 3}


@pytest.mark.parametrize(("longest", "expected"), [(4, []), (5, [5])])
def test_a_return_after_the_longest_lag_counts(longest: int, expected: list[int]) -> None:
    sections = np.ones((20, 1, 2))
    sections[-1] = sections[-6] = 0.0
    assert recurrence(make_blocks(np.zeros(1), np.ones(1)), sections, 0.1, longest).tolist() == expected


@pytest.mark.parametrize("unit", [1e-4, 1e4])
def test_which_of_many_motions_are_far_from_closing_is_said_of_their_last_sections_alone(unit: float) -> None:
    """Of the second the last section closes, of the third only earlier ones do, of the fourth one too long ago."""
    sections = np.zeros((4, 9, 1, 2))
    sections[:, :, 0, 1] = unit * 2.0 ** np.arange(9)
    sections[1, 5] = sections[1, 8] + 1e-6 * unit
    sections[2, 5] = sections[2, 7]
    sections[3, 4] = sections[3, 8]
    blocks, h = make_blocks(np.zeros((4, 1)), np.ones((4, 1))), np.zeros((4, 1, 2))
    h[:, 0, 1] = unit
    rows = np.array([3, 1, 2])
    assert far_from_closing(blocks, h, sections, rows, 3, 1e-5).tolist() == [True, False, True]
    assert far_from_closing(blocks, h, sections, rows, 3, 1e-7).tolist() == [True, True, True]
    assert far_from_closing(blocks, h, sections, rows, 4, 1e-5).tolist() == [False, False, True]


SLIDING = ModeCode(0, (), (1,)).number
"""The contact of a motion of a machine with one friction while that slides."""


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize(("name", "mode"), [("two-mass", FLIGHT), ("friction-oscillator", SLIDING)])
def test_a_trial_state_that_is_no_number_costs_next_to_nothing(name: str, mode: int, value: float) -> None:
    """Newton's method may come to one where a Jacobian is singular."""
    system = find_system(name)
    osc, _ = system.build_many({p.name: np.array([p.default]) for p in system.parameters})
    h = np.full((len(system.states) // 2, 2), value)

    def cost(_: np.ndarray) -> float:
        return float(iterate_alone(take_one(osc, 0), h, mode, 3, np.bool_(False)).tally[EVALUATIONS])

    assert osc.with_modes(cost, np.zeros(1, dtype=np.int64)) <= 20.0
