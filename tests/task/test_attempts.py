"""Two attempts at one tile that live at the same time: their worker was given up, and was only cut off or asleep.

Truth: the bytes of the store before and after.
"""

import os
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from atlas import Spec
from atlas.errors import RunError
from atlas.store.create import create_store
from atlas.store.object_backend import LocalBackend
from atlas.store.sidecar import sidecar_of
from atlas.store.store import AtlasStore, chunk_key, done_tiles, open_store
from atlas.store.tiles import read_tile, write_tile
from atlas.task import attempt
from atlas.task.attempt import run_tile_job
from atlas.task.store_ref import StoreRef
from atlas.task.tile_job import RunJob
from tests.planes import plane_of
from workers import tile as solving
from workers.results import empty_results


@pytest.fixture
def handle(tmp_path: Path) -> AtlasStore:
    return create_store(tmp_path / "out.zarr", plane_of(), (2, 3))


def job_of(handle: AtlasStore) -> RunJob:
    return RunJob((1, 1), StoreRef(str(handle.backend), handle.run_id, handle.solver_version))


class Sleeper:
    """A first attempt at a tile, in a thread, that falls asleep where ``asleep`` is called."""

    def __init__(self, job: RunJob) -> None:
        self._sleeping, self._awake, self.error = threading.Event(), threading.Event(), ""
        self._thread = threading.Thread(target=self._run, args=[job])

    def start(self) -> None:
        self._thread.start()
        assert self._sleeping.wait(600)  # kernels may have to be compiled

    def asleep(self) -> None:
        if threading.current_thread() is self._thread and not self._sleeping.is_set():
            self._sleeping.set()
            assert self._awake.wait(600)

    def wake(self) -> None:
        self._awake.set()
        self._thread.join()

    def _run(self, job: RunJob) -> None:
        try:
            run_tile_job(job)
        except RunError as error:
            self.error = str(error)


def before_it_writes(sleeper: Sleeper, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = solving.solve_tile

    def slow(*given: Any) -> Any:
        found = whole(*given)
        sleeper.asleep()
        return found

    monkeypatch.setattr(solving, "solve_tile", slow)


def between_two_writes(sleeper: Sleeper, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = LocalBackend.put

    def slow(place: LocalBackend, key: str, data: bytes) -> None:
        whole(place, key, data)
        if key.startswith("largest/c"):
            sleeper.asleep()

    monkeypatch.setattr(LocalBackend, "put", slow)


@pytest.mark.parametrize("when", [before_it_writes, between_two_writes])
def test_an_attempt_that_sleeps_while_another_does_its_tile_changes_no_bit(
    handle: AtlasStore, monkeypatch: pytest.MonkeyPatch, when: Callable[[Sleeper, pytest.MonkeyPatch], None]
) -> None:
    """The second ends before the first wakes."""
    job = job_of(handle)
    sleeper = Sleeper(job)
    when(sleeper, monkeypatch)
    sleeper.start()

    assert run_tile_job(job).cells > 0
    before = handle.backend.get_all(handle.backend.list_keys())
    sleeper.wake()
    assert sleeper.error == ""
    assert handle.backend.get_all(handle.backend.list_keys()) == before
    assert done_tiles(handle) == {(1, 1)}
    read_tile(handle, (1, 1))
    assert not sidecar_of(handle.backend).exists("started-1-1")


@pytest.mark.parametrize("side", [60, 128], ids=["chunks", "shards"])
def test_no_object_of_a_tile_is_removed_before_it_is_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, side: int
) -> None:
    """As a first attempt that was cut off has left them: all but the regime, or all of them."""
    axes = {name: {"start": 0.1, "stop": 0.5, "num": side} for name in ("omega", "b")}
    handle = create_store(tmp_path / "large.zarr", Spec("two-mass", axes), (side, side))
    arrays = empty_results(handle.spec.variables, (side, side), handle.spec.extra_sizes)
    write_tile(handle, (0, 0), arrays)
    handle.backend.remove(chunk_key(handle.regime, (0, 0)))
    removed: list[str] = []
    monkeypatch.setattr(LocalBackend, "remove", lambda _, key: removed.append(key))
    whole = LocalBackend.put

    def put(place: LocalBackend, key: str, data: bytes) -> None:
        assert place.exists(key) or key == chunk_key(handle.regime, (0, 0))
        whole(place, key, data)

    monkeypatch.setattr(LocalBackend, "put", put)
    write_tile(handle, (0, 0), arrays)
    assert not {*removed} - {chunk_key(variable, (0, 0)) for variable in handle.variables if variable.sparse}
    assert (0, 0) in done_tiles(open_store(handle.path))


def unfinished(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """From now on attempts at tiles do not live to remove their notes; the runs of those that solved one."""
    solved: list[str] = []
    monkeypatch.setattr(attempt, "solve_and_write", lambda job, _: solved.append(job.store_ref.lease))
    monkeypatch.setattr(LocalBackend, "remove", lambda *_: None)
    return solved


def test_a_tile_whose_process_died_twice_is_not_tried_again_and_the_last_is_named(
    handle: AtlasStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    job, solved = job_of(handle), unfinished(monkeypatch)
    for _ in range(2):
        run_tile_job(job)
    for _ in range(2):
        with pytest.raises(RunError, match=rf"has died 2 times, the last one was .*, process {os.getpid()}$"):
            run_tile_job(job)
    assert len(solved) == 2


def test_attempts_of_another_run_do_not_count(handle: AtlasStore, monkeypatch: pytest.MonkeyPatch) -> None:
    """Truth: a run that somebody ends in the middle of a tile is no sign that the tile is at fault."""
    solved = unfinished(monkeypatch)
    monkeypatch.setattr(RunJob, "handle", lambda job: handle)
    for claim in ("first", "second", "third", "third"):
        job = job_of(handle)
        run_tile_job(replace(job, store_ref=replace(job.store_ref, lease=claim)))
    assert solved == ["first", "second", "third", "third"]


@pytest.mark.parametrize("note", [b"", b"{", b"[]", b'{"run": "", "number": "many", "process": "x"}'])
def test_a_note_that_makes_no_sense_counts_as_none(
    handle: AtlasStore, note: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    solved = unfinished(monkeypatch)
    sidecar_of(handle.backend).put("started-1-1", note)
    for _ in range(2):
        run_tile_job(job_of(handle))
    assert len(solved) == 2
