"""The oracle against closed forms: a ball, a mass in a box, impact orbits."""

import math
from dataclasses import replace

import pytest
from mpmath import mp

from tests.exponential import flown
from tests.support.oracle import OracleMachine, one_sided_orbit, section_jacobian, simulate, symmetric_orbit
from tests.support.oracle.closed_form import ImpactOrbit
from tests.support.oracle.free_mass import (
    FreeOrbit,
    bouncing_ball_doubling,
    bouncing_ball_fold,
    bouncing_ball_orbits,
    impact_pair_orbits,
    impact_pair_symmetry_breaking,
)
from tests.support.oracle.machines import bouncing_ball, impact_pair

pytestmark = pytest.mark.slow


def distance(a: list, b: list) -> mp.mpf:
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


def multipliers(machine: OracleMachine, periods: int = 1) -> list:
    """Of the section's map at the machine's start, by differences of simulated orbits; largest modulus first."""
    J = mp.matrix(section_jacobian(machine, periods))
    return sorted(mp.eig(J, left=False, right=False), key=abs, reverse=True)


# A ball on a shaken table


def ball_in_flight(gamma: mp.mpf, R: mp.mpf, orbit: FreeOrbit) -> OracleMachine:
    """Half a period after its impact: the ball is at the top of its parabola."""
    start = (2 * gamma * mp.sin(orbit.phase) + mp.pi**2 / 2, gamma * mp.cos(orbit.phase))
    return bouncing_ball(gamma, R, tau=orbit.phase + mp.pi, start=start)


@pytest.mark.parametrize("gamma", ["1.05", "1.2", "1.5", "1.8"])
def test_a_simulated_ball_stays_on_the_closed_form_orbits(gamma: str) -> None:
    with mp.workdps(40):
        for orbit in bouncing_ball_orbits(gamma, 0.5):
            machine = ball_in_flight(mp.mpf(gamma), mp.mpf(0.5), orbit)
            run = simulate(machine, 2)
            assert distance(run.sections[2], run.sections[0]) < 1e-33
            assert len(run.impacts) == 2
            assert abs(run.impacts[0].t - mp.pi) < 1e-33
            assert abs(run.impacts[0].speed - orbit.before) < 1e-33


@pytest.mark.parametrize(("share", "stable"), [("0.01", True), ("0.99", True), ("1.01", False)])
def test_the_balls_orbit_is_stable_between_fold_and_doubling(share: str, stable: bool) -> None:
    """``share`` of the way from the fold to the doubling."""
    with mp.workdps(40):
        fold, doubling = bouncing_ball_fold(0.5), bouncing_ball_doubling(0.5)
        gamma = fold + mp.mpf(share) * (doubling - fold)
        node, saddle = bouncing_ball_orbits(gamma, 0.5)
        for orbit in (node, saddle):
            found = multipliers(ball_in_flight(gamma, mp.mpf(0.5), orbit))
            exact = sorted(orbit.multipliers, key=abs, reverse=True)
            assert abs(found[0] + found[1] - sum(exact)) < 1e-25
            assert abs(found[0] * found[1] - mp.mpf(0.5) ** 2) < 1e-25
        assert (abs(node.multipliers[0]) < 1) == stable
        assert abs(saddle.multipliers[0]) > 1


@pytest.mark.parametrize("R", [0.3, 0.7])
def test_a_ball_on_a_table_at_rest_comes_to_rest_when_the_geometric_series_says(R: float) -> None:
    """From the height 2: a fall of 2, then flights of 4 R, 4 R^2, ..."""
    run = simulate(bouncing_ball(0, R, start=(2, 0)), 3, rest=1e-14)
    with mp.workdps(40):
        end = 2 + 4 * mp.mpf(R) / (1 - mp.mpf(R))
        assert abs(run.stuck[0].start - end) < 1e-12
        assert abs(run.stuck[0].end - 6 * mp.pi) < 1e-35
        assert distance(run.sections[-1], [0, 0]) < 1e-40


def test_a_ball_at_rest_leaves_the_table_when_its_acceleration_is_that_of_gravity() -> None:
    """gamma sin t = 1 at the release, and the flight is the one from there."""
    run = simulate(bouncing_ball(1.25, 0.5), 1)
    with mp.workdps(40):
        release = mp.asin(mp.mpf("0.8"))
        assert abs(run.stuck[0].end - release) < 1e-35
        hit = run.impacts[0].t
        flight = hit - release
        height = 1.25 * (mp.sin(release) + flight * mp.cos(release) - mp.sin(hit)) - flight**2 / 2
        assert abs(height) < 1e-33


