"""Jobs of a large cluster by counts, on a pretended clock: requests a job, busy workers, one that fails at once."""

import asyncio
import random
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import pytest
from distributed import Client

from atlas.service import batches, dispatch, worker_setup
from atlas.service.batches import JobType
from atlas.service.dispatch import WorkerStatus
from atlas.service.summary import TileFailure
from atlas.service.timing import Timing
from atlas.service.worker_health import MAX_FAILURES
from tests.fake_cluster import Cluster, Numbered, outcomes

WORKERS = [f"tcp://10.0.{k // 250}.{k % 250}:1" for k in range(1000)]
BAD = WORKERS[0]


def same(job: Numbered) -> Numbered:
    return job


def nothing() -> None:
    """Neither prepares nor forgets."""


LABOUR: JobType[Numbered, Numbered] = JobType("out.zarr", same, nothing, nothing)


def all_outcomes(cluster: Cluster, jobs: int, monkeypatch: pytest.MonkeyPatch) -> tuple[list[Any], WorkerStatus]:
    """The outcomes of so many jobs on a pretended cluster, and what the last look showed of the workers."""
    seen: list[WorkerStatus] = []
    monkeypatch.setattr(dispatch, "time", cluster)
    monkeypatch.setattr(batches, "time", cluster)
    found = list(outcomes(cluster, LABOUR, (Numbered((k,)) for k in range(jobs)), seen.append))  # type: ignore[arg-type]
    return found, seen[-1]


def three_seconds(worker: str, job: Numbered) -> float:
    return random.Random(job.index[0]).lognormvariate(1.0, 0.4)


def test_a_thousand_workers_are_kept_busy_with_few_requests_a_job(monkeypatch: pytest.MonkeyPatch) -> None:
    cluster = Cluster(WORKERS, three_seconds)
    found, _ = all_outcomes(cluster, 8000, monkeypatch)
    assert {outcome.index for outcome in found} == {(k,) for k in range(8000)}
    assert sum(cluster.requests.values()) < 0.15 * 8000
    longest = max(three_seconds("", Numbered((k,))) for k in range(8000))
    assert cluster.busy > 0.95 * 1000 * (cluster.now - longest)


def test_a_worker_of_a_thousand_that_fails_at_once_is_left_out_after_a_few_jobs_and_costs_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is always idle, so that it is given whatever comes next."""

    def seconds(worker: str, job: Numbered) -> float:
        return 1e-3 if worker == BAD else three_seconds(worker, job)

    cluster = Cluster(WORKERS, seconds, lambda worker, _: "ImportError" if worker == BAD else "")
    found, last = all_outcomes(cluster, 4000, monkeypatch)
    assert not [outcome for outcome in found if isinstance(outcome, TileFailure)]
    assert {outcome.index for outcome in found} == {(k,) for k in range(4000)}
    assert last.excluded.keys() == {BAD}
    assert MAX_FAILURES <= cluster.attempts[BAD] <= MAX_FAILURES + dispatch.IN_FLIGHT


def test_jobs_are_restricted_to_few_of_many_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dask keeps the list for each job: of 999 workers it would take three times as long to place one."""
    restricted: list[int] = []

    class Looking(Cluster):
        def map(self, work: object, acts: list[object], jobs: list[Numbered], workers: Any, **more: object) -> Any:
            restricted.append(len(workers or ()) / len(jobs))
            return super().map(work, acts, jobs, workers, **more)

    cluster = Looking(WORKERS, three_seconds, lambda worker, _: "ImportError" if worker == BAD else "")
    all_outcomes(cluster, 4000, monkeypatch)
    assert 0 < max(restricted) <= dispatch.MAX_ALLOWED_WORKERS + 4


def hanging(jobs: set[tuple[str, int]], seconds: float) -> Callable[[str, Numbered], float]:
    """Jobs take a second, but so many seconds of one worker for some jobs."""
    return lambda worker, job: seconds if (worker, job.index[0]) in jobs else 1.0


