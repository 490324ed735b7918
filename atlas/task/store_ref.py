"""The store of a run for its jobs: checked, fenced, with a place for parts."""

import errno
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from atlas.errors import InputError, RunError
from atlas.store.backend import Fence, StoreBackend
from atlas.store.outage import LONG_PATIENCE, SHORT_PATIENCE
from atlas.store.parts import get_part, put_part
from atlas.store.sidecar import LEASE_NAME, token_fence
from atlas.store.store import AtlasStore
from atlas.task.compile import compile_once
from atlas.task.handle_cache import cached_handle, evict_handle
from workers import SOLVER_VERSION

_FULL = (errno.ENOSPC, errno.EDQUOT)
_FORBIDDEN = (errno.EROFS, errno.EACCES, errno.EPERM)


class WorkerRefusedError(RunError):
    """This worker must not or cannot do this run's jobs; another worker may."""


class StoreFullError(RunError):
    """There is no room for the store: no worker can continue."""


@dataclass(frozen=True)
class StoreRef:
    """The store of the jobs of a run, as sent through the scheduler.

    ``claim`` is the token of the run's claim of the store: once it is lost, nothing is written. A job run by hand has
    none. ``patience``: seconds to wait for a store at a URL that does not answer.
    """

    store: str | StoreBackend
    run_id: str
    solver_version: int
    patience: float = LONG_PATIENCE
    lease: str = ""

    def open(self, name: str = "", attempt: str = "") -> AtlasStore:
        """The handle of the store, see ``open_checked``, behind the fence of the run's claim.

        With the token of an ``attempt`` also behind the fence of the ``name`` that holds it.
        """
        with translate_file_errors(self.store):
            handle = open_checked(self.store, self.run_id, self.solver_version, self.patience)
            return self.with_fences(handle, name, attempt)

    def with_fences(self, handle: AtlasStore, name: str = "", attempt: str = "") -> AtlasStore:
        """The same handle behind these fences."""
        return handle.with_backend(self._guarded(handle.backend, name, attempt))

    def write_part(self, handle: AtlasStore, group: str, name: str, data: bytes) -> None:
        """Store a part of a group."""
        with translate_file_errors(self.store):
            put_part(handle, group, name, data)

    def evict(self) -> None:
        """Drop this process's cached handles of the store."""
        evict_handle(self.store, self.patience)

    def _guarded(self, place: StoreBackend, name: str, attempt: str) -> StoreBackend:
        """A place behind the fence of a job: its run has the claim, and a note holds the token of the attempt.

        RefusedError if another run has the claim; RunError after another attempt, since nothing is wrong with this
        worker.
        """
        fences: list[Fence] = []
        if self.lease:
            lost = "the run of this job has lost its claim of the store; nothing more is written"
            fences.append(token_fence(place, LEASE_NAME, self.lease, WorkerRefusedError, lost))
        if attempt:
            lost = "another attempt at this tile has begun; nothing more is written"
            fences.append(token_fence(place, name, attempt, RunError, lost))

        def fence() -> None:
            for check in fences:
                check()

        return place.with_fence(fence) if fences else place


@dataclass(frozen=True)
class PartReport:
    """What a finished job reports: its part, the seconds of the worker's processor, and how many cells it measured."""

    index: tuple[int, ...]
    name: str
    processor_seconds: float
    cells: int = 0


def prepare_worker(site: StoreRef, kernels: Sequence[str]) -> None:
    """Check the needs of any job on this worker, and make sure that its kernels are compiled."""
    site.open()
    compile_once(*kernels)


def open_checked(
    store: str | StoreBackend, run_id: str, solver_version: int, patience: float = SHORT_PATIENCE
) -> AtlasStore:
    """The handle of the store of a run on this worker, see ``cached_handle``.

    Raises RefusedError if this worker has another solver, or sees no store or another one at the path; OSError if the
    store's disk or server refused.
    """
    check_solver(solver_version)
    try:
        handle = cached_handle(store, patience)
    except InputError as error:
        if isinstance(error.__cause__, OSError):  # the disk or the server is at fault, not the path
            raise error.__cause__ from None
        raise WorkerRefusedError(f"{error}; is the path the same on all hosts?") from None
    if handle.run_id != run_id:
        raise WorkerRefusedError(f"{store} is not the store of run {run_id}; is the path the same on all hosts?")
    return handle


def check_solver(version: int) -> None:
    """Raise RefusedError unless this worker has the solver version that a run needs."""
    if version != SOLVER_VERSION:
        raise WorkerRefusedError(f"this worker has solver version {SOLVER_VERSION}, the run needs {version}")


@contextmanager
def translate_file_errors(store: object) -> Iterator[None]:
    """Turn errors of the file system into errors of the run: no room at all, or not for this worker; others pass."""
    try:
        yield
    except OSError as error:
        what = f"{store}: {error.strerror or error}"
        if error.errno in _FULL:
            raise StoreFullError(what) from error
        if error.errno in _FORBIDDEN:
            raise WorkerRefusedError(what) from error
        raise


def stored_part(handle: AtlasStore, group: str, name: str) -> bytes:
    """A part stored by a job; RefusedError if there is none."""
    data = get_part(handle, group, name)
    if data is None:
        raise WorkerRefusedError(f"{handle.backend}: has no part {name}; is the path the same on all hosts?")
    return data
