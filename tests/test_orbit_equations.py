"""Periodic orbits as equations of their impacts: the answer to kicks, derivatives, stability."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.handmade import (
    CURVES,
    bouncing_ball,
    exponents,
    general,
    impact_pair,
    reference_event,
    reference_name,
    reference_orbit,
    reference_values,
)
from workers.continuation.admissible import CONTACT, LOST, first_fault
from workers.continuation.equations import Itinerary, Motion, Orbit, check_orbits, many_orbits
from workers.continuation.extended import Extended, solve
from workers.continuation.orbits import section_state
from workers.continuation.oscillator import ModalOscillator, family_of
from workers.continuation.pulses import answers
from workers.continuation.stability import flights, multipliers, turn_map
from workers.model.oscillator import COLUMN, OF_FLOW, make_blocks
from workers.model.system import find_system

TWO_MASS = find_system("two-mass")

BIFURCATIONS = [record for record in CURVES if record["times"]]


def motion_at(record: dict[str, Any]) -> Motion:
    lin = family_of(TWO_MASS, reference_values(record), ()).model(np.zeros((1, 0)))
    return Motion(lin, many_orbits([reference_orbit(record)]))


@pytest.mark.parametrize("record", CURVES, ids=reference_name)
def test_a_reference_point_is_found_again_with_its_digits(record: dict[str, Any]) -> None:
    """Truth: 40-digit residuals. Newton starts a ten-thousandth away."""
    family, event, values = reference_event(record, tuple(record["free"]))
    square = Extended(family, event.point.orbit, event.conditions, values, 0.2 * values)
    exact = square.pack(event.point.orbit, event.point.contacts, values)
    square = square.at(exact)
    moved = exact * (1.0 + 1e-4 * np.random.default_rng(0).standard_normal(len(exact)))
    found = solve(square, moved)
    assert found.converged
    assert found.steps <= 5
    assert pytest.approx(exact, abs=2e-13) == found.X


@pytest.mark.parametrize("record", BIFURCATIONS, ids=reference_name)
def test_a_reference_orbit_has_its_multipliers_and_its_section_state(record: dict[str, Any]) -> None:
    found = multipliers(motion_at(record))[0]
    for re, im in record["multipliers"]:
        assert np.min(np.abs(found - complex(float(re), float(im)))) < 2e-13
    state = section_state(TWO_MASS, reference_values(record), reference_orbit(record))
    assert state == pytest.approx(record["state"], abs=2e-14)


@pytest.mark.slow
@pytest.mark.parametrize("record", BIFURCATIONS, ids=reference_name)
def test_a_reference_orbit_is_admissible(record: dict[str, Any]) -> None:
    family, event, values = reference_event(record, tuple(record["free"]))
    orbit = event.point.orbit
    lin = Extended(family, orbit, (), values, values).model(values)
    assert first_fault(Motion(lin, many_orbits([orbit])), event.point.contacts) is None


def test_a_contact_that_the_itinerary_lacks_is_found() -> None:
    """Truth: past its graze the orbit reaches the stop at the time of the graze."""
    record = next(record for record in CURVES if record["kind"] == "graze" and record["times"])
    given = reference_values(record)
    family = family_of(TWO_MASS, given, ("b",))
    orbit = reference_orbit(record)
    faults = []
    for b in (given["b"] * (1 - 1e-4), given["b"] * (1 + 1e-4)):
        values = np.array([b])
        equations = Extended(family, orbit, (), values, values)
        row = np.eye(1, 5, 4)[0]
        found = solve(equations, equations.pack(orbit, np.zeros(0), values), row)
        faults.append(first_fault(equations.motion(found.X)))
    crossed = [fault for fault in faults if fault is not None]
    assert len(crossed) == 1
    assert crossed[0].reason == CONTACT
    assert crossed[0].side == 1
    assert crossed[0].time == pytest.approx(float(record["extra"][0]), abs=0.1)


def test_an_impact_that_moves_off_its_stop_is_a_fault() -> None:
    record = CURVES[4]
    family, event, values = reference_event(record, ("omega",))
    lin = Extended(family, event.point.orbit, (), values, values).model(values)
    orbit = event.point.orbit
    turned = orbit._replace(speeds=orbit.speeds * np.array([1.0, -1.0]))
    fault = first_fault(Motion(lin, many_orbits([turned])))
    assert fault is not None
    assert (fault.reason, fault.impact) == (LOST, 1)


def kicked(
    lin: ModalOscillator, orbits: Orbit, span: float, h: np.ndarray, s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The naive twin: block states at times s, and at the end of the turn, by an integrator from h at time 0."""
    eta, lam, load = lin.gap.eta[0], lin.gap.lam[0], lin.gap.load[0]
    n = len(eta)

    def rate(_: float, u: np.ndarray) -> np.ndarray:
        x, v = u[:n], u[n:]
        return np.concatenate([v, load - 2.0 * eta * v - lam * x])

    u, out, now = np.concatenate([h[:, 0], h[:, 1]]), [], 0.0
    for t, v in [*zip(orbits.times[0], orbits.speeds[0], strict=True), (span, 0.0)]:
        inside = s[(s > now) & (s < t)]
        path = solve_ivp(rate, (now, t), u, t_eval=[*inside, t], method="DOP853", rtol=1e-13, atol=1e-13)
        out += list(path.y.T[: len(inside)])
        u = path.y[:, -1] - (1.0 + lin.R[0]) * v * lin.gap.kick[0].T.ravel()
        now = t
    return np.array(out), u


