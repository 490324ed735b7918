"""Claims about machines without a force: their cycles, with periods and multipliers, their equilibria, and their names.

Truth: closed forms, and numbers that a program in 30 digits found: B1 to B6, C3, rows 17 and 18.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from atlas.errors import InputError
from atlas.spec.spec import Spec, validate_parameters
from tests.support.oracle.piecewise.machine import PiecewiseContact, PiecewiseFriction, PiecewiseMachine
from tests.support.oracle.piecewise.motion import simulate
from tests.support.oracle.piecewise.one_mass import belt as belt_of_oracle
from tests.unforced import machine, pair_of, random_pair
from workers import Settings, System, solve_tile
from workers.history import within_periods
from workers.model.entries import DefinitionError
from workers.results import CENTRE, CHAOTIC, NO_IMPACT, PERIODIC, QUASIPERIODIC, UNDETERMINED

SPECTRUM = Settings(exponents="spectrum")


def belt(**entries: Any) -> System:
    """x'' + c x' + x + friction = 0 on a belt of speed v0, kinetic .4 and static Fs."""
    friction = {"name": "belt", "row": [1.0], "kinetic": 0.4, "static": "Fs", "belt": "v0", "slope": "s"}
    parameters = {"c": 0.1, "Fs": 1.0, "v0": 0.5, "s": 0.0}
    return machine(damping=[["c"]], friction=[friction], parameters=parameters, **entries)


def solved(system: System, settings: Settings = SPECTRUM, **params: Any) -> Any:
    return solve_tile(system, params, settings)


def test_a_block_on_a_belt_has_the_cycle_of_its_closed_form() -> None:
    """B1: T = 2 (Fs - Fk) / v + pi + 2 atan(v / (Fs - Fk)), undamped."""
    Fs, v = np.array([1.0, 1.0, 0.7, 1.3]), np.array([0.2, 0.9, 0.35, 0.1])
    found = solved(belt(), c=0.0, Fs=Fs, v0=v, x=1.6)
    stuck = 2.0 * (Fs - 0.4) / v
    T = stuck + math.pi + 2.0 * np.arctan(v / (Fs - 0.4))
    assert found["regime"].tolist() == [PERIODIC] * 4
    assert T[0] == pytest.approx(9.78509376238307763, rel=1e-15)
    np.testing.assert_allclose(found["cycle_period"], T, rtol=1e-13)
    np.testing.assert_allclose(found["belt_stuck"], stuck / T, rtol=1e-12)
    assert found["belt_stuck"][0] == pytest.approx(0.61317756842206796, rel=1e-13)
    assert found["period"].tolist() == [1] * 4
    assert found["spectrum"].tolist() == [[0.0, -math.inf]] * 4
    assert found["largest"].tolist() == [-math.inf] * 4


def test_the_cycle_of_row_17_slips_and_sticks_for_the_published_times() -> None:
    found = solved(belt(), x=0.95, v=0.5)
    T = 4.852290765476 + 1.806193810563
    assert found["cycle_period"] == pytest.approx(6.658484576038, abs=2e-12)
    assert found["cycle_period"] == pytest.approx(T, abs=2e-12)
    assert found["belt_stuck"] == pytest.approx(1.806193810563 / T, abs=1e-12)
    assert found["state"] == pytest.approx([0.95, 0.5], abs=1e-13)


def test_beyond_row_18_there_is_no_cycle_and_the_block_slides() -> None:
    end = 0.658855574469523615
    found = solved(belt(), x=1.0 - 0.1 * end, v=end, v0=end * np.array([1.0 - 1e-10, 1.0 + 1e-10]))
    assert found["regime"].tolist() == [PERIODIC, NO_IMPACT]
    slips = found["cycle_period"][0] * (1.0 - found["belt_stuck"][0])
    assert slips == pytest.approx(5.52880489921522436, abs=1e-4)  # it falls as the root of the distance
    assert math.isnan(found["cycle_period"][1])


def test_friction_that_falls_with_speed_makes_the_cycle_of_b3() -> None:
    falling = {"name": "belt", "row": [1.0], "kinetic": 1.0, "belt": 0.5, "slope": -0.2}
    found = solved(machine(damping=[[0.1]], friction=[falling]))
    assert found["regime"] == PERIODIC
    assert found["cycle_period"] == pytest.approx(6.439474890105244, abs=1e-12)
    assert found["belt_stuck"] == pytest.approx(0.1414199148892304, abs=1e-12)


