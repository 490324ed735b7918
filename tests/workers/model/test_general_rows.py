"""Machines of general matrices with contacts and friction: exact orbits and closed forms, from the package's own calls.

Truth: another solver's rows (certified modes, Newton's method in 30 digits) as printed, and closed forms where said.
"""

import math
from typing import Any

import numpy as np
import pytest

from tests.oscillators import cosine_mass
from tests.support.oracle.piecewise import HarmonicForce, PiecewiseContact, PiecewiseMachine, orbit
from workers import Settings, System, solve_tile
from workers.continuation import branch, family_of, orbit_from_state
from workers.model.system import find_system
from workers.results import FAILED, NO_IMPACT, NO_REASON, PERIODIC, REASONS, RUNS_AWAY

SPECTRUM = Settings(exponents="spectrum")


def bistable() -> System:
    """H: x'' + .1 x' - x, and 3 (|x| - .5) more beyond +-.5."""
    wall = {"name": "wall", "gap": [1.0], "upper": 0.5, "lower": -0.5, "stiffness": 3.0}
    return cosine_mass(stiffness=[[-1.0]], contacts=[wall], parameters={"A": {"default": 0.4}})


def rotor(**contact: Any) -> System:
    """G: gyroscopic damping, a circulatory force, and a force .3 omega^2 that turns with the rotor."""
    return System.from_mapping({
        "name": "rotor", "coordinates": ["x1", "x2"], "mass": [[1.0, 0.0], [0.0, 1.0]],
        "damping": [[0.1, -0.6], [0.6, 0.1]], "stiffness": [[1.0, 0.05], [-0.05, 1.0]],
        "force": ["0.3 * omega**2", "0.3 * omega**2"], "phase": [0.5 * math.pi, 0.0],
        "parameters": {"omega": {"default": 0.9}}, **contact,
    })  # fmt: skip


RIGID = {"gap": [1.0, 0.0], "upper": 0.2, "restitution": 0.7}
SOFT = {"contacts": [{"name": "stop", "gap": [1.0, 0.0], "upper": 0.2, "stiffness": 20.0, "damping": 0.2}]}


def falling_friction() -> System:
    """x'' + .1 x' + x + (1 - .2 |v|) sgn v = .3 cos 1.2 t, v = x' - .5: it gives more than the damper takes."""
    belt = {"name": "belt", "row": [1.0], "kinetic": 1.0, "slope": -0.2, "belt": 0.5}
    return cosine_mass(friction=[belt], parameters={"omega": {"default": 1.2}, "A": {"default": 0.3}})


def logs(*moduli: complex) -> Any:
    return pytest.approx(sorted((math.log(abs(mu)) for mu in moduli), reverse=True), abs=2e-12)


def test_a_bistable_mass_jumps_between_its_wells_on_the_orbit_known() -> None:
    system = bistable()
    found = solve_tile(system, {"x": 1.83, "v": 1.465}, SPECTRUM)
    assert (found["regime"], found["period"], bool(found["symmetric"])) == (PERIODIC, 1, True)
    assert found["state"] == pytest.approx([1.83074763472309, 1.4654475417794], abs=2e-13)
    mu = complex(0.35973461465413, 0.63567216244755)
    assert found["spectrum"] == logs(mu, mu)


def test_in_a_well_of_a_bistable_mass_the_linear_answer_grazes_where_the_closed_form_says() -> None:
    """Within x > .5 the law is 2 (x - .75): the answer A / |2 - 1 + .1 i| is .25 at A = .25 sqrt(1.01)."""
    near = 0.25 * math.sqrt(1.01) * np.array([1.0 - 1e-9, 1.0 + 1e-4])
    below, above = solve_tile(bistable(), {"A": near, "x": 0.75})["wall_fraction"]
    assert below == 1.0 and above < 1.0


def test_motion_at_the_crest_of_a_bistable_mass_is_no_class_and_leaves_it() -> None:
    """Without a force its centre is a saddle of multipliers 394.2 and .00135: what is near goes to a well."""
    found = solve_tile(bistable(), {"A": 0.0, "x": 1e-6}, SPECTRUM)
    assert found["reason"] == NO_REASON and found["state"] == pytest.approx([0.75, 0.0], abs=1e-9)
    assert found["spectrum"] == pytest.approx([-0.1 * np.pi] * 2, abs=1e-12)
    root = math.sqrt(0.05**2 + 1.0)
    assert math.exp(2 * np.pi * (root - 0.05)) == pytest.approx(394.2065934931409, rel=1e-14)


def test_a_rotor_strikes_its_rigid_stop_on_the_orbit_known() -> None:
    found = solve_tile(rotor(**RIGID), {}, SPECTRUM)
    assert (found["regime"], found["period"], found["impacts_upper"]) == (PERIODIC, 1, 2)
    speeds = sorted([1.5744584814766, 0.94506957930341])
    assert [found["min_impact_speed"], found["max_impact_speed"]] == pytest.approx(speeds, abs=1e-12)
    pair = complex(-0.3576635523544, 0.17071141321586)
    assert found["spectrum"] == logs(0.68351777009821, 0.55356901443406, pair, pair)
    assert found["sum_law_defect"] == pytest.approx(0.0, abs=1e-13)


