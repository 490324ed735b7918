"""A pretended cluster: what the dispatch uses of Dask's client, and workers of one thread, on a clock of their own.

Nothing is solved, and no time passes but that of the clock: requests and attempts are counted exactly.
"""

import asyncio
import heapq
import itertools
from collections import Counter
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any

import distributed
import pytest

from atlas.errors import RunError
from atlas.service import dispatch
from atlas.service.attempts import AttemptOutcome
from atlas.service.dispatch import Dispatcher, WorkerStatus
from atlas.service.timing import TIMING, Timing


@dataclass(frozen=True)
class Numbered:
    """A job."""

    index: tuple[int, ...]


@dataclass(eq=False)
class PretendedFuture:
    """Dask's future."""

    job: Numbered
    key: object
    worker: str = ""
    status: str = "pending"

    def done(self) -> bool:
        return self.status != "pending"

    def release(self) -> None:
        """Nothing is kept."""


@dataclass
class Cluster:
    """``seconds`` says how long a job takes at a worker; one that fails there does so after as long.

    ``requests`` counts what the client asked of the scheduler, ``attempts`` the jobs begun at each worker.
    """

    workers: list[str]
    seconds: Callable[[str, Numbered], float]
    fails: Callable[[str, Numbered], str] = lambda worker, job: ""
    status: str = "running"
    now: float = 0.0
    busy: float = 0.0
    requests: Counter[str] = field(default_factory=Counter)
    attempts: Counter[str] = field(default_factory=Counter)
    ended: list[PretendedFuture] = field(default_factory=list)
    loop: object = None

    def __post_init__(self) -> None:
        self._queues: dict[str, list[PretendedFuture]] = {worker: [] for worker in self.workers}
        self._idle = {worker: (0, k) for k, worker in enumerate(self.workers)}
        self._ends: list[tuple[float, int, PretendedFuture]] = []
        self._numbers = itertools.count()

    # What the dispatch measures time by

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        until = self.now + seconds
        while self._ends and self._ends[0][0] <= until:
            self.now, _, future = heapq.heappop(self._ends)
            future.status = "finished"
            self.ended.append(future)
            queue = self._queues[future.worker]
            queue.remove(future)
            if queue:
                self._begin(queue[0])
        self.now = until

    # Dask's client

    def nthreads(self) -> dict[str, int]:
        self.requests["nthreads"] += 1
        return dict.fromkeys(self.workers, 1)

    def scheduler_info(self, n_workers: int = 5) -> dict[str, Any]:
        """As of distributed 2025.4 to 2026.3: by default of five workers."""
        self.requests["scheduler_info"] += 1
        listed = self.workers if n_workers == -1 else self.workers[:n_workers]
        return {"workers": {worker: {"memory_limit": 0, "status": "running"} for worker in listed}}

    def processing(self) -> dict[str, list[Any]]:
        self.requests["processing"] += 1
        return {worker: [future.key for future in queue] for worker, queue in self._queues.items()}

    def submit(
        self, work: object, act: object, job: Numbered, workers: list[str] | None, key: object, **_: object
    ) -> PretendedFuture:
        """The job goes to the worker that has fewest, as Dask gives it."""
        self.requests["submit"] += 1
        worker = min(workers or self.workers, key=lambda worker: len(self._queues[worker]))
        future = PretendedFuture(job, key, worker)
        self._queues[worker].append(future)
        if len(self._queues[worker]) == 1:
            self._begin(future)
        return future

    def cancel(self, futures: list[PretendedFuture]) -> None:
        self.requests["cancel"] += 1

    def _begin(self, future: PretendedFuture) -> None:
        self.attempts[future.worker] += 1
        seconds = self.seconds(future.worker, future.job)
        self.busy += seconds
        heapq.heappush(self._ends, (self.now + seconds, next(self._numbers), future))

    # Dask's as_completed

    def add(self, future: PretendedFuture) -> None:
        """All futures are watched."""

    def next_batch(self, block: bool) -> list[PretendedFuture]:
        assert not block
        batch, self.ended = self.ended, []
        return batch

    async def gather(self, futures: dict[int, PretendedFuture], **_: object) -> dict[int, AttemptOutcome[Numbered]]:
        return {number: self._outcome(future) for number, future in futures.items()}

    def sync(self, call: Callable[[], Coroutine[Any, Any, Any]]) -> Any:
        return asyncio.run(call())

    def _outcome(self, future: PretendedFuture) -> AttemptOutcome[Numbered]:
        reason = self.fails(future.worker, future.job)
        seconds = self.seconds(future.worker, future.job)
        if reason:
            return AttemptOutcome(future.worker, RunError, reason=reason)
        return AttemptOutcome(future.worker, None, future.job, seconds)


def all_outcomes(
    cluster: Cluster, jobs: int, monkeypatch: pytest.MonkeyPatch, timing: Timing = TIMING
) -> tuple[list[Any], list[WorkerStatus]]:
    """The outcomes of so many jobs on a pretended cluster, and what the looks showed of the workers."""
    seen: list[WorkerStatus] = []
    with monkeypatch.context() as patch:
        patch.setattr(dispatch, "time", cluster)
        patch.setattr(distributed, "as_completed", lambda **_: cluster)
        force: Dispatcher[Numbered, Numbered] = Dispatcher(cluster, lambda job: job, timing)  # type: ignore[arg-type]
        return list(force.iter_outcomes((Numbered((k,)) for k in range(jobs)), seen.append)), seen
