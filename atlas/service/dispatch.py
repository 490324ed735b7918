"""Jobs out to the workers and their outcomes back: a window of them under way, again for those that went wrong."""

import math
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from atlas.errors import NetworkError, RunError
from atlas.service.cluster import LOST, loss_reported, worker_memory, worker_threads
from atlas.service.fitness import Failure, Fitness, Refusal, host_of
from atlas.service.summary import TileFailure
from atlas.service.timing import TIMING, Timing
from atlas.task.attempt import run_job
from atlas.task.task import Job, Receipt, RefusedError, StoreFullError
from atlas.text import byte_size, duration, plural

if TYPE_CHECKING:
    from distributed import Client, Future

IN_FLIGHT = 2
"""Tiles under way for each thread: one running, one waiting, so that no thread idles and no queue grows."""
ATTEMPTS = 3
"""How often a tile that raises, or whose workers die, is tried before it is left for another run."""
LEAST_MEMORY = 500_000_000
"""Bytes that a worker needs: with a lower limit Dask pauses it, for the kernels alone take most of them."""
NAMED = 3
"""Workers named in a line about several."""


class Numbered(Protocol):
    """A job: what it is told apart by."""

    @property
    def index(self) -> tuple[int, ...]:
        """Of its tile, or its place among others."""


J = TypeVar("J", bound=Numbered)
R = TypeVar("R")


@dataclass(frozen=True)
class Done(Generic[R]):
    """What a job gave, and on which worker."""

    worker: str
    result: R


@dataclass(frozen=True)
class Workers:
    """The workers of a run at some moment.

    threads    of all
    left_out   those that get no job, and why
    trouble    why no job has ended for a while, empty where nothing is known to be wrong
    """

    threads: int
    left_out: Mapping[str, str]
    trouble: str = ""


@dataclass(frozen=True)
class Attempt(Generic[J]):
    """A job on its way: its failures so far, and the workers that may have it, None for any."""

    job: J
    failures: tuple[Failure, ...] = ()
    workers: tuple[str, ...] | None = None


def tile_outcomes(
    client: "Client", jobs: Iterable[Job], tick: Callable[[Workers], None], timing: Timing = TIMING
) -> Iterator[Receipt | TileFailure]:
    """The outcomes of tiles; see ``outcomes``."""
    return outcomes(client, run_job, jobs, tick, timing)


def outcomes(
    client: "Client",
    act: Callable[[J], R],
    jobs: Iterable[J],
    tick: Callable[[Workers], None],
    timing: Timing = TIMING,
) -> Iterator[R | TileFailure]:
    """Submit jobs in a window and give each one's outcome as it ends; what is under way is dropped on the way out.

    ``act``, a function of a module, does a job on a worker.

    A job that fails is tried again, elsewhere if there is another worker, on another machine if there is one. A worker
    at which FAILURES jobs in a row failed gets no more while others do theirs, nor does one with too little memory.

    ``tick`` is called about every ``timing.tick`` seconds and after the last outcome, and may raise to end it. Raises
    RunError where the cluster is lost, no worker is left that may have a job, or the store has no room.
    """
    return _Window(client, act, jobs, timing).run(tick)


def work(act: Callable[[J], R], job: J) -> Done[R] | Refusal | Failure:
    """What a worker runs: the job, with whatever it raises as a value that names the worker."""
    from distributed import get_worker

    here = get_worker().address
    try:
        return Done(here, act(job))
    except RefusedError as error:
        return Refusal(here, str(error))
    except NetworkError as error:
        return Refusal(here, str(error), passing=True)
    except StoreFullError as error:
        return Failure(here, str(error), full=True)
    except Exception as error:
        return Failure(here, _in_words(error))


