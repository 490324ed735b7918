"""Jobs in flight: submitting jobs to Dask and fetching their results in batches, since a single request takes 5 ms.

The results pass through the scheduler. Fetching them directly would need a connection to every worker, and take half as
long again.
"""

import asyncio
import math
import time
import traceback
import uuid
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeAlias, TypeVar

from atlas.errors import NetworkError, RunError
from atlas.service.cluster import CLUSTER_LOST_MESSAGE, loss_reported
from atlas.service.worker_health import AttemptFailure, WorkerRefusal
from atlas.task.store_ref import StoreFullError, WorkerRefusedError

if TYPE_CHECKING:
    from distributed import Client, Future

MIN_POLL_SECONDS, MAX_POLL_SECONDS = 5e-3, 50e-3
"""Seconds between two polls of few jobs in flight, and of many; jobs that finish meanwhile form a batch."""
MIN_BATCH, MAX_HOLD_SECONDS = 16, 0.25
"""Number of finished jobs that form a batch, and maximum seconds to wait for them.

A batch is also one in 20 of the jobs in flight, if that is less. Both limits are small, so that no thread runs out of
jobs.
"""
MIN_WORKER_MEMORY = 500_000_000
"""Bytes of memory that a worker needs. The kernels take most of them; Dask pauses a worker with a lower limit."""
MANY_IN_FLIGHT = 400
"""Number of jobs in flight from which the pause between two polls is longest."""


class IndexedJob(Protocol):
    """A job with an index, which identifies it."""

    @property
    def index(self) -> tuple[int, ...]:
        """The index of the job's tile, or its number among other jobs."""


J = TypeVar("J", bound=IndexedJob)
R = TypeVar("R")


@dataclass(frozen=True)
class JobType(Generic[J, R]):
    """A kind of job, by module-level functions. At most one run at a time uses the name.

    name      name of the setup on the workers
    run       function that does a job
    setup     function that prepares a worker, once, before its first job
    teardown  function that drops the state of ``setup``, at the end
    memory    bytes of memory that a worker needs
    """

    name: str
    run: Callable[[J], R]
    setup: Callable[[], object]
    teardown: Callable[[], object]
    memory: int = MIN_WORKER_MEMORY


@dataclass(frozen=True)
class AttemptSuccess(Generic[R]):
    """The result of a successful attempt.

    worker   address of the worker
    result   what the job returned
    seconds  duration of the attempt, with the worker's setup if the attempt waited for it
    """

    worker: str
    result: R
    seconds: float = 0.0


Result: TypeAlias = AttemptSuccess[R] | WorkerRefusal | AttemptFailure
"""The value returned by ``run_on_worker``: the outcome of an attempt."""
if TYPE_CHECKING:
    Ended: TypeAlias = Future[Result[R]]


@dataclass(frozen=True)
class JobAttempt(Generic[J]):
    """An attempt at a job.

    job       the job
    failures  failures of its earlier attempts
    workers   addresses of the workers that may do it; None for all
    since     time of submission, in seconds of ``time.monotonic``
    is_moved  True if the job was taken from a worker that hangs
    """

    job: J
    failures: tuple[AttemptFailure, ...] = ()
    workers: tuple[str, ...] | None = None
    since: float = 0.0
    is_moved: bool = False


def run_on_worker(act: Callable[[J], R], job: J) -> Result[R]:
    """Run a job on this worker, and return its outcome; an exception becomes a value that names the worker."""
    from distributed import get_worker

    here, begin = get_worker().address, time.perf_counter()
    try:
        result = act(job)
        return AttemptSuccess(here, result, time.perf_counter() - begin)
    except WorkerRefusedError as error:
        return WorkerRefusal(here, str(error))
    except NetworkError as error:
        return WorkerRefusal(here, str(error), temporary=True)
    except StoreFullError as error:
        return AttemptFailure(here, str(error), store_full=True)
    except Exception as error:
        return AttemptFailure(here, _in_words(error), traceback=traceback.format_exc())


