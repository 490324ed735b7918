"""Jobs of a large cluster by counts, on a pretended clock, and on Dask: busy workers, bad ones, those that hang."""

import asyncio
import random
import re
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
from distributed import CancelledError, Client, get_worker
from distributed.comm import CommClosedError  # type: ignore[attr-defined]  # exported without __all__

from atlas.errors import RunError
from atlas.service import dispatch
from atlas.service.dispatch import Dispatcher, WorkerStatus
from atlas.service.summary import TileFailure
from atlas.service.timing import Timing
from tests.fake_cluster import Cluster, Numbered, PretendedFuture, all_outcomes

WORKERS = [f"tcp://10.0.{k // 250}.{k % 250}:1" for k in range(1000)]
BAD = WORKERS[0]
QUICK = Timing(tick=0.05)


def indices(outcomes: list[Any]) -> list[tuple[int, ...]]:
    return sorted(outcome.index for outcome in outcomes)


def three_seconds(worker: str, job: Numbered) -> float:
    return random.Random(job.index[0]).lognormvariate(1.0, 0.4)


def test_a_thousand_workers_are_kept_busy_and_a_job_is_submitted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    cluster = Cluster(WORKERS, three_seconds)
    found, _ = all_outcomes(cluster, 8000, monkeypatch)
    assert indices(found) == [(k,) for k in range(8000)]
    assert cluster.requests["submit"] == 8000
    longest = max(three_seconds("", Numbered((k,))) for k in range(8000))
    assert cluster.busy > 0.95 * 1000 * (cluster.now - longest)


# Workers at which jobs fail


def quick_at_bad(worker: str, job: Numbered) -> float:
    return 1e-3 if worker == BAD else three_seconds(worker, job)


