"""What the page says and shows of a cell that was clicked: its numbers, its motion, its basins."""

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import atlas
from atlas.cell.trajectory import cell_orbit
from atlas.errors import InputError
from atlas.explore import motion
from atlas.explore.basins import BAND, SIDE, BasinGrid, label_computation
from atlas.explore.basins_panel import BasinsPanel, label_colors
from atlas.explore.cell_lookup import CellResult
from atlas.explore.motion import motion_of, motions
from atlas.explore.static.about import meanings
from atlas.explore.subject import Subject, subject_of
from atlas.explore.text import cell_given, cell_line, cell_text
from atlas.render.class_maps import BASINS
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
        const arrays = Object.fromEntries(Object.entries(values).map(([name, value]) => [name, [value ?? NaN]]))
        return resultsOf({ ...told, variables, arrays: {} }, Object.keys(variables), 0, arrays)
    """
    told = json.loads(json.dumps(meanings()))  # with codes as texts, as the page has them
    return {label: text for label, text, _ in run(browser, script, {"told": told, **given})}


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
    line = cell_line(CellResult(parameters, {"regime": "periodic"}, of_atlas=False), subject)
    assert "R</i>" not in line and "b</i> = 0.1</span> &ensp; periodic" in line
    moved = cell_line(CellResult(parameters | {"R": 0.75}, {"regime": "periodic"}, of_atlas=False), subject)
    assert "<i>R</i> = 0.75</span> &ensp; periodic" in moved


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


def test_the_basins_of_a_cell_are_those_that_an_atlas_of_them_has(subject: Subject) -> None:
    grid = BasinGrid(subject.system, {"omega": 4.0, "b": 0.1}, subject.settings, subject.starts,
                ("x1", np.linspace(-0.09, 0.09, 5)), ("v1", np.linspace(-0.4, 0.4, 4)))  # fmt: skip
    question = label_computation(grid, slice(1, 3))
    rows, found = question.postprocess(question.function(question.argument))
    assert (rows, question.n_cells) == (slice(1, 3), 10)
    states = [{"x1": x, "v1": v} for v in grid.y[1][1:3] for x in grid.x[1]]
    periods = [atlas.point({**grid.parameters, **state}, settings=subject.settings)["period"] for state in states]
    labels = found.ravel().tolist()
    assert min(labels) >= 0 and len(set(periods)) == 2
    of_label = {label: {p for p, k in zip(periods, labels, strict=True) if k == label} for label in labels}
    assert all(len(found) == 1 for found in of_label.values())


def test_the_rows_of_basins_cover_the_plane(subject: Subject) -> None:
    assert SIDE % BAND == 0
    made = BasinGrid.from_cell(subject, cell_at(subject, 4.0, 0.1).parameters)
    assert made.x[0] == "x1" and made.x[1].size == made.y[1].size == SIDE
    assert -0.1 < made.x[1][0] < made.x[1][-1] < 0.1


def test_the_picture_of_basins_has_each_initial_state_at_the_centre_of_its_pixel(subject: Subject) -> None:
    grid = BasinGrid.from_cell(subject, cell_at(subject, 4.0, 0.1).parameters)
    (x0,), (y0,), (w,), (h,) = (grid.box[name] for name in ("x0", "y0", "w", "h"))
    centres = (np.arange(SIDE) + 0.5) / SIDE
    assert np.allclose(x0 + w * centres, grid.x[1], rtol=0.0, atol=1e-12)
    assert np.allclose(y0 + h * centres, grid.y[1], rtol=0.0, atol=1e-12)


def test_the_plane_of_initial_states_is_laid_out_away_from_the_thread_of_the_document(
    subject: Subject, monkeypatch: pytest.MonkeyPatch
) -> None:
    works, made, of_cell = list[Any](), list[BasinGrid](), BasinGrid.from_cell
    background = SimpleNamespace(deferred_call=lambda act: act, run=lambda work, refuse: works.append(work))
    wanted = SimpleNamespace(
        request=lambda who, jobs, keep_earlier=False: made.extend(job.question.argument[0] for job in jobs)
    )
    panel = BasinsPanel(SimpleNamespace(subject=subject, patches=wanted), background)  # type: ignore[arg-type]
    panel.set_topic(cell_at(subject, 4.0, 0.1))
    monkeypatch.setattr(BasinGrid, "from_cell", pytest.fail)
    panel._ask()
    assert not made
    monkeypatch.setattr(BasinGrid, "from_cell", of_cell)
    (work,) = works
    work()()
    assert len(made) == SIDE // BAND


def test_an_unknown_label_is_grey_and_each_other_has_its_colour() -> None:
    pixels = label_colors(np.array([[0, 1, -1, len(BASINS)]], dtype=np.int32)).view(np.uint8).reshape(4, 4)
    assert pixels[0].tolist() == [0x44, 0x77, 0xAA, 255] == pixels[3].tolist()
    assert pixels[2].tolist() == [221, 221, 221, 255]
