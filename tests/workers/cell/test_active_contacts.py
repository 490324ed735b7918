"""Claims about dampers that act beyond a position, and stops that feed in energy: closed forms, and the oracle."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import atlas
from atlas.check.rules import broken_rules
from atlas.spec.spec import Spec
from tests.support.oracle.piecewise import HarmonicForce, PiecewiseContact, simulate
from tests.support.oracle.piecewise.one_mass import oscillator
from workers import Settings, System, solve_tile, trace
from workers.model.entries import DefinitionError
from workers.results import (
    AT_EQUILIBRIUM,
    FAILED,
    INVALID,
    NO_IMPACT,
    NO_REASON,
    OUT_OF_RANGE,
    PERIODIC,
    RUNS_AWAY,
    UNDETERMINED,
)

SPECTRUM = Settings(exponents="spectrum")


def machine(contact: dict[str, Any], **given: Any) -> System:
    """One mass on a spring, x'' + c x' + x = A sin(omega t), with a contact."""
    table = {
        "name": "active", "coordinates": ["x"], "mass": [[1.0]], "damping": [["c"]], "stiffness": [[1.0]],
        "contacts": [{"name": "side", "gap": [1.0], **contact}],
    }  # fmt: skip
    return System.from_mapping(table | given)


SIDED = {"upper": 0.0, "damping": "2 * z - c"}
PARAMETERS = {"c": 0.2, "z": 0.3, "v": 1.0}


def per_cycle(z1: float, z2: float) -> tuple[float, float]:
    """Ratio of speeds after a cycle, and its duration, with the damping ratio z1 on one side and z2 on the other."""
    w1, w2 = math.sqrt(1.0 - z1 * z1), math.sqrt(1.0 - z2 * z2)
    return math.exp(-math.pi * (z1 / w1 + z2 / w2)), math.pi / w1 + math.pi / w2


@pytest.mark.parametrize(("z1", "z2"), [(0.1, 0.3), (0.3, -0.05), (-0.1, 0.05)])
def test_damping_that_switches_with_the_side_decays_by_its_closed_form(z1: float, z2: float) -> None:
    ratio, duration = per_cycle(z1, z2)
    still = machine(SIDED, force=["A"], parameters=PARAMETERS | {"A": 0.0})
    history = trace(still, {"omega": 2.0 * math.pi / duration, "c": 2.0 * z1, "z": z2}, periods=4)
    assert history.states[:, 1] == pytest.approx(ratio ** np.arange(5.0), rel=1e-13)
    assert np.max(np.abs(history.states[:, 0])) < 1e-14


def test_an_equilibrium_between_two_dampings_has_the_mean_decay_as_exponents() -> None:
    """Exponents per unit time are ln ratio / duration where they are below 0, else the motion runs away."""
    z1, z2 = np.array([0.1, 0.3, -0.1, -0.1]), np.array([0.3, -0.05, 0.2, 0.05])
    solved = solve_tile(machine(SIDED, parameters=PARAMETERS), {"c": 2.0 * z1, "z": z2}, SPECTRUM)
    assert solved["regime"].tolist() == [NO_IMPACT] * 3 + [FAILED] and solved["reason"][3] == RUNS_AWAY
    for k in range(3):
        ratio, duration = per_cycle(z1[k], z2[k])
        assert solved["spectrum"][k] == pytest.approx([math.log(ratio) / duration] * 2, rel=1e-9)


def test_a_cycle_between_negative_and_positive_damping_is_that_of_the_oracle() -> None:
    """Damping -.3 for |x| < 1 and 1 beyond: a van der Pol oscillator in pieces."""
    piecewise = machine({"upper": 1.0, "lower": -1.0, "damping": "1 - c"}, parameters={"c": -0.3, "v": 1.0})
    solved = solve_tile(piecewise, {}, SPECTRUM)
    assert solved["regime"] == PERIODIC and solved["spectrum"][0] == 0.0 > solved["spectrum"][1]
    beyond = PiecewiseContact([1.0], 1.0, -1.0, stiffness=0.0, damping=1.3)
    after = simulate(oscillator(1.0, damping=-0.3, contact=beyond), solved["state"], span=float(solved["cycle_period"]))
    assert [float(z) for z in after.sections[-1]] == pytest.approx(solved["state"].tolist(), abs=1e-10)


def test_motion_beyond_negative_damping_runs_away_and_inside_it_rests() -> None:
    """Damping .3 for |x| < 1 and -.7 beyond, from speeds of 1 and 5."""
    outside = machine({"upper": 1.0, "lower": -1.0, "damping": -1.0}, parameters={"c": 0.3})
    solved = solve_tile(outside, {"v": np.array([1.0, 5.0])}, SPECTRUM)
    assert solved["regime"].tolist() == [NO_IMPACT, FAILED] and solved["reason"][1] == RUNS_AWAY


