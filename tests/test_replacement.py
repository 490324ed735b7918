"""A finished tile that is solved again: it stays until its replacement is stored, and a kill loses neither."""

import errno
import itertools
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from distributed import Client

import atlas
from atlas.check.verify import verify
from atlas.store.added import add_allowances
from atlas.store.location import LocalPlace
from atlas.store.schema import BUDGET
from atlas.store.store import Header, done_tiles, read_header
from atlas.store.tiles import drop_tile, listed_tiles, read_tile
from atlas.task.attempt import run_job
from atlas.task.retry import Retry
from atlas.task.task import Job, StoreFullError
from tests.test_retry import FEW, MORE, plane_of_few, same
from workers.results import UNDETERMINED
from workers.tile import solve_tile


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory, client: Client) -> Path:
    path = tmp_path_factory.mktemp("replaced") / "few.zarr"
    atlas.run(plane_of_few(), path, client=client)
    return path


@pytest.fixture
def store(solved: Path, tmp_path: Path) -> Path:
    """A store with undetermined cells of its own for each test."""
    return Path(shutil.copytree(solved, tmp_path / "out.zarr"))


def due(header: Header) -> tuple[int, ...]:
    """A finished tile with undetermined cells."""
    return next(i for i in sorted(done_tiles(header)) if (read_tile(header, i)["regime"] == UNDETERMINED).any())


def retry_by_hand(header: Header, index: tuple[int, ...]) -> Job:
    add_allowances(header, [BUDGET])
    return Job(index, str(header.path), header.run_id, header.solver_version, Retry((UNDETERMINED,), MORE))


def assert_solved_again(header: Header, index: tuple[int, ...], before: dict[str, np.ndarray]) -> None:
    """The undetermined cells of a tile are those of a spec with the larger budget, to the bit; the others as before."""
    chosen, stored = before["regime"] == UNDETERMINED, read_tile(header, index)
    cells, settings = header.spec.cell_params(header.tiling.at(index).slices), plane_of_few(MORE).settings
    for name, values in solve_tile("two-mass", cells, settings).items():
        assert same(stored[name], values)[chosen].all(), name
        assert same(stored[name], before[name])[~chosen].all(), name
    np.testing.assert_array_equal(stored["budget"], np.where(chosen, MORE, FEW))


@pytest.mark.parametrize("dies_at", ["budget", "largest", "regime"])
def test_a_retry_killed_while_it_writes_a_tile_is_finished_by_the_next_run(
    store: Path, client: Client, monkeypatch: pytest.MonkeyPatch, dies_at: str
) -> None:
    header = read_header(store)
    index, everything = due(header), done_tiles(header)
    before, whole_write = read_tile(header, index), zarr.Array.__setitem__
    job = retry_by_hand(header, index)

    def dying(array: zarr.Array[Any], key: Any, value: Any) -> None:
        if array.basename == dies_at:
            raise KeyboardInterrupt
        whole_write(array, key, value)

    with monkeypatch.context() as patch:
        patch.setattr(zarr.Array, "__setitem__", dying)
        with pytest.raises(KeyboardInterrupt):
            run_job(job)
    assert done_tiles(header) == everything - {index}  # and so never a mixture
    summary = atlas.run(plane_of_few(), store, client=client)
    assert (summary.cells_solved, done_tiles(header)) == (0, everything)
    assert_solved_again(header, index, before)
    assert listed_tiles(header)[1] == set()
    assert verify(store, sample=0).fine


def test_a_retry_whose_worker_dies_while_it_writes_is_finished_by_the_next_attempt(
    store: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    header = read_header(store)
    index = due(header)
    before, job = read_tile(header, index), retry_by_hand(header, index)

    def dying(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(zarr.Array, "__setitem__", dying)
        with pytest.raises(KeyboardInterrupt):
            run_job(job)
    run_job(job)
    assert_solved_again(header, index, before)


@pytest.mark.parametrize(
    ("error", "becomes"),
    [
        (KeyboardInterrupt(), KeyboardInterrupt),
        (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), StoreFullError),
    ],
)
def test_a_finished_tile_stays_until_all_of_its_replacement_is_stored(
    store: Path, client: Client, monkeypatch: pytest.MonkeyPatch, error: BaseException, becomes: type[BaseException]
) -> None:
    header = read_header(store)
    index, everything = due(header), done_tiles(header)
    before, job = read_tile(header, index), retry_by_hand(header, index)

    def put(*_: object) -> None:
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(LocalPlace, "put", put)
        with pytest.raises(becomes):
            run_job(job)
    assert done_tiles(header) == everything
    after = read_tile(header, index)
    assert all(same(after[name], values).all() for name, values in before.items())
    assert atlas.run(plane_of_few(), store, client=client).tiles_solved == 0


def test_a_replacement_that_is_damaged_is_left_and_the_tile_solved(
    store: Path, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    header = read_header(store)
    index = due(header)
    before = read_tile(header, index)
    drop_tile(header, index)
    header.place.put(f"regime/replaced/{index[0]}/{index[1]}", b"PK no archive")
    assert atlas.run(plane_of_few(), store, client=client).tiles_solved == 1
    after = read_tile(header, index)
    assert all(same(after[name], values).all() for name, values in before.items())
    assert listed_tiles(header)[1] == set()


class Dying:
    """Counts what is written into a store, by Zarr or as whole objects, and dies before one of these writes."""

    def __init__(self, at: int) -> None:
        self.at, self.count = at, 0

    def patched(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for kind, name in ((zarr.Array, "__setitem__"), (LocalPlace, "put"), (LocalPlace, "remove")):
            monkeypatch.setattr(kind, name, self.dying(getattr(kind, name)))

    def dying(self, whole: Callable[..., None]) -> Callable[..., None]:
        def write(*given: Any) -> None:
            self.count += 1
            if self.count >= self.at:
                raise KeyboardInterrupt
            whole(*given)

        return write


@pytest.mark.slow
def test_a_retry_killed_at_any_of_its_writes_leaves_the_old_tile_or_is_finished(
    solved: Path, tmp_path: Path, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the next attempt, by a plain run, by the same retry in turn, so that each meets a kill at every stage.

    Truth: the tile of before to the bit, and cells solved apart. No kill leaves a mixture.
    """
    store, retry = tmp_path / "out.zarr", atlas.RunOptions(retry=Retry((UNDETERMINED,), MORE))
    for at in itertools.count(1):
        shutil.rmtree(store, ignore_errors=True)
        header = read_header(shutil.copytree(solved, store))
        index, everything = due(header), done_tiles(header)
        before, job, death = read_tile(header, index), retry_by_hand(header, index), Dying(at)
        with monkeypatch.context() as patch:
            death.patched(patch)
            try:
                run_job(job)
            except KeyboardInterrupt:
                pass
            else:
                break
        finished = index in done_tiles(header)
        old = finished and all(same(read_tile(header, index)[name], values).all() for name, values in before.items())
        assert finished or listed_tiles(header)[1] == {index}
        if at % 3 == 0:
            run_job(job)
        else:
            begun = bool(listed_tiles(header)[1])
            atlas.run(plane_of_few(), store, client, retry if at % 3 == 1 else atlas.RunOptions())
            assert done_tiles(header) == everything
            assert listed_tiles(header)[1] == set()
            if at % 3 == 2 and old and not begun:
                continue
        assert_solved_again(header, index, before)
    assert at > len(header.variables)
