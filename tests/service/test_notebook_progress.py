"""Claims about progress in a notebook: a bar by default, changed in place, and snapshots that print as one line."""

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from distributed import Client

import atlas
from atlas.check.verify import verify
from atlas.service.notebook import NotebookReporter, progress_reporter
from atlas.service.plan import make_plan
from atlas.service.progress import Progress
from tests.planes import plane_of


class Screen:
    """What a notebook shows: each display, as HTML, in its last state; and how often it was sent something."""

    def __init__(self) -> None:
        self.cells: list[str] = []
        self.messages = 0

    def display(self, shown: Any, display_id: bool) -> Any:
        assert display_id
        place = len(self.cells)
        self.cells.append("")

        def update(new: Any) -> None:
            self.messages += 1
            self.cells[place] = new._repr_html_()

        update(shown)
        return SimpleNamespace(update=update)


@pytest.fixture
def notebook(monkeypatch: pytest.MonkeyPatch) -> Screen:
    """This process as the kernel of a notebook, by IPython's two public functions."""
    screen = Screen()
    shell = SimpleNamespace(kernel=object())
    ipython = SimpleNamespace(get_ipython=lambda: shell)
    monkeypatch.setitem(sys.modules, "IPython", ipython)  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=screen.display))  # type: ignore[arg-type]
    return screen


def test_a_run_in_a_notebook_shows_one_bar_and_leaves_it_full(notebook: Screen, client: Client, tmp_path: Path) -> None:
    spec = plane_of()
    atlas.run(spec, tmp_path / "a.zarr", client)
    (html,) = notebook.cells
    assert '<progress value="35" max="35">' in html
    verify(tmp_path / "a.zarr", sample=1)
    assert len(notebook.cells) == 2


def test_a_function_of_the_users_own_takes_the_place_of_the_bar(
    notebook: Screen, client: Client, tmp_path: Path
) -> None:
    seen: list[Progress] = []
    atlas.run(plane_of(), tmp_path / "a.zarr", client, atlas.RunOptions(on_progress=seen.append))
    assert seen and notebook.cells == []


def test_outside_of_a_notebook_nothing_is_shown() -> None:
    with progress_reporter(None) as report:
        assert report is None


def test_ipython_in_a_terminal_is_no_notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    ipython = SimpleNamespace(get_ipython=lambda: SimpleNamespace())
    monkeypatch.setitem(sys.modules, "IPython", ipython)  # type: ignore[arg-type]
    with progress_reporter(None) as report:
        assert report is None


def test_many_snapshots_of_a_stage_are_few_messages_and_the_last_one_is_shown() -> None:
    screen = Screen()
    with NotebookReporter(screen.display, interval=1e9) as report:
        for done in range(1, 1001):
            report(Progress("solving", tiles=1000, cells=1000, tiles_done=done, cells_done=done))
    assert screen.messages == 2
    assert 'value="1000"' in screen.cells[0]


def test_what_a_stage_says_is_no_html() -> None:
    screen = Screen()
    with NotebookReporter(screen.display) as report:
        report(Progress("<b> & co"))
    assert screen.cells == ["<div><span>&lt;b&gt; &amp; co</span></div>"]


def test_a_snapshot_prints_as_one_short_line() -> None:
    plan = make_plan(plane_of(), 1)
    progress = Progress("solving", plan, 9, 35, 4, 12, 12, 6.0, {"periodic": 9, "chaotic": 3})
    line = "solving: 4/9 tiles, 12/35 cells, 2 cells/s, 12 s left, periodic 75.0 %, chaotic 25.0 %"
    assert (str(progress), repr(progress)) == (line, f"<Progress {line}>")
    assert repr(Progress("starting")) == "<Progress starting>"
