"""The tables of measurements: pages show the kept data, and scripts still measure what was kept."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.paths import ROOT
from tests.script import script

PAGE = """before

[Table](measured/cell.csv)

*`{}`, solver version 9*

after"""
COMMAND = "python -m scripts.bench_cell"


@pytest.fixture
def docs(tmp_path: Path) -> Path:
    """A page with its table."""
    (tmp_path / "measured").mkdir()
    (tmp_path / "measured/cell.csv").write_text("a,b\n1,2\n")
    table = {"command": COMMAND, "solver_version": 9, "head": ["a", "b"], "rows": [["1", "2"]]}
    (tmp_path / "measured/cell.json").write_text(json.dumps(table))
    (tmp_path / "page.md").write_text(PAGE.format(COMMAND))
    return tmp_path


def test_pages_show_each_table_once_as_the_script_that_it_names_has_measured_it() -> None:
    assert script("measured", "--check") == ""


def edit(docs: Path) -> None:
    (docs / "page.md").write_text(PAGE.format(COMMAND).replace("version 9", "version 8"))


def edit_the_file(docs: Path) -> None:
    (docs / "measured/cell.csv").write_text("a,b\n7,2\n")


def lose(docs: Path) -> None:
    (docs / "measured/cell.json").unlink()


def show_twice(docs: Path) -> None:
    (docs / "another.md").write_text(PAGE.format(COMMAND))


def name_another_script(docs: Path) -> None:
    path = docs / "measured/cell.json"
    path.write_text(path.read_text().replace("bench_cell", "bench_none"))


def lengthen_a_row(docs: Path) -> None:
    path = docs / "measured/cell.json"
    path.write_text(path.read_text().replace('"2"', '"2", "3"'))


@pytest.mark.parametrize(
    ("fault", "found"),
    [
        (edit, "page.md: tables differ from those measured; run python -m scripts.measured"),
        (edit_the_file, "page.md: tables differ from those measured; run python -m scripts.measured"),
        (lose, "page.md: no table cell"),
        (show_twice, "cell: shown 2 times, must be shown once"),
        (name_another_script, "cell: scripts.bench_none does not write it"),
        (lengthen_a_row, "cell: rows and head differ in length"),
    ],
)
def test_a_fault_of_a_table_is_found(docs: Path, fault: Callable[[Path], None], found: str) -> None:
    fault(docs)
    assert found in script("measured", "--check", "--docs", str(docs), code=1).splitlines()


@pytest.mark.parametrize("fault", [edit, edit_the_file])
def test_a_table_that_was_edited_is_written_anew(docs: Path, fault: Callable[[Path], None]) -> None:
    fault(docs)
    script("measured", "--docs", str(docs))
    assert (docs / "page.md").read_text() == PAGE.format(COMMAND)
    assert (docs / "measured/cell.csv").read_text() == "a,b\n1,2\n"


def test_rough_numbers_are_not_kept() -> None:
    assert "--keep: found --light" in script("stress", "--light", "--keep", code=2)


@pytest.mark.slow
def test_the_rows_of_the_stress_table_are_rows_of_its_report() -> None:
    from scripts.stress.report import table

    options = ("--cells", "60", "--recheck", "2", "--workers", "0", "--systems", "0.5", "--modes", "0", "--json")
    made = {what for what, _ in table(json.loads(script("stress", *options)))}
    assert made >= {row[0] for row in json.loads((ROOT / "docs/measured/stress.json").read_text())["rows"]}
