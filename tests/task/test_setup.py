"""What jobs read of their store: its header once in each process, and again where the store has changed."""

import shutil
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from distributed import Client

import atlas
from atlas.store import handle_cache
from atlas.store.create import create_store
from atlas.store.store import done_tiles, open_store
from atlas.task.store_ref import StoreRef, WorkerRefusedError
from atlas.task.tile_job import RunJob, run_tile_job
from tests.planes import plane_of
from workers import tile as solving


def test_a_run_reads_its_header_once_in_each_process(
    tmp_path: Path, two_workers: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, whole = [], handle_cache.open_store
    first = threading.Lock()

    def reading(place: Any) -> Any:
        with first:
            read.append(place)
        return whole(place)

    monkeypatch.setattr(handle_cache, "open_store", reading)
    summary = atlas.run(plane_of((1, 1)), tmp_path / "out.zarr", client=two_workers)
    assert summary.tiles_done == 35
    assert 1 <= len(read) <= 2  # the two workers of this process may begin at once


def made(store: Path) -> RunJob:
    handle = create_store(store, plane_of(), (2, 3))
    return RunJob((1, 1), StoreRef(str(handle.path), handle.run_id, handle.solver_version))


def test_a_store_that_is_replaced_under_way_is_noticed_by_the_next_job(tmp_path: Path) -> None:
    job = made(tmp_path / "out.zarr")
    run_tile_job(job)
    shutil.rmtree(job.store_ref.store)
    another = made(tmp_path / "out.zarr")
    with pytest.raises(
        WorkerRefusedError, match=r"not the store of run .*; check that the path is the same on every host"
    ):
        run_tile_job(replace(job, index=(0, 0)))
    assert run_tile_job(replace(another, index=(0, 0))).cells == 6


def test_a_store_that_is_removed_under_way_is_noticed_by_the_next_job(tmp_path: Path) -> None:
    job = made(tmp_path / "out.zarr")
    run_tile_job(job)
    shutil.rmtree(job.store_ref.store)
    with pytest.raises(WorkerRefusedError, match=r"no such store; check that the path is the same on every host"):
        run_tile_job(replace(job, index=(0, 0)))
    assert not Path(job.store_ref.store).exists()


def test_a_store_that_is_replaced_while_a_tile_is_solved_gets_nothing_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job, whole = made(tmp_path / "out.zarr"), solving.solve_tile
    run_tile_job(job)

    def slow(*given: Any) -> Any:
        shutil.rmtree(job.store_ref.store)
        made(tmp_path / "out.zarr")
        return whole(*given)

    monkeypatch.setattr(solving, "solve_tile", slow)
    with pytest.raises(WorkerRefusedError, match="not the store of run"):
        run_tile_job(replace(job, index=(0, 0)))
    assert done_tiles(open_store(tmp_path / "out.zarr")) == set()
