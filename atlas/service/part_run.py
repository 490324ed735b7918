"""A computation on the workers whose intermediate results, the parts, are kept in the store, so that it can be
resumed.
"""

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, Protocol, TypeVar

from atlas.errors import RunError
from atlas.service.attempts import IndexedJob
from atlas.service.dispatch import WorkerStatus
from atlas.service.progress import Progress
from atlas.service.store_call import StoreCall
from atlas.service.summary import TileFailure
from atlas.service.worker_pool import WorkerPool
from atlas.store.parts import drop_parts, finished_parts
from atlas.store.store import AtlasStore
from atlas.store.zarr_backend import check_not_packed
from atlas.task.store_ref import PartReport


class PartJob(IndexedJob, Protocol):
    """A job that computes one part, an intermediate result, and writes it into the store."""

    @property
    def part(self) -> str:
        """Path of the part in the store: its group and its name."""


P = TypeVar("P", bound=PartJob)


@dataclass(frozen=True, kw_only=True)
class PartCost:
    """The cost of a computation on the workers; 0 if the store had its result already.

    seconds            duration
    processor_seconds  processor time of the workers
    workers            number of worker threads
    tasks              number of jobs
    """

    seconds: float = 0.0
    processor_seconds: float = 0.0
    workers: int = 0
    tasks: int = 0


class PartRun(Generic[P]):
    """A computation on the workers of a call, whose intermediate results are parts of the call's store, which is
    leased.

    call     the call
    handle   handle of the store
    act      function that does a job on a worker
    kernels  kernels that the jobs need
    digests  digest of the computation by group of its parts; stored parts of another computation are removed

    The attribute ``handle`` is the handle whose backend confirms the lease. ``cells`` is the number of cells of the
    jobs done.
    """

    def __init__(
        self,
        call: StoreCall,
        handle: AtlasStore,
        act: Callable[[P], PartReport],
        kernels: tuple[str, ...],
        digests: Mapping[str, str],
    ) -> None:
        check_not_packed(handle.backend)
        call.connect()
        call.acquire_lease()
        self.pool, self.digests = WorkerPool(call, handle, act, kernels), digests
        self.handle, self.workers = self.pool.handle, call.threads
        self.tasks = self.cells = 0
        self.processor_seconds = 0.0

    @cached_property
    def stored(self) -> set[str]:
        """The parts, as "group/name", that earlier calls of the same computation have stored."""
        groups = self.digests.items()
        return {f"{group}/{name}" for group, digest in groups for name in finished_parts(self.handle, group, digest)}

    def run(self, jobs: Iterable[P], get_progress: Callable[[], Progress]) -> None:
        """Run the jobs whose parts are not stored yet, and report progress.

        ``get_progress`` returns the present progress. Raise RunError if a job fails for good.
        """

        def tick(status: WorkerStatus) -> None:
            self.pool.call.lease.check()
            self.workers = max(self.workers, status.threads)
            waiting = "" if status.threads else "no workers connected: waiting for one to join"
            self._report(get_progress(), status.trouble or waiting)

        missing = [job for job in jobs if job.part not in self.stored]
        for outcome in self.pool.iter_outcomes(missing, tick) if missing else ():
            if isinstance(outcome, TileFailure):
                raise RunError(
                    f"a job failed: {outcome.message}; finished parts are kept, rerun the same command to resume"
                )
            self.tasks, self.cells = self.tasks + 1, self.cells + outcome.cells
            self.processor_seconds += outcome.processor_seconds
            self._report(get_progress())

    def end(self) -> PartCost:
        """Remove the parts from the store, once the final result is written, and return the cost of the computation."""
        for group in self.digests:
            drop_parts(self.handle, group)
        seconds = time.monotonic() - self.pool.begin
        return PartCost(
            seconds=seconds, processor_seconds=self.processor_seconds, workers=self.workers, tasks=self.tasks
        )

    def _report(self, progress: Progress, trouble: str = "") -> None:
        """Report the progress of the jobs, or ``trouble``, the reason why none makes progress."""
        seconds = time.monotonic() - self.pool.begin
        self.pool.call.options.report(replace(progress, stage=trouble or progress.stage, seconds=seconds))
