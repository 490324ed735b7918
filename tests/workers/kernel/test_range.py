"""The range of the gap coordinate: exact over orbits, by turning points that no sampling could miss."""

import math
import time
from typing import Any

import numpy as np
import pytest

from tests import naive
from tests.reference_motion import ball_in_flight, measured, on_attractor
from workers import Settings, System, solve_tile, trace
from workers.cell.ranges import FOLLOWED, free_range
from workers.kernel.cell_loops import excursions
from workers.kernel.motion import FLIGHT
from workers.model.oscillator import many_of
from workers.results import CHAOTIC, NO_IMPACT, PERIODIC

ONE_MASS: dict[str, Any] = {
    "name": "slow-mass", "title": "a mass under a slow force", "coordinates": ["x"], "mass": [[1.0]],
    "damping": [[0.0]], "stiffness": [[1.0]], "force": [0.1], "gap": [1.0], "restitution": 0.5,
}  # fmt: skip


def test_an_orbit_that_hits_both_stops_ranges_over_the_gap_exactly() -> None:
    found = solve_tile("two-mass", naive.FIGURES[3])
    assert found["symmetric"]
    assert found["peak_to_peak"] == 2.0 * naive.FIGURES[3]["b"]


def test_motion_without_impact_has_twice_its_amplitude() -> None:
    """Truth: the amplitude of the first mass from the matrices at the forcing frequency."""
    p = naive.FIGURES[3] | {"b": 2.0}
    B = naive.first_order(p)
    response = np.linalg.solve(1j * p["omega"] * np.eye(4) - B[:4, :4], B[:4, 4])
    found = solve_tile("two-mass", p)
    assert found["regime"] == NO_IMPACT
    assert found["peak_to_peak"] == pytest.approx(2.0 * abs(response[0]), rel=1e-13)


def test_motion_of_two_harmonics_without_impact_ranges_from_its_lowest_to_its_highest_point() -> None:
    """Truth: the sum of the forced responses of one mass, a / (1 - w^2 + 2 i zeta w) each, sampled densely."""
    zeta, omega, phases = 0.05, 0.7, np.linspace(0.0, 2.0 * np.pi, 200_001)
    first, second = (a / (1.0 - w * w + 2j * zeta * w) for a, w in ((1.0, omega), (0.8, 2.0 * omega)))
    y = np.imag(first * np.exp(1j * phases) + second * np.exp(2j * phases))
    system = System.from_mapping(
        {
            "name": "two-harmonics", "title": "a mass forced by two harmonics", "coordinates": ["x"],
            "mass": [[1.0]], "damping": [[2.0 * zeta]], "stiffness": [[1.0]], "force": [1.0],
            "harmonics": [{"order": 2, "force": [0.8]}], "gap": [1.0], "upper": 9.0, "lower": -9.0,
            "restitution": 0.8, "parameters": {"omega": {"default": omega}},
        }
    )  # fmt: skip
    found = solve_tile(system, {})
    assert found["regime"] == NO_IMPACT
    assert found["peak_to_peak"] == pytest.approx(np.ptp(y), rel=1e-9)


def test_turning_points_give_the_same_range_of_motion_without_impact() -> None:
    osc, _ = naive.two_mass(**(naive.FIGURES[3] | {"b": 2.0}))
    many, still = many_of(osc), np.zeros((1, 2, 2))
    one = np.ones(1, dtype=np.int64)
    ends = excursions(many, still, np.full((1, 1), FLIGHT), one, 10_000 * one, np.zeros(1, dtype=np.int64))
    assert ends[0, 1] - ends[0, 0] == pytest.approx(free_range(many, still)[0], rel=1e-12)


ONE_SIDED: list[tuple[str, dict[str, float]]] = [
    ("single-mass", {}),
    ("two-mass", {"mu_k": 5.0, "zeta": 0.05, "R": 0.8, "omega": 1.9, "b": 0.4, "tau": math.pi}),
    ("bouncing-ball", ball_in_flight(1.2, 0.5)),
]


@pytest.mark.parametrize(("name", "params"), ONE_SIDED, ids=[name for name, _ in ONE_SIDED])
def test_an_orbit_ranges_from_its_stop_to_where_it_turns(name: str, params: dict[str, float]) -> None:
    """Truth: the oracle's turning points; the gap is the first coordinate."""
    found = solve_tile(name, params)
    assert found["regime"] == PERIODIC
    motion = measured(name, on_attractor(name, params), int(found["period"]))
    assert found["peak_to_peak"] == pytest.approx(motion["high"][0] - motion["low"][0], rel=1e-10)


def test_a_mass_that_bounces_to_rest_ranges_from_its_stop() -> None:
    """The default ball: thrown off by the table, it comes to rest in every period."""
    found = solve_tile("bouncing-ball", {})
    assert found["sticks"]
    # Where it leaves, the table falls with g: A omega^2 sin(phase) = g; then y'' = -g + A omega^2 sin.
    A, phase = 1.2, math.asin(1.0 / 1.2)
    t = np.linspace(0.0, 2.0 * math.pi, 2_000_001)
    y = -0.5 * t**2 + A * (np.sin(phase) - np.sin(phase + t)) + A * np.cos(phase) * t
    first = int(np.flatnonzero(y[1000:] < 0.0)[0]) + 1000
    assert found["peak_to_peak"] == pytest.approx(y[:first].max(), rel=1e-9)


