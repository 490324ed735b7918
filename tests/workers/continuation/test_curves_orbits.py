"""Orbits of cells taken to other parameters, many at a time, and whether two orbits are one."""

import math

import numpy as np
import pytest

from tests.oscillators import cosine_mass
from tests.reference_machines import TWO_MASS
from workers import solve_tile
from workers.continuation import Itinerary, Orbit, family_of, orbit_from_state
from workers.continuation.orbit_equality import distance, is_same_orbit
from workers.continuation.orbits import attract, continued_to, many_of, refine_orbit

ASYMMETRIC = {"omega": 2.32, "b": 0.193}
"""Parameters of an orbit of one impact at either stop that is not its own mirror image."""


@pytest.fixture(scope="module")
def orbit() -> Orbit:
    found = solve_tile("two-mass", ASYMMETRIC)
    assert (found["period"], found["impacts_upper"], found["impacts_lower"], found["symmetric"]) == (1, 1, 1, False)
    return orbit_from_state(TWO_MASS, ASYMMETRIC, found["state"], 1)


def test_an_orbit_begun_later_is_the_same(orbit: Orbit) -> None:
    omega = ASYMMETRIC["omega"]
    turn = 2.0 * math.pi / omega
    later = Orbit(orbit.itinerary, orbit.times + 3.0 * turn, orbit.speeds)
    other_first = Orbit(
        Itinerary(orbit.itinerary.sides[::-1], 1),
        np.array([orbit.times[1], orbit.times[0] + turn]),
        orbit.speeds[::-1].copy(),
    )
    assert is_same_orbit(orbit, later, omega)
    assert is_same_orbit(orbit, other_first, omega)


def test_a_mirror_image_half_a_period_later_is_the_same(orbit: Orbit) -> None:
    omega = ASYMMETRIC["omega"]
    sides = tuple(-side for side in orbit.itinerary.sides)
    mirror = Orbit(Itinerary(sides, 1), orbit.times + math.pi / omega, -orbit.speeds)
    assert is_same_orbit(orbit, mirror, omega)
    assert not is_same_orbit(orbit, Orbit(Itinerary(sides, 1), orbit.times, -orbit.speeds), omega)


def test_other_speeds_times_and_itineraries_are_other_orbits(orbit: Orbit) -> None:
    omega = ASYMMETRIC["omega"]
    assert distance(orbit, Orbit(orbit.itinerary, orbit.times, 1.01 * orbit.speeds), omega) == pytest.approx(0.01)
    shifted = Orbit(orbit.itinerary, orbit.times + np.array([0.0, 0.01]), orbit.speeds)
    assert 0.0 < distance(orbit, shifted, omega) <= 0.01 * omega + 1e-12
    assert math.isinf(distance(orbit, Orbit(Itinerary((1,), 1), orbit.times[:1], orbit.speeds[:1]), omega))


def test_many_orbits_are_moved_as_each_one_is(orbit: Orbit) -> None:
    family = family_of(TWO_MASS, ASYMMETRIC, ("omega", "b"))
    start = np.array([[ASYMMETRIC["omega"], ASYMMETRIC["b"]]])
    values = start + np.array([[0.0, 0.0], [0.01, 0.0], [-0.01, 0.002], [0.005, -0.003]])
    found = continued_to(family, many_of([orbit] * 4, np.repeat(start, 4, axis=0)), values)
    assert found.converged.all()
    for k in range(4):
        alone = refine_orbit(
            family_of(TWO_MASS, dict(zip(("omega", "b"), values[k], strict=True)), ()), orbit, np.zeros(0)
        )
        assert found.orbit(k).times == pytest.approx(alone.times, abs=1e-12)
        assert found.orbit(k).speeds == pytest.approx(alone.speeds, abs=1e-12)
    assert attract(family, found).all()


@pytest.mark.parametrize("name", ["R", "load"])
def test_an_orbit_is_moved_though_one_moved_with_it_is_none(orbit: Orbit, name: str) -> None:
    """To a machine without rebound, or a symmetric orbit to one that is not its own mirror image: neither holds there.

    The others are found as they are alone.
    """
    if name == "R":
        family, start = family_of(TWO_MASS, ASYMMETRIC, ("omega", "R")), np.array([[ASYMMETRIC["omega"], 0.8]])
        values = np.array([[2.321, 0.8], [2.32, 0.0]])
    else:
        stops = {"name": "stop", "gap": [1.0], "upper": 1.0, "lower": -1.0, "stiffness": 10.0}
        system = cosine_mass(contacts=[stops], load=["p"], parameters={"p": {"default": 0.0}})
        orbit = Orbit(Itinerary((), 1, True), np.zeros(0), np.zeros(0))
        family, start = family_of(system, {"A": 0.1}, ("omega", "p")), np.array([[1.2, 0.0]])
        values = np.array([[1.201, 0.0], [1.2, 0.01]])
    both = continued_to(family, many_of([orbit] * 2, np.repeat(start, 2, axis=0)), values)
    alone = continued_to(family, many_of([orbit], start), values[:1])
    assert both.converged.tolist() == [True, False]
    assert np.array_equal(both.orbit(0).times, alone.orbit(0).times)


def test_an_orbit_that_lost_its_stability_does_not_attract() -> None:
    """The symmetric orbit on either side of the symmetry breaking of the first record of curves.json's kind."""
    family = family_of(TWO_MASS, {"b": 0.33, "R": 0.8, "tau": 0.0}, ("omega",))
    orbit = Orbit(Itinerary((1,), 1, symmetric=True), np.array([1.0189538951595758]), np.array([0.67299783747295054]))
    exact = 1.8443244880291019
    values = np.array([[exact - 1e-3], [exact + 1e-3]])
    found = continued_to(family, many_of([orbit, orbit], np.full((2, 1), exact)), values)
    assert found.converged.all()
    assert sorted(attract(family, found).tolist()) == [False, True]


def test_no_orbit_is_told_where_it_has_ceased_to_be() -> None:
    """Beyond the fold of curves.json at omega = 2.013, R = 0.95."""
    family = family_of(TWO_MASS, {"b": 0.15, "R": 0.95, "tau": 0.0}, ("omega",))
    times = [0.8957761509263993, 1.934638537085077, 2.595966588408751]
    speeds = [0.6043537286396591, -0.26046116018718839, -0.26592798277093465]
    orbit = Orbit(Itinerary((1, -1, -1), 1), np.array(times), np.array(speeds))
    exact = 2.0130904979164509
    found = continued_to(
        family, many_of([orbit] * 2, np.full((2, 1), exact)), np.array([[exact - 0.01], [exact + 0.01]])
    )
    assert not attract(family, found).all()
    assert not found.converged.all()
