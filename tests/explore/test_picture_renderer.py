"""When the explorer looks a view up and draws it, without a browser."""

import itertools
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import psutil
import pytest
from distributed import Client

from atlas.explore import picture_renderer as painting
from atlas.explore.cell_lookup import CellLookup
from atlas.explore.explorer import Explorer
from atlas.explore.picture_renderer import PictureRenderer, RenderedPicture
from atlas.explore.subject import subject_of
from atlas.explore.tile_cache import TileCache
from atlas.explore.view_state import ViewState, initial_view
from atlas.explore.viewport import STAGES
from atlas.platform import release_memory
from atlas.query.read_counter import count_chunk_reads
from atlas.store.store import open_store
from atlas.store.tiles import drop_tile, read_tile, write_tile
from tests.explore.messages import opened
from tests.explore.test_solving import exploring, waited
from workers.results import PENDING

SIZE = (48, 40)


@pytest.fixture
def explorer(finished: Path, client: Client) -> Iterator[Explorer]:
    with exploring(finished, client) as made:
        yield made


@pytest.fixture
def came() -> list[RenderedPicture]:
    return []


@pytest.fixture
def painter(explorer: Explorer, came: list[RenderedPicture]) -> Iterator[PictureRenderer]:
    made = PictureRenderer(explorer, came.append, pytest.fail)
    yield made
    made.close()
    made.wait()


@pytest.fixture
def view(explorer: Explorer) -> ViewState:
    return replace(initial_view(explorer.subject), x=(2.5, 3.5), y=(0.15, 0.25))


def test_a_view_that_changes_while_it_does_not_rest_is_looked_up_once(
    painter: PictureRenderer, came: list[RenderedPicture], view: ViewState
) -> None:
    for k in range(6):
        painter.show(replace(view, x=(2.5 + 0.01 * k, 3.5)), SIZE)
    assert painter.is_busy and waited(lambda: not painter.is_busy)
    assert painter.n_lookups == 1
    assert came[-1].shares == (1.0, 1.0, 1.0, 1.0)
    steps = [picture.shares for picture in came]
    assert all(old <= new for one, other in pairwise(steps) for old, new in zip(one, other, strict=True))
    assert opened(came[-1].message)[0]["axes"][0]["edges"][0] == pytest.approx(2.55, abs=0.05)


def test_while_a_slider_moves_the_first_stage_alone_is_solved(
    explorer: Explorer, painter: PictureRenderer, view: ViewState, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(painting, "FULL_SOLVE_SECONDS", 3.0)
    plane = explorer.subject.plane.with_value("R", 0.71)
    painter.show(replace(view, plane=plane), SIZE, rests=False)

    def stages() -> set[int]:
        sight = painter.sight
        return (
            set() if sight is None else {sight.x.level - key.level_x for key, _ in explorer.tiles.tiles_of_plane(plane)}
        )

    assert waited(lambda: stages() == {STAGES}, 3.0)
    assert waited(lambda: stages() == set(range(STAGES + 1)) and not painter.is_busy)
    assert painter.n_lookups == 2


def test_pictures_follow_each_other_no_faster_than_they_may(
    painter: PictureRenderer, came: list[RenderedPicture], view: ViewState, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(painting, "MIN_FRAME_SECONDS", 1000.0)
    painter.show(view, SIZE)
    assert waited(lambda: bool(came))
    explorer = painter._explorer
    assert waited(lambda: explorer.patches.n_remaining(painter) == 0)
    assert len(came) == 1 and painter.is_busy  # the picture of what was solved meanwhile is still to come
    painter.show(replace(view, kind="period"), SIZE)
    assert waited(lambda: len(came) == 2, 5.0)


def test_a_painter_that_is_closed_ends_at_once(explorer: Explorer) -> None:
    made = PictureRenderer(explorer, pytest.fail, pytest.fail)
    thread = threading.Thread(target=made.wait)
    made.close()
    thread.start()
    thread.join(5.0)
    assert not thread.is_alive() and made not in explorer.listeners


def test_a_picture_has_the_cells_of_its_window(
    painter: PictureRenderer, came: list[RenderedPicture], view: ViewState
) -> None:
    painter.show(view, SIZE)
    assert waited(lambda: bool(came))
    for axis, window, size in zip(opened(came[0].message)[0]["axes"], (view.x, view.y), SIZE, strict=True):
        low, high = axis["edges"]
        cell = (high - low) / axis["count"]
        assert low <= window[0] < low + cell and high - cell < window[1] <= high
        assert 0.4 * size < axis["count"] <= 1.2 * size + 2


def test_a_view_that_is_drawn_again_reads_the_atlas_once_and_while_a_run_fills_it_anew(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    handle, index = open_store(finished), (0, 0)
    arrays = read_tile(handle, index)
    drop_tile(handle, index)
    monkeypatch.setattr("atlas.explore.tile_cache.RELIST_SECONDS", 0.0)
    subject = subject_of(str(finished))
    known = CellLookup(TileCache(subject))
    sight = subject.viewport((2.0, 4.0), (0.1, 0.5), (7, 5))

    def pending() -> int:
        return int(np.sum(known.visible_cells(subject.plane, sight, ["largest"]).ds.regime.values == PENDING))

    assert pending() == arrays["regime"].size
    write_tile(handle, index, arrays)
    assert pending() == 0
    with count_chunk_reads() as reads:
        for _ in range(5):
            assert pending() == 0
    assert reads.chunks == 0
    with count_chunk_reads() as reads:
        known.visible_cells(subject.plane, sight, ["period"])
    assert reads.chunks > 0


def test_memory_that_drawing_freed_is_given_back_once_nothing_is_to_be_drawn(
    painter: PictureRenderer, came: list[RenderedPicture], view: ViewState, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[int] = []
    monkeypatch.setattr(painting, "RELEASE_MEMORY_SECONDS", 0.05)
    monkeypatch.setattr(painting, "release_memory", lambda: given.append(len(came)))
    painter.show(view, SIZE)
    assert waited(lambda: not painter.is_busy and bool(given) and given[-1] == len(came))
    count = len(given)
    assert not waited(lambda: len(given) > count, 0.5)  # once


def test_memory_goes_back_though_there_is_always_more_to_be_drawn(
    painter: PictureRenderer, view: ViewState, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A visitor who never rests: each view is replaced before it is looked up."""
    given: list[bool] = []
    painter.show(view, SIZE)
    assert waited(lambda: not painter.is_busy)
    monkeypatch.setattr(painting, "RELEASE_MEMORY_SECONDS", 0.05)
    monkeypatch.setattr(painting, "release_memory", lambda: given.append(painter.is_busy))
    moves = itertools.count(1)

    def moved() -> bool:
        shift = 1e-4 * next(moves)
        painter.show(replace(view, x=(2.5 + shift, 3.5 + shift)), SIZE)
        return bool(given)

    assert waited(moved, 5.0)
    assert given[0]


@pytest.mark.skipif(sys.platform != "linux", reason="glibc")
def test_what_threads_have_freed_goes_back_to_the_system() -> None:
    """Small blocks that stay between large ones keep the C library from giving these back by itself."""
    stay: list[bytes] = []

    def use() -> None:
        large = []
        for _ in range(2000):
            large.append(bytearray(100_000))
            stay.append(bytes(2000))

    thread = threading.Thread(target=use)
    thread.start()
    thread.join()
    process = psutil.Process()
    before = process.memory_info().rss
    release_memory()
    assert process.memory_info().rss < before - 50_000_000