WALL = {"upper": 0.0, "restitution": "R"}
FORCED = {"force": ["A"], "parameters": {"c": 0.2, "A": 1.0, "R": 1.2, "b": 0.0}}
each_form = pytest.mark.parametrize(
    "form", [{}, {"phases": [{"start": 0.0}, {"start": 0.5}]}], ids=["one contact", "modes"]
)


@each_form
def test_an_orbit_at_a_wall_that_feeds_in_energy_is_that_of_the_oracle(form: dict[str, Any]) -> None:
    """R = 1.2 and c = .2, omega = .8: an attracting orbit of two impacts. Exponents add up to 2 ln R hits - c T."""
    system = machine(WALL | {"upper": 0.3}, **FORCED, **form)
    solved = solve_tile(system, {"omega": 0.8}, SPECTRUM)
    T = 2.0 * math.pi / 0.8
    assert (solved["regime"], solved["period"], solved["impacts_upper"]) == (PERIODIC, 1, 2)
    assert solved["spectrum"].sum() == pytest.approx(4.0 * math.log(1.2) - 0.2 * T, abs=1e-13)
    wall = PiecewiseContact([1.0], 0.3, restitution=1.2)
    truth = replace(oscillator(0.8, damping=0.2, contact=wall), forces=(HarmonicForce(1, [1.0], [0.0]),))
    after = simulate(truth, solved["state"]).sections[-1]
    assert [float(z) for z in after] == pytest.approx(solved["state"].tolist(), abs=1e-10)
    squares = solved["min_impact_speed"] ** 2 + solved["max_impact_speed"] ** 2
    assert solved["impact_energy"] == pytest.approx(0.5 * (1.0 - 1.2**2) * squares, rel=1e-12)


@each_form
def test_large_motion_runs_away_where_a_wall_outweighs_the_damping(form: dict[str, Any]) -> None:
    """The half cycle between impacts takes e^(-pi z / sqrt(1 - z^2)) of the speed: balance at R = 1.3713."""
    balance = math.exp(math.pi * 0.1 / math.sqrt(0.99))
    system = machine(WALL, **FORCED, **form)
    solved = solve_tile(system, {"omega": 0.8, "R": balance * np.array([0.97, 1.03]), "v": -1e4}, SPECTRUM)
    assert solved["reason"].tolist() == [NO_REASON, RUNS_AWAY]


@each_form
def test_rest_on_a_wall_that_feeds_in_energy_is_no_attractor(form: dict[str, Any]) -> None:
    ball = machine(
        {"lower": 0.0, "restitution": "R"}, stiffness=[[0.0]], load=[-1.0], force=["A"],
        parameters={"c": 0.0, "A": 0.2, "R": 0.5}, **form,
    )  # fmt: skip
    solved = solve_tile(ball, {"R": np.array([0.5, 1.2])}, SPECTRUM)
    assert solved["regime"].tolist() == [PERIODIC, UNDETERMINED] and solved["reason"][1] == AT_EQUILIBRIUM


def test_restitution_is_valid_from_0_to_2() -> None:
    for form in ({}, {"phases": [{"start": 0.0}, {"start": 0.5}]}):
        solved = solve_tile(machine(WALL, **FORCED, **form), {"omega": 0.8, "R": np.array([-0.1, 2.1])})
        assert solved["regime"].tolist() == [INVALID] * 2 and solved["reason"].tolist() == [OUT_OF_RANGE] * 2


def test_only_contacts_that_feed_in_energy_may_have_a_negative_loss() -> None:
    spec = Spec(machine(WALL | {"upper": 0.3}, **FORCED), {"R": [0.8, 1.2]}, {"omega": 0.8})
    slices = (slice(0, 2),)
    arrays = solve_tile(spec.system_def, spec.cell_params(slices), spec.settings)
    assert arrays["impact_energy"][1] < 0.0 < arrays["impact_energy"][0]
    assert broken_rules(spec, slices, arrays) == {}
    wrong = broken_rules(spec, slices, arrays | {"impact_energy": np.array([-1.0, -1.0])})
    assert wrong["impact_energy is negative"].tolist() == [True, False]


def test_negative_damping_of_a_contact_released_by_force_gets_one_line() -> None:
    message = (
        'system.contacts[0].damping: found -0.1 at the defaults, must be 0 or more with release = "force", or '
        'release = "displacement"'
    )
    with pytest.raises(DefinitionError) as caught:
        machine({"upper": 0.0, "damping": -0.1, "release": "force"}, parameters={"c": 0.2})
    assert str(caught.value) == message
    shock = machine({"upper": 0.0, "damping": "d", "release": "force"}, parameters={"c": 0.2, "d": 0.1})
    solved = atlas.solve_tile(shock, {"d": -0.1})
    assert (solved["regime"], solved["reason"]) == (INVALID, OUT_OF_RANGE)
