"""Periodic orbits as equations of their states and times of impacts: one turn, derivatives, stability."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.reference_machines import (
    CURVES,
    bouncing_ball,
    reference_event,
    reference_name,
    reference_orbit,
    reference_values,
)
from workers.continuation.admissibility import CONTACT, LOST, Graze, first_fault
from workers.continuation.equations import check_orbits, motion_of, motion_of_unknowns
from workers.continuation.extended_system import ExtendedSystem, solve
from workers.continuation.families import family_of, machine_of
from workers.continuation.floquet import multipliers
from workers.continuation.itinerary import Itinerary, Orbit, many_orbits
from workers.continuation.orbits import section_state
from workers.continuation.shooting import OrbitMotion
from workers.kernel.flow import flow_with_tangent
from workers.kernel.motion import axes
from workers.model.family import OrbitMachines
from workers.model.oscillator import make_blocks
from workers.model.system import System, find_system

TWO_MASS = find_system("two-mass")

BIFURCATIONS = [record for record in CURVES if record["times"]]


def motion_at(record: dict[str, Any]) -> OrbitMotion:
    lin = family_of(TWO_MASS, reference_values(record), ()).model(np.zeros((1, 0)))
    return motion_of(lin, many_orbits([reference_orbit(record)]))


@pytest.mark.parametrize("record", CURVES, ids=reference_name)
def test_a_reference_point_is_found_again_with_its_digits(record: dict[str, Any]) -> None:
    """Truth: 40-digit residuals. Newton starts a ten-thousandth away."""
    family, event, values = reference_event(record, tuple(record["free"]))
    square = ExtendedSystem(family, event.point.orbit, event.conditions, values, 0.2 * values)
    exact = square.pack(event.point.orbit, event.point.contacts, values)
    square = square.rebordered(exact)
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
    lin = ExtendedSystem(family, orbit, (), values, values).model(values)
    grazes = [Graze(float(t), 0, 1) for t in event.point.contacts]
    assert first_fault(motion_of(lin, many_orbits([orbit])), grazes) is None


def test_a_contact_that_the_itinerary_lacks_is_found() -> None:
    """Truth: past its graze the orbit reaches the stop at the time of the graze."""
    record = next(record for record in CURVES if record["kind"] == "graze" and record["times"])
    given = reference_values(record)
    family = family_of(TWO_MASS, given, ("b",))
    orbit = reference_orbit(record)
    faults = []
    for b in (given["b"] * (1 - 1e-4), given["b"] * (1 + 1e-4)):
        values = np.array([b])
        equations = ExtendedSystem(family, orbit, (), values, values)
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
    lin = ExtendedSystem(family, event.point.orbit, (), values, values).model(values)
    motion = motion_of(lin, many_orbits([event.point.orbit]))
    first, second = motion.itinerary.sides
    turned = replace(motion, itinerary=motion.itinerary._replace(sides=(first, -second)))
    fault = first_fault(turned)
    assert fault is not None
    assert (fault.reason, fault.impact) == (LOST, 1)


def general(damping: float, harmonics: int) -> System:
    """Three masses with coupled damping, that of their free motion among it, under a load, between unequal stops."""
    Q = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    C = Q @ np.array([[0.4, 0.3, 0.0], [0.3, 6.0, 0.0], [0.0, 0.0, 2.0 * damping]]) @ Q.T
    K = Q @ np.diag([2.5, 4.0, 0.0]) @ Q.T
    second = [{"order": 2, "force": [0.3, -0.4, 0.9], "phase": [0.1, 0.2, 0.3]}][: harmonics - 1]
    return System.from_mapping({
        "name": "general", "coordinates": ["x1", "x2", "x3"], "mass": np.eye(3).tolist(), "damping": C.tolist(),
        "stiffness": K.tolist(), "force": [0.7, -1.1, 0.4], "harmonics": second, "load": [0.5, 0.2, -0.3],
        "gap": [1.0, -0.4, 0.6], "upper": 1.0, "lower": -0.7, "restitution": 0.6,
        "parameters": {"omega": {"default": 1.7}, "tau": {"default": 0.4}},
    })  # fmt: skip


def general_motion(system: System) -> OrbitMotion:
    """No orbit: a turn of the general machine from anywhere."""
    start = np.random.default_rng(2).standard_normal((1, 6))
    return OrbitMotion(machine_of(system, {}), Itinerary((1, -1, 1), 2), np.array([[0.9, 2.2, 5.1]]), start)


def test_flows_are_those_of_the_kernel_s_formula() -> None:
    """Truth: matrix exponentials; near critical and far over it too."""
    from scipy.linalg import expm

    for eta, lam in ((0.1, 4.0), (2.0, 4.0), (2.0 + 1e-7, 4.0), (9.0, 4.0), (0.7, 0.0), (0.0, 0.0), (0.0, 3.0)):
        for s in (1e-3, 0.4, 3.0):
            blocks = make_blocks(np.array([[eta]]), np.array([[lam]]))
            exact = expm(np.array([[0.0, 1.0], [-lam, -2.0 * eta]]) * s)
            found = axes(1)
            flow_with_tangent(blocks[0], s, np.zeros((1, 2)), found)
            assert pytest.approx(exact, abs=1e-13) == found[:, 0].T


@pytest.mark.parametrize("record", BIFURCATIONS, ids=reference_name)
def test_the_jacobian_is_that_of_finite_differences(record: dict[str, Any]) -> None:
    differences_of(motion_at(record), 1e-8)


@pytest.mark.parametrize("harmonics", [1, 2])
def test_the_jacobian_with_a_rigid_mode_is_that_of_finite_differences(harmonics: int) -> None:
    differences_of(general_motion(general(0.3, harmonics)), 1e-7)


def differences_of(motion: OrbitMotion, tolerance: float) -> None:
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
    expected = np.prod(motion.orbits.speeds) * np.linalg.det(motion.turn.maps[0] - z * np.eye(4))
    assert np.linalg.det(motion.linearised(z)[0]) == pytest.approx(expected, abs=1e-11)


@pytest.mark.parametrize("record", BIFURCATIONS, ids=reference_name)
def test_multipliers_keep_the_exact_law_of_their_product(record: dict[str, Any]) -> None:
    motion, orbit = motion_at(record), reference_orbit(record)
    lin, turn = motion.lin, orbit.itinerary.periods * (0.5 if orbit.itinerary.symmetric else 1.0)
    damping = np.trace(lin.machines.damping[0, 0] @ np.linalg.inv(lin.machines.mass[0]))
    law = -damping * turn * 2.0 * np.pi / lin.omega[0] + 2.0 * np.log(lin.elements.R[0, 0]) * len(orbit.times)
    assert abs(np.prod(multipliers(motion)[0])) == pytest.approx(np.exp(law), rel=1e-11, abs=1e-13)


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
    def pair(**changes: float) -> OrbitMachines:
        return machine_of(find_system("impact-pair"), {"alpha": 0.3, "nu": 1.0} | changes)

    with pytest.raises(ValueError, match="R: found 0"):
        check_orbits(pair(R=0.0), Itinerary((1, -1), 1))
    with pytest.raises(ValueError, match="equal stops"):
        check_orbits(pair(delta=0.1), Itinerary((1,), 1, symmetric=True))
    with pytest.raises(ValueError, match="found 2, must be odd"):
        check_orbits(pair(), Itinerary((1,), 2, symmetric=True))
    with pytest.raises(ValueError, match="upper stop"):
        check_orbits(machine_of(find_system("bouncing-ball"), {}), Itinerary((1,), 1))
