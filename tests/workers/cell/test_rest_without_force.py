"""Claims about machines that nothing drives: they come to rest at a vertex, stand, drift freely, or keep a free phase.

Truth: closed forms. Motion that shrinks by a factor rho each turn of length T decays at the rate -ln(rho) / T.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.unforced import machine
from workers import Settings, System, solve_tile
from workers.attractors.coexistence import solve_attractors
from workers.attractors.initial_states import AttractorSettings
from workers.cell import event_trail
from workers.results import AT_EQUILIBRIUM, FREE_PHASE, NO_IMPACT, PERIODIC, UNDETERMINED, WORK_SPENT

SPECTRUM = Settings(exponents="spectrum")
ONE = [[1.0, 0.0], [0.0, 1.0]]
FALLING = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.8]]
LOADED = {"stiffness": [[0.0]], "load": [-1.0], "contacts": [
    {"name": "stop", "gap": [1.0], "lower": 0.0, "law": [[0.0, 0.5], [0.2, 1.0], [1.0, 9.0]]},
]}  # fmt: skip
"""A load of 1 on a stop whose force is 1 at the vertex, depth .2; its stiffness is 2.5 before and 10 beyond it."""


def rubbed(**friction: Any) -> list[dict[str, Any]]:
    return [{"name": "rail", "row": [1.0], **friction}]


def soft(upper: float) -> list[dict[str, Any]]:
    return [{"name": "stop", "gap": [1.0], "upper": upper, "stiffness": 9.0}]


def pair(**entries: Any) -> System:
    """Two masses of 1."""
    return System.from_mapping({"name": "pair", "coordinates": ["x1", "x2"], "mass": ONE} | entries)


def two(first: dict[str, Any], second: dict[str, Any], along: str) -> list[dict[str, Any]]:
    """An element on each of two masses."""
    return [{"name": "a", along: [1.0, 0.0], **first}, {"name": "b", along: [0.0, 1.0], **second}]


@pytest.mark.parametrize(("damping", "friction", "rate"), [
    (0.1, {"kinetic": 0.0, "slope": 0.2}, 0.15), (0.2, {"law": FALLING}, 0.1),
])  # fmt: skip
def test_friction_without_a_level_at_zero_speed_is_damping(damping: float, friction: Any, rate: float) -> None:
    """x'' + (c + slope) x' + x = 0 has the rate (c + slope) / 2 twice."""
    found = solve_tile(machine(damping=[[damping]], friction=rubbed(**friction)), {"x": 0.5}, SPECTRUM)
    assert (found["regime"], found["reason"]) == (NO_IMPACT, 0)
    assert found["spectrum"] == pytest.approx([-rate, -rate], abs=1e-13)
    assert found["state"].tolist() == [0.0, 0.0]
    driven = machine(damping=[[damping]], friction=rubbed(**friction), force=["A"], parameters={"A": 0.0})
    found = solve_tile(driven, {"x": 0.5, "omega": 2.0}, SPECTRUM)
    assert found["regime"] == NO_IMPACT
    assert found["spectrum"] == pytest.approx([-math.pi * rate, -math.pi * rate], abs=1e-13)


def at_a_vertex() -> list[tuple[System, float, list[float], float]]:
    """Machines that rest at a vertex or a stop, their start, rates and rest.

    Between soft and free flight only the damping counts; a rebound takes ln R in half a turn, pi / sqrt(1 - .05^2).
    """
    rebounds = 0.05 - math.log(0.5) * math.sqrt(1.0 - 0.05**2) / math.pi
    law = {"name": "spring", "row": [1.0], "law": [[-1.0, -1.0], [0.0, 0.0], [1.0, 4.0]]}
    slow = 4.5 - math.sqrt(4.5**2 - 2.5)
    return [
        (machine(damping=[[0.1]], contacts=soft(0.0)), 0.5, [-0.05, -0.05], 0.0),
        (machine(damping=[[0.1]], gap=[1.0], upper=0.0, restitution=0.5), -0.5, [-rebounds, -rebounds], 0.0),
        (machine(damping=[[0.1]], stiffness=[[0.0]], springs=[law]), 0.5, [-0.05, -0.05], 0.0),
        (machine(damping=[[0.1]], **LOADED), 0.5, [-0.05, -0.05], -0.2),
        (machine(damping=[[1.5]], **LOADED), 0.5, [-0.75, -0.75], -0.2),
        (machine(damping=[[9.0]], **LOADED), 0.5, [-slow, slow - 9.0], -0.2),  # from outside, through no more events
        (machine(damping=[[3.0]], contacts=soft(0.0)), 0.5, [math.sqrt(1.25) - 1.5, -math.sqrt(1.25) - 1.5], 0.0),
    ]


@pytest.mark.parametrize("case", range(7))
def test_motion_comes_to_rest_at_a_vertex_at_the_rates_of_its_turns(case: int) -> None:
    system, start, rates, end = at_a_vertex()[case]
    found = solve_tile(system, {"x": start}, SPECTRUM)
    assert (found["regime"], found["reason"]) == (NO_IMPACT, 0)
    assert found["spectrum"] == pytest.approx(rates, abs=1e-12)
    assert found["error"] < 1e-12
    assert found["state"] == pytest.approx([end, 0.0], abs=1e-15)
    assert found["periods_used"] < 200


