"""What the page says and shows of a cell that was clicked: its numbers, its motion."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import atlas
from atlas.cell.trajectory import cell_orbit
from atlas.errors import InputError
from atlas.explore import motion
from atlas.explore.cell_lookup import CellResult
from atlas.explore.motion import motion_of, motions
from atlas.explore.static.about import meanings
from atlas.explore.subject import Subject, subject_of
from atlas.explore.text import cell_given, cell_text, number, plain, where
from tests.explore.modules import run
from workers.results import REASONS

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning:playwright")


@pytest.fixture(scope="module")
def subject() -> Subject:
    return subject_of("omega-b")


def cell_at(subject: Subject, omega: float, b: float) -> CellResult:
    found = atlas.point({"omega": omega, "b": b}, settings=subject.settings)
    values = {k: v for k, v in found.items() if isinstance(v, int | float | str) and k not in ("system", "source")}
    return CellResult(found["parameters"], values | {"omega": omega, "b": b}, of_atlas=False)


def results_shown(browser: Any, given: dict[str, Any]) -> dict[str, str]:
    """The results of a cell on the page: label and words."""
    script = """
        const { resultsOf } = await import("/front/words.mjs"), { told, variables, values } = given
        const arrays = Object.fromEntries(Object.entries(values).map(([name, value]) => [name, [Number(value ?? NaN)]]))
        return resultsOf({ ...told, variables, arrays: {} }, Object.keys(variables), 0, arrays)
    """
    told = json.loads(json.dumps(meanings()))  # with codes as texts, as the page has them
    return {label: text for label, text, _ in run(browser, script, {"told": told, **plain(given)})}


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.123456789, 0.0123, "0.1235 ± 0.012"),
        (0.123456789, 0.00123, "0.1235 ± 0.0012"),
        (0.123456789, 0.0000123, "0.123457 ± 1.2·10⁻⁵"),
        (-0.45274512, 5.3e-15, "−0.452745 ± 5.3·10⁻¹⁵"),
        (12.3456789, 0.5, "12.35 ± 0.5"),
        (0.0, 0.01, "0 ± 0.01"),
    ],
)
def test_a_number_has_four_to_six_digits_and_its_error_two(browser: Any, value: float, error: float, text: str) -> None:
    cell = CellResult(
        {}, {"omega": 2.0, "b": 0.1, "largest": value, "error": error, "regime": "chaotic"}, of_atlas=False
    )
    assert results_shown(browser, cell_given(cell, subject_of("omega-b")))["largest exponent"] == text


NUMBERS = {
    (0.0, 6): "0", (1.0, 6): "1", (-2.5, 6): "−2.5", (0.001, 6): "0.001", (1e-4, 6): "10⁻⁴",
    (-1.25e-7, 6): "−1.25·10⁻⁷",
    (1234567.0, 6): "1234570", (2.99999999, 6): "3", (0.0009999999, 6): "10⁻³", (0.123456, 3): "0.123",
    (float("nan"), 6): "none", (float("-inf"), 6): "−∞", (float("inf"), 6): "∞",
}  # fmt: skip
"""Numbers with their digits, and the text that Python and the page's script write."""


def test_the_script_and_python_write_a_number_in_the_same_way(browser: Any) -> None:
    given = [[str(value).replace("inf", "Infinity"), digits] for value, digits in NUMBERS]
    script = """
        const { number } = await import("/front/words.mjs")
        return given.map(([value, digits]) => number(Number(value), digits))
    """
    assert run(browser, script, given) == [number(*case) for case in NUMBERS] == [*NUMBERS.values()]


def test_the_page_names_variables_in_words_and_gets_all_digits_for_the_pointer(browser: Any, subject: Subject) -> None:
    cell = cell_at(subject, 3.9, 0.1)
    given = cell_given(cell, subject)
    assert "impacts above" in results_shown(browser, given)
    assert given["values"]["max_impact_speed"] == cell.results["max_impact_speed"]


def test_the_page_shows_of_a_cell_the_results_of_its_regime_alone(browser: Any, subject: Subject) -> None:
    numbers = {"omega": 2.0, "b": 0.1, "largest": 0.5, "error": 0.01, "period": 0, "impacts_upper": 0}
    chaotic = results_shown(
        browser, cell_given(CellResult({}, numbers | {"regime": "chaotic"}, of_atlas=False), subject)
    )
    assert chaotic == {"regime": "chaotic", "largest exponent": "0.5 ± 0.01"}
    resting = numbers | {"period": 1, "impacts_upper": -1, "largest": math.nan, "error": math.nan}
    shown = results_shown(
        browser, cell_given(CellResult({}, resting | {"regime": "periodic"}, of_atlas=False), subject)
    )
    assert shown["impacts above"] == "without end: at rest on a stop" and "largest exponent" not in shown


