"""The Dask workers of a run, for one leased store.

A pool uses the workers of a given client, or starts a local cluster when the first job is submitted.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Generic, Protocol, TypeVar

from atlas.errors import RunError
from atlas.service.attempts import J, R
from atlas.service.clients import start_client
from atlas.service.dispatch import MIN_WORKER_MEMORY, Dispatcher, WorkerStatus
from atlas.service.progress import LOG_INTERVAL, Progress, prepare_kernels
from atlas.service.store_call import StoreCall
from atlas.service.summary import TileFailure
from atlas.store.object_backend import picklable_backend
from atlas.store.store import AtlasStore
from atlas.task.store_ref import StoreRef
from workers import SOLVER_VERSION


class TimedReport(Protocol):
    """The report of a finished job, with its processor time."""

    @property
    def processor_seconds(self) -> float:
        """Seconds of a worker's processor that the job took."""


T = TypeVar("T", bound=TimedReport)


@dataclass
class WorkerPool(Generic[J, R]):
    """Dask workers for a leased store; the first use of ``dispatcher`` sets them up.

    call     call that leases the store
    handle   handle of the store, whose commits confirm the lease
    run      function that does a job on a worker
    kernels  kernels that the jobs need, compiled before the first job
    memory   bytes of memory that a worker needs
    threads  number of worker threads: as requested, later the largest number observed
    begin    start of the jobs, in seconds of ``time.monotonic``

    ``tasks`` and ``processor_seconds`` are totals over the jobs of ``run_jobs``.
    """

    call: StoreCall
    handle: AtlasStore
    run: Callable[[J], R]
    kernels: tuple[str, ...]
    memory: int = MIN_WORKER_MEMORY
    begin: float = field(default_factory=time.monotonic)
    tasks: int = 0
    processor_seconds: float = 0.0
    reported: float = 0.0
    last: str = ""

    def __post_init__(self) -> None:
        self.handle, self.threads = self.handle.with_backend(self.call.backend), self.call.threads

    @cached_property
    def store_ref(self) -> StoreRef:
        """The reference to the store that jobs receive."""
        backend, patience = picklable_backend(self.handle.backend), self.call.options.patience
        return StoreRef(backend, self.handle.run_id, SOLVER_VERSION, patience, self.call.lease.token)

    @cached_property
    def dispatcher(self) -> Dispatcher[J, R]:
        """The dispatcher of the pool's workers; a local cluster is open until the call ends."""
        call = self.call
        if call.client is None:
            prepare_kernels(call.options.report, *self.kernels)
        client = start_client(call.client, self.threads, call.options, call.stack)
        self.begin = time.monotonic() if call.client is None else self.begin
        return Dispatcher(client, self.run, call.options.timing, self.memory)

    def iter_outcomes(self, jobs: Iterable[J], on_tick: Callable[[WorkerStatus], None]) -> Iterator[R | TileFailure]:
        """Yield the outcomes of jobs as ``Dispatcher.iter_outcomes`` does.

        Raise RunError also if the lease has been lost meanwhile.
        """
        try:
            yield from self.dispatcher.iter_outcomes(jobs, on_tick)
        except RunError:
            with suppress(OSError):  # a store that cannot be reached tells nothing about its lease
                self.handle.backend.confirm_lease()  # workers refuse if the lease was lost
            raise

    def run_jobs(
        self: "WorkerPool[J, T]",
        jobs: Sequence[J],
        get_progress: Callable[[], Progress],
        on_result: Callable[[T], None] = lambda _: None,
    ) -> None:
        """Run jobs whose results are parts of the store, and call ``on_result`` with each report.

        ``get_progress`` returns the snapshot to show. Raise RunError if a job fails for good.
        """

        def tick(workers: WorkerStatus) -> None:
            self.call.lease.check()
            self.threads = max(self.threads, workers.threads)
            waiting = "" if workers.threads else "no workers connected: waiting for one to join"
            self._report(get_progress(), workers.trouble or waiting)

        for outcome in self.iter_outcomes(jobs, tick) if jobs else ():
            if isinstance(outcome, TileFailure):
                raise RunError(
                    f"a job failed: {outcome.message}; finished parts are kept, rerun the same command to resume"
                )
            self.tasks += 1
            self.processor_seconds += outcome.processor_seconds
            on_result(outcome)
            self._report(get_progress())

    def _report(self, progress: Progress, trouble: str = "") -> None:
        """Report the progress of the jobs; for a log once every LOG_INTERVAL seconds."""
        now = time.monotonic()
        stage = trouble or progress.stage
        passing = now - self.reported < LOG_INTERVAL or stage == self.last
        if not passing:
            self.reported, self.last = now, stage
        self.call.options.report(replace(progress, stage=stage, transient=passing))
