"""A damped free mass that hits nothing: it coasts to a stop, anywhere, and vibrates about that place."""

import math

import numpy as np
import pytest

from workers import Settings, solve_tile, trace
from workers.results import LOCKING, NO_IMPACT

BOX = {"alpha": 0.05, "nu": 3.0, "beta": 0.1, "omega": 1.3, "tau": 0.4, "y": 0.2, "v": 0.02}
"""An impact pair that is shaken by far less than its clearance."""


def test_a_damped_mass_shaken_within_its_clearance_has_no_impact() -> None:
    found = solve_tile("impact-pair", BOX, Settings(exponents="spectrum"))
    T = 2.0 * math.pi / BOX["omega"]
    assert (found["regime"], found["period"], found["largest"]) == (NO_IMPACT, 1, 0.0)
    assert found["spectrum"] == pytest.approx([0.0, -BOX["beta"] * T], rel=1e-14)
    assert found["kaplan_yorke"] == 1.0


def test_the_state_of_a_coasting_mass_is_where_it_comes_to_rest() -> None:
    """y + y'/beta + alpha omega/beta cos(omega t + tau) is kept, the integral of the equation of motion."""
    alpha, beta, omega, tau, y, v = (BOX[name] for name in ("alpha", "beta", "omega", "tau", "y", "v"))
    push = alpha * omega / beta * math.cos(tau)
    Z = alpha * omega**2 / (-(omega**2) + 1j * beta * omega) * np.exp(1j * tau)
    kept = y + v / beta + push
    rate = (1j * omega * Z).imag
    resting = [kept - rate / beta - push, rate]
    assert solve_tile("impact-pair", BOX)["state"] == pytest.approx(resting, abs=1e-14)


def test_the_state_of_a_coasting_mass_is_a_periodic_orbit() -> None:
    state = solve_tile("impact-pair", BOX)["state"]
    turn = trace("impact-pair", BOX | {"y": state[0], "v": state[1]}, 3)
    assert turn.states[-1] == pytest.approx(state, abs=1e-13)
    assert not len(turn.impacts)


def test_a_mass_that_hits_walls_first_is_followed_until_it_coasts() -> None:
    found = solve_tile("impact-pair", BOX | {"v": 3.0})
    assert found["regime"] == NO_IMPACT
    assert 0 < found["periods_used"] < 200


def test_without_damping_nothing_says_that_a_free_mass_meets_no_wall() -> None:
    assert solve_tile("impact-pair", BOX | {"beta": 0.0, "v": 0.1})["regime"] == LOCKING


def test_a_load_drives_a_free_mass_to_a_wall_however_little_it_is_shaken() -> None:
    assert solve_tile("impact-pair", BOX | {"delta": 0.01})["regime"] != NO_IMPACT
