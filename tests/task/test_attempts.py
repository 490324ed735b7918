"""Two attempts at one tile that live at the same time: their worker was given up, and was only cut off or asleep.

Truth: the bytes of the store before and after.
"""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from atlas import Spec
from atlas.errors import RunError
from atlas.store.create import create_store
from atlas.store.object_backend import LocalBackend
from atlas.store.store import AtlasStore, chunk_key, done_tiles, open_store
from atlas.store.tiles import read_tile, write_tile
from atlas.task.store_ref import StoreRef
from atlas.task.tile_job import RunJob, run_tile_job
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