def test_a_rotor_presses_its_soft_stop_on_the_orbit_known() -> None:
    found = solve_tile(rotor(**SOFT), {}, SPECTRUM)
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    assert found["stop_fraction"] * 2 * np.pi / 0.9 == pytest.approx(1.158689834365899 - 0.4462209546761861, abs=1e-12)
    assert found["max_impact_speed"] == pytest.approx(1.6083008655105, abs=1e-12)
    first, second = complex(0.638853677226, 0.26554619736132), complex(-0.27648695912635, 0.60991806738187)
    assert found["spectrum"] == logs(first, first, second, second)


def test_friction_that_falls_faster_than_damping_rises_sticks_and_slips_on_the_orbit_known() -> None:
    found = solve_tile(falling_friction(), {"x": 0.3, "v": 0.5}, SPECTRUM)
    assert (found["regime"], found["period"]) == (PERIODIC, 1)
    assert found["largest"] == pytest.approx(math.log(0.49992983100406), abs=1e-12)
    assert found["spectrum"][1] == -math.inf
    assert found["belt_stuck"] * 2 * np.pi / 1.2 == pytest.approx(1.334480238462699 - 0.3506497883225591, abs=1e-12)


@pytest.mark.parametrize(
    ("name", "free", "start", "known"),
    [
        ("rotor", "omega", {}, [0.68351777009821, 0.55356901443406, complex(-0.3576635523544, 0.17071141321586)]),
        ("bistable", "A", {"x": 1.83, "v": 1.465}, [complex(0.35973461465413, 0.63567216244755) ** 0.5]),
    ],
)
def test_branches_go_through_the_orbits_known(
    name: str, free: str, start: dict[str, float], known: list[complex]
) -> None:
    """Of the symmetric orbit of the bistable mass they have the multipliers of half a turn."""
    system = rotor(**RIGID) if name == "rotor" else bistable()
    values = {p.name: p.default for p in system.parameters}
    found = solve_tile(system, start)
    exact = orbit_from_state(system, values, found["state"], int(found["period"]))
    run = branch(family_of(system, values, (free,)), exact, values[free], (0.95 * values[free], 1.02 * values[free]))
    at = min(run.points, key=lambda point: abs(float(point.values[0]) - values[free]))
    assert float(at.values[0]) == values[free]
    for mu in known:
        assert min(abs(np.array(at.multipliers) - mu)) < 1e-12


# What grows without bound, and what does not


def bouncing(growth: float, R: float) -> System:
    """x'' - 2 growth x' + x with a rigid stop at 1."""
    return cosine_mass(damping=[[-2.0 * growth]], gap=[1.0], upper=1.0, restitution=R)


def test_a_growing_mass_at_a_rigid_stop_is_bounded_just_where_the_closed_form_says() -> None:
    """R e^(growth pi / wd) < 1 holds it: for growth .05 that is R < .8545."""
    limit = math.exp(-0.05 * math.pi / math.sqrt(1.0 - 0.05**2))
    for R, held in ((limit - 0.03, True), (limit + 0.03, False)):
        found = solve_tile(bouncing(0.05, R), {"A": 0.3, "omega": 2.3}, Settings(max_periods=4000, survival=500))
        assert (found["reason"] == RUNS_AWAY) is not held, (R, REASONS[int(found["reason"])].name)
        assert np.isnan(found["largest"]) is not held or held


def test_what_falls_from_its_crest_away_from_the_only_stop_runs_away_and_what_falls_on_it_does_not() -> None:
    system = cosine_mass(stiffness=[[-1.0]], gap=[1.0], upper=0.2, restitution=0.5)
    found = solve_tile(system, {"A": 0.0, "x": np.array([-1e-3, 1e-3])})
    assert (found["regime"][0], found["reason"][0]) == (FAILED, RUNS_AWAY)
    assert found["periods_used"][0] == 0  # certain at once
    assert found["reason"][1] == NO_REASON and found["state"][1] == pytest.approx([0.2, 0.0])


def test_what_stays_in_a_well_does_not_run_away_from_the_crest_between() -> None:
    """There nothing grows, and no guard is met any more."""
    found = solve_tile(bistable(), {"omega": 3.0, "A": 0.1, "x": 0.75, "v": 0.01})
    assert (found["reason"], found["regime"], found["wall_fraction"]) == (NO_REASON, NO_IMPACT, 1.0)


