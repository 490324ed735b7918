"""Orbits from cells: proven periodic cells of the solver against the equations, and back to section states."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import atlas
from workers import Settings, solve_tile
from workers.continuation import family_of, orbit_from_state, section_state
from workers.continuation.admissibility import first_fault
from workers.continuation.equations import motion_of
from workers.continuation.floquet import multipliers
from workers.continuation.itinerary import Orbit, many_orbits
from workers.continuation.orbit_equality import is_minimal
from workers.model.system import System, find_system
from workers.results import PERIODIC

TWO_MASS = find_system("two-mass")


def drawn(count: int, seed: int, **ranges: tuple[float, float]) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    return {name: rng.uniform(*bounds, count) for name, bounds in ranges.items()}


def turn_of(orbit: Orbit) -> float:
    """The periods of a turn of the equations: half of an orbit that is symmetric."""
    return orbit.itinerary.periods * (0.5 if orbit.itinerary.symmetric else 1.0)


def agree(params: dict[str, Any], settings: Settings) -> int:
    """How many proven periodic cells there are; each is compared with the orbit of the equations."""
    found = solve_tile("two-mass", params, settings)
    cells = np.flatnonzero((found["regime"] == PERIODIC) & ~found["sticks"])
    for k in cells:
        values = {name: float(column[k]) for name, column in params.items()}
        orbit = orbit_from_state(
            TWO_MASS, values, found["state"][k], int(found["period"][k]), bool(found["symmetric"][k])
        )
        motion = motion_of(family_of(TWO_MASS, values, ()).model(np.zeros((1, 0))), many_orbits([orbit]))
        assert section_state(TWO_MASS, values, orbit) == pytest.approx(found["state"][k], abs=1e-10)
        mu, turn = np.sort(np.abs(multipliers(motion)[0]))[::-1], turn_of(orbit)
        known = np.exp(turn * found["spectrum"][k])
        # Both round: where an orbit has 25 impacts at each stop, 25 values of omega one unit in the last place apart
        # give exponents that range over 2.5e-8 by the equations and 1.6e-8 by the solver.
        rounding = 2.0 * found["error"][k]
        assert math.log(mu[0]) / turn == pytest.approx(found["spectrum"][k, 0], abs=max(1e-9, rounding))
        # The solver's small exponents are off by up to some 1e-9 near grazes, these not (products in 40 digits).
        assert mu == pytest.approx(known, rel=turn * max(1e-8, rounding), abs=1e-12)
        assert orbit.itinerary.impacts(1) == found["impacts_upper"][k]
        assert orbit.itinerary.impacts(-1) == found["impacts_lower"][k]
        assert is_minimal(motion)
        assert mu[0] < 1.0
        assert first_fault(motion) is None
    return len(cells)


def test_proven_cells_are_orbits_of_the_equations() -> None:
    params = drawn(30, 1, omega=(1.8, 4.5), b=(0.1, 0.5), R=(0.5, 0.85))
    assert agree(params, Settings(exponents="spectrum", max_periods=1000, survival=1000, tolerance=0.3)) >= 18


@pytest.mark.parametrize("omega", [0.9, 0.95])
def test_an_orbit_of_a_rigid_mode_far_from_the_middle_is_found(omega: float) -> None:
    """A ball that starts high: the offset of y is many times what an impact does to it."""
    values = {"omega": omega, "R": 0.7, "y": 0.5, "v": 3.0}
    found = solve_tile("bouncing-ball", values, Settings(max_periods=1000))
    assert (found["period"], found["impacts_lower"]) == (1, 1)
    orbit = orbit_from_state(find_system("bouncing-ball"), values, found["state"], 1)
    assert orbit.speeds == pytest.approx([-2.0 * np.pi / omega / 1.7], abs=1e-12)


@pytest.mark.slow
def test_a_thousand_proven_cells_are_orbits_of_the_equations() -> None:
    params = drawn(2300, 3, omega=(0.6, 4.5), b=(0.03, 1.0), R=(0.3, 0.95), f2=(-1.0, 1.0))
    assert agree(params, Settings(exponents="spectrum", max_periods=3000, survival=3000, tolerance=0.3)) >= 1000


def test_cells_that_rest_on_a_stop_are_orbits_of_the_equations() -> None:
    """Truth: the cells' own states and exponents; of the chatter before a rest the equations have the hops alone."""
    params = drawn(60, 3, omega=(0.5, 2.0), b=(0.1, 0.8), R=(0.05, 0.4))
    found = solve_tile("two-mass", params, Settings(exponents="spectrum", max_periods=1000, survival=0))
    cells = np.flatnonzero((found["regime"] == PERIODIC) & found["sticks"])
    assert len(cells) >= 20
    for k in cells:
        values = {name: float(column[k]) for name, column in params.items()}
        orbit = orbit_from_state(
            TWO_MASS, values, found["state"][k], int(found["period"][k]), bool(found["symmetric"][k])
        )
        motion = motion_of(family_of(TWO_MASS, values, ()).model(np.zeros((1, 0))), many_orbits([orbit]))
        assert section_state(TWO_MASS, values, orbit) == pytest.approx(found["state"][k], abs=1e-12)
        lasting = np.isfinite(found["spectrum"][k])
        assert lasting.sum() == 2
        mu = np.sort(np.abs(multipliers(motion)[0]))[::-1]
        assert np.log(mu[lasting]) / turn_of(orbit) == pytest.approx(found["spectrum"][k][lasting], abs=1e-9)
        assert first_fault(motion) is None