@pytest.mark.parametrize("damping", [0.0, 1e-4, 0.05, 0.3, 2.0])
def test_the_answer_to_kicks_is_that_of_a_general_integrator(damping: float) -> None:
    """Blocks with both entries of c and k, a damped or undamped rigid mode under a load, and two harmonics."""
    lin = general(rigid_damping=damping)
    itinerary = Itinerary((1, -1, 1), 2)
    span = float(itinerary.span(lin)[0])
    v = np.array([[0.8, -0.5, 0.3]])
    balance = lin.gap.blocks[0, 2, COLUMN.load] * span / ((1.0 + lin.R[0]) * lin.gap.kick[0, 2, 1])
    orbits = Orbit(itinerary, np.array([[0.9, 2.2, 5.1]]), v * balance / v.sum(), np.array([0.25]))
    start = Motion(lin, orbits).block_state(np.zeros((1, 1)))[0, ..., 0]
    s = np.array([0.3, 1.0, 2.0, 2.3, 4.0, 6.0])
    path, end = kicked(lin, orbits, span, start, s)
    phase = lin.omega[0] * s + lin.tau[0]
    waves = zip(lin.gap.sin_part[0], lin.gap.cos_part[0], (phase, 2.0 * phase), strict=True)
    Y = sum(sin * np.sin(angle) + cos * np.cos(angle) for sin, cos, angle in waves)
    y = path[:, :3] @ lin.gap.row[0, :, 0] + path[:, 3:] @ lin.gap.row[0, :, 1] + Y
    assert end == pytest.approx(np.concatenate([start[:, 0], start[:, 1]]), abs=1e-10)
    assert Motion(lin, orbits).at(s[None])[0][0] == pytest.approx(y, abs=1e-10)


@pytest.mark.parametrize("damping", [0.0, 1e-9, 0.02, 0.13, 0.14, 1.0, 40.0])
def test_the_answer_of_a_rigid_mode_has_a_unit_kick_and_mean_zero(damping: float) -> None:
    """Truth: its definition, g'(0) - g'(L) = 1 and g(0) = g(L); 0.13 and 0.14 lie on either side of the series."""
    lin = bouncing_ball((), A=1.0, R=0.5).model(np.zeros((1, 0)))
    eta = np.full((1, 1), damping)
    blocks = lin.gap.blocks.copy()
    blocks[..., :OF_FLOW] = make_blocks(eta, lin.gap.lam)[..., :OF_FLOW]
    lin = lin._replace(gap=lin.gap._replace(blocks=blocks))
    nodes, weights = np.polynomial.legendre.leggauss(200)
    s = np.concatenate([[0.0, 3.7], 1.85 * (nodes + 1.0)])
    u, load = answers(lin.gap.blocks, np.array([3.7]), 1.0, s[None, :, None])
    g0, g1 = u[0, 0, :, :, 0]
    assert g0[0] == pytest.approx(g0[1], abs=1e-14)
    assert g1[0] - g1[1] == pytest.approx(1.0, abs=1e-14)
    assert 1.85 * weights @ g0[2:] == pytest.approx(0.0, abs=1e-12)
    assert load == pytest.approx(-1.0 / 3.7, abs=1e-12)


def test_flows_are_those_of_the_kernel_s_formula() -> None:
    """Truth: matrix exponentials; near critical and far over it too."""
    from scipy.linalg import expm

    for eta, lam in ((0.1, 4.0), (2.0, 4.0), (2.0 + 1e-7, 4.0), (9.0, 4.0), (0.7, 0.0), (0.0, 0.0), (0.0, 3.0)):
        for s in (1e-3, 0.4, 3.0):
            blocks = make_blocks(np.array([[eta]]), np.array([[lam]]))
            exact = expm(np.array([[0.0, 1.0], [-lam, -2.0 * eta]]) * s)
            found = flights(blocks, np.array([[s]]), np.ones(1), np.zeros((1, 0)))[0, 0]
            assert found == pytest.approx(exact, abs=1e-13)