class InFlightJobs(Generic[J, R]):
    """The attempts in flight.

    client   client of the cluster
    act      function that does a job
    seconds  maximum wait for a result that Dask cannot find
    """

    def __init__(self, client: "Client", act: Callable[[J], R], seconds: float) -> None:
        self._client, self._act, self._seconds = client, act, seconds
        self._token, self._submitted = uuid.uuid4().hex[:8], 0
        self._running: dict[Ended[R], JobAttempt[J]] = {}
        self._apart: dict[Ended[R], str] = {}
        self._taken = -math.inf

    def __len__(self) -> int:
        return len(self._running)

    def submit(self, attempts: Iterable[JobAttempt[J]]) -> None:
        """Submit attempts.

        Attempts for the same workers go into one request, which costs little more than a single attempt.
        """
        together: dict[tuple[str, ...] | None, list[JobAttempt[J]]] = {}
        for attempt in attempts:
            together.setdefault(attempt.workers, []).append(attempt)
        for workers, group in together.items():
            jobs, keys = [one.job for one in group], []
            for job in jobs:
                self._submitted += 1  # a key of its own for each attempt: Dask remembers a failed one's
                keys.append((f"tile-{self._token}", self._submitted, *job.index))
            acts, names = [self._act] * len(jobs), list(workers) if workers else None
            with loss_reported(self._client):
                futures = self._client.map(run_on_worker, acts, jobs, key=keys, workers=names, pure=False)
            now = time.monotonic()
            self._running.update({future: replace(one, since=now) for future, one in zip(futures, group, strict=True)})

    @property
    def oldest(self) -> float:
        """Time at which the first of the attempts in flight was submitted; infinite if there are none."""
        return min((attempt.since for attempt in self._running.values()), default=math.inf)

    def held(self) -> dict[str, list[JobAttempt[J]]]:
        """Return the attempts in flight by worker, the oldest first, by one request to the scheduler."""
        under_way = {future.key: attempt for future, attempt in self._running.items()}
        with loss_reported(self._client):
            keys_by_worker = self._client.processing()
        held = {worker: [under_way[key] for key in keys if key in under_way] for worker, keys in keys_by_worker.items()}
        oldest_first = {w: sorted(held[w], key=lambda attempt: (attempt.since, attempt.job.index)) for w in held}
        return {worker: attempts for worker, attempts in oldest_first.items() if attempts}

    def set_apart(self, worker: str, attempts: Iterable[JobAttempt[J]]) -> None:
        """Stop counting attempts on a worker as in flight. They continue, since Dask cannot interrupt them."""
        gone = {id(attempt) for attempt in attempts}
        for future in [future for future, attempt in self._running.items() if id(attempt) in gone]:
            del self._running[future]
            self._apart[future] = worker

    def returned(self) -> set[str]:
        """Return the workers all of whose attempts set apart have ended since; each worker is returned once."""
        before = {*self._apart.values()}
        self._apart = {future: worker for future, worker in self._apart.items() if not future.done()}
        return before - {*self._apart.values()}

    def cancel(self, which: Callable[[JobAttempt[J]], bool], waiting: bool = False) -> list[JobAttempt[J]]:
        """Cancel the attempts for which ``which`` is True, and return them.

        With ``waiting`` only attempts that no worker has begun are cancelled: Dask cannot interrupt others.
        """
        futures = [future for future, attempt in self._running.items() if which(attempt)]
        with loss_reported(self._client):
            if futures and waiting:
                begun = {key for keys in self._client.processing().values() for key in keys}
                futures = [future for future in futures if future.key not in begun and not future.done()]
            if futures:
                self._client.cancel(futures)
        return [self._running.pop(future) for future in futures]

    def ended(self) -> "Iterator[tuple[JobAttempt[J], Result[R]]]":
        """Yield the attempts that have ended after a short wait, with their results.

        If a result was lost with its worker, Dask repeats the job, and the attempt ends again.
        """
        time.sleep(MIN_POLL_SECONDS + MAX_POLL_SECONDS * min(1.0, len(self._running) / MANY_IN_FLIGHT))
        ended = [future for future in self._running if future.done()]
        few = len(ended) < min(MIN_BATCH, len(self._running) // 20)
        if few and time.monotonic() - self._taken < MAX_HOLD_SECONDS:
            return
        self._taken = time.monotonic()
        if any(future.status not in ("finished", "error") for future in ended):
            raise RunError(CLUSTER_LOST_MESSAGE)
        failed = [(future, self._failure_of(future)) for future in ended if future.status == "error"]
        for future, result in (*failed, *self._fetched([future for future in ended if future.status == "finished"])):
            future.release()
            yield self._running.pop(future), result

    def _fetched(self, finished: "list[Ended[R]]") -> "Iterator[tuple[Ended[R], Result[R]]]":
        """Yield the results of finished jobs, which lie on their workers, by one request to the scheduler."""
        by_number = dict(enumerate(finished))

        async def gather() -> dict[int, Any]:
            asked = self._client.gather(by_number, errors="skip", direct=False, asynchronous=True)
            return await asyncio.wait_for(asked, self._seconds)

        with loss_reported(self._client):
            try:
                results = self._client.sync(gather) if finished else {}
            except TimeoutError:
                return
        for number, result in results.items():
            if result is not None:
                yield by_number[number], result

    def _failure_of(self, future: "Ended[R]") -> AttemptFailure:
        """Return the failure of a job that never returned, since all workers that had it died."""
        error = future.exception()
        assert error is not None
        if "deserialization of the task graph" in str(error):
            raise RunError(
                f"the scheduler cannot load this package ({type(error).__name__}); install the same impact-atlas on "
                "every host, the scheduler's too"
            )
        return AttemptFailure("", _in_words(error))


def _in_words(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
