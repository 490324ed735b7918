"""Sending jobs to workers and collecting the outcomes.

A limited number of jobs is in flight, and failed jobs are retried.
"""

import logging
import math
import random
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Generic

from atlas.errors import RunError
from atlas.formatting import byte_size, duration, plural
from atlas.service.batches import AttemptSuccess, InFlightJobs, J, JobAttempt, JobType, R, Result
from atlas.service.cluster import CLUSTER_LOST_MESSAGE, worker_memory, worker_threads
from atlas.service.summary import TileFailure
from atlas.service.timing import TIMING, Timing
from atlas.service.worker_health import AttemptFailure, WorkerHealth, WorkerRefusal, host_of

if TYPE_CHECKING:
    from distributed import Client

LOG = logging.getLogger(__name__)
"""Decisions, and errors of workers with their tracebacks, at level DEBUG."""
IN_FLIGHT, MAX_IN_FLIGHT = 2, 64
"""Number of jobs in flight for each thread, at least and at most: one running, one waiting, so that no thread idles.

If jobs are short, enough of them are in flight to keep the thread busy for QUEUED_SECONDS.
"""
QUEUED_SECONDS = 10.0
"""Seconds of work queued per thread. Dask's adaptive scaling adds workers while more than 5 s are queued."""
EXTRA_IN_FLIGHT = 1
"""Number of jobs in flight beyond one per thread if their order may change: the next begins as soon as one ends."""
MAX_ATTEMPTS = 3
"""Maximum number of attempts, in one run, at a tile that raises or whose workers die."""
MAX_NAMED_WORKERS = 3
"""Maximum number of workers, or of tiles of a worker, that a message names."""
SLOW = 10.0
"""Factor on the duration of the longest job so far.

A worker that finishes no job for longer hangs, if ``Timing.hung`` has passed too.
"""
MAX_ALLOWED_WORKERS = 64
"""Maximum number of workers that jobs are restricted to, with four more for each job.

Dask keeps a copy of the list for each job.
"""


@dataclass(frozen=True)
class WorkerStatus:
    """The workers of a run.

    threads   number of worker threads
    excluded  reasons for the exclusion of workers, by address
    trouble   reason why no job has finished lately; empty if none is known
    """

    threads: int
    excluded: Mapping[str, str]
    trouble: str = ""


@contextmanager
def open_dispatcher(client: "Client", job_type: JobType[J, R], timing: Timing = TIMING) -> "Iterator[Dispatcher[J, R]]":
    """Set up the workers of a cluster for their jobs until the end of the block, and yield their dispatcher."""
    from atlas.service.worker_setup import prepare_workers  # imports Dask, which takes a while to load

    with prepare_workers(client, job_type, timing.connect) as act:
        yield Dispatcher(client, act, timing, job_type.memory)