@pytest.mark.parametrize("start", [0.1, -0.7])
def test_an_impact_holds_an_oscillator_that_grows_in_the_cycle_of_b4(start: float) -> None:
    growing = machine(damping=[[-0.1]], gap=[1.0], upper=1.0, restitution=0.8)
    found = solved(growing, x=start)
    assert (found["regime"], found["period"], found["impacts_upper"]) == (PERIODIC, 1, 1)
    assert found["cycle_period"] == pytest.approx(3.66749316841195374, rel=1e-13)
    assert found["max_impact_speed"] == pytest.approx(4.198117780509497, rel=1e-12)
    assert found["spectrum"] == pytest.approx([0.0, -0.02168723488629277], abs=1e-13)
    assert found["spectrum"][0] == 0.0
    assert found["largest"] == found["spectrum"][1]
    # What is told per forcing period elsewhere is per unit of time.
    assert found["impacts_per_period"] == pytest.approx(1.0 / 3.66749316841195374, rel=1e-13)
    assert found["impact_energy"] == pytest.approx(0.5 * (1.0 - 0.8**2) * 4.198117780509497**2 / 3.66749316841195374)
    assert abs(found["sum_law_defect"]) < 1e-14


def flutter() -> System:
    """Z(1.8, .1) with soft stops: two masses with a stiffness that is not symmetric, B6."""
    stops = {"name": "rub", "gap": [0.0, 1.0], "upper": 0.5, "lower": -0.5, "stiffness": 10.0, "damping": 0.5}
    return System.from_mapping({
        "name": "flutter", "coordinates": ["x1", "x2"], "mass": [[3.0, 1.0], [1.0, 1.0]],
        "damping": [[0.2, -0.1], [-0.1, 0.1]], "stiffness": [[0.2, 0.8], [-1.0, 1.0]], "contacts": [stops],
    })  # fmt: skip


def test_flutter_between_soft_stops_has_the_symmetric_cycle_and_the_multipliers_of_b6() -> None:
    found = solved(flutter(), x1=0.1)
    T = 15.1055186924726138
    assert (found["regime"], found["symmetric"]) == (PERIODIC, True)
    assert found["cycle_period"] == pytest.approx(T, rel=1e-13)
    mu = abs(complex(0.00089792497918, 0.00189567119235))
    assert found["spectrum"] == pytest.approx(np.log([1.0, 0.57873210266101, mu, mu]) / T, abs=1e-9)
    assert found["spectrum"][0] == 0.0
    passing = -np.array([1.27117619126548, 0.5, 0.143905942436102, 0.387039907780657])
    assert found["state"] == pytest.approx(passing, abs=1e-11)


@pytest.mark.parametrize(("c", "v0", "s"), [(0.05, 0.4, 0.0), (0.15, 0.2, 0.05), (0.02, 0.7, -0.1)])
def test_the_oracle_goes_round_a_cycle_to_where_it_began(c: float, v0: float, s: float) -> None:
    """An independent simulation, in more digits, from the state of the result over the period of the result."""
    found = solved(belt(), x=1.2, c=c, v0=v0, s=s)
    assert found["regime"] == PERIODIC
    there = belt_of_oracle(v0)
    friction = tuple(replace(element, slope=s) for element in there.friction)
    there = replace(there, damping=[[c]], friction=friction)
    run = simulate(there, found["state"].tolist(), span=float(found["cycle_period"]), digits=30)
    assert [float(z) for z in run.sections[-1]] == pytest.approx(found["state"].tolist(), abs=1e-11)
    assert {event.kind for event in run.events} >= {"stick"}


# Equilibria


def test_a_block_that_slides_for_ever_stands_still_with_the_exponents_of_sliding() -> None:
    """K x = kinetic; x'' + .1 x' + x = 0 has the rate .05 twice, or .01 and 1 by overdamping."""
    found = solved(belt(), x=0.45, c=[0.1, 2.5])
    assert found["regime"].tolist() == [NO_IMPACT] * 2
    rates = [[-0.05, -0.05], [-0.5, -2.0]]
    np.testing.assert_allclose(found["spectrum"], rates, rtol=1e-12)
    assert found["largest"].tolist() == found["spectrum"][:, 0].tolist()
    np.testing.assert_allclose(found["state"], [[0.4, 0.0]] * 2, atol=1e-15)
    assert np.isnan(found["cycle_period"]).all()


def test_a_mass_that_a_load_presses_on_its_stop_rests_there() -> None:
    """All its directions are lost."""
    found = solved(machine(damping=[[0.1]], load=[1.0], gap=[1.0], upper=0.5, restitution=0.6))
    assert (found["regime"], found["sticks"]) == (NO_IMPACT, True)
    assert found["spectrum"].tolist() == [-math.inf, -math.inf]
    assert found["state"].tolist() == [0.5, 0.0]


@pytest.mark.parametrize("load", [0.2, 1.0])
def test_a_mass_that_friction_holds_stands_at_one_place_of_many(load: float) -> None:
    held = {"name": "rail", "row": [1.0], "kinetic": 0.5, "static": 1.0}
    found = solved(machine(damping=[[0.1]], load=[load], friction=[held]))
    assert found["regime"] == NO_IMPACT
    assert found["spectrum"].tolist() == [0.0, -math.inf]


