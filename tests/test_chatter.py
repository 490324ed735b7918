"""Chatter to rest: what happens meanwhile, when the rest begins, and what is told of it. One value in every machine."""

import math
from typing import Any

import numpy as np
import pytest

from tests.hybrids import built, follow
from tests.oracle.machines import bouncing_ball
from tests.oracle.pieces import Contact, Machine, simulate
from tests.oracle.simulate import simulate as simulate_rigid
from workers import Settings, System, solve_tile, trace
from workers.kernel.motion import RUNNING
from workers.results import CHAOTIC, PERIODIC

BALL: dict[str, Any] = {
    "name": "ball", "coordinates": ["y"], "mass": [[1.0]], "force": ["A"], "load": ["-g"], "gap": [1.0],
    "lower": 0.0, "restitution": "R",
    "parameters": {
        "A": {"default": 1.2}, "g": {"default": 1.0}, "R": {"default": 0.5}, "y": {"default": 0.0},
        "omega": {"default": 1.0},
    },
    "measures": {"push": {"acceleration": [1.0], "report": ["mean", "rms"]}},
}  # fmt: skip
"""A ball on a table, as a machine with one rigid contact."""

PHASES: dict[str, Any] = {"phases": [{"start": 0.0}, {"start": 0.371}]}
"""Phases of one law make it a machine with modes."""

KINDS = [pytest.param({}, id="plain"), pytest.param(PHASES, id="with modes")]


def switched_mass() -> System:
    """A free mass above a stop under three loads in turn."""
    return System.from_mapping({
        "name": "mass", "coordinates": ["x"], "mass": [[1.0]], "load": [-1.0], "gap": [1.0], "lower": 0.0,
        "restitution": 0.5, "parameters": {"x": {"default": 1.0}, "omega": {"default": 1.0}},
        "phases": [{"start": 0.0}, {"start": 0.3, "load": [0.1]}, {"start": 0.9, "load": [-3.0]}],
    })  # fmt: skip


def through_loads(x: float, v: float, R: float, pieces: list[tuple[float, float]]) -> tuple[float, float]:
    """Where a free mass above a stop at 0 goes under constant loads (load, duration), in closed form hop by hop."""
    for load, left in pieces:
        while True:
            root = math.sqrt(max(v * v - 2.0 * load * x, 0.0))
            t = (
                (v + root) / -load
                if load < 0.0
                else (2.0 * x / (root - v) if v < 0.0 and v * v > 2 * load * x else math.inf)
            )
            if t >= left:
                x, v = x + v * left + 0.5 * load * left**2, v + load * left
                break
            x, v, left = 0.0, -R * (v + load * t), left - t
    return x, v


def test_a_chatter_ends_where_the_load_changes_before_it_is_over() -> None:
    """Truth: parabolas."""
    period = 2.0 * math.pi
    loads = [(-1.0, 0.3 * period), (0.1, 0.6 * period), (-3.0, 0.1 * period)]
    expected = through_loads(1.0, 0.0, 0.5, loads)
    assert expected == pytest.approx((1.61696, -1.27160), abs=1e-5)
    assert trace(switched_mass(), {}, 1).states[1].tolist() == pytest.approx(expected, abs=1e-12)


@pytest.mark.slow
def test_that_mass_is_chaotic() -> None:
    """Its exponent is that of parabolas followed hop by hop."""
    found = solve_tile(switched_mass(), {}, Settings(tolerance=0.02))
    assert found["regime"] == CHAOTIC and found["largest"] == pytest.approx(0.34, abs=0.06)