class Dispatcher(Generic[J, R]):
    """Sends jobs to the workers of a cluster and collects their outcomes.

    A job that fails is retried, on another worker or host if there is one. A worker is excluded if MAX_FAILURES
    consecutive jobs failed on it while other workers succeed, if it has too little memory, or while it hangs. Jobs of a
    worker that hangs are sent to others, each once: a job that is as slow elsewhere is slow.

    client  client of the cluster
    act     function that does a job on a worker
    timing  waiting times
    memory  bytes of memory that a worker needs
    ahead   seconds of work queued for each thread; with 0 the next job is chosen as late as possible
    """

    def __init__(
        self,
        client: "Client",
        act: Callable[[J], R],
        timing: Timing,
        memory: int,
        queued_seconds: float = QUEUED_SECONDS,
    ) -> None:
        self.client, self.timing, self.memory, self.ahead = client, timing, memory, queued_seconds
        self.pending: Iterator[J] = iter(())
        self.in_flight: InFlightJobs[J, R] = InFlightJobs(client, act, timing.connect)
        self.retries: deque[JobAttempt[J]] = deque()
        self.doubtful: list[JobAttempt[J]] = []
        self.fitness = WorkerHealth()
        self.threads: dict[str, int] = {}
        self.most_workers = self.done = 0
        self.thread_seconds = 0.0
        self.longest: float | None = None
        self.heard: dict[str, float] = {}
        self.last_fit_worker_at = self.last_finished_at = self.refreshed_at = time.monotonic()

    def iter_outcomes(self, jobs: Iterable[J], on_tick: Callable[[WorkerStatus], None]) -> Iterator[R | TileFailure]:
        """Submit jobs, a limited number at a time, and yield their outcomes as they finish.

        ``jobs`` may run dry and yield again later. It is polled whenever there is room, as long as jobs are in flight.
        ``on_tick`` is called about every ``timing.tick`` seconds and after the last outcome; it may raise to stop. At
        an error the jobs in flight are cancelled. Raise RunError if the cluster is lost, all workers are excluded, or
        the store is full.
        """
        self.pending, ticked = iter(jobs), -math.inf
        self.last_fit_worker_at = self.last_finished_at = self.refreshed_at = time.monotonic()
        self.done, self.thread_seconds = 0, 0.0
        try:
            while True:
                if time.monotonic() - ticked >= self.timing.tick:
                    self.refresh_workers()
                    on_tick(self.worker_status())
                    ticked = time.monotonic()
                self.submit_jobs()
                if not (self.in_flight or self.retries):
                    yield from self.judge_doubtful()
                    if not self.retries:
                        on_tick(self.worker_status())  # shows workers excluded since the last tick
                        return
                    continue
                for attempt, result in self.in_flight.ended():
                    outcome = self.handle_result(attempt, result)
                    if outcome is not None:
                        yield outcome
        finally:
            with suppress(Exception):  # a cluster that is gone has nothing to cancel
                self.in_flight.cancel(lambda _: True)

    def refresh_workers(self) -> None:
        """Update the workers from the cluster, which may grow and shrink during the run."""
        threads, now = worker_threads(self.client), time.monotonic()
        self.thread_seconds += sum(self.threads.values()) * (now - self.refreshed_at)
        self.refreshed_at = now
        if threads.keys() - self.threads.keys():
            self.require_memory(self.memory)
        if threads != self.threads:
            LOG.debug("%s: %s", plural(len(threads), "worker"), ", ".join(sorted(threads)))
        self.threads = threads
        self.most_workers = max(self.most_workers, len(self.threads))
        # Dask keeps a job for the workers to which it is restricted, even if all of them are gone.
        lost = self.in_flight.cancel(lambda a: a.workers is not None and threads.keys().isdisjoint(a.workers))
        if lost:
            LOG.debug("workers are gone: %s sent to others", plural(len(lost), "tile"))
        self.retries.extend(lost)
        for worker in threads:
            self.heard.setdefault(worker, now)
        self.move_jobs(now)

    def move_jobs(self, now: float) -> None:
        """Take jobs from workers that hang, and readmit workers that have finished the jobs taken from them."""
        for worker in self.in_flight.returned():
            LOG.debug("%s has ended the tiles that were taken from it", worker)
            self.fitness.readmit(worker)
            self.heard[worker] = now
        if self.longest is None:
            return
        limit = max(self.timing.hung, SLOW * self.longest)
        if now - self.in_flight.oldest <= limit:
            return
        willing = self.threads.keys() - self.fitness.excluded.keys()
        hung = {}
        for worker, attempts in self.in_flight.held().items():
            old = [attempt for attempt in attempts if not attempt.is_moved and now - attempt.since > limit]
            if worker in willing and old and now - self.heard[worker] > limit:
                hung[worker] = [attempt for attempt in attempts if not attempt.is_moved]
        for worker, attempts in hung.items() if willing - hung.keys() else ():  # else there is no other worker
            silent = duration(now - max(self.heard[worker], min(attempt.since for attempt in attempts)))
            reason = f"it has had {_tiles(attempts)} for {silent}, the longest job took {duration(self.longest)}"
            LOG.debug("%s hangs: %s", worker, reason)
            self.fitness.record_refusal(WorkerRefusal(worker, f"{reason}; other workers do them"))
            self.in_flight.set_apart(worker, attempts)
            self.retries.extend(replace(attempt, is_moved=True) for attempt in attempts)

    def require_memory(self, memory: int) -> None:
        """Set the bytes of memory that jobs need from now on. Workers with less memory are excluded."""
        self.memory = memory
        for worker, (limit, _) in worker_memory(self.client).items():
            if 0 < limit < memory:
                needed = f"required {byte_size(memory)}; raise it with: dask worker --memory-limit"
                self.fitness.record_refusal(
                    WorkerRefusal(worker, f"memory limit {byte_size(limit)} is below the {needed}")
                )

    def worker_status(self) -> WorkerStatus:
        """Return the status of the workers, by the last refresh and the outcomes so far."""
        return WorkerStatus(sum(self.threads.values()), self.fitness.excluded, self.describe_trouble())

    def describe_trouble(self) -> str:
        """Return the reason why no job has finished for a while; empty if nothing is known to be wrong."""
        silent = time.monotonic() - self.last_finished_at
        if silent < self.timing.stall_after or not self.in_flight:
            return ""
        memory = worker_memory(self.client)
        paused = [f"{worker} (limit {byte_size(limit)})" for worker, (limit, stopped) in memory.items() if stopped]
        if not paused:
            usual = self.timing.hung if self.longest is None else 2.0 * self.longest
            held = self.in_flight.held() if silent >= usual else {}
            shown = [f"{worker} has {_tiles(attempts)}" for worker, attempts in held.items()]
            more = ", ..." if len(shown) > MAX_NAMED_WORKERS else ""
            return (
                f"no job finished for {duration(silent)}: {', '.join(shown[:MAX_NAMED_WORKERS])}{more}" if shown else ""
            )
        names = ", ".join(paused[:MAX_NAMED_WORKERS]) + (", ..." if len(paused) > MAX_NAMED_WORKERS else "")
        return (
            f"no job finished for {duration(silent)}: Dask has paused {plural(len(paused), 'worker')} short of "
            f"memory: {names}"
        )

    def submit_jobs(self) -> None:
        """Submit jobs until the maximum number is in flight, jobs to be retried first.

        Raise RunError if the cluster is lost, or if all workers are excluded and no replacement has come.
        """
        left_out = self.fitness.excluded
        willing = [worker for worker in self.threads if worker not in left_out]
        if willing or not left_out:
            self.last_fit_worker_at = time.monotonic()
        elif not self.in_flight and (
            len(self.threads) >= self.most_workers
            or time.monotonic() - self.last_fit_worker_at > self.timing.replacement_worker
        ):
            if not self.fitness.readmit_failed():
                worker, reason = next(iter(left_out.items()))
                raise RunError(
                    f"all workers are excluded, for example {worker}: {reason}; finished tiles are kept, rerun the "
                    "same command to resume"
                )
            return
        else:
            return  # a worker that did jobs is gone, and may reconnect
        if self.client.status != "running":
            raise RunError(CLUSTER_LOST_MESSAGE)
        room = max(0, self.window_size(max(1, sum(self.threads[worker] for worker in willing))) - len(self.in_flight))
        anywhere = _some(willing, room) if left_out else None
        attempts = []
        for _ in range(room):
            attempt = self.retries.popleft() if self.retries else next(map(JobAttempt, self.pending), None)
            if attempt is None:
                break
            workers = _elsewhere(willing, attempt.failures) if attempt.failures and willing else anywhere
            attempts.append(replace(attempt, workers=workers))
        self.in_flight.submit(attempts)

    def window_size(self, threads: int) -> int:
        """Return the number of jobs to keep in flight for this number of threads, by the durations of jobs so far."""
        if not self.ahead:
            return threads + EXTRA_IN_FLIGHT
        jobs = math.ceil(self.ahead * self.done / self.thread_seconds) if self.thread_seconds else IN_FLIGHT
        return threads * min(MAX_IN_FLIGHT, max(IN_FLIGHT, jobs))

    def cancel_stale(self, stale: Callable[[J], bool]) -> list[J]:
        """Cancel the jobs for which ``stale`` is True, and return them.

        Jobs that a worker has begun are not cancelled.
        """
        dropped = self.in_flight.cancel(lambda attempt: stale(attempt.job), waiting=True)
        for attempts in (self.retries, self.doubtful):
            gone = [attempt for attempt in attempts if stale(attempt.job)]
            for attempt in gone:
                attempts.remove(attempt)
            dropped += gone
        return [attempt.job for attempt in dropped]

    def handle_result(self, attempt: JobAttempt[J], result: Result[R]) -> R | TileFailure | None:
        """Return the outcome of a job; None if the job is retried, or in doubt."""
        self.last_finished_at = time.monotonic()
        if result.worker:
            self.heard[result.worker] = self.last_finished_at
        if isinstance(result, AttemptSuccess):
            self.fitness.finish(result.worker)
            self.done += 1
            self.longest = max(self.longest or 0.0, result.seconds)
            return result.result
        if isinstance(result, WorkerRefusal):
            LOG.debug("%s refuses tile %s: %s", result.worker, attempt.job.index, result.reason)
            self.fitness.record_refusal(result)
            self.retries.append(attempt)
            return None
        if result.store_full:
            raise RunError(f"{result.reason}; finished tiles are kept, make room and rerun the same command")
        where, trace = result.worker or "a worker that died", f"\n{result.traceback}".rstrip()
        LOG.debug("tile %s failed on %s: %s%s", attempt.job.index, where, result.reason, trace)
        self.fitness.fail(attempt.job.index, result, attempt.failures)
        attempt = replace(attempt, failures=(*attempt.failures, result))
        at_fault = self.fitness.is_at_fault(attempt.failures, MAX_ATTEMPTS)
        if at_fault:
            return _given_up(attempt)
        LOG.debug("tile %s is retried, %s", attempt.job.index, "later" if at_fault is None else "elsewhere if possible")
        (self.retries if at_fault is False else self.doubtful).append(attempt)
        return None

    def judge_doubtful(self) -> Iterator[TileFailure]:
        """Decide on the jobs in doubt once all others are finished: retry a job, or yield its failure."""
        if self.fitness.excluded.keys() >= self.threads.keys():
            self.fitness.readmit_failed()
        for attempt in self.doubtful:
            if self.fitness.is_at_fault(attempt.failures, MAX_ATTEMPTS) is False:
                self.retries.append(attempt)
            else:
                yield _given_up(attempt)
        self.doubtful.clear()