class _Window(Generic[J, R]):
    def __init__(self, client: "Client", act: Callable[[J], R], jobs: Iterable[J], timing: Timing) -> None:
        self.client, self.act, self.waiting, self.timing = client, act, iter(jobs), timing
        self.token = uuid.uuid4().hex[:8]
        self.running: dict[Future[Done[R] | Refusal | Failure], Attempt[J]] = {}
        self.again: deque[Attempt[J]] = deque()
        self.doubtful: list[Attempt[J]] = []
        self.ended: SimpleQueue[Future[Done[R] | Refusal | Failure]] = SimpleQueue()
        self.fitness = Fitness()
        self.threads: dict[str, int] = {}
        self.submitted = self.most_workers = 0
        self.last_good = self.last_end = time.monotonic()

    def run(self, tick: Callable[[Workers], None]) -> Iterator[R | TileFailure]:
        ticked = -math.inf
        try:
            while True:
                if time.monotonic() - ticked >= self.timing.tick:
                    self.look()
                    tick(self.workers())
                    ticked = time.monotonic()
                self.fill()
                if not (self.running or self.again):
                    yield from self.judged()
                    if not self.again:
                        tick(self.workers())  # who was left out since the last one
                        return
                    continue
                try:
                    future = self.ended.get(timeout=self.timing.tick)
                except Empty:
                    continue
                outcome = self.outcome(future)
                if outcome is not None:
                    yield outcome
        finally:
            if self.running:
                with suppress(Exception):  # a cluster that is gone has nothing to cancel
                    self.client.cancel(list(self.running))

    def look(self) -> None:
        """Look at the cluster, which may grow and shrink under way."""
        threads = worker_threads(self.client)
        if threads.keys() - self.threads.keys():
            for worker, (limit, _) in worker_memory(self.client).items():
                if 0 < limit < LEAST_MEMORY:
                    needed = f"needs {byte_size(LEAST_MEMORY)}: dask worker --memory-limit"
                    self.fitness.refuse(Refusal(worker, f"its memory limit is {byte_size(limit)}, a worker {needed}"))
        self.threads = threads
        self.most_workers = max(self.most_workers, len(self.threads))
        # Dask keeps a job for the workers that it was given to, though all of them are gone.
        lost = [f for f, a in self.running.items() if a.workers and not self.threads.keys() & {*a.workers}]
        for future in lost:
            self.again.append(self.running.pop(future))
        if lost:
            with loss_reported(self.client):
                self.client.cancel(lost)

    def workers(self) -> Workers:
        """The workers, as far as the last look and the ends of attempts show."""
        return Workers(sum(self.threads.values()), self.fitness.left_out, self.trouble())

    def trouble(self) -> str:
        """Why no job has ended for a while, empty where nothing is known to be wrong."""
        silent = time.monotonic() - self.last_end
        if silent < self.timing.stalled or not self.running:
            return ""
        memory = worker_memory(self.client)
        paused = [f"{worker} (limit {byte_size(limit)})" for worker, (limit, stopped) in memory.items() if stopped]
        if not paused:
            return ""
        names = ", ".join(paused[:NAMED]) + (", ..." if len(paused) > NAMED else "")
        return (
            f"nothing has ended for {duration(silent)}: Dask has paused {plural(len(paused), 'worker')} for want of "
            f"memory: {names}"
        )

    def fill(self) -> None:
        """Submit as many jobs as the window has room for, those to be tried again first."""
        left_out = self.fitness.left_out
        willing = [worker for worker in self.threads if worker not in left_out]
        if willing or not left_out:
            self.last_good = time.monotonic()
        elif not self.running and (
            len(self.threads) >= self.most_workers or time.monotonic() - self.last_good > self.timing.worker
        ):
            if not self.fitness.restored():
                worker, reason = next(iter(left_out.items()))
                raise RunError(
                    f"no worker can do this run: {worker}: {reason}; finished tiles are kept; the same command resumes"
                )
            return
        else:
            return  # one that did tiles is gone, and may come back
        if self.client.status != "running":
            raise RunError(LOST)
        threads = sum(self.threads[worker] for worker in willing)
        for _ in range(IN_FLIGHT * max(1, threads) - len(self.running)):
            attempt = self.again.popleft() if self.again else next(map(Attempt, self.waiting), None)
            if attempt is None:
                return
            restricted = bool(left_out or attempt.failures) and bool(willing)
            self.submit(replace(attempt, workers=_elsewhere(willing, attempt.failures) if restricted else None))

    def submit(self, attempt: Attempt[J]) -> None:
        self.submitted += 1  # a key of its own for each attempt: Dask remembers a failed one's
        key = (f"tile-{self.token}", self.submitted, *attempt.job.index)
        with loss_reported(self.client):
            future = self.client.submit(work, self.act, attempt.job, key=key, workers=attempt.workers)
        self.running[future] = attempt
        future.add_done_callback(self.ended.put)

    def outcome(self, future: "Future[Done[R] | Refusal | Failure]") -> R | TileFailure | None:
        """The outcome of a job; None where it is to be tried again, or is in doubt."""
        attempt = self.running.pop(future, None)
        if attempt is None:
            return None  # it was given to other workers
        self.last_end = time.monotonic()
        if future.status == "finished":
            with loss_reported(self.client):  # its result is still on the worker
                result = future.result()
            future.release()
        elif future.status == "error":
            result = self.failure_of(future)
        else:
            raise RunError(LOST)
        if isinstance(result, Done):
            self.fitness.finish(result.worker)
            return result.result
        if isinstance(result, Refusal):
            self.fitness.refuse(result)
            self.again.append(attempt)
            return None
        if result.full:
            raise RunError(f"{result.reason}; finished tiles are kept; make room and give the same command again")
        self.fitness.fail(attempt.job.index, result, attempt.failures)
        attempt = replace(attempt, failures=(*attempt.failures, result))
        at_fault = self.fitness.is_at_fault(attempt.failures, ATTEMPTS)
        if at_fault:
            return _given_up(attempt)
        (self.again if at_fault is False else self.doubtful).append(attempt)
        return None

    def judged(self) -> Iterator[TileFailure]:
        """What is left of jobs in doubt once all others are done; some may be tried again."""
        if self.fitness.left_out.keys() >= self.threads.keys():
            self.fitness.restored()
        for attempt in self.doubtful:
            if self.fitness.is_at_fault(attempt.failures, ATTEMPTS) is False:
                self.again.append(attempt)
            else:
                yield _given_up(attempt)
        self.doubtful.clear()

    def failure_of(self, future: "Future[Done[R] | Refusal | Failure]") -> Failure:
        """The failure of a job that came to no end of its own: all workers that had it died."""
        error = future.exception()
        assert error is not None
        if "deserialization of the task graph" in str(error):
            raise RunError(
                f"the scheduler cannot load this package ({type(error).__name__}); install the same impact-atlas on "
                "every host, the scheduler's too"
            )
        future.release()
        return Failure("", _in_words(error))


def _elsewhere(willing: list[str], failures: tuple[Failure, ...]) -> tuple[str, ...]:
    """The workers for the next attempt: of other machines than those of the failures, else others, else any."""
    failed = {each.worker for each in failures}
    hosts = {host_of(worker) for worker in failed}
    apart = [worker for worker in willing if host_of(worker) not in hosts]
    return tuple(apart or [worker for worker in willing if worker not in failed] or willing)


def _given_up(attempt: Attempt[J]) -> TileFailure:
    last = attempt.failures[-1]
    return TileFailure(attempt.job.index, last.reason, last.worker)


def _in_words(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
