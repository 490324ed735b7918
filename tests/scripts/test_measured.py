"""The tables of measurements: pages show the kept data, and scripts still measure what was kept."""

import shlex
from pathlib import Path

import pytest

from scripts import bench_survival, compare_sticking, measured, stress
from scripts.stress_report import table
from tests.paths import ROOT

TABLES = sorted(path.stem for path in measured.FOLDER.glob("*.json"))

each_table = pytest.mark.parametrize("name", TABLES)


@pytest.mark.parametrize("page", measured.pages(), ids=lambda page: page.name)
def test_a_page_shows_its_tables_as_they_were_measured(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert measured.filled(text) == text


@each_table
def test_a_kept_table_stands_on_one_page(name: str) -> None:
    shown = [page.name for page in measured.pages() if name in measured.names_on(page.read_text(encoding="utf-8"))]
    assert len(shown) == 1


@each_table
def test_a_kept_table_names_the_script_that_writes_it(name: str) -> None:
    command = shlex.split(measured.read_table(name)["command"])
    assert command[:2] == ["python", "-m"]
    script = (ROOT / f"{command[2].replace('.', '/')}.py").read_text(encoding="utf-8")
    assert f'"{name}"' in script
    assert "parsed(" in script


@each_table
def test_a_kept_table_is_rectangular(name: str) -> None:
    kept = measured.read_table(name)
    assert {len(row) for row in kept["rows"]} == {len(kept["head"])}


def test_a_place_without_a_table_is_an_error() -> None:
    with pytest.raises(FileNotFoundError):
        measured.filled("<!-- measured: no-such-table -->\n<!-- end -->")


def test_a_table_that_was_edited_on_its_page_is_set_anew() -> None:
    page = "before\n<!-- measured: sticking -->\n| edited |\n<!-- end -->\nafter"
    text = measured.filled(page)
    assert "edited" not in text
    assert measured.as_text(measured.read_table("sticking")) in text
    assert (text.startswith("before\n"), text.endswith("-->\nafter")) == (True, True)


def test_rough_numbers_are_not_kept(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.argv", ["stress.py", "--light", "--keep"])
    with pytest.raises(SystemExit) as stopped:
        stress.main()
    assert stopped.value.code == 2
    assert "--keep: found --light" in capsys.readouterr().err


def test_the_survival_tables_have_the_columns_that_the_script_measures() -> None:
    assert {tuple(measured.read_table(name)["head"]) for name in ("survival", "survival-modes")} == {
        bench_survival.HEAD
    }


@pytest.mark.slow
def test_the_rows_of_sticking_cells_are_the_ones_that_the_script_measures() -> None:
    head, rows = compare_sticking.table(compare_sticking.run(cells=1, seed=1))
    kept = measured.read_table("sticking")
    assert head[1:] == kept["head"][1:]
    assert [row[0] for row in rows] == [row[0] for row in kept["rows"]]


@pytest.mark.slow
def test_the_rows_of_the_stress_table_are_rows_of_its_report() -> None:
    facts = stress.run(cells=60, seed=1, rechecked=2, max_periods=400, workers=0, systems=0.5, modes=0.0)
    made = [what for what, _ in table(facts)]
    assert set(made) >= {row[0] for row in measured.read_table("stress")["rows"]}
