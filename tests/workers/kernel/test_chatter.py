"""Chatter to rest: what happens meanwhile, when the rest begins, and what is told of it. One value in every machine."""

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from mpmath import mp

from tests.support.oracle.machines import bouncing_ball
from tests.support.oracle.piecewise import PiecewiseContact, PiecewiseMachine, PiecewisePhase, simulate
from tests.support.oracle.simulate import simulate as simulate_rigid
from tests.support.solver_bridge import built, follow
from workers import Settings, System, solve_tile, trace
from workers.kernel.chatter import chatter_end, hop
from workers.kernel.motion import RUNNING
from workers.model.oscillator import COLUMN, make_blocks
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


def test_a_chatter_ends_where_the_load_changes_before_it_is_over() -> None:
    """Truth: the oracle, and parabolas that were followed hop by hop."""
    phases = (PiecewisePhase(0.0), PiecewisePhase(0.3, load=[0.1]), PiecewisePhase(0.9, load=[-3.0]))
    stop = PiecewiseContact([1.0], None, 0.0, restitution=0.5)
    machine = PiecewiseMachine([[1.0]], [[0.0]], [[0.0]], [-1.0], 1.0, contacts=(stop,), phases=phases)
    expected = [float(z) for z in simulate(machine, [1.0, 0.0], digits=30).sections[1]]
    assert expected == pytest.approx((1.61696, -1.27160), abs=1e-5)
    assert trace(switched_mass(), {}, 1).states[1].tolist() == pytest.approx(expected, abs=1e-12)


@pytest.mark.slow
def test_that_mass_is_chaotic() -> None:
    """Its exponent is that of parabolas followed hop by hop."""
    found = solve_tile(switched_mass(), {}, Settings(tolerance=0.02))
    assert found["regime"] == CHAOTIC and found["largest"] == pytest.approx(0.34, abs=0.06)


def test_another_element_that_engages_meanwhile_is_met_by_the_hops() -> None:
    """Under a constant load the first hops reach a soft stop. Truth: the oracle."""
    contacts = (
        PiecewiseContact([1.0], None, 0.0, restitution=0.8),
        PiecewiseContact([1.0], 0.2, None, stiffness=20.0, damping=0.5),
    )
    machine = PiecewiseMachine([[1.0]], [[0.0]], [[0.0]], [-1.0], 1.0, (), contacts=contacts)
    found = follow(built(machine), [0.1, -1.0], duration=3.0)
    assert found.status == RUNNING and any(e.index == 1 for e in found.events)
    expected = simulate(machine, [0.1, -1.0], span=3.0, digits=30, rest=1e-8).sections[-1]
    np.testing.assert_allclose(found.state, np.array(expected, float), rtol=0.0, atol=1e-9)


@cache
def last_rest(A: float, R: float) -> tuple[float, float]:
    """Start and end, in 60 digits, of the last rest of a ball on a table that ends before 2.9 periods."""
    stays = simulate_rigid(bouncing_ball(A, R), 3, digits=60, rest=1e-14).stuck
    return next((float(s.start), float(s.end)) for s in reversed(stays) if float(s.end) < 5.8 * math.pi)


@pytest.mark.parametrize(("A", "R"), [(1.2, 0.3), (1.2, 0.5), (1.2, 0.8), (1.05, 0.95), (1.01, 0.979), (1.003, 0.99)])
@pytest.mark.parametrize("more", KINDS)
def test_rest_its_share_and_what_is_measured_of_a_ball_are_those_of_60_digits(
    more: dict[str, Any], A: float, R: float
) -> None:
    """It flies with A sin(t) - g until its chatter ends. Truth: every hop down to 1e-14 of a time scale."""
    found = solve_tile(System.from_mapping(BALL | more), {"A": A, "R": R})
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    T, (start, end) = 2.0 * math.pi, last_rest(A, R)
    assert found["stuck_fraction"] == pytest.approx((end - start) / T, abs=1e-12)
    if more:
        assert found["stop_fraction"] == pytest.approx((end - start) / T, abs=1e-12)

    def square(t: float) -> float:  # the integral of (A sin - 1)^2
        return A**2 * (0.5 * t - 0.25 * math.sin(2.0 * t)) + 2.0 * A * math.cos(t) + t

    def first(t: float) -> float:
        return -A * math.cos(t) - t

    assert found["push_rms"] == pytest.approx(
        math.sqrt((square(T) - square(0.0) - square(end) + square(start)) / T), rel=1e-11
    )
    assert found["push_mean"] == pytest.approx((-T - first(end) + first(start)) / T, rel=1e-11)


