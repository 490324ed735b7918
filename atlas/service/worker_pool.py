"""The Dask workers of a run, for one leased store.

A pool uses the workers of a given client, or starts a local cluster when the first job is submitted.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from atlas.errors import RunError
from atlas.service.attempts import J, R
from atlas.service.clients import check_client, connect_client, start_client, worker_count
from atlas.service.cluster import leave_if_bootstrapping
from atlas.service.dispatch import MIN_WORKER_MEMORY, Dispatcher, WorkerStatus
from atlas.service.lease import Lease, hold_lease
from atlas.service.notebook import progress_reporter
from atlas.service.options import RunOptions
from atlas.service.progress import LOG_INTERVAL, Progress, prepare_kernels
from atlas.service.summary import TileFailure
from atlas.store.create import remove_half_made
from atlas.store.object_backend import Given, StoreBackend, open_backend, picklable_backend, with_patience
from atlas.store.sidecar import LEASE_NAME, clear_sidecar, read_lease_token, sidecar_of
from atlas.store.store import AtlasStore, open_store
from atlas.task.store_ref import StoreRef
from workers import SOLVER_VERSION

if TYPE_CHECKING:
    from distributed import Client


class TimedReport(Protocol):
    """The report of a finished job, with its processor time."""

    @property
    def processor_seconds(self) -> float:
        """Seconds of a worker's processor that the job took."""


T = TypeVar("T", bound=TimedReport)


@dataclass
class WorkerPool(Generic[J, R]):
    """Dask workers for a leased store; the first use of ``dispatcher`` sets them up.

    run      function that does a job on a worker
    kernels  kernels that the jobs need, compiled before the first job
    threads  number of worker threads: as requested, later the largest number observed
    memory   bytes of memory that a worker needs
    begin    start of the jobs, in seconds of ``time.monotonic``

    ``tasks`` and ``processor_seconds`` are totals over the jobs of ``run_jobs``.
    """

    handle: AtlasStore
    run: Callable[[J], R]
    kernels: tuple[str, ...]
    options: RunOptions
    lease: Lease
    stack: ExitStack
    threads: int
    client: "Client | None"
    memory: int = MIN_WORKER_MEMORY
    begin: float = field(default_factory=time.monotonic)
    tasks: int = 0
    processor_seconds: float = 0.0
    reported: float = 0.0
    last: str = ""

    @classmethod
    def open(
        cls,
        handle: AtlasStore,
        act: Callable[[J], R],
        kernels: tuple[str, ...],
        client: "Client | None",
        options: RunOptions,
        stack: ExitStack,
    ) -> "WorkerPool[J, R]":
        """Lease a store until ``stack`` is closed, and return its pool.

        The commits of the pool's handle confirm the lease.
        """
        client = connect_client(client, options, stack)
        threads = worker_count(client, options)
        claim = stack.enter_context(hold_store_lease(handle.backend, options))
        return cls(
            handle.with_backend(claim.bind(handle.backend)),
            act,
            kernels,
            options,
            claim,
            stack,
            threads,
            client,
        )

    @cached_property
    def store_ref(self) -> StoreRef:
        """The reference to the store that jobs receive."""
        handle = self.handle
        return StoreRef(
            picklable_backend(handle.backend), handle.run_id, SOLVER_VERSION, self.options.patience, self.lease.token
        )

    @cached_property
    def dispatcher(self) -> Dispatcher[J, R]:
        """The dispatcher of the pool's workers; a local cluster is open until ``stack`` is closed."""
        if self.client is None:
            prepare_kernels(self.options.report, *self.kernels)
        client = start_client(self.client, self.threads, self.options, self.stack)
        self.begin = time.monotonic() if self.client is None else self.begin
        return Dispatcher(client, self.run, self.options.timing, self.memory)

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
            self.lease.check()
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
        self.options.report(replace(progress, stage=stage, transient=passing))


@contextmanager
def open_store_call(
    store: "Given | AtlasStore", client: "Client | None", options: RunOptions
) -> Iterator[tuple[AtlasStore, RunOptions, ExitStack]]:
    """Begin a call that works on a store, and yield its handle, the options with a progress reporter, and a stack.

    The stack is closed when the call ends. The handle waits ``options.patience`` seconds for a server that does not
    respond. Raise InputError if the client contradicts the options, or if there is no atlas at ``store``.
    """
    leave_if_bootstrapping()
    check_client(client, options)
    with progress_reporter(options.on_progress) as report, ExitStack() as stack:
        options = replace(options, on_progress=report)
        if isinstance(store, AtlasStore):
            handle = store.with_backend(with_patience(store.backend, options.patience))
        else:
            backend = open_backend(store, storage_options=options.storage_options)
            handle = open_store(with_patience(backend, options.patience))
        yield handle, options, stack


@contextmanager
def hold_store_lease(backend: StoreBackend, options: RunOptions) -> Iterator[Lease]:
    """Hold the lease of a store within the block.

    Partial stores left by killed runs are removed at the start, and the sidecar files of this run at the end. A single
    heartbeat waits only as long as the backend does. The run as a whole waits ``options.patience`` seconds for the
    store; meanwhile every commit still confirms the lease.
    """
    notes = sidecar_of(with_patience(backend, options.patience))

    def say(text: str) -> None:
        options.report(Progress(text))

    def tidy() -> None:
        if read_lease_token(notes) == claim.token:  # else the sidecar belongs to another run
            clear_sidecar(notes, (key for key in notes.list_keys() if key != LEASE_NAME))

    patience = options.patience if backend.local is None else 0.0
    with hold_lease(sidecar_of(backend), str(backend), say, options.timing, patience) as claim:
        if backend.local is not None:
            remove_half_made(backend.local)
        try:
            yield claim
        except Exception:
            raise  # sidecar files of unfinished tiles stay: the tiles may be the cause
        except BaseException:
            tidy()
            raise
        tidy()
