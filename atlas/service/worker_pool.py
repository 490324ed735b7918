"""The Dask workers of a run, for one leased store.

They are the workers of a given client, or of a local cluster, which is started when the first job is submitted.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Generic

from atlas.errors import RunError
from atlas.service.attempts import J, R
from atlas.service.clients import start_client
from atlas.service.dispatch import MIN_WORKER_MEMORY, Dispatcher, WorkerStatus
from atlas.service.progress import prepare_kernels
from atlas.service.store_call import StoreCall
from atlas.service.summary import TileFailure
from atlas.store.object_backend import picklable_backend
from atlas.store.store import AtlasStore
from atlas.task.store_ref import StoreRef
from workers import SOLVER_VERSION


@dataclass
class WorkerPool(Generic[J, R]):
    """Dask workers for a leased store; the first use of ``dispatcher`` connects to them.

    call     call that leases the store
    handle   handle of the store, whose backend confirms the lease before it writes a finished tile
    run      function that does a job on a worker
    kernels  kernels that the jobs need, compiled before the first job
    memory   bytes of memory that a worker needs
    begin    start of the jobs, in seconds of ``time.monotonic``
    """

    call: StoreCall
    handle: AtlasStore
    run: Callable[[J], R]
    kernels: tuple[str, ...]
    memory: int = MIN_WORKER_MEMORY
    begin: float = field(default_factory=time.monotonic)

    def __post_init__(self) -> None:
        self.handle = self.handle.with_backend(self.call.backend)

    @cached_property
    def store_ref(self) -> StoreRef:
        """The reference to the store that jobs carry to the workers."""
        backend, patience = picklable_backend(self.handle.backend), self.call.options.patience
        return StoreRef(backend, self.handle.run_id, SOLVER_VERSION, patience, self.call.lease.token)

    @cached_property
    def dispatcher(self) -> Dispatcher[J, R]:
        """The dispatcher, which sends jobs to the workers; a local cluster that it starts is open until the call
        ends.
        """
        call = self.call
        if call.client is None:
            prepare_kernels(call.options.report, *self.kernels)
        client = start_client(call.client, call.threads, call.options, call.stack)
        self.begin = time.monotonic() if call.client is None else self.begin
        return Dispatcher(client, self.run, call.options.timing, self.memory)

    def iter_outcomes(self, jobs: Iterable[J], on_tick: Callable[[WorkerStatus], None]) -> Iterator[R | TileFailure]:
        """Run jobs on the workers and yield their reports or failures, as ``Dispatcher.iter_outcomes`` does.

        Raise RunError also if the lease has been lost meanwhile.
        """
        try:
            yield from self.dispatcher.iter_outcomes(jobs, on_tick)
        except RunError:
            with suppress(OSError):  # a store that cannot be reached tells nothing about its lease
                self.handle.backend.confirm_lease()  # workers refuse if the lease was lost
            raise