def test_the_tiles_of_a_worker_that_hangs_are_given_to_others_and_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Truth: a worker that never ends a job costs the run 60 s, 10 times the longest job being less."""
    cluster = Cluster(WORKERS[:3], hanging({(BAD, k) for k in range(3, 300)}, 1e9))
    found, last = all_outcomes(cluster, 300, monkeypatch)
    assert {outcome.index for outcome in found} == {(k,) for k in range(300)}
    assert last.excluded.keys() == {BAD}
    assert re.fullmatch(
        r"it has had tiles? \(\d+,\)(, .+)? for 1 min \d s, the longest job took 1\.0 s; other workers do them",
        last.excluded[BAD],
    )
    assert cluster.now < 300 / 2 + 30


def test_a_run_says_which_worker_has_ended_nothing_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    cluster, troubles = Cluster(WORKERS[:2], hanging({(BAD, 8)}, 1e9)), set[str]()
    monkeypatch.setattr(dispatch, "time", cluster)
    monkeypatch.setattr(batches, "time", cluster)
    jobs = (Numbered((k,)) for k in range(10))
    found = list(outcomes(cluster, LABOUR, jobs, lambda workers: troubles.add(workers.trouble)))  # type: ignore[arg-type]
    assert {outcome.index for outcome in found} == {(k,) for k in range(10)}
    assert f"no job finished for 40 s: {BAD} has tile (8,)" in troubles


def test_a_worker_that_was_only_slow_gets_tiles_again(monkeypatch: pytest.MonkeyPatch) -> None:
    cluster = Cluster(WORKERS[:2], hanging({(BAD, 4)}, 100.0))
    found, last = all_outcomes(cluster, 300, monkeypatch)
    assert sorted(outcome.index for outcome in found) == [(k,) for k in range(300)]
    assert not last.excluded
    assert cluster.attempts[BAD] > 20


def test_a_tile_that_is_as_slow_elsewhere_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    slow = {(worker, 5) for worker in WORKERS[:4]}
    cluster = Cluster(WORKERS[:4], hanging(slow, 200.0))
    found, _ = all_outcomes(cluster, 40, monkeypatch)
    assert sorted(outcome.index for outcome in found) == [(k,) for k in range(40)]
    assert 60 + 200 < cluster.now < 60 + 60 + 200


def test_the_only_worker_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    cluster = Cluster([BAD], hanging({(BAD, 5)}, 200.0))
    found, last = all_outcomes(cluster, 20, monkeypatch)
    assert sorted(outcome.index for outcome in found) == [(k,) for k in range(20)]
    assert not last.excluded
    assert cluster.attempts.total() == 20


@dataclass(frozen=True)
class Job:
    index: tuple[int, ...]


def test_dask_is_asked_for_jobs_and_results_in_batches(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    whole_map, whole_gather = Client.map, Client.gather

    def counted_map(self: Client, work: object, acts: object, jobs: list[Job], **more: Any) -> Any:
        asked.append(len(jobs))
        return whole_map(self, work, acts, jobs, **more)

    def counted_gather(self: Client, futures: Any, **more: Any) -> Any:
        asked.append(len(futures))
        return whole_gather(self, futures, **more)

    monkeypatch.setattr(Client, "map", counted_map)
    monkeypatch.setattr(Client, "gather", counted_gather)
    monkeypatch.setattr(Client, "submit", None)
    monkeypatch.setattr(dispatch, "IN_FLIGHT", 50)
    labour: JobType[Job, Job] = JobType("out.zarr", lambda job: job, nothing, nothing)
    found = list(outcomes(client, labour, (Job((k,)) for k in range(200)), lambda _: None))
    assert {outcome.index for outcome in found} == {(k,) for k in range(200)}
    assert sum(asked) == 400
    assert asked[0] == 100
    assert len(asked) < 200


def test_a_result_that_is_lost_with_its_worker_holds_up_no_other(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Truth: Dask's own gather waits until such a job has been done again."""
    whole, asked = Client.gather, []

    def gather(self: Client, futures: Any, **more: Any) -> Any:
        asked.append(len(futures))
        return asyncio.sleep(60) if len(asked) == 1 else whole(self, futures, **more)

    monkeypatch.setattr(Client, "gather", gather)
    labour: JobType[Job, Job] = JobType("out.zarr", lambda job: job, nothing, nothing)
    timing = Timing(connect=0.1)
    found = list(outcomes(client, labour, (Job((k,)) for k in range(20)), lambda _: None, timing))
    assert {outcome.index for outcome in found} == {(k,) for k in range(20)}


RELEASE, BEGUN = threading.Event(), list[tuple[int, ...]]()


def hang_once(job: Job) -> Job:
    """Do a job; the first attempt at one of them waits."""
    BEGUN.append(job.index)
    if job.index == (3,) and BEGUN.count((3,)) == 1:
        RELEASE.wait(60)
    return job


def test_dask_gives_the_tiles_of_a_worker_that_hangs_to_another(
    two_workers: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dispatch, "SLOW", 1.0)
    seen = list[WorkerStatus]()
    RELEASE.clear()
    BEGUN.clear()
    labour: JobType[Job, Job] = JobType("out.zarr", hang_once, nothing, nothing)
    timing = Timing(tick=0.05, hung=0.5)
    try:
        found = list(outcomes(two_workers, labour, (Job((k,)) for k in range(40)), seen.append, timing))
    finally:
        RELEASE.set()
    assert sorted(outcome.index for outcome in found) == [(k,) for k in range(40)]
    assert BEGUN.count((3,)) == 2
    (reason,) = seen[-1].excluded.values()
    assert re.search(r"it has had tiles? .*\(3,\).* for .* s, the longest job took .* s; other workers do them", reason)


@contextmanager
def no_setup(client: object, labour: JobType[Any, Any], seconds: float) -> Iterator[Any]:
    yield labour.run


@pytest.fixture(autouse=True)
def without_setup(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dask's plugins have tests of their own."""
    monkeypatch.setattr(worker_setup, "prepare_workers", no_setup)
