"""The stress run's light mode: what must not happen does not, and its own checks would notice."""

import json
import math

import numpy as np
import pytest

from scripts import compare_sticking, stress
from scripts.stress_cells import Findings, draw, misplaced, solve
from workers import Settings
from workers.results import PERIODIC
from workers.tile import solve_cells

pytestmark = pytest.mark.slow


def test_the_light_mode_finds_nothing_that_must_not_happen(capsys: pytest.CaptureFixture[str]) -> None:
    code = stress.main(["--light", "--json"])
    facts = json.loads(capsys.readouterr().out)
    assert facts["cells"] == sum(facts["regimes"].values()) == 200
    assert facts["never"] == dict.fromkeys(stress.NEVER, 0)
    assert facts["sum_law_broken"] == 0
    assert facts["failed"] == {}
    assert code == 0
    assert facts["with_impacts"] > 50
    assert facts["sticking"] > 20
    assert facts["checked"]["flights sampled densely"] > 10


def test_the_report_says_what_was_counted() -> None:
    facts = stress.run(cells=30, seed=3, rechecked=0, max_periods=100, workers=0)
    text = stress.report(facts)
    assert "Stress report: 30 random cells, seed 3" in text
    for kind in stress.NEVER:
        assert f"0  {kind}" in text


def test_a_cell_is_drawn_from_its_seed_and_number_alone() -> None:
    assert draw(5, 17) == draw(5, 17) != draw(5, 18)


def test_the_draw_covers_the_whole_space() -> None:
    cells = [draw(2, k) for k in range(2000)]
    omega = np.array([p["omega"] for p in cells])
    assert omega.min() < 2e-3
    assert omega.max() > 5e2
    for name, value in (("R", 0.0), ("R", 1.0), ("zeta", 0.0), ("f2", 1.0)):
        assert sum(p[name] == value for p in cells) > 100, name
    on_stop = [p for p in cells if abs(p["x1"]) == p["b"]]
    for sign in (-1.0, 0.0, 1.0):
        assert sum(np.sign(p["v1"]) * np.sign(p["x1"]) == sign for p in on_stop) > 50
    assert sum(abs(p["x1"]) > p["b"] for p in cells) > 20


def test_tasks_do_not_change_what_is_found() -> None:
    settings = Settings(exponents="spectrum", max_periods=60, section_samples=4)
    whole = solve(4, 0, 20, settings)
    parts = Findings()
    for first in (10, 0):
        parts.add(solve(4, first, 10, settings))
    assert (parts.regimes, parts.checked, parts.counts) == (whole.regimes, whole.checked, whole.counts)
    assert parts.worst["periods"][0] == whole.worst["periods"][0]


@pytest.mark.parametrize(("name", "value"), [("largest", math.nan), ("error", math.inf), ("sum_law_defect", math.nan)])
def test_a_number_that_is_missing_from_a_periodic_cell_is_noticed(name: str, value: float) -> None:
    settings = Settings(exponents="spectrum", section_samples=4)
    params = {"omega": 4.0, "b": 0.1, "R": 0.8, "zeta": 0.05, "mu_m": 2.0, "mu_k": 5.0, "f2": 0.0}
    result = {key: array[()] for key, array in solve_cells("two-mass", params, settings).arrays.items()}
    assert result["regime"] == PERIODIC
    assert misplaced(params, result) == []
    assert name in misplaced(params, {**result, name: value})


def test_a_general_event_integrator_is_lost_in_sticking_cells() -> None:
    facts = compare_sticking.run(cells=3, seed=1)
    for counts in facts.values():
        assert counts["cells"] == 3
        assert counts["right"] < 3
    assert compare_sticking.table(facts).startswith("| solve_ivp")
