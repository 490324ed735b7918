"""Claims about friction with a law for each direction: closed forms, the oracle, and equal laws as one law."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from atlas.spec.equation import equation_of
from tests.refusals import refuse
from tests.support.oracle.piecewise import HarmonicForce, PiecewiseFriction, measures, simulate
from tests.support.oracle.piecewise.one_mass import oscillator
from workers import Settings, System, solve_tile, trace
from workers.results import NO_IMPACT, PERIODIC

SPECTRUM = Settings(exponents="spectrum")
DAMPER = {"law": [[0, 0], [1, "2 * z1"]], "law_back": [[0, 0], [1, "2 * z2"]]}
Z1, Z2 = 0.3, 0.1


def definition(friction: dict[str, Any], **given: Any) -> dict[str, Any]:
    """One mass on a spring with friction on the ground."""
    table = {
        "name": "one-way", "coordinates": ["x"], "mass": [[1.0]], "stiffness": [[1.0]],
        "friction": [{"name": "ground", "row": [1.0], **friction}],
    }  # fmt: skip
    return table | given


def machine(friction: dict[str, Any], **given: Any) -> System:
    return System.from_mapping(definition(friction, **given))


def per_cycle() -> tuple[float, float]:
    """Ratio of displacements at rest after a cycle, and its duration."""
    w1, w2 = math.sqrt(1.0 - Z1 * Z1), math.sqrt(1.0 - Z2 * Z2)
    return math.exp(-math.pi * (Z1 / w1 + Z2 / w2)), math.pi / w1 + math.pi / w2


def test_damping_that_switches_with_the_direction_decays_by_its_closed_form() -> None:
    ratio, duration = per_cycle()
    damped = machine(DAMPER, force=["A"], parameters={"A": 0.0, "z1": Z1, "z2": Z2, "x": 1.0})
    history = trace(damped, {"omega": 2.0 * math.pi / duration}, periods=4)
    assert history.states[:, 0] == pytest.approx(ratio ** np.arange(5.0), rel=1e-12)


def test_an_orbit_with_a_level_for_each_direction_is_that_of_the_oracle() -> None:
    """Levels .3 forward and .1 backward, x'' + .1 x' + x + f = 2 sin .9t, which slides always.

    Truth: the oracle, to which they are .2 in both directions and a load of -.1, which takes nothing in a turn.
    """
    system = machine(
        {"law": [[0, 0.3], [1, 0.3]], "law_back": [[0, 0.1], [1, 0.1]]}, damping=[[0.1]], force=[2.0],
    )  # fmt: skip
    solved = solve_tile(system, {"omega": 0.9}, SPECTRUM)
    assert (solved["regime"], solved["ground_stuck"]) == (PERIODIC, 0.0)
    rub = PiecewiseFriction([1.0], 0.2, 0.2)
    truth = replace(oscillator(0.9, load=-0.1, friction=rub), forces=(HarmonicForce(1, [2.0], [0.0]),))
    after = simulate(truth, solved["state"]).sections[-1]
    assert [float(z) for z in after] == pytest.approx(solved["state"].tolist(), abs=1e-9)
    lost = measures(truth, solved["state"], digits=30)["friction_loss"]
    assert solved["ground_loss"] == pytest.approx(lost, rel=1e-9)


def test_friction_holds_up_to_the_level_of_the_direction_in_which_it_would_slide() -> None:
    """A mass at rest under a load p slides forward beyond p = .5 and backward beyond p = -.2."""
    system = machine(
        {"law": [[0, 0.5], [1, 0.6]], "law_back": [[0, 0.2], [1, 0.3]]}, damping=[[0.2]], load=["p"],
        parameters={"p": 0.0},
    )  # fmt: skip
    p = np.array([-0.21, -0.19, 0.49, 0.51])
    solved = solve_tile(system, {"p": p}, SPECTRUM)
    assert solved["regime"].tolist() == [NO_IMPACT] * 4
    assert (solved["state"][:, 0] == 0.0).tolist() == [False, True, True, False]


@pytest.mark.parametrize("law", [[[0, 0.4], [0.5, 0.2], [2, 0.6]], [[0, 0.1], [1, 0.3], [2, 0.2], [3, 0.2]]])
def test_equal_laws_for_both_directions_are_one_law_to_the_bit(law: list[list[float]]) -> None:
    given: dict[str, Any] = {"damping": [[0.1]], "force": ["A"], "parameters": {"A": 1.0}}
    one, both = machine({"law": law}, **given), machine({"law": law, "law_back": law}, **given)
    cells = {"omega": np.array([0.5, 0.9, 1.4]), "A": np.array([0.6, 1.0, 1.5])}
    alone, twice = (solve_tile(system, cells, SPECTRUM) for system in (one, both))
    for name in alone:
        assert alone[name].tobytes() == twice[name].tobytes(), name


def test_the_equation_and_the_table_have_both_laws() -> None:
    system = machine(DAMPER, parameters={"z1": Z1, "z2": Z2})
    assert "1 segment from (0, 0) to (1, 2 * z1) forward, 1 segment from (0, 0) to (1, 2 * z2) backward" in (
        equation_of(system)
    )
    assert System.from_mapping(system.table()) == system


TWO = [[0, 0.2], [1, 0.2]]
WRONG = [
    ({"kinetic": 1.0, "law_back": TWO}, "system.friction[0].law_back: found without a table in law; give law as a"),
    ({"law": "0.2 + v", "within": 0.1, "range": 1, "law_back": TWO}, "law_back: found without a table in law"),
    ({"law": TWO, "law_back": "0.2"}, "system.friction[0].law_back: found '0.2', must be 2 to 65 rows [v, force]"),
    ({"law": TWO, "law_back": [[0, -0.1], [1, 1]]}, "system.friction[0].law_back: found force -0.1 at the defaults"),
    ({"law": TWO, "law_back": [[0, 1], [1, 0.5]]}, "system.friction[0].law_back: falls without end from |v| 0 on"),
    ({"law": TWO, "static": 0.3, "law_back": [[0, 0.4], [1, 1]]}, "static: found 0.3, kinetic 0.4 at the defaults"),
]  # fmt: skip


@pytest.mark.parametrize(("friction", "message"), WRONG, ids=[message for _, message in WRONG])
def test_laws_for_each_direction_that_are_wrong_get_one_line(friction: dict[str, Any], message: str) -> None:
    refuse(definition(friction), message)
