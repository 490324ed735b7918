"""Claims about what sticks or is held for good: the rest has its own exponents, and a place of rest is neutral."""

import functools
import math

import numpy as np
import pytest

from workers import Settings, System, solve_tile
from workers.cell.cell_batch import Results
from workers.results import NO_IMPACT, PERIODIC

SPECTRUM = Settings(exponents="spectrum", survival=0, max_periods=3000)
OMEGA, ZETA = 0.7, 0.05

PAIR = f"""
[system]
name = "pair"
coordinates = ["x1", "x2"]
mass = [[1, 0], [0, 2]]
damping = [[{2 * ZETA}, {-2 * ZETA}], [{-2 * ZETA}, {2 * ZETA}]]
stiffness = [[1, -1], [-1, 4]]
force = [0.3, 0]
load = [0, "N"]
"""
STUCK = """
[[system.friction]]
name = "ground"
row = [0, 1]
kinetic = "s"
"""
FORCED = """
[[system.phases]]
start = 0
[[system.phases]]
start = 0.4
friction.ground = { kinetic = "2 * s" }
"""
HELD = """
[[system.contacts]]
name = "wall"
gap = [0, 1]
upper = 0.5
restitution = 0.6
[[system.contacts]]
name = "far"
gap = [1, 0]
upper = 50
stiffness = 1
"""
PARAMETERS = """
[system.parameters]
s = { default = 5.0 }
N = { default = 0.0 }
"""


@functools.cache
def pair(elements: str, **values: float) -> Results:
    system = System.from_toml(PAIR + elements + PARAMETERS)
    return solve_tile(system, {"omega": OMEGA} | values, SPECTRUM)


RATES = [-2.0 * math.pi / OMEGA * ZETA] * 2
"""Exponents of the first mass while the second one stays where it is: x1'' + 2 zeta x1' + x1 = ..."""


@pytest.mark.parametrize(("force", "place"), [(0.5, -0.4), (1.0, 0.1), (1.2 - 1e-9, 0.0)])
def test_a_force_below_static_friction_leaves_a_mass_where_it_stands(force: float, place: float) -> None:
    """Any place is one of rest: the exponent of the displacement is 0, the velocity is lost."""
    found = solve_tile("friction-oscillator", {"A": force, "s": 1.2, "x": place}, SPECTRUM)
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    np.testing.assert_array_equal(found["spectrum"], [0.0, -np.inf])
    assert (found["largest"], found["stuck_fraction"]) == (0.0, 1.0)
    np.testing.assert_allclose(found["state"], [place, 0.0], rtol=0.0, atol=1e-15)


def test_a_force_above_static_friction_moves_it_for_good() -> None:
    found = solve_tile("friction-oscillator", {"A": 1.2 + 1e-6, "s": 1.2}, SPECTRUM)
    assert found["regime"] == PERIODIC
    assert 0.0 < found["stuck_fraction"] < 1.0
    assert found["largest"] < 0.0


@pytest.mark.parametrize("elements", [STUCK, STUCK + FORCED], ids=["one phase", "two phases"])
def test_beside_a_mass_that_sticks_for_good_the_other_has_its_own_exponents(elements: str) -> None:
    found = pair(elements, x2=0.3)
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    np.testing.assert_allclose(found["spectrum"], [0.0, *RATES, -np.inf], rtol=0.0, atol=1e-12)


def test_the_mass_that_sticks_stays_where_it_began_to() -> None:
    """And the other one moves about it as its forced response says."""
    for place in (0.0, 0.3):
        x1, x2, v1, v2 = pair(STUCK, x2=place)["state"]
        response = 0.3 / (1.0 - OMEGA**2 + 2j * ZETA * OMEGA)
        assert (x2, v2) == (pytest.approx(place, abs=1e-14), 0.0)
        assert (x1, v1) == pytest.approx((place + response.imag, OMEGA * response.real), abs=1e-12)


def test_beside_a_mass_that_a_stop_holds_for_good_the_other_has_its_own_exponents() -> None:
    """At rest on the stop: both directions of the second mass are lost."""
    found = pair(HELD, N=10.0, x2=0.5)
    assert found["regime"] in (NO_IMPACT, PERIODIC)
    np.testing.assert_allclose(found["spectrum"], [*RATES, -np.inf, -np.inf], rtol=0.0, atol=1e-12)