def test_another_element_that_engages_meanwhile_is_met_by_the_hops() -> None:
    """Under a constant load the first hops reach a soft stop. Truth: the oracle."""
    contacts = (Contact([1.0], None, 0.0, restitution=0.8), Contact([1.0], 0.2, None, stiffness=20.0, damping=0.5))
    machine = Machine([[1.0]], [[0.0]], [[0.0]], [-1.0], 1.0, (), contacts=contacts)
    found = follow(built(machine), [0.1, -1.0], duration=3.0)
    assert found.status == RUNNING and any(e.index == 1 for e in found.events)
    expected = simulate(machine, [0.1, -1.0], span=3.0, digits=30, rest=1e-8).sections[-1]
    np.testing.assert_allclose(found.state, np.array(expected, float), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("R", [0.3, 0.5, 0.8])
@pytest.mark.parametrize("more", KINDS)
def test_rest_its_share_and_what_is_measured_of_a_ball_are_those_of_40_digits(more: dict[str, Any], R: float) -> None:
    """It flies with A sin(t) - g until its chatter ends. Truth: every hop down to 1e-14 of a time scale."""
    found = solve_tile(System.from_mapping(BALL | more), {"R": R})
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    T, stays = 2.0 * math.pi, simulate_rigid(bouncing_ball(1.2, R), 8, digits=60, rest=1e-14).stuck
    start, end = next((float(stay.start), float(stay.end)) for stay in reversed(stays) if float(stay.end) < 7.9 * T)
    assert found["stuck_fraction"] == pytest.approx((end - start) / T, abs=1e-10)
    if more:
        assert found["stop_fraction"] == pytest.approx((end - start) / T, abs=1e-10)

    def square(t: float) -> float:  # the integral of (A sin - 1)^2
        return 1.2**2 * (0.5 * t - 0.25 * math.sin(2.0 * t)) + 2.4 * math.cos(t) + t

    def first(t: float) -> float:
        return -1.2 * math.cos(t) - t

    assert found["push_rms"] == pytest.approx(
        math.sqrt((square(T) - square(0.0) - square(end) + square(start)) / T), rel=1e-10
    )
    assert found["push_mean"] == pytest.approx((-T - first(end) + first(start)) / T, rel=1e-10)


@pytest.mark.parametrize("more", KINDS)
def test_a_trace_has_every_impact_of_a_chatter_and_its_end(more: dict[str, Any]) -> None:
    """Truth: a ball dropped from y = 1 under a constant load, whose speeds are a geometric series."""
    R, g = 0.7, 9.81
    values = {"A": 0.0, "R": R, "g": g, "y": 1.0}
    times, sides, speeds = trace(System.from_mapping(BALL | more), values, 1).impacts.T
    count = len(times) - 1
    fall, fast = math.sqrt(2.0 / g), math.sqrt(2.0 * g)
    assert count > 30 and np.all(sides == -1.0)
    assert speeds[:-1] == pytest.approx(fast * R ** np.arange(count), abs=1e-9) and speeds[0] == pytest.approx(
        4.4294, abs=1e-4
    )
    flights = np.concatenate([[fall], 2.0 * fall * R ** np.arange(1.0, count)])
    assert times[:-1] == pytest.approx(np.cumsum(flights), abs=1e-9)
    assert speeds[-1] == 0.0
    assert times[-1] == pytest.approx(fall * (1.0 + R) / (1.0 - R), abs=1e-9)
    assert speeds[-2] < 1e-4


def test_impacts_are_counted_where_only_friction_sticks() -> None:
    """Row 22 of the oracle: a mass that friction holds for a while hits its stop once in a turn."""
    found = solve_tile(System.from_mapping({
        "name": "rubs", "coordinates": ["x"], "mass": [[1.0]], "damping": [[0.1]], "stiffness": [[1.0]],
        "force": [1.2], "phase": [math.pi / 2], "gap": [1.0], "upper": 0.8, "restitution": 0.6,
        "friction": [{"name": "ground", "row": [1.0], "kinetic": 0.3, "static": 0.4}],
        "parameters": {"omega": {"default": 0.8}},
    }), {})  # fmt: skip
    assert (found["regime"], found["period"], found["sticks"]) == (PERIODIC, 1, True)
    assert (found["impacts_upper"], found["impacts_lower"], found["impacts_per_period"]) == (1, 0, 1.0)
    assert found["min_impact_speed"] == pytest.approx(1.883636149199, abs=1e-9)
    assert found["mean_impact_speed"] == found["max_impact_speed"] == found["min_impact_speed"]
