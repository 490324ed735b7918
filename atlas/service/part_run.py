"""A computation in parts on the workers: the store keeps finished parts, so that the same call resumes it."""

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
    """A job that writes one part of a computation."""

    @property
    def part(self) -> str:
        """The group and the name of the part."""


P = TypeVar("P", bound=PartJob)


@dataclass(frozen=True, kw_only=True)
class PartCost:
    """The cost of a computation in parts; 0 if the store had its result already.

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
    """A computation in parts, on the workers of a call and in its store, which is leased.

    call     the call
    handle   handle of the store; that of the run has commits that confirm the lease
    act      function that does a job on a worker
    kernels  kernels that the jobs need
    digests  digest of the computation by group of its parts; stored parts of another computation are removed

    ``cells`` is the number of cells of the jobs done.
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
        """The parts, as group and name, that earlier calls have stored."""
        groups = self.digests.items()
        return {f"{group}/{name}" for group, digest in groups for name in finished_parts(self.handle, group, digest)}

    def run(self, jobs: Iterable[P], get_progress: Callable[[], Progress]) -> None:
        """Run the jobs whose parts are not stored. ``get_progress`` returns the snapshot to show.

        Raise RunError if a job fails for good.
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
        """Remove the parts, once the result is written, and return the cost of the computation."""
        for group in self.digests:
            drop_parts(self.handle, group)
        seconds = time.monotonic() - self.pool.begin
        return PartCost(
            seconds=seconds, processor_seconds=self.processor_seconds, workers=self.workers, tasks=self.tasks
        )

    def _report(self, progress: Progress, trouble: str = "") -> None:
        """Report the progress of the jobs, or why none makes progress."""
        seconds = time.monotonic() - self.pool.begin
        self.pool.call.options.report(replace(progress, stage=trouble or progress.stage, seconds=seconds))