@pytest.mark.parametrize(("omega", "R", "highest"), [(1.05, 0.0, 0.3392105694), (1.1, 0.2, 0.5603377648)])
def test_the_flight_after_a_release_counts_where_it_is_the_only_high_one(
    omega: float, R: float, highest: float
) -> None:
    """Truth: the closed form of that flight."""
    Gamma = 1.2 * omega**2
    phase, t = math.asin(1.0 / Gamma), np.linspace(0.0, 2.0 * math.pi, 2_000_001)
    y = (-0.5 * t**2 + Gamma * (np.sin(phase) - np.sin(phase + t)) + Gamma * np.cos(phase) * t) / omega**2
    first = int(np.flatnonzero(y[1000:] < 0.0)[0]) + 1000
    assert y[:first].max() == pytest.approx(highest, abs=1e-9)
    found = solve_tile("bouncing-ball", {"omega": omega, "R": R})
    assert found["sticks"] and found["peak_to_peak"] == pytest.approx(highest, abs=1e-9)


def test_chaos_that_hits_one_stop_alone_has_the_range_of_64_periods_from_its_state() -> None:
    """Truth: the closed form of the flights between the impacts of its trace."""
    params = {"omega": 2.2, "R": 0.9, "A": 1.2, "tau": 0.0}
    found = solve_tile("bouncing-ball", params)
    assert found["regime"] == CHAOTIC
    y, v = found["state"].tolist()
    history = trace("bouncing-ball", params | {"y": y, "v": v}, FOLLOWED, Settings(exponents="none"))
    impacts, highest = history.impacts, 0.0
    ends, speeds = [*impacts[:, 0], history.times[-1]], [v, *0.9 * impacts[:, 2]]
    for t, end, at, speed in zip([0.0, *impacts[:, 0]], ends, [y, *np.zeros(len(impacts))], speeds, strict=True):
        s = np.linspace(0.0, end - t, 2001)
        shaken = 1.2 * (np.sin(2.2 * t) - np.sin(2.2 * (t + s)) + 2.2 * np.cos(2.2 * t) * s)
        highest = max(highest, float(np.max(at + speed * s - 0.5 * s**2 + shaken)))
    assert found["peak_to_peak"] == pytest.approx(highest, rel=1e-6)


def test_chaos_that_hits_both_stops_ranges_over_the_gap() -> None:
    found = solve_tile("two-mass", naive.FIGURES[5], Settings(exponents="none"))
    assert found["peak_to_peak"] == 2.0 * naive.FIGURES[5]["b"]


def test_what_takes_more_evaluations_than_allowed_has_no_range() -> None:
    osc, _ = naive.two_mass(**naive.FIGURES[5])
    h, one = np.full((1, 2, 2), 0.01), np.ones(1, dtype=np.int64)
    ends = excursions(many_of(osc), h, np.full((len(one), 1), FLIGHT), 64 * one, 100 * one, 0 * one)
    assert np.isnan(ends).all()


def test_undamped_motion_under_a_very_slow_force_has_the_range_of_its_closed_form() -> None:
    """x'' + x = A sin(w t): a sin(w t) + x(0) cos t - a w sin t with a = A / (1 - w^2)."""
    definition = ONE_MASS | {"upper": 5.0, "parameters": {"omega": {"default": 2.2e-7}}}
    omega = np.array([1e-3, 2.2e-7])
    found = solve_tile(System.from_mapping(definition), {"omega": omega, "x": 0.05})
    a = 0.1 / (1.0 - omega**2)
    assert np.all(found["regime"] == NO_IMPACT)
    assert found["peak_to_peak"] == pytest.approx(2.0 * (a + np.hypot(0.05, a * omega)), rel=1e-13)


def test_undamped_modes_under_two_slow_harmonics_have_the_range_of_their_closed_form() -> None:
    """x1 = (x1 + x2) / 2 + (x1 - x2) / 2, modes of frequencies 1 and sqrt 3; the force moves x1 by 2/3 of itself."""
    definition = ONE_MASS | {
        "name": "slow-pair", "coordinates": ["x1", "x2"], "mass": [[1.0, 0.0], [0.0, 1.0]],
        "damping": [[0.0, 0.0], [0.0, 0.0]], "stiffness": [[2.0, -1.0], [-1.0, 2.0]], "force": [0.3, 0.0],
        "harmonics": [{"order": 2, "force": [0.2, 0.0]}], "gap": [1.0, 0.0], "upper": 5.0,
        "parameters": {"omega": {"default": 1e-6}},
    }  # fmt: skip
    phases = np.linspace(0.0, 2.0 * np.pi, 2_000_001)
    forced = 2.0 / 3.0 * np.ptp(0.3 * np.sin(phases) + 0.2 * np.sin(2.0 * phases))
    found = solve_tile(System.from_mapping(definition), {"x1": 0.02, "x2": -0.01})
    assert found["regime"] == NO_IMPACT
    assert found["peak_to_peak"] == pytest.approx(forced + 2.0 * (0.005 + 0.015), rel=1e-7)


def test_the_search_for_turning_points_ends_with_its_allowance() -> None:
    """A period of 2.9e7 has nine million turning points, which took 5 s; the allowance lasts for a thousandth of it."""
    osc = System.from_mapping(ONE_MASS | {"upper": 5.0}).build({"omega": 2.2e-7, "tau": 0.0})
    h, one = np.full((1, 1, 2), 0.01), np.ones(1, dtype=np.int64)
    arguments = many_of(osc), h, np.full((1, 1), FLIGHT), one
    excursions(*arguments, one, 0 * one)
    begun = time.process_time()
    ends = excursions(*arguments, 10_000 * one, 0 * one)
    assert np.isnan(ends).all() and time.process_time() - begun < 0.5
