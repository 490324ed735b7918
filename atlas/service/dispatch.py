"""Sending jobs to the workers of a Dask cluster and collecting their reports.

Dask places the jobs, moves them to idle workers, and repeats those of workers that die. Added here is what Dask does
not provide:

- a limit on the jobs in flight, since the jobs of a large atlas would take gigabytes of the scheduler;
- another worker for a job that failed, since Dask's own retries may choose the same worker;
- a second attempt on another worker at a job that takes too long;
- exclusion of workers at which jobs fail that succeed elsewhere.
"""

import asyncio
import logging
import math
import random
import time
import uuid
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from statistics import median
from typing import TYPE_CHECKING, Any, Generic

from atlas.errors import NetworkError, RunError
from atlas.formatting import byte_size, duration, plural
from atlas.service.attempts import AttemptOutcome, J, JobAttempt, OpenJob, R, outcome_of_error, run_attempt
from atlas.service.cluster import CLUSTER_LOST_MESSAGE, loss_reported, worker_memory, worker_threads
from atlas.service.summary import TileFailure
from atlas.service.timing import TIMING, Timing
from atlas.task.store_ref import StoreFullError

if TYPE_CHECKING:
    from distributed import Client, Future

LOG = logging.getLogger(__name__)
"""Logger, at level DEBUG, of decisions about jobs and workers and of errors of workers with their tracebacks."""
POLL_SECONDS, QUICK_POLL_SECONDS = 0.1, 0.01
"""Seconds between two looks at the jobs in flight. Jobs that finish meanwhile are fetched together, which costs less.

QUICK_POLL_SECONDS applies if jobs are not queued for each thread.
"""
IN_FLIGHT, MAX_IN_FLIGHT = 2, 64
"""Minimum and maximum number of jobs in flight for each thread: at least one running and one queued, so no thread
idles.
"""
QUEUED_SECONDS = 10.0
"""Seconds of work that are kept in flight for each thread.

Dask's adaptive scaling adds workers while more than 5 s are queued.
"""
SLOW = 20.0
"""Multiple of the median duration after which a job counts as slow and is given to a second worker as well.

The job must also be in flight for longer than ``Timing.hung``.
"""
MEDIAN_OF = 1001
"""Number of most recently finished jobs whose durations give the median."""
MAX_BLAMED = 3
"""Number of jobs after which a worker is excluded, if they failed on it and succeeded on another worker."""
MAX_ERRORS, MAX_DEATHS = 3, 2
"""Numbers of failed attempts after which a job is given up: with an exception, and by the death of the worker."""
MAX_FAILED_JOBS = 16
"""Number of jobs that failed twice after which a run ends with an error if no job has succeeded yet."""
MAX_ALLOWED = 64
"""Maximum number of workers that a job is restricted to; Dask keeps a copy of the list for each job."""
MAX_NAMED = 3
"""Maximum number of workers that a message names."""
MIN_WORKER_MEMORY = 500_000_000
"""Minimum memory of a worker, in bytes. The kernels take most of it; Dask pauses a worker with a lower limit."""


@dataclass(frozen=True)
class WorkerStatus:
    """The state of a run's workers.

    threads   number of worker threads
    excluded  reasons for the exclusion of workers, by address
    trouble   reason why no job has finished lately; empty if none is known
    """

    threads: int
    excluded: Mapping[str, str]
    trouble: str = ""