def test_a_start_on_a_vertex_that_attracts_from_both_sides_is_at_rest() -> None:
    found = solve_tile(machine(damping=[[0.1]], contacts=soft(0.0)), {}, SPECTRUM)
    assert (found["regime"], found["reason"]) == (NO_IMPACT, 0)
    assert found["spectrum"] == pytest.approx([-0.05, -0.05], abs=1e-12)
    growing = solve_tile(machine(damping=[[-0.1]], contacts=soft(0.0)), {}, SPECTRUM)
    assert (growing["regime"], growing["reason"]) == (UNDETERMINED, AT_EQUILIBRIUM)


def test_all_starts_come_to_the_one_rest_at_a_vertex() -> None:
    system, box = (
        machine(damping=[[0.1]], friction=rubbed(kinetic=0.0, slope=0.2)),
        (("x", -2.0, 2.0), ("v", -2.0, 2.0)),
    )
    found = solve_attractors(
        system, {}, replace(SPECTRUM, max_periods=1000, survival=500), AttractorSettings(16, box=box)
    )
    assert (found["attractors"], found["undecided"], found["share"][0]) == (1, 0, 1.0)


def test_rest_at_a_vertex_is_found_with_a_declared_force_of_zero() -> None:
    system = machine(damping=[[0.1]], contacts=soft(0.0), force=["A"], parameters={"A": 0.0})
    found = solve_tile(system, {"x": 0.5, "A": [0.0, 0.1]}, SPECTRUM)
    assert found["regime"].tolist() == [NO_IMPACT, PERIODIC]
    assert found["spectrum"][0] == pytest.approx([-0.1 * math.pi] * 2, abs=1e-12)


def test_two_masses_rest_at_a_stop_of_one_at_rates_that_add_up_to_the_damping() -> None:
    """Sum of rates = trace of C: soft contact without damping takes none of the volume."""
    coupled = {"damping": [[0.1, 0.0], [0.0, 0.2]], "stiffness": [[2.0, -1.0], [-1.0, 2.0]]}
    stop = [{"name": "stop", "gap": [1.0, 0.0], "upper": 0.0, "stiffness": 9.0}]
    found = solve_tile(pair(**coupled, contacts=stop), {"x1": 0.5}, SPECTRUM)
    assert found["regime"] == NO_IMPACT
    assert np.sum(found["spectrum"]) == pytest.approx(-0.3, abs=1e-9)
    assert found["spectrum"][0] == pytest.approx(found["spectrum"][1], abs=1e-9)


@pytest.mark.parametrize(("damping", "stiffness"), [(-0.1, 1.0), (0.1, -1.0)])
@pytest.mark.parametrize("force", [{}, {"force": [0.0]}])
def test_a_start_on_an_equilibrium_that_repels_says_so(damping: float, stiffness: float, force: Any) -> None:
    stops = {"gap": [1.0], "upper": 1.0, "lower": -1.0, "restitution": 0.8}
    stops = {"contacts": [{"name": "stops", **stops}, {"name": "far", "gap": [1.0], "upper": 9.0, "stiffness": 1.0}]}
    found = solve_tile(machine(damping=[[damping]], stiffness=[[stiffness]], **stops, **force), {}, SPECTRUM)
    assert (found["regime"], found["reason"]) == (UNDETERMINED, AT_EQUILIBRIUM)


def test_a_mass_that_drifts_freely_in_its_gap_stands_beside_one_that_decays() -> None:
    gap = {"name": "stops", "gap": [-1.0, 1.0], "upper": 1.0, "lower": -1.0, "restitution": 0.7}
    system = System.from_mapping({
        "name": "free", "coordinates": ["x", "y"], "velocities": ["vx", "vy"], "mass": [[1.0, 0.0], [0.0, 0.3]],
        "damping": [[0.05, 0.0], [0.0, 0.0]], "stiffness": [[4.0, 0.0], [0.0, 0.0]], "contacts": [gap],
    })  # fmt: skip
    found = solve_tile(system, {"x": 0.05, "y": 0.3}, SPECTRUM)
    assert (found["regime"], found["reason"]) == (NO_IMPACT, 0)
    assert found["spectrum"] == pytest.approx([0.0, 0.0, -0.025, -0.025], abs=1e-14)
    assert found["state"] == pytest.approx([0.0, 0.3, 0.0, 0.0], abs=1e-14)
    alone = machine(stiffness=[[0.0]], gap=[1.0], upper=1.0, lower=-1.0, restitution=0.7)
    found = solve_tile(alone, {}, SPECTRUM)
    assert found["regime"] == NO_IMPACT
    assert found["spectrum"].tolist() == [0.0, 0.0]