# What decides the numbers


def test_a_cycle_is_the_same_wherever_it_begins() -> None:
    found, elsewhere = solved(belt(), x=0.95, v=0.5), solved(belt(), x=-1.3, v=0.7)
    assert elsewhere["cycle_period"] == pytest.approx(found["cycle_period"], rel=1e-14)
    assert elsewhere["state"] == pytest.approx(found["state"], abs=1e-14)


def test_time_has_no_unit_of_its_own() -> None:
    """A machine a thousand times faster: rates are a thousand times larger, and periods as much shorter."""
    slow = solved(belt(), x=1.2)
    friction = {"name": "belt", "row": [1.0], "kinetic": 0.4, "static": 1.0, "belt": 0.5e3}
    fast = solved(machine(mass=[[1e-6]], damping=[[0.1e-3]], friction=[friction]), x=1.2)
    assert fast["cycle_period"] == pytest.approx(1e-3 * slow["cycle_period"], rel=1e-12)
    growing = {"gap": [1.0], "upper": 1.0, "restitution": 0.8}
    slow = solved(machine(damping=[[-0.1]], **growing), x=0.1)
    fast = solved(machine(mass=[[1e-6]], damping=[[-0.1e-3]], **growing), x=0.1)
    assert fast["largest"] == pytest.approx(1e3 * slow["largest"], rel=1e-10)


@pytest.mark.parametrize("exponents", ["none", "largest"])
def test_a_cycle_is_found_whatever_exponents_are_wanted(exponents: str) -> None:
    found = solved(belt(), Settings(exponents=exponents), x=0.95, v=0.5)
    assert found["cycle_period"] == pytest.approx(6.658484576038, abs=2e-12)


def test_a_machine_without_a_force_has_no_frequency_and_no_phase() -> None:
    assert [p.name for p in belt().parameters] == ["c", "Fs", "v0", "s", "x", "v"]
    for name in ("omega", "tau"):
        line = f"'{name}': system 'mass' has no force; leave this name out"
        with pytest.raises(KeyError, match=line):
            solve_tile(belt(), {name: 1.0})
        with pytest.raises(InputError, match=f"parameter {line}"):
            validate_parameters(belt(), {name: 1.0})
        with pytest.raises(InputError, match=f"parameter in axes {line}"):
            Spec(belt(), {name: [1.0, 2.0]})
        with pytest.raises(DefinitionError, match=f"system.parameters.{name}: found in a machine without a force"):
            machine(parameters={name: 1.0})
    with pytest.raises(DefinitionError, match=r"system\.load\[0\]: unknown name 'omega'"):
        belt(load=["omega"])


def test_the_schedule_in_forcing_periods_is_refused_without_a_force() -> None:
    with pytest.raises(DefinitionError, match='must be "adaptive" for a machine without a force'):
        solve_tile(belt(), {}, Settings(method="fixed", transient_periods=10, periods=10))


def test_results_are_told_per_unit_of_time() -> None:
    named = {variable.name: variable for variable in belt().variables(SPECTRUM)}
    assert named["largest"].long_name == "largest Lyapunov exponent per unit time"
    assert named["cycle_period"].long_name == "time that a cycle takes; NaN unless the motion repeats"
    assert not any("forcing period" in variable.long_name for variable in named.values())


# Motion that does not close


def driven() -> System:
    """A mass that damping -d drives, on another one between two rigid stops of restitution R: x2 = +-1."""
    stops = {"name": "stops", "gap": [0.0, 1.0], "upper": 1.0, "lower": -1.0, "restitution": "R"}
    return System.from_mapping({
        "name": "driven", "coordinates": ["x1", "x2"], "mass": [[1.0, 0.0], [0.0, 1.0]],
        "damping": [["c", 0.0], [0.0, "-d"]], "stiffness": [["1 + k", "-k"], ["-k", "k"]], "contacts": [stops],
        "parameters": {"c": 0.1, "d": 0.15, "k": 1.0, "R": 0.7, "x2": 0.1},
    })  # fmt: skip


def test_a_torus_has_two_exponents_of_zero_and_passes_an_event_at_ever_other_states() -> None:
    found = solved(driven(), Settings(exponents="spectrum", section_samples=200))
    assert found["regime"] == QUASIPERIODIC
    assert abs(found["largest"]) < 1e-5
    assert found["spectrum"][1] == 0.0
    assert found["kaplan_yorke"] == 2.0
    section = found["section"]
    assert np.abs(np.abs(section[:, 1]) - 1.0).max() < 1e-12
    assert len(np.unique(section[:, 0].round(6))) == 200
    assert math.isnan(found["cycle_period"])