@pytest.mark.parametrize("record", BIFURCATIONS, ids=reference_name)
def test_the_jacobian_is_that_of_finite_differences(record: dict[str, Any]) -> None:
    differences_of(motion_at(record), 1e-8)


def test_the_jacobian_with_a_rigid_mode_is_that_of_finite_differences() -> None:
    lin = general(harmonics=1)
    orbit = Orbit(Itinerary((1, -1, 1), 2), np.array([0.9, 2.2, 5.1]), np.array([0.8, -0.5, 0.3]), 0.25)
    differences_of(Motion(lin, many_orbits([orbit])), 1e-7)


def differences_of(motion: Motion, tolerance: float) -> None:
    (lin, (itinerary, times, speeds, offset)), J = motion, motion.linearised()[0]
    m, X = times.shape[1], np.concatenate([times[0], speeds[0], offset])[: len(J)]
    for i in range(len(J)):
        ends = []
        for sign in (1.0, -1.0):
            moved = X.copy()
            moved[i] += sign * 1e-6
            offset = moved[2 * m :] if len(J) > 2 * m else offset
            ends.append(Motion(lin, Orbit(itinerary, moved[None, :m], moved[None, m : 2 * m], offset)).residual()[0])
        assert J[:, i] == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=tolerance)


@pytest.mark.parametrize("z", [1.0, -1.0, np.exp(0.7j), 1.3])
@pytest.mark.parametrize("record", BIFURCATIONS[2:7:2] + BIFURCATIONS[-1:], ids=reference_name)
def test_the_determinant_is_that_of_the_turn_without_poles(record: dict[str, Any], z: complex) -> None:
    """det J_z = prod(-v_i) det(z - DP) / det(z - e^(A span)), the whole orbit and the half of a symmetric one."""
    motion, one = motion_at(record), np.eye(4)
    (lin, orbits), span = motion, motion.span
    free = orbits.itinerary.sign * flights(lin.gap.blocks, span[:, None], lin.R, np.zeros((1, 0)))[0, 0]
    DP = turn_map(motion)[0]
    expected = np.prod(-orbits.speeds) * np.linalg.det(z * one - DP) / np.linalg.det(z * one - free)
    assert np.linalg.det(motion.linearised(z)[0]) == pytest.approx(expected, abs=1e-11)


@pytest.mark.parametrize("record", BIFURCATIONS, ids=reference_name)
def test_exponents_keep_the_exact_law_of_their_sum(record: dict[str, Any]) -> None:
    motion, orbit = motion_at(record), reference_orbit(record)
    lin, found = motion.lin, exponents(motion)[0]
    per_period = len(orbit.times) * (2 if orbit.itinerary.symmetric else 1) / orbit.itinerary.periods
    law = -2.0 * lin.gap.eta.sum() * 2.0 * np.pi / lin.omega[0] + 2.0 * np.log(lin.R[0]) * per_period
    assert found.sum() == pytest.approx(law, abs=1e-12)


def test_the_bouncing_ball_has_the_multipliers_of_its_map() -> None:
    """Closed form: with A cos t = pi (1 - R)/(1 + R) at the impact, trace (1 + R)^2 A sin t + 1 + R^2 or so, det R^2.

    Here from the fold, Gamma = pi (1 - R)/(1 + R), t = 0: multipliers 1 and R^2.
    """
    R = 0.5
    lin = bouncing_ball((), A=np.pi * (1 - R) / (1 + R), R=R).model(np.zeros((1, 0)))
    v = -2.0 * np.pi / (1.0 + R)
    orbit = Orbit(Itinerary((-1,), 1), np.zeros((1, 1)), np.array([[v]]), np.array([-(1 + R) * v * 2 * np.pi / 12]))
    if Motion(lin, orbit).residual()[0, 1] ** 2 >= 1e-20:
        orbit = orbit._replace(times=orbit.times + np.pi)
    assert Motion(lin, orbit).residual() == pytest.approx(0.0, abs=1e-13)
    mu = multipliers(Motion(lin, orbit))[0]
    assert mu == pytest.approx([1.0, R**2], abs=1e-7)


def test_sticking_and_false_symmetry_are_refused_in_one_line() -> None:
    pair = impact_pair((), alpha=0.3, R=0.6).model(np.zeros((1, 0)))
    with pytest.raises(ValueError, match="R = 0"):
        check_orbits(pair._replace(R=np.zeros(1)), Itinerary((1, -1), 1))
    with pytest.raises(ValueError, match="equal stops"):
        check_orbits(pair._replace(lower=np.ones(1)), Itinerary((1,), 1, symmetric=True))
    with pytest.raises(ValueError, match="odd number of periods, found 2"):
        check_orbits(pair, Itinerary((1,), 2, symmetric=True))
    with pytest.raises(ValueError, match="upper stop"):
        check_orbits(pair._replace(upper=np.array([np.inf])), Itinerary((1,), 1))
