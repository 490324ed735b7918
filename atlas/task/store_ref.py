"""The reference to the store of a run that jobs carry to the workers, which open and check the store by it."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from atlas.errors import InputError, RunError
from atlas.store.backend import StoreBackend
from atlas.store.handle_cache import cached_handle
from atlas.store.outage import LONG_PATIENCE, SHORT_PATIENCE
from atlas.store.parts import get_part, put_part
from atlas.store.sidecar import with_confirmation
from atlas.store.store import AtlasStore
from workers import SOLVER_VERSION

_FULL = (errno.ENOSPC, errno.EDQUOT)
_FORBIDDEN = (errno.EROFS, errno.EACCES, errno.EPERM)


class WorkerRefusedError(RunError):
    """This worker must not or cannot do the jobs of this run; another worker may."""


class StoreFullError(RunError):
    """The store has no space left: no worker can continue."""


@dataclass(frozen=True)
class StoreRef:
    """The reference to the store of a run, as jobs carry it through the scheduler to the workers.

    store            path or URL, or backend
    run_id           identifier of the run that created the store
    solver_version   solver version of the store
    patience         seconds to wait for a store at a URL that does not respond
    lease            token of the run's lease of the store, empty for a job that is run by hand; nothing is finished
                     once the lease is lost
    """

    store: str | StoreBackend
    run_id: str
    solver_version: int
    patience: float = LONG_PATIENCE
    lease: str = ""

    def open(self) -> AtlasStore:
        """Return the handle of the store on this worker, with a backend that confirms the lease of the run.

        Its writes that finish a tile raise WorkerRefusedError if the run has lost its lease. See ``open_checked``.
        """
        with translate_file_errors(self.store):
            handle = open_checked(self.store, self.run_id, self.solver_version, self.patience)
        if not self.lease:
            return handle
        lost = "the run that sent this job has lost its lease; nothing more is finished"
        return handle.with_backend(with_confirmation(handle.backend, self.lease, WorkerRefusedError, lost))

    def write_part(self, handle: AtlasStore, group: str, name: str, data: bytes) -> None:
        """Store an intermediate result of a search, as a part of a group."""
        with translate_file_errors(self.store):
            put_part(handle, group, name, data)


@dataclass(frozen=True)
class PartReport:
    """The report of a finished job whose result is a part, an intermediate result in the store.

    index               index of the job
    name                name of the part
    processor_seconds   processor time of the worker, in seconds
    cells               number of cells that were measured
    """

    index: tuple[int, ...]
    name: str
    processor_seconds: float
    cells: int = 0


def open_checked(
    store: str | StoreBackend, run_id: str, solver_version: int, patience: float = SHORT_PATIENCE
) -> AtlasStore:
    """Return the handle of a run's store, after checks that this worker may do jobs of the run.

    Raise WorkerRefusedError if this worker has another solver version, or sees no store or another store at the path.
    Raise OSError if the store's disk or server refuses access. See ``cached_handle``.
    """
    check_solver(solver_version)
    try:
        handle = cached_handle(store, patience)
    except InputError as error:
        if isinstance(error.__cause__, OSError):  # the disk or the server is at fault, not the path
            raise error.__cause__ from None
        raise WorkerRefusedError(f"{error}; check that the path is the same on every host") from None
    if handle.run_id != run_id:
        raise WorkerRefusedError(
            f"{store} is not the store of run {run_id}; check that the path is the same on every host"
        )
    return handle


def check_solver(version: int) -> None:
    """Raise WorkerRefusedError unless this worker has the solver version that a run needs."""
    if version != SOLVER_VERSION:
        raise WorkerRefusedError(f"this worker has solver version {SOLVER_VERSION}, the run needs {version}")


@contextmanager
def translate_file_errors(store: object) -> Iterator[None]:
    """Convert file-system errors within the block into errors about jobs; other errors pass.

    A lack of space becomes StoreFullError, a lack of permission WorkerRefusedError.
    """
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
    """Return the bytes of a part, an intermediate result that another job has stored.

    Raise WorkerRefusedError if it is missing.
    """
    data = get_part(handle, group, name)
    if data is None:
        raise WorkerRefusedError(f"{handle.backend}: has no part {name}; check that the path is the same on every host")
    return data