@pytest.mark.parametrize("name", ["two-mass", "soft-impact"])
def test_an_orbit_of_no_periods_is_refused_in_one_line(name: str) -> None:
    system = find_system(name)
    with pytest.raises(ValueError, match=r"^periods: found 0, must be 1 or more$"):
        orbit_from_state(system, {}, np.zeros(len(system.states)), 0)


def lifted(R: float) -> System:
    """x'' + .5 x' = 1.02 sin .002 t - 1 above a stop at 0: one flight a period, and hops until it rests."""
    return System.from_mapping({
        "name": "lifted", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.5]], "force": [1.02], "load": [-1.0],
        "contacts": [{"name": "stop", "gap": [1.0], "lower": 0.0, "restitution": R}],
        "parameters": {"omega": {"default": 0.002}},
    })  # fmt: skip


@pytest.mark.parametrize(("R", "hops"), [(0.96, 150), (0.99, 450)])
def test_an_orbit_of_hundreds_of_hops_is_found_though_the_last_ones_are_near_rounding(R: float, hops: int) -> None:
    """Truth: it leaves where the force equals the load; then the closed form of one flight, whose end is a root."""
    orbit = orbit_from_state(lifted(R), {}, np.zeros(2), 1)
    c, a, omega, t0 = 0.5, 1.02, 0.002, math.asin(1.0 / 1.02) / 0.002

    def forced(t: float) -> tuple[float, float]:
        """A particular solution and its velocity."""
        scale, sin, cos = a / (c * c + omega * omega), math.sin(omega * t), math.cos(omega * t)
        return -t / c - scale * (c * cos / omega + sin), -1.0 / c + scale * (c * sin - omega * cos)

    def height(t: float) -> float:
        (x0, v0), (x, _), s = forced(t0), forced(t), t - t0
        return x - x0 + v0 * math.expm1(-c * s) / c

    landing = brentq(height, t0 + 100.0, t0 + 500.0, xtol=1e-12)
    assert orbit.times[:2] == pytest.approx([t0, landing], abs=1e-7)
    assert len(orbit.times) > hops


def test_an_orbit_with_more_events_than_are_followed_is_refused_with_their_number() -> None:
    cell = atlas.point({}, system=lifted(0.995))
    assert cell["regime"] == "periodic"
    with pytest.raises(ValueError, match="events in one period of the motion: found 512 or more"):
        orbit_from_state(lifted(0.995), {}, np.array(cell["state"]), 1)