# A mass in a shaken box


def pair_in_flight(clearance: mp.mpf, R: mp.mpf, orbit: FreeOrbit) -> OracleMachine:
    """A quarter of a period after the upper impact: the mass is half way between the impacts."""
    rho = (1 + R) / (1 - R)
    start = (-mp.cos(orbit.phase), rho * mp.cos(orbit.phase) + mp.sin(orbit.phase))
    return impact_pair(clearance, R, tau=orbit.phase + mp.pi / 2, start=start)


@pytest.mark.parametrize("clearance", ["2.9", "6", "12.7"])
def test_a_simulated_impact_pair_stays_on_the_closed_form_orbits(clearance: str) -> None:
    with mp.workdps(40):
        nu, R = mp.mpf(clearance), mp.mpf("0.6")
        for orbit in impact_pair_orbits(nu, R):
            run = simulate(pair_in_flight(nu, R, orbit), 1)
            assert distance(run.sections[1], run.sections[0]) < 1e-33
            assert [impact.side for impact in run.impacts] == [-1, 1]
            assert abs(run.impacts[0].t - mp.pi / 2) < 1e-33
            assert abs(run.impacts[0].speed - orbit.before) < 1e-33


@pytest.mark.parametrize("clearance", ["2.6", "2.9", "12.7"])
def test_simulated_multipliers_of_the_impact_pair_are_the_squares_of_those_of_half_a_period(clearance: str) -> None:
    with mp.workdps(40):
        nu, R = mp.mpf(clearance), mp.mpf("0.6")
        orbit = impact_pair_orbits(nu, R)[0]
        found = multipliers(pair_in_flight(nu, R, orbit))
        assert abs(sum(found) - sum(value**2 for value in orbit.multipliers)) < 1e-25
        assert (abs(orbit.multipliers[0]) < 1) == (nu > impact_pair_symmetry_breaking(R))


# Impact orbits of several masses


DENSE = OracleMachine(
    mass=[[2.0, 0.5, 0.0], [0.5, 1.0, 0.25], [0.0, 0.25, 1.5]],
    damping=[[0.5, -0.25, 0.0], [-0.25, 0.25, 0.0], [0.0, 0.0, 0.125]],
    stiffness=[[3.0, -1.0, 0.0], [-1.0, 2.0, -0.5], [0.0, -0.5, 1.0]],
    gap_row=[1.0, -0.5, 0.25],
    force_sin=[[1.0, 0.0, 0.5]],
    force_cos=[[0.0, 0.25, 0.0]],
    load=[0.0, 0.0, 0.0],
    omega=2.5,
    tau=0.7,
    upper=0.1,
    lower=-0.1,
    R=0.7,
)  # fmt: skip
"""Neither its damping nor its gap is simple."""


def seen_in_flight(machine: OracleMachine, orbit: ImpactOrbit) -> OracleMachine:
    """The machine on the orbit, with its section a tenth of a period after the impact."""
    T = 2 * mp.pi / machine.omega
    start = flown(machine, orbit.after, T / 10, orbit.time)
    return replace(machine, tau=machine.tau + machine.omega * (orbit.time + T / 10), start=start)


@pytest.mark.parametrize("kind", ["symmetric", "one-sided", "one-sided under a load"])
def test_orbits_of_three_coupled_masses_are_followed_with_their_multipliers(kind: str) -> None:
    with mp.workdps(40):
        if kind == "symmetric":
            machine, orbits = DENSE, symmetric_orbit(DENSE)
        else:
            load = [0.25, 0.0, -0.125] if "load" in kind else [0.0, 0.0, 0.0]
            machine = replace(DENSE, load=load, lower=-math.inf)
            orbits = one_sided_orbit(machine)
        followed = 0
        for orbit in orbits:
            moved = seen_in_flight(machine, orbit)
            run = simulate(moved, 1)
            if len(run.impacts) > (2 if kind == "symmetric" else 1):
                continue  # the closed form does not know that this flight meets a stop on its way
            followed += 1
            assert distance(run.sections[1], run.sections[0]) < 1e-32
            found = multipliers(moved)
            assert distance([abs(value) for value in found], [abs(value) for value in orbit.multipliers]) < 1e-12
        assert followed > 0