class Dispatcher(Generic[J, R]):
    """Sends jobs to the workers of a cluster and collects their reports.

    A job that fails is tried again on another worker, and if it fails there, too, a last time after all other jobs. A
    worker is excluded if it refuses, has too little memory, or fails at jobs that succeed elsewhere; if the store does
    not respond to it, until another worker has done a job; and if one of its jobs takes too long, until it ends a job.

    client  client of the cluster
    act     module-level function that does a job on a worker
    timing  waiting times
    memory  bytes of memory that a worker needs
    queue   True to keep jobs waiting for each thread; False to choose the next job as late as possible
    """

    def __init__(
        self,
        client: "Client",
        act: Callable[[J], R],
        timing: Timing = TIMING,
        memory: int = MIN_WORKER_MEMORY,
        queue: bool = True,
    ) -> None:
        self.client, self._act, self._timing, self.memory, self._queue = client, act, timing, memory, queue
        self._token, self._numbers = uuid.uuid4().hex[:8], count()
        self._threads: dict[str, int] = {}
        self._most_workers = 0
        self._seconds = deque[float](maxlen=MEDIAN_OF)
        self._refused, self._unreachable, self._slow = dict[str, str](), dict[str, str](), dict[str, str]()
        self._blamed = defaultdict[str, dict[tuple[int, ...], str]](dict)
        self._proven = set[str]()
        self._start(iter(()))

    def _start(self, jobs: Iterator[J]) -> None:
        self._pending = jobs
        self._attempts: dict[Future[AttemptOutcome[R]], JobAttempt[J]] = {}
        self._flying: set[OpenJob[J]] = set()
        self._retries: deque[OpenJob[J]] = deque()
        self._deferred: list[OpenJob[J]] = []
        self._unfetched: list[Future[AttemptOutcome[R]]] = []
        self._fit_at = self._ended_at = time.monotonic()

    def iter_outcomes(self, jobs: Iterable[J], on_tick: Callable[[WorkerStatus], None]) -> Iterator[R | TileFailure]:
        """Submit jobs, a limited number at a time, and yield their reports or failures as they end.

        ``jobs`` may run dry and yield again later. It is polled whenever there is room, as long as jobs are in flight.
        ``on_tick`` is called about every ``timing.tick`` seconds and after the last outcome; it may raise to stop. At
        an error the jobs in flight are cancelled. Raise RunError if the cluster is lost, all workers are excluded, the
        store is full, or many jobs fail and none succeeds.
        """
        from distributed import as_completed

        self._start(iter(jobs))
        self._completed = as_completed(loop=self.client.loop)
        ticked = -math.inf
        try:
            while True:
                if time.monotonic() - ticked >= self._timing.tick:
                    self._refresh()
                    on_tick(self._status())
                    ticked = time.monotonic()
                is_waiting = not self._fill()
                if not (is_waiting or self._flying or self._retries or self._deferred):
                    on_tick(self._status())  # shows workers excluded since the last tick
                    return
                time.sleep(POLL_SECONDS if self._queue else QUICK_POLL_SECONDS)
                for future, result in self._fetch_results():
                    outcome = self._handle(future, result)
                    if outcome is not None:
                        yield outcome
        finally:
            with suppress(Exception):  # a cluster that is gone has nothing to cancel
                self.client.cancel(list(self._attempts))
            self._attempts.clear()

    def require_memory(self, memory: int) -> None:
        """Set the bytes of memory that jobs need from now on. Workers with less memory are excluded."""
        self.memory = memory
        for worker, (limit, _) in worker_memory(self.client).items():
            if 0 < limit < memory:
                needed = f"required {byte_size(memory)}; raise it with: dask worker --memory-limit"
                self._exclude(self._refused, worker, f"memory limit {byte_size(limit)} is below the {needed}")

    def _refresh(self) -> None:
        """Update the list of workers from the cluster, and give the jobs of lost or hanging workers to others."""
        threads, now = worker_threads(self.client), time.monotonic()
        if threads.keys() - self._threads.keys():
            self.require_memory(self.memory)
        if threads != self._threads:
            LOG.debug("%s: %s", plural(len(threads), "worker"), ", ".join(sorted(threads)))
        self._threads, self._most_workers = threads, max(self._most_workers, len(threads))
        # Dask keeps a job for the workers to which it is restricted, even if all of them are gone.
        lost = [f for f, a in self._attempts.items() if a.workers and threads.keys().isdisjoint(a.workers)]
        if lost:
            self.client.cancel(lost)
        for future in lost:
            open_job = self._attempts.pop(future).open_job
            open_job.n_flying -= 1
            if open_job in self._flying and not open_job.n_flying:
                self._requeue(open_job, self._retries)
        self._copy_slow(now)

    def _copy_slow(self, now: float) -> None:
        """Send jobs that take many times the median duration to second workers as well; the first outcome counts."""
        old = {
            f: a for f, a in self._attempts.items() if now - a.since > self._timing.hung and not a.open_job.is_copied
        }
        old = {future: attempt for future, attempt in old.items() if attempt.open_job in self._flying}
        usual = median(self._seconds) if old and self._seconds else math.inf
        old = {future: attempt for future, attempt in old.items() if now - attempt.since > SLOW * usual}
        holders = self._holders() if old else {}
        slow = {future: attempt for future, attempt in old.items() if future.key in holders}
        if not self._threads.keys() - self._excluded.keys() - {holders[future.key] for future in slow}:
            return  # no other worker
        for future, attempt in slow.items():
            worker, index = holders[future.key], attempt.open_job.job.index
            reason = f"tile {index} has taken {duration(now - attempt.since)}, the median is {duration(usual)}"
            self._exclude(self._slow, worker, f"{reason}; other workers do its tiles")
        for attempt in slow.values():
            attempt.open_job.is_copied = True
            self._submit(attempt.open_job)

    def _holders(self) -> dict[Any, str]:
        """Return the address of the worker that has each submitted job, by Dask's key of the job."""
        with loss_reported(self.client):
            return {key: worker for worker, keys in self.client.processing().items() for key in keys}

    @property
    def _excluded(self) -> dict[str, str]:
        """The reason for the exclusion of each excluded worker, by its address."""
        blamed = {worker: jobs for worker, jobs in self._blamed.items() if len(jobs) >= MAX_BLAMED}
        reasons = {
            worker: f"{len(jobs)} tiles failed on this worker and succeeded elsewhere, the first is {index}: {reason}"
            for worker, jobs in blamed.items()
            for index, reason in list(jobs.items())[:1]
        }
        return reasons | self._slow | self._unreachable | self._refused

    def _exclude(self, kind: dict[str, str], worker: str, reason: str) -> None:
        LOG.debug("%s is excluded: %s", worker, reason)
        kind[worker] = reason

    def _status(self) -> WorkerStatus:
        return WorkerStatus(sum(self._threads.values()), self._excluded, self._describe_trouble())

    def _describe_trouble(self) -> str:
        """Return the reason why no job has ended for a while, as text; empty if nothing is known to be wrong."""
        silent = time.monotonic() - self._ended_at
        if silent < self._timing.stall_after or not self._flying:
            return ""
        memory = worker_memory(self.client)
        paused = [f"{worker} (limit {byte_size(limit)})" for worker, (limit, stopped) in memory.items() if stopped]
        begin = f"no job finished for {duration(silent)}: "
        if paused:
            return f"{begin}Dask has paused {plural(len(paused), 'worker')} short of memory: {_some_of(paused)}"
        if silent < (2 * median(self._seconds) if self._seconds else self._timing.hung):
            return ""
        holders = self._holders()
        tiles = [(holders[f.key], a.open_job.job.index) for f, a in self._attempts.items() if f.key in holders]
        return f"{begin}{_some_of([f'{worker} has tile {index}' for worker, index in tiles])}" if tiles else ""

    def _fill(self) -> bool:
        """Submit jobs until enough are in flight; return False if all workers are excluded, but another may still come.

        Raise RunError if no worker is left and no replacement has come.
        """
        fit, waited = self._fit_workers(), time.monotonic() - self._fit_at > self._timing.replacement_worker
        if fit or not self._threads:
            self._fit_at = time.monotonic()
        elif not self._flying and (waited or len(self._threads) >= self._most_workers):
            worker, reason = next(iter(self._excluded.items()))
            raise RunError(
                f"all workers are excluded, for example {worker}: {reason}; finished tiles are kept, rerun the same "
                "command to resume"
            )
        else:
            return False  # a worker that did jobs is gone, and may reconnect
        if self.client.status != "running":
            raise RunError(CLUSTER_LOST_MESSAGE)
        threads = max(1, sum(self._threads[worker] for worker in fit))
        while len(self._flying) < self._window(threads) and (open_job := self._next_job()):
            self._flying.add(open_job)
            self._submit(open_job)
        return True

    def _fit_workers(self) -> list[str]:
        """Return the workers that get jobs: all that are not excluded.

        If all are excluded, return the workers that neither refused nor failed to reach the store.
        """
        excluded, refusing = self._excluded, self._refused | self._unreachable
        fit = [worker for worker in self._threads if worker not in excluded]
        return fit or [worker for worker in self._threads if worker not in refusing]

    def _window(self, threads: int) -> int:
        """Return the number of jobs to keep in flight on ``threads`` threads, by the durations of the most recent
        jobs.
        """
        if not self._queue:
            return threads + 1
        short = math.ceil(QUEUED_SECONDS * len(self._seconds) / (sum(self._seconds) or math.inf))
        return threads * min(MAX_IN_FLIGHT, max(IN_FLIGHT, short))

    def _next_job(self) -> OpenJob[J] | None:
        """Return the next job to submit, None if there is none: retries first, and deferred jobs after all others."""
        if not self._retries and (job := next(self._pending, None)) is not None:
            return OpenJob(job)
        if not self._retries and not self._flying:
            # Dask blames a worker's death on all its jobs: alone only the job that kills its worker fails again.
            last = [job for job in self._deferred if not job.failures[-1].is_death] or self._deferred[:1]
            self._deferred = [job for job in self._deferred if job not in last]
            self._retries.extend(last)
        return self._retries.popleft() if self._retries else None

    def _submit(self, open_job: OpenJob[J]) -> None:
        """Submit one attempt at a job to Dask."""
        workers = self._allowed_workers(open_job)
        key = (f"tile-{self._token}", next(self._numbers), *open_job.job.index)  # Dask remembers a failed attempt's
        with loss_reported(self.client):
            future = self.client.submit(
                run_attempt, self._act, open_job.job, key=key, workers=workers and list(workers), pure=False
            )
        open_job.n_flying += 1
        self._attempts[future] = JobAttempt(open_job, workers, time.monotonic())
        self._completed.add(future)

    def _allowed_workers(self, open_job: OpenJob[J]) -> tuple[str, ...] | None:
        """Return the workers to which an attempt at a job is restricted; None for no restriction.

        After a failure they are workers on which the job has not failed, preferably workers that have finished other
        jobs.
        """
        if not (open_job.failures or self._excluded):
            return None
        fit, failed = self._fit_workers(), {failure.worker for failure in open_job.failures}
        some = [worker for worker in fit if worker not in failed] or fit
        some = [worker for worker in some if not failed or worker in self._proven] or some
        return None if len(some) == len(self._threads) else tuple(random.sample(some, min(len(some), MAX_ALLOWED)))

    def _handle(self, future: "Future[AttemptOutcome[R]]", outcome: AttemptOutcome[R]) -> R | TileFailure | None:
        """Process the outcome of an attempt, and return the report or the failure of its job.

        Return None if the job is to be tried again, if another attempt at it is in flight, or if it has ended before.
        """
        attempt = self._attempts.pop(future, None)
        if attempt is None:
            return None  # cancelled
        open_job, self._ended_at = attempt.open_job, time.monotonic()
        open_job.n_flying -= 1
        self._slow.pop(outcome.worker, None)  # it does not hang
        if open_job not in self._flying:
            return None  # another attempt was faster
        if outcome.error is None:
            self._flying.remove(open_job)
            self._record_success(open_job, outcome)
            return outcome.report
        self._record_failure(open_job, outcome)
        is_hopeless = open_job.n_errors >= MAX_ERRORS or open_job.n_deaths >= MAX_DEATHS
        if open_job.n_flying and not is_hopeless:
            open_job.is_copied = False
            return None  # another attempt is in flight, which may hang
        if outcome.error is not RunError:
            self._requeue(open_job, self._retries)
        elif is_hopeless:
            self._flying.remove(open_job)
            LOG.debug("tile %s is given up after %s", open_job.job.index, plural(len(open_job.failures), "attempt"))
            return TileFailure(open_job.job.index, outcome.reason, outcome.worker, outcome.traceback)
        else:
            defer = outcome.is_death or open_job.n_errors >= MAX_ERRORS - 1
            self._requeue(open_job, self._deferred if defer else self._retries)
        return None

    def _fetch_results(self) -> "Iterator[tuple[Future[AttemptOutcome[R]], AttemptOutcome[R]]]":
        """Yield the attempts that have ended, with their outcomes, by one request to the scheduler.

        If a result was lost with its worker, Dask repeats the job, and the attempt ends again. Dask would wait for such
        a result, and for a worker that hangs. An outcome that does not arrive within ``timing.connect`` seconds is
        therefore requested again later.
        """
        ended = [*self._unfetched, *self._completed.next_batch(block=False)]
        by_number = {n: future for n, future in enumerate(ended) if future.status == "finished"}

        async def gather() -> dict[int, AttemptOutcome[R]]:
            gathering = self.client.gather(by_number, errors="skip", direct=False, asynchronous=True)
            return await asyncio.wait_for(gathering, self._timing.connect)

        outcomes: dict[int, AttemptOutcome[R]] = {}
        with loss_reported(self.client), suppress(TimeoutError):
            outcomes = {n: outcome for n, outcome in self.client.sync(gather).items() if outcome} if by_number else {}
        self._unfetched = []
        for n, future in enumerate(ended):
            if n in outcomes:
                yield future, outcomes[n]
            elif n in by_number:
                self._unfetched.append(future)
            elif future.status == "error":
                yield future, outcome_of_error(future.exception())
            elif future in self._attempts and future.status in ("lost", "pending"):
                self._completed.add(future)  # its result was lost
            elif future in self._attempts:
                raise RunError(CLUSTER_LOST_MESSAGE)

    def _requeue(self, open_job: OpenJob[J], queue: "deque[OpenJob[J]] | list[OpenJob[J]]") -> None:
        self._flying.remove(open_job)
        queue.append(open_job)

    def _record_success(self, open_job: OpenJob[J], outcome: AttemptOutcome[R]) -> None:
        """Record that a worker did a job. Workers on which the same job had failed are blamed: enough blame excludes a
        worker.
        """
        self._seconds.append(outcome.seconds)
        self._proven.add(outcome.worker)
        self._unreachable.clear()  # the store responds to this worker, so perhaps to the others too
        for failure in open_job.failures:
            if failure.worker:
                self._blamed[failure.worker][open_job.job.index] = failure.reason
        self._blamed.pop(outcome.worker, None)

    def _record_failure(self, open_job: OpenJob[J], outcome: AttemptOutcome[R]) -> None:
        """Record an attempt that did not succeed. Raise RunError if the run cannot succeed: the store is full, or all
        jobs fail.
        """
        index, where = open_job.job.index, outcome.worker or "an unknown worker"
        LOG.debug("tile %s failed on %s: %s\n%s", index, where, outcome.reason, outcome.traceback)
        if outcome.error is StoreFullError:
            raise RunError(f"{outcome.reason}; finished tiles are kept, make room and rerun the same command")
        if outcome.error is not RunError:
            kind = self._unreachable if outcome.error is NetworkError else self._refused
            self._exclude(kind, outcome.worker, outcome.reason)
            return
        open_job.failures.append(outcome)
        if not self._proven and len(self._deferred) >= MAX_FAILED_JOBS:
            raise RunError(
                f"{plural(len(self._deferred), 'tile')} failed twice and none succeeded, for example tile {index} on "
                f"{where}: {outcome.reason}; rerun the same command to resume"
            )


def _some_of(names: list[str]) -> str:
    return ", ".join(names[:MAX_NAMED]) + ", ..." * (len(names) > MAX_NAMED)
