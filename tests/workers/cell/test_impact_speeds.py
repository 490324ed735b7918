"""Speeds of impacts and the energy that they lose, in every cell."""

import math
from typing import Any

import numpy as np
import pytest

from tests import naive
from tests.reference_motion import ball_in_flight, measured, on_attractor
from tests.support.oracle.closed_form import symmetric_orbit
from workers import Settings, solve_tile
from workers.history import trace
from workers.results import CHAOTIC, NO_IMPACT, PERIODIC

SPEEDS = ["min_impact_speed", "mean_impact_speed", "max_impact_speed"]


@pytest.mark.parametrize(("R", "A"), [(0.5, 1.2), (0.3, 1.8)])
def test_a_bouncing_ball_meets_the_table_at_the_speed_of_the_closed_form(R: float, A: float) -> None:
    """Over a period T gravity takes g T, and the impact gives (1 + R) V."""
    found = solve_tile("bouncing-ball", ball_in_flight(A, R))
    speed = 2.0 * math.pi / (1.0 + R)
    assert [int(found[name]) for name in ("regime", "period", "impacts_lower")] == [PERIODIC, 1, 1]
    assert [float(found[name]) for name in SPEEDS] == pytest.approx([speed] * 3, rel=1e-12)
    assert found["impact_energy"] == pytest.approx(0.5 * (1.0 - R**2) * speed**2, rel=1e-12)


def test_a_symmetric_orbit_has_the_speed_and_the_loss_of_the_closed_form() -> None:
    """Truth: linear algebra in 40 digits. The first mass is 1, and so is what an impact meets."""
    p = naive.FIGURES[3]
    found = solve_tile("two-mass", p)
    (orbit,) = (o for o in symmetric_orbit(p) if o.exponents[0] < 0)
    speed = float(orbit.before[2])
    assert [float(found[name]) for name in SPEEDS] == pytest.approx([speed] * 3, rel=1e-12)
    assert found["impact_energy"] == pytest.approx((1.0 - p["R"] ** 2) * speed**2, rel=1e-12)  # two impacts a period


BALANCED: list[tuple[str, dict[str, float]]] = [
    ("two-mass", naive.FIGURES[3]),
    ("two-mass", naive.FIGURES[3] | {"omega": 4.4, "b": 0.12, "mu_m": 3.0}),
    ("single-mass", {}),
    ("impact-pair", {}),
]


@pytest.mark.parametrize(("name", "params"), BALANCED, ids=[f"{n}-{k}" for k, (n, _) in enumerate(BALANCED)])
def test_impacts_and_damping_take_what_the_force_puts_into_an_orbit(name: str, params: dict[str, float]) -> None:
    """Truth: the oracle's integrals."""
    found = solve_tile(name, params)
    assert found["regime"] == PERIODIC
    motion = measured(name, on_attractor(name, params), int(found["period"]))
    assert found["impact_energy"] == pytest.approx(motion["work"] - motion["damper_loss"], rel=1e-9)
    assert found["impact_energy"] == pytest.approx(motion["stop_loss"], rel=1e-9)


def test_a_chaotic_cell_has_the_speeds_of_the_impacts_of_its_trace() -> None:
    p, skipped, counted = naive.FIGURES[5], 50, 200
    settings = Settings(method="fixed", transient_periods=skipped, periods=counted)
    found = solve_tile("two-mass", p, settings)
    history = trace("two-mass", p, skipped + counted, settings)
    speeds = history.impacts[history.impacts[:, 0] > history.times[skipped], 2]
    assert found["regime"] == CHAOTIC
    assert [float(found[name]) for name in SPEEDS] == pytest.approx(
        [speeds.min(), speeds.mean(), speeds.max()], rel=1e-12
    )
    lost = 0.5 * (1.0 - p["R"] ** 2) * float(np.sum(speeds**2)) / counted
    assert found["impact_energy"] == pytest.approx(lost, rel=1e-12)
    assert found["impacts_per_period"] == len(speeds) / counted


def test_averages_of_two_stretches_are_joined() -> None:
    """The adaptive schedule averages chaos before and after watching it; both are parts of one mean."""
    found = solve_tile("two-mass", naive.FIGURES[5], Settings(tolerance=0.05, survival=2000))
    slowest, mean, fastest = (float(found[name]) for name in SPEEDS)
    assert slowest < mean < fastest
    square = 2.0 * float(found["impact_energy"]) / (1.0 - 0.8**2) / float(found["impacts_per_period"])
    assert mean**2 < square < mean * fastest  # the mean of squares


def test_a_chatter_to_rest_loses_all_of_its_energy() -> None:
    """Truth: the impacts of the trace, and the geometric series of those that are left of each chatter."""
    p = naive.STICKING
    found = solve_tile("two-mass", p)
    impacts = trace("two-mass", on_attractor("two-mass", p), 1).impacts
    last = np.append(np.diff(impacts[:, 1]) != 0.0, True)  # of the chatter at one stop
    lost = 0.5 * (1.0 - p["R"] ** 2) * np.sum(impacts[:, 2] ** 2) + 0.5 * np.sum((p["R"] * impacts[last, 2]) ** 2)
    assert found["impact_energy"] == pytest.approx(float(lost), rel=1e-6)
    assert found["max_impact_speed"] == pytest.approx(impacts[:, 2].max(), rel=1e-12)
    assert found["min_impact_speed"] == 0.0
    assert math.isnan(found["mean_impact_speed"])


def test_an_impact_without_rebound_loses_all_that_it_has() -> None:
    """With R = 0 every impact that rests is the last of its chatter; none is counted, each has its speed."""
    found: dict[str, Any] = solve_tile("two-mass", naive.STICKING | {"R": 0.0})
    assert found["sticks"]
    assert found["symmetric"]
    assert found["impact_energy"] == pytest.approx(float(found["max_impact_speed"]) ** 2, rel=1e-12)  # two a period


def test_motion_without_impact_loses_nothing_and_has_no_speeds() -> None:
    found = solve_tile("two-mass", naive.FIGURES[3] | {"b": 2.0})
    assert found["regime"] == NO_IMPACT
    assert found["impact_energy"] == 0.0
    assert all(math.isnan(found[name]) for name in SPEEDS)