def _tiles(attempts: list[JobAttempt[J]]) -> str:
    """Return the first few tiles of some attempts as text."""
    names = ", ".join(str(attempt.job.index) for attempt in attempts[:MAX_NAMED_WORKERS])
    return f"tile{'s' * (len(attempts) > 1)} {names}{', ...' * (len(attempts) > MAX_NAMED_WORKERS)}"


def _elsewhere(willing: list[str], failures: tuple[AttemptFailure, ...]) -> tuple[str, ...] | None:
    """Return the workers for the next attempt.

    They are those on hosts without a failure, else those without a failure, else all.
    """
    failed = {failure.worker for failure in failures}
    hosts = {host_of(worker) for worker in failed}
    apart = [worker for worker in willing if host_of(worker) not in hosts]
    return _some(apart or [worker for worker in willing if worker not in failed] or willing)


def _some(workers: list[str], jobs: int = 1) -> tuple[str, ...] | None:
    """Return enough workers for Dask to choose from, for this number of jobs; None if there are no workers."""
    enough = MAX_ALLOWED_WORKERS + 4 * jobs
    return tuple(workers if len(workers) <= enough else random.sample(workers, enough)) or None


def _given_up(attempt: JobAttempt[J]) -> TileFailure:
    last = attempt.failures[-1]
    LOG.debug("tile %s is given up after %s", attempt.job.index, plural(len(attempt.failures), "attempt"))
    return TileFailure(attempt.job.index, last.reason, last.worker, last.traceback)
