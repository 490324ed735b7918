"""A pretended cluster: what the dispatch uses of Dask's client, and workers of one thread, on a clock of their own.

Nothing is solved, and no time passes but that of the clock: requests and attempts are counted exactly.
"""

import asyncio
import heapq
import itertools
from collections import Counter
from collections.abc import Callable, Coroutine, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from atlas.service.batches import AttemptSuccess, JobType
from atlas.service.dispatch import WorkerStatus, open_dispatcher
from atlas.service.timing import TIMING, Timing
from atlas.service.worker_health import AttemptFailure


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

    def map(
        self,
        work: object,
        acts: list[object],
        jobs: list[Numbered],
        workers: list[str] | None,
        key: list[object],
        **_: object,
    ) -> list[PretendedFuture]:
        """Each job goes to the worker that has fewest, as Dask gives it."""
        self.requests["map"] += 1
        futures = [PretendedFuture(*pair) for pair in zip(jobs, key, strict=True)]
        loads = [(len(self._queues[worker]), k, worker) for k, worker in enumerate(workers or self.workers)]
        heapq.heapify(loads)
        for future in futures:
            load, k, future.worker = loads[0]
            heapq.heapreplace(loads, (load + 1, k, future.worker))
            self._queues[future.worker].append(future)
            if load == 0:
                self._begin(future)
        return futures

    async def gather(self, futures: Mapping[int, PretendedFuture], **_: object) -> dict[int, object]:
        self.requests["gather"] += 1
        return {number: self._result(future) for number, future in futures.items()}

    def sync(self, call: Callable[[], Coroutine[Any, Any, Any]]) -> Any:
        return asyncio.run(call())

    def cancel(self, futures: list[PretendedFuture]) -> None:
        self.requests["cancel"] += 1

    def register_plugin(self, plugin: object) -> None:
        self.requests["register_plugin"] += 1

    def unregister_worker_plugin(self, name: str) -> None:
        self.requests["unregister_worker_plugin"] += 1

    def _begin(self, future: PretendedFuture) -> None:
        self.attempts[future.worker] += 1
        seconds = self.seconds(future.worker, future.job)
        self.busy += seconds
        heapq.heappush(self._ends, (self.now + seconds, next(self._numbers), future))

    def _result(self, future: PretendedFuture) -> object:
        reason = self.fails(future.worker, future.job)
        seconds = self.seconds(future.worker, future.job)
        return AttemptFailure(future.worker, reason) if reason else AttemptSuccess(future.worker, future.job, seconds)


def outcomes(
    client: Any,
    labour: JobType[Any, Any],
    jobs: Iterable[Any],
    tick: Callable[[WorkerStatus], None],
    timing: Timing = TIMING,
) -> Iterator[Any]:
    """The outcomes of jobs, the only ones of their run."""
    with open_dispatcher(client, labour, timing) as force:
        yield from force.iter_outcomes(jobs, tick)