def test_a_long_chatter_of_two_masses_next_to_resonance_is_known_as_well_as_the_machine_is() -> None:
    """Truth: 26 periods in 40 digits, at the end of which periods agree to 1e-15. |x1| is .008, of terms of 1500: a
    unit in the last place of omega moves the share of rest by 1e-10 and more."""
    params = {
        "omega": 0.15847196861603696, "mu_m": 0.03756753669567823, "mu_k": 0.026008830643225,
        "R": 0.9786052038818498, "zeta": 0.0003629456451160653, "f2": 0.0, "tau": 4.181852646911042,
        "b": 0.007867228943286852, "x1": -0.00678907194844019, "x2": 0.0331074404269827,
        "v1": 0.00331733271428745, "v2": -0.0347606991425185,
    }  # fmt: skip
    found = solve_tile("two-mass", params)
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    assert found["stuck_fraction"] == pytest.approx(0.443872341076883, abs=3e-9)


@pytest.mark.parametrize("R", [0.4, 0.9, 0.979, 0.995])
def test_estimates_of_the_end_of_a_chatter_are_extrapolated_to_fourth_order(R: float) -> None:
    """Truth: chatter whose n-th impact at speed R^n has an estimate that misses the end by 2 w^3 - 3 w^4 + 5 w^5."""
    missed = []
    for w in (0.02, 0.002):
        speeds = w / R ** np.arange(2.0, -1.0, -1.0)
        estimates = 1.0 + 2.0 * speeds**3 - 3.0 * speeds**4 + 5.0 * speeds**5
        missed.append(abs(chatter_end(tuple(estimates), w, R) - 1.0))
    assert missed[0] < 2e3 * 0.02**5 and missed[1] < 2e3 * 0.002**5


def test_what_is_no_estimate_or_a_bad_one_leaves_the_last_one_alone() -> None:
    assert chatter_end((math.nan, math.nan, 3.0), 0.1, 0.9) == 3.0
    assert chatter_end((0.0, 2.0, 3.0), 0.1, 0.9) == 3.0


@pytest.mark.parametrize("s", [0.4, 0.01])
def test_a_hop_ends_where_its_closed_form_does(s: float) -> None:
    """Truth: a damped oscillation and a forced part that are at one place twice, in 60 digits."""
    eta, lam, omega, phase, A, B, x = 0.05, 1.3, 0.9, 0.3, 0.4, -0.2, 0.7
    blocks = make_blocks(np.array([eta]), np.array([lam]))
    blocks[0, [COLUMN.c0, COLUMN.cA1]] = 1.0
    with mp.workdps(60):
        wd = mp.sqrt(mp.mpf(lam) - mp.mpf(eta) ** 2)

        def y(t: Any, v: Any) -> Any:
            free = mp.exp(-eta * t) * (x * mp.cos(wd * t) + (v + mp.mpf(eta) * x) / wd * mp.sin(wd * t))
            return free + A * mp.sin(omega * t + phase) + B * mp.cos(omega * t + phase)

        v = mp.findroot(lambda v: y(mp.mpf(s), v) - y(mp.zero, v), 0.0)
        before, after = (mp.diff(lambda t: y(t, v), t) for t in (mp.zero, mp.mpf(s)))
    side = -1 if before > 0 else 1
    found = hop(blocks, np.array([[A, B]]), omega, np.array([[x, float(v)]]), phase, side, float(abs(before)),
                s * (1.0 + 1e-4), math.sqrt(lam))  # fmt: skip
    assert found == pytest.approx((s, float(abs(after))), rel=1e-13)


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
