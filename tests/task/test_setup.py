"""What workers do once for a run: on those of the beginning and those that join, in a thread, and named where it fails.

Truth: counts of what was read and compiled, by worker.
"""

import shutil
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from distributed import Client, get_worker

import atlas
from atlas.errors import NetworkError
from atlas.service.batches import JobType
from atlas.service.dispatch import WorkerStatus
from atlas.service.timing import Timing
from atlas.store.create import create_store
from atlas.store.store import done_tiles, open_store
from atlas.task import handle_cache
from atlas.task.attempt import run_tile_job
from atlas.task.store_ref import StoreRef, WorkerRefusedError
from atlas.task.tile_job import RunJob
from tests.fake_cluster import Numbered, outcomes
from tests.planes import plane_of
from workers import tile as solving

CALLS: dict[str, Counter[str]] = {}
QUICK = Timing(tick=0.02)


@dataclass(frozen=True)
class Prepared:
    """A setup that counts itself by worker, and then does what a test gave it by name."""

    name: str

    def __call__(self) -> None:
        CALLS.setdefault(self.name, Counter())[threading.current_thread().name] += 1
        DOES.get(self.name, lambda: None)()


DOES: dict[str, Callable[[], None]] = {}


def done(job: Numbered) -> str:
    return str(get_worker().address)


def nothing() -> None:
    """Nothing is kept."""


def run_steps(
    client: Client, name: str, count: int = 20, tick: Callable[[WorkerStatus], None] = lambda _: None
) -> list[Any]:
    labour: JobType[Numbered, str] = JobType(name, done, Prepared(name), nothing)
    return list(outcomes(client, labour, (Numbered((k,)) for k in range(count)), tick, QUICK))


def names_of(client: Client) -> set[str]:
    """The plugins of all workers, and of those to come."""
    on_workers = client.run(lambda dask_worker: list(dask_worker.plugins)).values()
    to_come = client.run_on_scheduler(lambda dask_scheduler: list(dask_scheduler.worker_plugins))
    return {*to_come}.union(*on_workers)


def test_the_setup_is_done_once_on_each_worker_and_taken_away_at_the_end(two_workers: Client, tmp_path: Path) -> None:
    name, there = str(tmp_path), set()
    assert len({*run_steps(two_workers, name, tick=lambda _: there.update(names_of(two_workers)))}) == 2
    assert name in there
    assert CALLS[name].total() == 2
    assert name not in names_of(two_workers)


def test_it_is_taken_away_where_the_run_ends_by_an_error(two_workers: Client, tmp_path: Path) -> None:
    def stop(_: WorkerStatus) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_steps(two_workers, str(tmp_path), tick=stop)
    assert str(tmp_path) not in names_of(two_workers)


def test_a_worker_that_joins_later_does_it_too(two_workers: Client, tmp_path: Path) -> None:
    name = str(tmp_path)

    def join(workers: WorkerStatus) -> None:
        if workers.threads == 2:
            two_workers.cluster.scale(3)
            two_workers.wait_for_workers(3, timeout=30)

    assert len({*run_steps(two_workers, name, 60, join)}) == 3
    assert CALLS[name].total() == 3


def test_workers_answer_while_a_setup_takes_its_time_and_jobs_wait_for_it(two_workers: Client, tmp_path: Path) -> None:
    name, answered, over = str(tmp_path), threading.Event(), []

    def slow() -> None:
        over.append(answered.wait(timeout=30))

    def ask(_: WorkerStatus) -> None:
        assert len(two_workers.run(lambda: 1)) == 2  # by the event loops of both
        assert two_workers.call_stack() is not None
        answered.set()

    DOES[name] = slow
    assert len(run_steps(two_workers, name, tick=ask)) == 20
    assert over == [True, True]


def test_a_worker_whose_setup_fails_is_named_with_its_reason_and_does_no_job(
    two_workers: Client, tmp_path: Path
) -> None:
    name, turns, last = str(tmp_path), iter(range(100)), []

    def refuse() -> None:
        if next(turns) == 0:
            raise WorkerRefusedError("sees no store")

    DOES[name] = refuse
    workers = {*run_steps(two_workers, name, tick=last.append)}
    ((refused, reason),) = last[-1].excluded.items()
    assert (len(workers), reason) == (1, "sees no store")
    assert refused not in workers
    assert CALLS[name].total() == 2


@pytest.mark.parametrize("error", [NetworkError("no answer"), OSError("a disk that is away")])
def test_a_setup_that_fails_for_a_while_is_tried_again_by_the_next_job(
    two_workers: Client, tmp_path: Path, error: Exception
) -> None:
    name, turns, last = f"{tmp_path}", iter(range(100)), []

    def fail() -> None:
        if next(turns) == 0:
            raise error

    DOES[name] = fail
    assert len(run_steps(two_workers, name, tick=last.append)) == 20
    assert last[-1].excluded == {}


# What jobs have of it


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
    assert not [key for key in handle_cache._headers if str(key[0]) == str(tmp_path / "out.zarr")]


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
