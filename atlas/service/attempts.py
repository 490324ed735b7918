"""Run one attempt at a job on a Dask worker, and describe its outcome, with the name of the worker, as a value."""

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

from atlas.errors import NetworkError, RunError
from atlas.task.store_ref import StoreFullError, WorkerRefusedError


class IndexedJob(Protocol):
    """A job that is sent to a worker, with an index that identifies it."""

    @property
    def index(self) -> tuple[int, ...]:
        """The index of the job's tile, or its number among other jobs."""


J = TypeVar("J", bound=IndexedJob)
R = TypeVar("R")


@dataclass(frozen=True)
class AttemptOutcome(Generic[R]):
    """The outcome of an attempt at a job.

    worker     address of the worker; empty if unknown
    error      None if it is done; the error by which the worker or the store is known to be the reason, that is
               WorkerRefusedError, NetworkError or StoreFullError; RunError for any other exception
    report     what the job returned; None unless it is done
    seconds    duration on the worker
    reason     message of the exception; empty if the job is done
    traceback  traceback on the worker
    is_death   True if the worker's process died
    """

    worker: str
    error: type[Exception] | None = None
    report: R | None = None
    seconds: float = 0.0
    reason: str = ""
    traceback: str = ""
    is_death: bool = False


@dataclass(eq=False)
class OpenJob(Generic[J]):
    """A job that has neither a report nor been given up.

    job        the job
    failures   outcomes of its failed attempts
    n_flying   number of its attempts in flight
    is_copied  True if it took long, and a second worker has got it
    """

    job: J
    failures: list[AttemptOutcome[Any]] = field(default_factory=list)
    n_flying: int = 0
    is_copied: bool = False

    @property
    def n_deaths(self) -> int:
        """Number of attempts at the job that ended with the death of their workers."""
        return sum(failure.is_death for failure in self.failures)

    @property
    def n_errors(self) -> int:
        """Number of attempts at the job that ended with an exception."""
        return len(self.failures) - self.n_deaths


@dataclass(frozen=True, eq=False)
class JobAttempt(Generic[J]):
    """An attempt at a job that is submitted to Dask and has not ended.

    open_job  the job
    workers   addresses of the workers that may run it; None for all
    since     its begin in seconds of ``time.monotonic``
    """

    open_job: OpenJob[J]
    workers: tuple[str, ...] | None
    since: float


def run_attempt(act: Callable[[J], R], job: J) -> AttemptOutcome[R]:
    """Run ``act`` on a job in this worker and return the outcome, which names the worker.

    Exceptions are caught: an attempt that raises has an outcome, too.
    """
    from distributed import get_worker

    worker, begin = get_worker().address, time.perf_counter()
    try:
        return AttemptOutcome(worker, None, act(job), time.perf_counter() - begin)
    except Exception as error:
        known = (WorkerRefusedError, NetworkError, StoreFullError)
        kind: type[Exception] = next((kind for kind in known if isinstance(error, kind)), RunError)
        reason = _format_error(error) if kind is RunError else str(error)
        return AttemptOutcome(worker, kind, reason=reason, traceback=traceback.format_exc())


def outcome_of_error(error: BaseException) -> AttemptOutcome[Any]:
    """Return the outcome of an attempt whose function never returned, from the error that Dask reports instead.

    The worker died, for example. Raise RunError if the scheduler cannot load this package.
    """
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        reason = f"all of its workers have died, {error.allowed_failures + 1} of them"
        return AttemptOutcome(error.last_worker.address, RunError, reason=reason, is_death=True)
    if "deserialization of the task graph" in str(error):
        raise RunError(
            f"the scheduler cannot load this package ({type(error).__name__}); install the same impact-atlas on every "
            "host, the scheduler's too"
        )
    return AttemptOutcome("", RunError, reason=_format_error(error))


def _format_error(error: BaseException) -> str:
    """Return the type and the message of an exception in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
