"""The store of a run for its jobs: checked, fenced, with a place for parts."""

import errno
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from atlas.errors import InputError, RunError
from atlas.store.outage import BRIEF, LONG
from atlas.store.parts import get_part, put_part
from atlas.store.place import Fence, Place
from atlas.store.sidecar import CLAIM, note_fence
from atlas.store.store import Atlas
from atlas.task.compile import compile_once
from atlas.task.known import forget_handle, known_handle
from workers import SOLVER_VERSION

_FULL = (errno.ENOSPC, errno.EDQUOT)
_FORBIDDEN = (errno.EROFS, errno.EACCES, errno.EPERM)


class RefusedError(RunError):
    """This worker must not or cannot do this run's jobs; another worker may."""


class StoreFullError(RunError):
    """There is no room for the store: no worker can continue."""


@dataclass(frozen=True)
class Site:
    """The store of the jobs of a run, as sent through the scheduler.

    ``claim`` is the token of the run's claim of the store: once it is lost, nothing is written. A job run by hand has
    none. ``patience``: seconds to wait for a store at a URL that does not answer.
    """

    store: str | Place
    run_id: str
    solver_version: int
    patience: float = LONG
    claim: str = ""

    def handle(self, note: str = "", attempt: str = "") -> Atlas:
        """The handle of the store, see ``checked_handle``, behind the fence of the run's claim.

        With the token of an ``attempt`` also behind the fence of the ``note`` that holds it.
        """
        with file_errors(self.store):
            handle = checked_handle(self.store, self.run_id, self.solver_version, self.patience)
            return self.fenced(handle, note, attempt)

    def fenced(self, handle: Atlas, note: str = "", attempt: str = "") -> Atlas:
        """The same handle behind these fences."""
        return handle.at(self._guarded(handle.place, note, attempt))

    def keep(self, handle: Atlas, group: str, name: str, data: bytes) -> None:
        """Store a part of a group."""
        with file_errors(self.store):
            put_part(handle, group, name, data)

    def forget(self) -> None:
        """Drop this process's cached handles of the store."""
        forget_handle(self.store, self.patience)

    def _guarded(self, place: Place, note: str, attempt: str) -> Place:
        """A place behind the fence of a job: its run has the claim, and a note holds the token of the attempt.

        RefusedError if another run has the claim; RunError after another attempt, since nothing is wrong with this
        worker.
        """
        fences: list[Fence] = []
        if self.claim:
            lost = "the run of this job has lost its claim of the store; nothing more is written"
            fences.append(note_fence(place, CLAIM, self.claim, RefusedError, lost))
        if attempt:
            lost = "another attempt at this tile has begun; nothing more is written"
            fences.append(note_fence(place, note, attempt, RunError, lost))

        def fence() -> None:
            for check in fences:
                check()

        return place.behind(fence) if fences else place


@dataclass(frozen=True)
class PartReceipt:
    """What a finished job reports: its part, the seconds of the worker's processor, and how many cells it measured."""

    index: tuple[int, ...]
    name: str
    processor_seconds: float
    cells: int = 0


def prepare(site: Site, kernels: Sequence[str]) -> None:
    """Check the needs of any job on this worker, and make sure that its kernels are compiled."""
    site.handle()
    compile_once(*kernels)


def checked_handle(store: str | Place, run_id: str, solver_version: int, patience: float = BRIEF) -> Atlas:
    """The handle of the store of a run on this worker, see ``known_handle``.

    Raises RefusedError if this worker has another solver, or sees no store or another one at the path; OSError if the
    store's disk or server refused.
    """
    check_solver(solver_version)
    try:
        handle = known_handle(store, patience)
    except InputError as error:
        if isinstance(error.__cause__, OSError):  # the disk or the server is at fault, not the path
            raise error.__cause__ from None
        raise RefusedError(f"{error}; is the path the same on all hosts?") from None
    if handle.run_id != run_id:
        raise RefusedError(f"{store} is not the store of run {run_id}; is the path the same on all hosts?")
    return handle


def check_solver(version: int) -> None:
    """Raise RefusedError unless this worker has the solver version that a run needs."""
    if version != SOLVER_VERSION:
        raise RefusedError(f"this worker has solver version {SOLVER_VERSION}, the run needs {version}")


@contextmanager
def file_errors(store: object) -> Iterator[None]:
    """Turn errors of the file system into errors of the run: no room at all, or not for this worker; others pass."""
    try:
        yield
    except OSError as error:
        what = f"{store}: {error.strerror or error}"
        if error.errno in _FULL:
            raise StoreFullError(what) from error
        if error.errno in _FORBIDDEN:
            raise RefusedError(what) from error
        raise


def stored_part(handle: Atlas, group: str, name: str) -> bytes:
    """A part stored by a job; RefusedError if there is none."""
    data = get_part(handle, group, name)
    if data is None:
        raise RefusedError(f"{handle.place}: has no part {name}; is the path the same on all hosts?")
    return data