def test_chaos_has_an_exponent_of_zero_and_obeys_the_sum_law_in_units_of_time() -> None:
    """Sum = -tr C + 2 ln R times the impacts in a unit of time.

    All of 40 motions from machines 1e-9 apart are chaotic here: rounding does not decide the class.
    """
    c, d, R = 0.05, 0.29, 0.68
    settings = Settings(exponents="spectrum", survival=1000, max_periods=3000, tolerance=0.05, section_samples=50)
    found = solved(driven(), settings, c=c, d=d, R=R, k=1.26)
    assert found["regime"] == CHAOTIC
    assert found["largest"] > 0.05
    assert np.sum(found["spectrum"] == 0.0) == 1
    law = d - c + 2.0 * math.log(R) * found["impacts_per_period"]
    assert np.sum(found["spectrum"]) == pytest.approx(law, abs=5e-3)  # the 0 was one by average
    assert np.abs(np.abs(found["section"][:, 1]) - 1.0).max() < 1e-12


# Random machines


def cycles_close(seed: int) -> bool:
    """Whether a random pair of masses, one on a belt and one between a stop, has a cycle; the oracle goes round it."""
    matrices, rub, stop = random_pair(seed)
    system = pair_of(matrices, rub, stop)
    found = solved(system, Settings(exponents="spectrum", max_periods=500, survival=0), x1=0.3)
    if found["regime"] != PERIODIC:
        return False
    there = PiecewiseMachine(**matrices, load=[0.0, 0.0], omega=1.0, contacts=(PiecewiseContact([0.0, 1.0], **stop),),
                    friction=(PiecewiseFriction(**rub),))  # fmt: skip
    T, none = float(found["cycle_period"]), {p.name: np.array([p.default]) for p in system.parameters}
    machines, _ = system.build_many(system.with_cycle(none, T))
    start = within_periods(machines, found["state"][None], np.array([0.37 * T]))[0, 0]  # away from the event
    run = simulate(there, start.tolist(), span=T, digits=30)
    assert [float(z) for z in run.sections[-1]] == pytest.approx(start.tolist(), abs=1e-9), seed
    return True


def test_the_oracle_goes_round_the_cycles_of_random_pairs_of_masses() -> None:
    assert sum(cycles_close(seed) for seed in range(8)) >= 4


@pytest.mark.slow
def test_the_oracle_goes_round_the_cycles_of_many_random_pairs_of_masses() -> None:
    assert sum(cycles_close(seed) for seed in range(100, 300)) >= 100


# At the ends of rests


@pytest.mark.parametrize("load", [0.1, 0.4, 0.8])
def test_the_share_of_rest_leaves_out_the_hops_before_it_wherever_a_turn_begins(load: float) -> None:
    """Loads scale this cycle and change no time: the share is one number, that of rests event by event."""
    system = System.from_mapping({
        "name": "rests", "coordinates": ["x1", "x2"], "mass": [[1.0, 0.0], [0.0, 1.0]],
        "damping": [[0.3, 0.0], [0.0, -0.2]], "stiffness": [[3.0, -2.0], [-2.0, 3.0]], "load": [load, 0.0],
        "contacts": [{"name": "stop", "gap": [1.0, 0.0], "upper": 0.05, "restitution": 0.5},
                     {"name": "far", "gap": [0.0, 1.0], "upper": 1.0, "lower": -1.0, "stiffness": 30.0}],
        "parameters": {"x2": 0.3},
    })  # fmt: skip
    found = solve_tile(system, {}, Settings(max_periods=2000))
    assert found["regime"] == PERIODIC
    assert found["stuck_fraction"] == pytest.approx(0.18701167369097602, abs=1e-11)
    assert found["stop_fraction"] == pytest.approx(0.18701167369097602, abs=1e-11)


@pytest.mark.parametrize("x", [0.4, 2.0])
def test_a_block_whose_friction_does_not_fall_swings_for_ever_below_the_speed_of_its_belt(x: float) -> None:
    """x'' + x = .3 while it slides: from outside it comes to the circle that touches the belt's speed, no nearer."""
    system = System.from_mapping({
        "name": "even", "coordinates": ["x"], "mass": [[1.0]], "stiffness": [[1.0]], "parameters": {"x": 0.4},
        "friction": [{"name": "belt", "row": [1.0], "kinetic": 0.3, "static": 0.3, "belt": 0.5}],
    })  # fmt: skip
    found = solve_tile(system, {"x": x}, Settings(max_periods=2000))
    assert (found["regime"], found["reason"]) == (UNDETERMINED, CENTRE)
    assert np.hypot(found["state"][0] - 0.3, found["state"][1]) == pytest.approx(min(x - 0.3, 0.5), abs=1e-8)