def test_friction_beside_a_crest_lets_go_what_runs_away() -> None:
    ground = {"name": "ground", "row": [1.0], "kinetic": 0.1}
    system = cosine_mass(stiffness=[[-1.0]], friction=[ground])
    found = solve_tile(system, {"A": 0.0, "x": np.array([0.05, 0.5])})
    assert found["reason"].tolist() == [NO_REASON, RUNS_AWAY]
    assert found["state"][0] == pytest.approx([0.05, 0.0])


def test_what_grows_where_no_contact_sees_it_is_refused() -> None:
    table = {"name": "two", "coordinates": ["x1", "x2"], "mass": [[1, 0], [0, 1]], "damping": [[0.1, "c"], [0, 0.1]],
             "stiffness": [[1, 0], [0, "k"]], "force": [0.3, 0.0], "gap": [1, 0], "upper": 0.2, "restitution": 0.8,
             "parameters": {"omega": {"default": 1.0}, "k": {"default": 1.0}, "c": {"default": 0.0}}}  # fmt: skip
    cells = {"k": np.array([1.0, -1.0, -1.0]), "c": np.array([0.0, 0.0, 0.5]), "x2": 1e-3}
    found = solve_tile(System.from_mapping(table), cells)
    assert [REASONS[int(code)].name for code in found["reason"][:2]] == ["none", "unstable"]
    assert REASONS[int(found["reason"][2])].name == "runs_away"


# The packaged systems


def oracle_harvester(omega: float, A: float) -> PiecewiseMachine:
    k, stop = 0.5, 1.0 / 1.5
    return PiecewiseMachine([[1]], [[2 * (0.02 + 0.05)]], [[-k]], [0], omega, (HarmonicForce(1, [A], [0]),), (
        PiecewiseContact([1], stop, -stop, stiffness=1 + k),))  # fmt: skip


def oracle_rotor(omega: float, b: float) -> PiecewiseMachine:
    turn, whirl, push = 0.2 * omega, 2 * 0.02 * omega, 0.1 * omega**2
    damping, stiffness = [[2 * (0.02 + 0.02), turn], [-turn, 2 * (0.02 + 0.02)]], [[1, whirl], [-whirl, 1]]
    stops = (PiecewiseContact([1, 0], b, -b, restitution=0.7),)
    return PiecewiseMachine(
        [[1, 0], [0, 1]], damping, stiffness, [0, 0], omega, (HarmonicForce(1, [0, push], [push, 0]),), stops
    )


@pytest.mark.parametrize(
    ("name", "cell"),
    [
        ("bistable-harvester", {"omega": 0.6, "A": 0.4}),
        ("bistable-harvester", {"omega": 0.75, "A": 0.45}),
        ("bistable-harvester", {"omega": 1.2, "A": 0.25}),
        ("rotor-rub", {"omega": 1.4, "b": 0.5}),
        ("rotor-rub", {"omega": 2.9, "b": 0.3}),
        ("rotor-rub", {"omega": 3.6, "b": 0.6}),
    ],
)
def test_orbits_of_the_packaged_machines_are_those_of_the_oracle(name: str, cell: dict[str, float]) -> None:
    found = solve_tile(name, cell, SPECTRUM)
    truth = {"bistable-harvester": oracle_harvester, "rotor-rub": oracle_rotor}[name](*cell.values())
    assert found["regime"] == PERIODIC and (name != "rotor-rub" or found["impacts_per_period"] > 0.0)
    exact = orbit(truth, found["state"].tolist(), int(found["period"]))
    assert found["state"] == pytest.approx([float(x) for x in exact.state], abs=1e-11)
    moduli = sorted((abs(complex(mu)) for mu in exact.multipliers), reverse=True)
    assert np.exp(found["spectrum"] * found["period"]) == pytest.approx(moduli, abs=1e-9)


def test_the_shaft_of_the_rotor_feeds_its_whirl_above_the_speed_known_in_closed_form() -> None:
    """omega = w (1 + zeta / zeta_i) with w^2 - gamma omega w = 1: 1 / sqrt(.15) for the defaults."""
    speed, rotor_rub = 1.0 / math.sqrt(0.15), find_system("rotor-rub")
    values = {p.name: p.default for p in rotor_rub.parameters}
    below, above = (rotor_rub.build(values | {"omega": speed * (1.0 + by)}).growth for by in (-1e-9, 1e-9))
    assert below == 0.0 < above < 1e-9


def test_the_coil_of_a_harvester_that_stays_in_its_well_takes_the_power_of_the_linear_machine() -> None:
    """zeta_e V^2 with V = A omega / |1 - omega^2 + 2 i (zeta + zeta_e) omega|."""
    A, omega = 0.02, 0.8
    speed = A * omega / abs(complex(1.0 - omega**2, 2.0 * 0.07 * omega))
    found = solve_tile("bistable-harvester", {"omega": omega, "A": A})
    assert found["coil_power"] == pytest.approx(0.05 * speed**2, rel=1e-12)
    assert found["regime"] == NO_IMPACT and found["well_fraction"] == 1.0
