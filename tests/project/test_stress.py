"""The stress run's light mode: what must not happen does not, and its own checks would notice."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from scripts.stress.findings import RandomCell, StressFindings
from scripts.stress.report import NEVER
from scripts.stress.result_checks import cells_of, contradictions, misplaced, solve
from scripts.stress.systems import SIZES, system
from tests.script import script
from tests.support.oracle.model import machine_of
from workers import Settings
from workers.model.system import find_system
from workers.results import PERIODIC
from workers.tile import solve_tile

pytestmark = pytest.mark.slow


def test_the_light_mode_finds_nothing_that_must_not_happen() -> None:
    facts = json.loads(script("stress", "--light", "--json"))
    assert facts["cells"] == sum(facts["regimes"].values()) == 240
    assert facts["kinds"] == {"modes": 40, "systems": 80, "two-mass": 120}
    assert facts["never"] == dict.fromkeys(NEVER, 0)
    assert facts["sum_law_broken"] == 0
    assert facts["failed"] == {}
    assert facts["with_impacts"] > 50
    assert facts["sticking"] > 20
    assert facts["checked"]["flights checked, two-mass"] > 10
    assert facts["checked"]["flights checked, systems"] > 10
    assert facts["checked"]["sum law, periodic, modes"] > 10


def test_the_report_says_what_was_counted() -> None:
    options = ("--recheck", "0", "--max-periods", "100", "--workers", "0", "--systems", "0", "--modes", "0")
    text = script("stress", "--cells", "30", "--seed", "3", *options)
    assert "Stress report: 30 random cells, seed 3" in text
    for kind in NEVER:
        assert f"0  {kind}" in text


def two_mass(seed: int, number: int) -> RandomCell:
    return cells_of(seed, False, [number])[0]


def of_system(seed: int, number: int) -> RandomCell:
    return cells_of(seed, True, [number])[0]


@pytest.mark.parametrize("draw", [two_mass, of_system])
def test_a_cell_is_drawn_from_its_seed_and_number_alone(draw: Callable[[int, int], RandomCell]) -> None:
    once, again, another = draw(5, 17), draw(5, 17), draw(5, 18)
    assert once.facts() == again.facts()
    assert once.params != another.params


def test_the_draw_covers_the_whole_space() -> None:
    cells = [cell.params for cell in cells_of(2, False, range(2000))]
    omega = np.array([p["omega"] for p in cells])
    assert omega.min() < 2e-3
    assert omega.max() > 5e2
    for name, value in (("R", 0.0), ("R", 1.0), ("zeta", 0.0), ("f2", 1.0)):
        assert sum(p[name] == value for p in cells) > 100, name
    on_stop = [p for p in cells if abs(p["x1"]) == p["b"]]
    for sign in (-1.0, 0.0, 1.0):
        assert sum(np.sign(p["v1"]) * np.sign(p["x1"]) == sign for p in on_stop) > 50
    assert sum(abs(p["x1"]) > p["b"] for p in cells) > 20


def test_the_drawn_systems_are_of_every_kind() -> None:
    tables = [system(2, k)[0] for k in range(120)]
    assert {len(table["mass"]) for table in tables} == set(SIZES)
    assert {len(table["harmonics"]) for table in tables} == {1, 2, 3, 4}
    undamped = [not np.any(table["damping"]) for table in tables]
    rigid = [np.linalg.svd(table["stiffness"])[1][-1] < 1e-9 * np.max(np.abs(table["mass"])) for table in tables]
    one_sided = [("upper" in table) != ("lower" in table) for table in tables]
    loaded = [np.any(table["load"]) for table in tables]
    for kind in (undamped, rigid, one_sided, loaded, np.logical_and(rigid, loaded)):
        assert 3 < np.sum(kind) < 110


def test_a_cell_of_a_drawn_system_is_the_machine_that_the_oracle_flies() -> None:
    for cell in cells_of(2, True, range(0, 600, 13)):
        oscillator = find_system(cell.system).build(cell.params)
        machine = machine_of(cell.machine)
        given = [float(value) for value in (machine.omega, machine.tau, machine.upper, machine.lower, machine.R)]
        assert given == [cell.params["omega"], cell.params["tau"], cell.upper, cell.lower, cell.params["R"]]
        assert oscillator.trace == pytest.approx(cell.trace, rel=1e-9, abs=1e-12 * cell.params["omega"])
        assert (oscillator.upper, oscillator.lower, oscillator.R) == (cell.upper, cell.lower, cell.params["R"])


def test_tasks_do_not_change_what_is_found() -> None:
    settings = Settings(exponents="spectrum", max_periods=60, section_samples=4)
    for of_systems in (False, True):
        whole = solve(cells_of(4, of_systems, range(20)), settings)
        parts = StressFindings()
        for first in (10, 0):
            parts.add(solve(cells_of(4, of_systems, range(first, first + 10)), settings))
        assert (parts.regimes, parts.checked, parts.counts) == (whole.regimes, whole.checked, whole.counts)
        assert parts.worst["periods"][0] == whole.worst["periods"][0]


@pytest.fixture(scope="module")
def periodic() -> tuple[RandomCell, dict[str, Any]]:
    """A periodic cell with impacts, and its results."""
    params = {"omega": 4.0, "b": 0.1, "R": 0.8, "zeta": 0.05, "mu_m": 2.0, "mu_k": 5.0, "f2": 0.0}
    settings = Settings(exponents="spectrum", section_samples=4)
    result = {key: array[()] for key, array in solve_tile("two-mass", params, settings).items()}
    return replace(two_mass(1, 0), params=params, upper=0.1, lower=-0.1, trace=0.4), result


@pytest.mark.parametrize(("name", "value"), [("largest", math.nan), ("error", math.inf), ("sum_law_defect", math.nan)])
def test_a_number_that_is_missing_from_a_periodic_cell_is_noticed(
    periodic: tuple[RandomCell, dict[str, Any]], name: str, value: float
) -> None:
    cell, result = periodic
    assert result["regime"] == PERIODIC
    assert misplaced(cell, result) == []
    assert name in misplaced(cell, {**result, name: value})


@pytest.mark.parametrize(("name", "value"), [("largest", 0.1), ("period", 0), ("impacts_per_period", 0.7)])
def test_results_of_a_periodic_cell_that_contradict_each_other_are_noticed(
    periodic: tuple[RandomCell, dict[str, Any]], name: str, value: float
) -> None:
    cell, result = periodic
    assert contradictions(cell, result) == []
    assert contradictions(cell, {**result, name: value}) != []
