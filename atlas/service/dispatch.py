"""Jobs out to the workers and their outcomes back: a window of them under way, again for those that went wrong."""

import math
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from atlas.errors import NetworkError, RunError
from atlas.service.cluster import LOST, worker_threads
from atlas.service.summary import TileFailure
from atlas.service.timing import TIMING, Timing
from atlas.task.attempt import run_job
from atlas.task.task import Job, Receipt, RefusedError, StoreFullError

if TYPE_CHECKING:
    from distributed import Client, Future

IN_FLIGHT = 2
"""Tiles under way for each thread: one running, one waiting, so that no thread idles and no queue grows."""
ATTEMPTS = 3
"""How often a tile that raises, or whose workers die, is tried before it is left for another run."""


@dataclass(frozen=True)
class Refusal:
    """A worker that refuses this run's tiles, and why. ``passing``: the store may answer it later."""

    worker: str
    reason: str
    passing: bool = False


class Numbered(Protocol):
    """A job: what it is told apart by."""

    @property
    def index(self) -> tuple[int, ...]:
        """Of its tile, or its place among others."""


J = TypeVar("J", bound=Numbered)
R = TypeVar("R")


def tile_outcomes(
    client: "Client", jobs: Iterable[Job], tick: Callable[[int, dict[str, str]], None], timing: Timing = TIMING
) -> Iterator[Receipt | TileFailure]:
    """The outcomes of tiles; see ``outcomes``."""
    return outcomes(client, run_job, jobs, tick, timing)


def outcomes(
    client: "Client",
    act: Callable[[J], R],
    jobs: Iterable[J],
    tick: Callable[[int, dict[str, str]], None],
    timing: Timing = TIMING,
) -> Iterator[R | TileFailure]:
    """Submit jobs in a window and give each one's outcome as it ends; what is under way is dropped on the way out.

    ``act``, a function of a module, does a job on a worker.

    ``tick`` is called about every ``timing.tick`` seconds, with the number of worker threads and the reasons of the
    workers that refuse, and may raise to end it. Raises RunError where the cluster is lost, all workers refuse, or the
    store has no room.
    """
    return _Window(client, act, jobs, timing).run(tick)


def work(act: Callable[[J], R], job: J) -> R | Refusal:
    """What a worker runs: the job, with a refusal as a value that names the worker."""
    from distributed import get_worker

    try:
        return act(job)
    except RefusedError as error:
        return Refusal(get_worker().address, str(error))
    except NetworkError as error:
        return Refusal(get_worker().address, str(error), passing=True)


class _Window(Generic[J, R]):
    def __init__(self, client: "Client", act: Callable[[J], R], jobs: Iterable[J], timing: Timing) -> None:
        self.client, self.act, self.waiting, self.timing = client, act, iter(jobs), timing
        self.token = uuid.uuid4().hex[:8]
        self.running: dict[Future[R | Refusal], tuple[J, int]] = {}
        self.again: deque[tuple[J, int]] = deque()
        self.ended: SimpleQueue[Future[R | Refusal]] = SimpleQueue()
        self.refused: dict[str, str] = {}
        self.away: set[str] = set()
        self.threads: dict[str, int] = {}
        self.submitted = self.most_workers = 0
        self.last_good = time.monotonic()

    def run(self, tick: Callable[[int, dict[str, str]], None]) -> Iterator[R | TileFailure]:
        ticked = -math.inf
        try:
            while True:
                if time.monotonic() - ticked >= self.timing.tick:
                    self.threads = worker_threads(self.client)  # a cluster may grow and shrink under way
                    self.most_workers = max(self.most_workers, len(self.threads))
                    tick(sum(self.threads.values()), self.refused)
                    ticked = time.monotonic()
                self.fill()
                if not (self.running or self.again):
                    return
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

    def fill(self) -> None:
        """Submit as many jobs as the window has room for, those to be tried again first."""
        willing = [worker for worker in self.threads if worker not in self.refused]
        if willing or not self.refused:
            self.last_good = time.monotonic()
        elif not self.running and (
            len(self.threads) >= self.most_workers or time.monotonic() - self.last_good > self.timing.worker
        ):
            worker, reason = next(iter(self.refused.items()))
            raise RunError(
                f"no worker can do this run: {worker}: {reason}; finished tiles are kept; the same command resumes"
            )
        else:
            return  # one that did tiles is gone, and may come back
        if self.client.status != "running":
            raise RunError(LOST)
        for _ in range(IN_FLIGHT * max(1, sum(self.threads.values())) - len(self.running)):
            item = self.again.popleft() if self.again else next(((job, 1) for job in self.waiting), None)
            if item is None:
                return
            self.submit(*item, willing)

    def submit(self, job: J, attempt: int, willing: list[str]) -> None:
        self.submitted += 1  # a key of its own for each attempt: Dask remembers a failed one's
        future = self.client.submit(
            work,
            self.act,
            job,
            key=(f"tile-{self.token}", self.submitted, *job.index),
            workers=willing if self.refused else None,
            allow_other_workers=bool(self.refused),  # else a tile would wait for ever for workers that are gone
        )
        self.running[future] = (job, attempt)
        future.add_done_callback(self.ended.put)

    def outcome(self, future: "Future[R | Refusal]") -> R | TileFailure | None:
        """The outcome of a job; None where it is to be tried again."""
        job, attempt = self.running.pop(future)
        if future.status == "finished":
            result = future.result()
            future.release()
            if not isinstance(result, Refusal):
                for worker in self.away:  # the store answers, so perhaps these too
                    self.refused.pop(worker, None)
                self.away.clear()
                return result
            self.refused[result.worker] = result.reason
            if result.passing:
                self.away.add(result.worker)
            self.again.append((job, attempt))
            return None
        if future.status != "error":
            raise RunError(LOST)
        error = future.exception()
        future.release()
        if isinstance(error, StoreFullError):
            raise RunError(f"{error}; finished tiles are kept; make room and give the same command again")
        if isinstance(error, ImportError) or "deserialization of the task graph" in str(error):
            raise RunError(
                f"the scheduler or a worker cannot load this package ({type(error).__name__}); install the same "
                "impact-atlas on every host, the scheduler's too"
            )
        if attempt < ATTEMPTS:
            self.again.append((job, attempt + 1))
            return None
        return TileFailure(job.index, " ".join(f"{type(error).__name__}: {error}".split()))