def test_a_worker_of_a_thousand_that_fails_at_once_is_excluded_and_costs_no_job(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is always idle, so that it is given whatever comes next."""
    cluster = Cluster(WORKERS, quick_at_bad, lambda worker, _: "ImportError: numba" if worker == BAD else "")
    found, seen = all_outcomes(cluster, 4000, monkeypatch)
    assert not [outcome for outcome in found if isinstance(outcome, TileFailure)]
    assert indices(found) == [(k,) for k in range(4000)]
    words = r"\d+ tiles failed on this worker and succeeded elsewhere, the first is \(\d+,\): ImportError: numba"
    assert seen[-1].excluded.keys() == {BAD} and re.fullmatch(words, seen[-1].excluded[BAD])
    assert cluster.attempts[BAD] < 200


def test_a_host_of_bad_workers_costs_no_job(monkeypatch: pytest.MonkeyPatch) -> None:
    bad = {*WORKERS[:16]}
    cluster = Cluster(WORKERS[:40], quick_at_bad, lambda worker, _: "ImportError" if worker in bad else "")
    found, _ = all_outcomes(cluster, 1000, monkeypatch)
    assert not [outcome for outcome in found if isinstance(outcome, TileFailure)]
    assert indices(found) == [(k,) for k in range(1000)]


def test_jobs_that_fail_everywhere_are_tried_three_times_and_exclude_no_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = range(10, 20)
    tried: Counter[int] = Counter()

    def fail(worker: str, job: Numbered) -> str:
        tried[job.index[0]] += 1
        return "ZeroDivisionError" if job.index[0] in wrong else ""

    cluster = Cluster(WORKERS[:3], lambda *_: 1.0, fail)
    found, seen = all_outcomes(cluster, 60, monkeypatch)
    failed = [outcome for outcome in found if isinstance(outcome, TileFailure)]
    assert indices(failed) == [(k,) for k in wrong]
    assert {tried[k] for k in wrong} == {3} and tried.total() == 80
    assert not seen[-1].excluded


def test_where_every_job_fails_the_run_ends_after_a_few_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    cluster = Cluster(WORKERS[:3], lambda *_: 1.0, lambda *_: "ImportError: numba")
    with pytest.raises(RunError, match=r"^16 tiles failed twice and none succeeded, for example tile .*: ImportError"):
        all_outcomes(cluster, 1000, monkeypatch)
    assert cluster.attempts.total() < 60


def test_a_worker_that_failed_gets_jobs_where_the_others_are_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    cluster = Cluster(
        WORKERS[:2], lambda *_: 1.0, lambda worker, job: "OSError" if worker == BAD and job.index[0] < 8 else ""
    )

    class Leaving(Cluster):
        def nthreads(self) -> dict[str, int]:
            self.workers = self.workers[: 1 if self.now > 30 else 2]
            return super().nthreads()

    cluster = Leaving(WORKERS[:2], cluster.seconds, cluster.fails)
    found, _ = all_outcomes(cluster, 200, monkeypatch)
    assert {outcome.index for outcome in found if not isinstance(outcome, TileFailure)} == {(k,) for k in range(200)}


def test_jobs_are_restricted_to_few_of_many_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dask keeps the list for each job: of 999 workers it would take three times as long to place one."""
    restricted: list[int] = []

    class Looking(Cluster):
        def submit(self, *given: Any, **more: Any) -> Any:
            restricted.append(len(more["workers"] or ()))
            return super().submit(*given, **more)

    cluster = Looking(WORKERS, quick_at_bad, lambda worker, _: "ImportError" if worker == BAD else "")
    all_outcomes(cluster, 4000, monkeypatch)
    assert 0 < max(restricted) <= dispatch.MAX_ALLOWED


# Workers that hang


def hanging(jobs: set[tuple[str, int]], seconds: float) -> Callable[[str, Numbered], float]:
    """Jobs take a second, but so many seconds of one worker for some jobs."""
    return lambda worker, job: seconds if (worker, job.index[0]) in jobs else 1.0


def test_the_tiles_of_a_worker_that_hangs_are_given_to_others_and_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Truth: a worker that never ends a job costs the run 60 s, 20 times the median being less."""
    cluster = Cluster(WORKERS[:3], hanging({(BAD, k) for k in range(3, 300)}, 1e9))
    found, seen = all_outcomes(cluster, 300, monkeypatch)
    assert indices(found) == [(k,) for k in range(300)]
    assert seen[-1].excluded.keys() == {BAD}
    words = r"tile \(\d+,\) has taken 1 min \d s, the median is 1\.0 s; other workers do its tiles"
    assert re.fullmatch(words, seen[-1].excluded[BAD])
    assert cluster.now < 300 / 2 + 30


def test_a_run_says_which_worker_has_ended_nothing_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    cluster = Cluster(WORKERS[:2], hanging({(BAD, 8)}, 1e9))
    found, seen = all_outcomes(cluster, 10, monkeypatch)
    assert indices(found) == [(k,) for k in range(10)]
    assert f"no job finished for 40 s: {BAD} has tile (8,)" in {workers.trouble for workers in seen}


def test_a_worker_that_was_only_slow_gets_tiles_again(monkeypatch: pytest.MonkeyPatch) -> None:
    cluster = Cluster(WORKERS[:2], hanging({(BAD, 4)}, 100.0))
    found, seen = all_outcomes(cluster, 300, monkeypatch)
    assert indices(found) == [(k,) for k in range(300)]
    assert not seen[-1].excluded
    assert cluster.attempts[BAD] > 20


def test_a_tile_that_is_as_slow_elsewhere_is_begun_twice_and_the_first_result_counts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    slow = {(worker, 5) for worker in WORKERS[:4]}
    cluster = Cluster(WORKERS[:4], hanging(slow, 200.0))
    found, _ = all_outcomes(cluster, 40, monkeypatch)
    assert indices(found) == [(k,) for k in range(40)]
    assert 200 < cluster.now < 200 + 10


def test_the_only_worker_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    cluster = Cluster([BAD], hanging({(BAD, 5)}, 200.0))
    found, seen = all_outcomes(cluster, 20, monkeypatch)
    assert indices(found) == [(k,) for k in range(20)]
    assert not seen[-1].excluded
    assert cluster.attempts.total() == 20


class LosingCluster(Cluster):
    """A cluster on which the worker of one job dies after the job: Dask does the job again, under the same future."""

    lost_status = ""

    def next_batch(self, block: bool) -> list[PretendedFuture]:
        batch = super().next_batch(block)
        for future in batch:
            if future.job.index == (5,) and not self.requests["lost"]:
                self.requests["lost"] += 1
                future.status = self.lost_status
                queue = self._queues[future.worker]
                queue.append(future)
                if len(queue) == 1:
                    self._begin(future)
        return batch


@pytest.mark.parametrize("status", ["lost", "pending"])
def test_a_result_that_is_lost_with_its_worker_is_no_lost_cluster(status: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Dask calls the future lost, and pending once the job is to be repeated."""
    cluster = LosingCluster(WORKERS[:4], three_seconds)
    cluster.lost_status = status
    found, _ = all_outcomes(cluster, 20, monkeypatch)
    assert indices(found) == [(k,) for k in range(20)]
    assert (cluster.requests["lost"], cluster.requests["submit"]) == (1, 20)


# On Dask


@dataclass(frozen=True)
class Job:
    index: tuple[int, ...]


def outcomes(client: Client, act: Callable[[Job], Any], jobs: int, timing: Timing = QUICK) -> tuple[list[Any], Any]:
    seen = list[WorkerStatus]()
    found = list(Dispatcher(client, act, timing).iter_outcomes((Job((k,)) for k in range(jobs)), seen.append))
    return found, seen[-1]


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
    RELEASE.clear()
    BEGUN.clear()
    try:
        found, last = outcomes(two_workers, hang_once, 40, Timing(tick=0.05, hung=0.5))
    finally:
        RELEASE.set()
    assert indices(found) == [(k,) for k in range(40)]
    assert BEGUN.count((3,)) == 2
    (reason,) = last.excluded.values()
    assert re.search(r"tile \(\d+,\) has taken .* s, the median is .* s; other workers do its tiles", reason)


def test_dask_tries_a_job_that_failed_on_another_worker(two_workers: Client) -> None:
    bad = min(two_workers.nthreads())

    def picky(job: Job) -> Job:
        if get_worker().address == bad:
            raise ImportError("no numba")
        return job

    found, last = outcomes(two_workers, picky, 40)
    assert indices(found) == [(k,) for k in range(40)]
    assert {*map(type, found)} == {Job}
    assert last.excluded.keys() <= {bad}


def test_a_result_that_is_lost_with_its_worker_holds_up_no_other(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Truth: Dask's own gather waits until such a job has been done again."""
    whole, asked = Client.gather, []

    def gather(self: Client, futures: Any, **more: Any) -> Any:
        asked.append(len(futures))
        return asyncio.sleep(60) if len(asked) == 1 else whole(self, futures, **more)

    monkeypatch.setattr(Client, "gather", gather)
    found, _ = outcomes(client, lambda job: job, 20, Timing(connect=0.1))
    assert indices(found) == [(k,) for k in range(20)]


@pytest.mark.parametrize("raised", [CancelledError, CommClosedError])
def test_a_cluster_that_goes_before_a_result_is_here_is_lost(
    client: Client, monkeypatch: pytest.MonkeyPatch, raised: type[Exception]
) -> None:
    async def gone(*_: object, **__: object) -> None:
        raise raised

    monkeypatch.setattr(Client, "gather", gone)
    with pytest.raises(RunError, match=r"^the cluster was lost; rerun the same command to resume"):
        outcomes(client, lambda job: job, 3)


def test_a_job_whose_second_attempt_fails_while_the_first_hangs_is_begun_again(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: Counter[str] = Counter()

    def fail(worker: str, job: Numbered) -> str:
        tried[worker] += job.index == (4,)
        return "OSError" if job.index == (4,) and tried.total() == 1 else ""

    cluster = Cluster(WORKERS[:3], hanging({(BAD, k) for k in range(3, 60)}, 1e9), fail)
    found, _ = all_outcomes(cluster, 60, monkeypatch)
    assert indices(found) == [(k,) for k in range(60)]
    assert not [outcome for outcome in found if isinstance(outcome, TileFailure)]


def test_a_run_without_a_fit_worker_waits_for_the_one_that_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    """One of two workers has too little memory; the other is away from 5 s to 20 s."""

    class Away(Cluster):
        def nthreads(self) -> dict[str, int]:
            self.workers = WORKERS[:1] if 5 < self.now < 20 else WORKERS[:2]
            return super().nthreads()

        def scheduler_info(self, n_workers: int = 5) -> dict[str, Any]:
            return {"workers": {BAD: {"memory_limit": 1, "status": "running"}}}

    found, seen = all_outcomes(Away(WORKERS[:2], lambda *_: 1.0), 40, monkeypatch)
    assert indices(found) == [(k,) for k in range(40)]
    assert seen[-1].excluded.keys() == {BAD}
