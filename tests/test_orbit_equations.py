"""Periodic orbits as equations of their states and times of impacts: one turn, derivatives, stability."""

from dataclasses import replace
from itertools import pairwise
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
from workers.continuation.equations import ImpactMotion, Motion, check_orbits, motion_of, motion_of_unknowns
from workers.continuation.extended import Extended, solve
from workers.continuation.itinerary import Itinerary, Orbit, many_orbits
from workers.continuation.orbits import section_state
from workers.continuation.oscillator import ModalOscillator, family_of
from workers.continuation.stability import flights, multipliers, turn_map
from workers.model.oscillator import make_blocks
from workers.model.system import find_system

TWO_MASS = find_system("two-mass")

BIFURCATIONS = [record for record in CURVES if record["times"]]


def motion_at(record: dict[str, Any]) -> Motion:
    lin = family_of(TWO_MASS, reference_values(record), ()).model(np.zeros((1, 0)))
    return motion_of(lin, many_orbits([reference_orbit(record)]))


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
def test_the_times_of_a_reference_orbit_give_its_state_and_speeds(record: dict[str, Any]) -> None:
    motion = motion_at(record)
    assert motion.turn.residuals == pytest.approx(0.0, abs=1e-14)
    assert motion.orbits.speeds[0] == pytest.approx(reference_orbit(record).speeds, abs=1e-14)


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
    assert first_fault(motion_of(lin, many_orbits([orbit])), event.point.contacts) is None


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
        row = np.eye(1, 7, 6)[0]
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
    motion = motion_of(lin, many_orbits([event.point.orbit]))
    first, second = motion.itinerary.sides
    turned = replace(motion, itinerary=motion.itinerary._replace(sides=(first, -second)))
    fault = first_fault(turned)
    assert fault is not None
    assert (fault.reason, fault.impact) == (LOST, 1)


def bounced(motion: Motion, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The naive twin: block states (h, h') at times s of one turn, and at its end, by an integrator.

    An impact changes the velocity of y, forced part and all, by -(1 + R) times itself.
    """
    lin, times = motion.lin, motion.times[0]
    eta, lam, load = lin.gap.eta[0], lin.gap.lam[0], lin.gap.load[0]
    n = len(eta)

    def rate(_: float, u: np.ndarray) -> np.ndarray:
        x, v = u[:n], u[n:]
        return np.concatenate([v, load - 2.0 * eta * v - lam * x])

    def flight(u: np.ndarray, begin: float, end: float) -> np.ndarray:
        inside = s[(s > begin) & (s < end)]
        path = solve_ivp(rate, (begin, end), u, t_eval=[*inside, end], method="DOP853", rtol=1e-13, atol=1e-13)
        out.extend(path.y.T[: len(inside)])
        return np.asarray(path.y[:, -1])

    u, out = motion.start[0].T.ravel(), list[np.ndarray]()
    for begin, end in pairwise([*times, times[0] + motion.span[0]]):
        v = np.sum(lin.gap.row[0].T.ravel() * rate(begin, u)) + waves(lin, np.array([begin]))[1, 0]
        u = flight(u - (1.0 + lin.R[0]) * v * lin.gap.kick[0].T.ravel(), begin, end)
    return np.array(out), u


def waves(lin: ModalOscillator, s: np.ndarray) -> np.ndarray:
    """The forced part of y and its derivative (2, K) at times s (K,)."""
    omega, found = lin.omega[0], np.zeros((2, len(s)))
    for k, (sin, cos) in enumerate(zip(lin.gap.sin_part[0], lin.gap.cos_part[0], strict=True), 1):
        angle = k * (omega * s + lin.tau[0])
        found[0] += sin * np.sin(angle) + cos * np.cos(angle)
        found[1] += k * omega * (sin * np.cos(angle) - cos * np.sin(angle))
    return found


def general_motion(rigid_damping: float = 0.3, harmonics: int = 2) -> Motion:
    """No orbit: a turn of the general oscillator from anywhere."""
    lin = general(rigid_damping=rigid_damping, harmonics=harmonics)
    start = np.random.default_rng(2).standard_normal((1, 3, 2))
    return ImpactMotion(lin, Itinerary((1, -1, 1), 2), np.array([[0.9, 2.2, 5.1]]), start)


@pytest.mark.parametrize("damping", [0.0, 1e-4, 0.05, 0.3, 2.0])
def test_a_turn_is_that_of_a_general_integrator(damping: float) -> None:
    """Blocks with both entries of c and k, a damped or undamped rigid mode under a load, and two harmonics."""
    motion = general_motion(damping)
    lin, s = motion.lin, np.array([1.0, 2.0, 2.3, 4.0, 6.0, 8.0])
    path, end = bounced(motion, s)
    y = path[:, :3] @ lin.gap.row[0, :, 0] + path[:, 3:] @ lin.gap.row[0, :, 1] + waves(lin, s)[0]
    states, (found, _, _) = motion.at(s[None])
    assert states[0].transpose(0, 2, 1).reshape(6, 6) == pytest.approx(path, abs=1e-10)
    assert found[0] == pytest.approx(y, abs=1e-10)
    assert motion.turn.residuals[0, :6].reshape(3, 2).T.ravel() == pytest.approx(
        end - motion.start[0].T.ravel(), abs=1e-10
    )


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
    differences_of(general_motion(harmonics=1), 1e-7)


def differences_of(motion: Motion, tolerance: float) -> None:
    J, X = motion.linearised()[0], motion.unknowns
    for i in range(len(J)):
        step = 1e-6 * np.eye(1, len(J), i)
        ends = (motion_of_unknowns(motion.lin, motion.itinerary, X + sign * step).turn.residuals for sign in (1, -1))
        ahead, behind = ends
        assert J[:, i] == pytest.approx((ahead - behind)[0] / 2e-6, abs=tolerance)


@pytest.mark.parametrize("z", [1.0, -1.0, np.exp(0.7j), 1.3])
@pytest.mark.parametrize("record", BIFURCATIONS[2:7:2] + BIFURCATIONS[-1:], ids=reference_name)
def test_the_determinant_is_that_of_the_turn_without_poles(record: dict[str, Any], z: complex) -> None:
    """det J_z = det(DP - z) prod v_i, the whole orbit and the half of a symmetric one."""
    motion = motion_at(record)
    expected = np.prod(motion.orbits.speeds) * np.linalg.det(turn_map(motion)[0] - z * np.eye(4))
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
    orbits = (Orbit(Itinerary((-1,), 1), np.array([[t]]), np.array([[v]])) for t in (0.0, np.pi))
    motion = min((motion_of(lin, orbit) for orbit in orbits), key=lambda motion: np.abs(motion.turn.residuals).max())
    assert motion.turn.residuals == pytest.approx(0.0, abs=1e-13)
    assert motion.orbits.speeds == pytest.approx(v, abs=1e-13)
    mu = multipliers(motion)[0]
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