def test_two_equal_cycles_with_a_free_phase_attract_nothing_together() -> None:
    """Each mass has its own cycle, of 3.85966469; the difference of their phases has the multiplier 1."""
    stop = {"upper": 1.0, "restitution": 0.6}
    system = pair(damping=[[-0.2, 0.0], [0.0, -0.2]], stiffness=ONE, contacts=two(stop, stop, "gap"))
    found = solve_tile(system, {"x1": [0.5, 0.3, 0.9, 0.3], "x2": [0.1, 0.8, -0.4, 0.1]}, SPECTRUM)
    assert found["regime"].tolist() == [UNDETERMINED] * 4
    assert found["reason"].tolist() == [FREE_PHASE] * 4
    assert found["periods_used"].max() < 500
    alone = solve_tile(machine(damping=[[-0.2]], gap=[1.0], **stop), {"x": 0.5}, SPECTRUM)
    assert alone["cycle_period"] == pytest.approx(3.85966469, abs=1e-8)
    apart = solve_tile(
        pair(damping=[[-0.2, 0.0], [0.0, 0.2]], stiffness=ONE, contacts=two(stop, stop, "gap")), {"x1": 0.5}, SPECTRUM
    )
    assert apart["regime"] == PERIODIC
    assert apart["cycle_period"] == pytest.approx(float(alone["cycle_period"]), rel=1e-12)


SWINGS = {"stiffness": [[2.0, -1.0], [-1.0, 2.0]]}


def test_two_blocks_that_slip_and_stick_at_one_time_have_the_cycle_of_one() -> None:
    """x1 = -x2 moves as a block of stiffness 3; the period is known to 30 digits."""
    belts = two(*({"kinetic": 0.3, "static": 0.8, "belt": belt} for belt in (0.3, -0.3)), "row")
    both = pair(damping=[[0.1, 0.0], [0.0, 0.1]], **SWINGS, friction=belts)
    found = solve_tile(both, {"x1": 0.5, "x2": -0.5}, SPECTRUM)
    one = machine(damping=[[0.1]], stiffness=[[3.0]], friction=rubbed(kinetic=0.3, static=0.8, belt=0.3))
    alone = solve_tile(one, {"x": 0.5}, SPECTRUM)
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    assert found["cycle_period"] == pytest.approx(3.774081626381019, rel=1e-14)
    assert found["cycle_period"] == pytest.approx(float(alone["cycle_period"]), rel=1e-14)
    assert found["a_stuck"] == pytest.approx(float(alone["rail_stuck"]), rel=1e-12)
    assert found["b_stuck"] == pytest.approx(float(alone["rail_stuck"]), rel=1e-12)


@pytest.mark.parametrize("second", [0.3, 0.301])
def test_two_masses_that_strike_their_stops_at_one_time_have_the_cycle_of_one(second: float) -> None:
    """x1 = x2 moves as a mass of stiffness 1; every start near it comes to it."""
    stop = {"upper": 0.5, "restitution": 0.6}
    both = pair(damping=[[-0.1, 0.0], [0.0, -0.1]], **SWINGS, contacts=two(stop, stop, "gap"))
    found = solve_tile(both, {"x1": 0.3, "x2": second}, SPECTRUM)
    alone = solve_tile(machine(damping=[[-0.1]], gap=[1.0], **stop), {"x": 0.3}, SPECTRUM)
    assert (found["regime"], found["period"], found["a_upper"], found["b_upper"]) == (PERIODIC, 1, 1, 1)
    assert found["cycle_period"] == pytest.approx(4.614437763274993, rel=1e-14)
    assert found["cycle_period"] == pytest.approx(float(alone["cycle_period"]), rel=1e-14)
    assert found["largest"] == pytest.approx(-0.0607016, abs=1e-7)


def two_blocks_on_belts() -> System:
    """Two uncoupled blocks, whose cycles have periods without a common multiple: a torus."""
    belts = two(*({"kinetic": 0.4, "static": 1.0, "belt": belt} for belt in (0.2, 0.3)), "row")
    return pair(damping=[[0.0, 0.0], [0.0, 0.0]], stiffness=[[1.0, 0.0], [0.0, 2.0]], friction=belts)


def test_a_torus_is_examined_at_a_cost_that_grows_with_its_periods(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each look takes up an event about ten times, not once for each period that follows it."""
    looks, legs, former = list[int](), list[int](), event_trail.trail_of

    def counted(rows: Any, *given: Any) -> Any:
        if not legs or len(rows) < legs[-1]:
            looks.append(0)
        looks[-1] += len(rows)
        legs.append(len(rows))
        return former(rows, *given)

    monkeypatch.setattr(event_trail, "trail_of", counted)
    solve_tile(two_blocks_on_belts(), {}, Settings(exponents="none", max_periods=3000, survival=0, max_period=1000))
    assert max(legs) > 1500  # of more than 600 periods
    assert max(looks) < 10 * max(legs)


def test_the_look_at_events_is_paid_from_the_budget_of_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("workers.cell.cell_batch.WORK_PER_PERIOD", 1)
    monkeypatch.setattr("workers.cell.cell_batch.MIN_WORK", 9000)
    found = solve_tile(two_blocks_on_belts(), {}, Settings(exponents="none", max_periods=3000, survival=0))
    assert found["reason"] == WORK_SPENT
