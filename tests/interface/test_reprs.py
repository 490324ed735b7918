"""What an interpreter and a notebook show of a result: it fits on a screen."""

import re
from dataclasses import replace
from html import unescape
from types import SimpleNamespace
from typing import Any

import pytest
import xarray as xr

import atlas
from atlas.accessor import PlottableBranches
from atlas.store import create, store
from tests.synthetic import fill, spec_of
from workers.model.system import find_system

SCREEN = 50
"""Lines."""


@pytest.fixture(scope="module")
def handle(tmp_path_factory: pytest.TempPathFactory) -> store.AtlasStore:
    made = create.create_store(tmp_path_factory.mktemp("repr") / "a.zarr", spec_of(), (19, 45))
    fill(made)
    return made


@pytest.mark.parametrize("opened", [atlas.open, xr.open_zarr])
def test_a_notebook_shows_an_atlas_with_its_long_attributes_folded(handle: store.AtlasStore, opened: Any) -> None:
    """The spec names every value of every axis: thousands of characters."""
    shown = opened(handle.path)._repr_html_()
    folds = re.findall(r"<input[^>]*type='checkbox'([^>]*)/?>\s*<label[^>]*>\s*(\w+)", shown)
    assert "checked" not in dict((name, state) for state, name in folds)["Attributes"]


def test_an_interpreter_shows_an_atlas_on_one_screen(handle: store.AtlasStore) -> None:
    assert len(repr(atlas.open(handle.path)).splitlines()) <= SCREEN


def test_branches_show_what_they_are_of_in_one_line() -> None:
    ways = [SimpleNamespace(points=[None] * 55, events=[None]), SimpleNamespace(points=[None] * 20, events=[])]
    traced: Any = tuple(SimpleNamespace(run=way) for way in ways)
    found = PlottableBranches(find_system("two-mass"), {"b": 0.15}, "omega", (2.0, 4.0), traced)
    reach = "two-mass along omega from 2 to 4"
    assert repr(found) == f"<PlottableBranches of {reach}: 2 branches, 75 points, 1 event>"


LONGEST = 400
"""Characters."""


def test_a_spec_shows_its_axes_and_what_differs_from_the_defaults() -> None:
    spec = atlas.Spec("two-mass", {"omega": {"start": 2, "stop": 4, "num": 500}}, {"b": 0.2, "R": 0.8})
    assert repr(spec) == "<Spec of two-mass: omega 2..4 (500 values); b = 0.2>"


def test_a_status_and_the_accessor_show_what_they_are_of(handle: store.AtlasStore) -> None:
    found = atlas.status(handle.path)
    assert repr(found) == str(found) and len(repr(found)) <= LONGEST
    shown = repr(atlas.open(handle.path).atlas)
    assert re.fullmatch(r"<atlas of two-mass: \d+ omega x \d+ b cells; .*>", shown), shown


def test_options_show_what_differs_from_their_defaults() -> None:
    assert repr(atlas.RunOptions()) == "RunOptions()"
    assert repr(atlas.RunOptions(workers=2)) == "RunOptions(workers=2)"


def rows_of(html: str) -> list[str]:
    """The rows of a table as a browser shows them: the texts of their cells."""
    rows = re.findall("<tr>(.*?)</tr>", html)
    return [" ".join(unescape(cell) for cell in re.findall("<td[^>]*>(.*?)</td>", row)) for row in rows]


def words(lines: list[str]) -> list[list[str]]:
    return [line.split() for line in lines]


def test_a_plan_a_status_and_a_report_are_tables_in_a_notebook_with_the_facts_of_their_text(
    handle: store.AtlasStore,
) -> None:
    """Truth: the text, whose facts they must have, each once and in order."""
    spec = atlas.Spec("two-mass", {"x1": [0.0, 0.1], "v1": [0.0, 0.1]})
    found = [atlas.plan(spec, probe=False), atlas.status(handle.path), atlas.verify(handle.path, sample=0)]
    for summary in found:
        assert words(rows_of(summary._repr_html_())) == words(str(summary).splitlines())


def test_text_in_a_table_is_escaped(handle: store.AtlasStore) -> None:
    """Notes come from outside: whoever can write next to a store must not run a script in a notebook."""
    status = replace(atlas.status(handle.path), trouble="<script>alert(1)</script>")
    html = status._repr_html_()
    assert "<script>" not in html and "&lt;script&gt;" in html