def test_the_page_shows_an_exponent_that_is_infinite(browser: Any, subject: Subject) -> None:
    resting = {"omega": 2.0, "b": 0.1, "regime": "periodic", "largest": -math.inf, "error": 0.0}
    shown = results_shown(browser, cell_given(CellResult({}, resting, of_atlas=False), subject))
    assert shown["largest exponent"] == "−∞"


def test_the_page_says_of_a_contact_of_the_machine_itself_that_it_has_no_end(browser: Any, tmp_path: Path) -> None:
    axes = "".join(f"[axes.{name}]\nstart = 1.0\nstop = 2.0\nnum = 3\n" for name in ("omega", "alpha"))
    (tmp_path / "capsule.toml").write_text(f'system = "capsule"\n{axes}', encoding="utf-8")
    resting = {"omega": 1.0, "alpha": 1.0, "regime": "periodic", "stop_upper": -1}
    capsule = subject_of(str(tmp_path / "capsule.toml"))
    cells = [CellResult({}, resting | {"regime": name}, of_atlas=False) for name in ("periodic", "chaotic")]
    shown = [[*results_shown(browser, cell_given(cell, capsule)).values()] for cell in cells]
    assert [texts.count("without end: at rest on a stop") for texts in shown] == [1, 0]


def test_the_page_gives_the_reason_of_a_cell_without_a_result(browser: Any, subject: Subject) -> None:
    results = {"omega": 2.0, "b": 0.1, "regime": "failed", "reason": REASONS[1].text}
    assert (
        results_shown(browser, cell_given(CellResult({}, results, of_atlas=False), subject))["reason"]
        == REASONS[1].text
    )


def test_a_cell_of_another_plane_says_by_what_that_differs(subject: Subject) -> None:
    parameters = dict(subject.plane.parameters) | {"omega": 2.0, "b": 0.1}
    assert where(subject, parameters) == {"ω": "2", "b": "0.1"}
    assert where(subject, parameters | {"R": 0.75}) == {"ω": "2", "b": "0.1", "R": "0.75"}


def test_the_copied_numbers_are_those_of_the_cell_in_full(subject: Subject) -> None:
    cell = cell_at(subject, 3.9, 0.1)
    copied = json.loads(cell_text(cell))
    assert copied["largest"] == cell.results["largest"] and copied["omega"] == 3.9


def test_the_drawn_path_of_an_orbit_stays_between_the_stops_and_hits_them(subject: Subject) -> None:
    made = motion_of(cell_orbit({"omega": 4.0, "b": 0.1}))
    assert made.stops == [-0.1, 0.1] and made.lane == 0
    assert np.abs(made.y).max() <= 0.1 + 1e-9 and np.abs(made.y).max() > 0.099
    assert np.array_equal(made.moving[0], made.moving[2])


def test_a_long_path_is_thinned_and_says_how_many_points_a_period_has(subject: Subject) -> None:
    made = motion_of(cell_orbit({"omega": 1.55, "b": 0.1}, settings=subject.settings))
    assert made.moving.shape == (4, 40 * made.per_period + 1) and made.per_period == 80


def test_each_attractor_of_a_cell_has_a_portrait_of_its_own(subject: Subject) -> None:
    found = atlas.attractors({"omega": 4.0, "b": 0.1}, starts=8)
    drawn = motions(subject, {"omega": 4.0, "b": 0.1}, [row["state"] for row in found["coexisting"]])
    assert {place: motion.moving.shape[1] // motion.per_period for place, motion in drawn.items()} == {0: 1, 1: 3}


def test_a_motion_that_cannot_be_shown_leaves_the_others_their_places(
    subject: Subject, monkeypatch: pytest.MonkeyPatch
) -> None:
    def orbit(given: dict[str, float], *_: object) -> float:
        if given["x1"] == 0.0:
            raise InputError("no motion")
        return given["x1"]

    monkeypatch.setattr(motion, "cell_orbit", orbit)
    monkeypatch.setattr(motion, "motion_of", lambda x: x)
    assert motions(subject, {"omega": 4.0}, [[0.0] * 4, [0.05] * 4]) == {1: 0.05}
