"""One tile: what is to be done, doing it here and now, and the receipt for it."""

import errno
import re
import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from atlas.errors import ChunkError, InputError, RunError
from atlas.store.location import Place, place_of
from atlas.store.outage import BRIEF, LONG
from atlas.store.schema import extra_sizes
from atlas.store.sidecar import claim_token, notes_of
from atlas.store.store import Header, is_done, read_header
from atlas.store.tally import tile_entry
from atlas.store.tiles import finish_replacement, read_tile, write_tile
from atlas.task.compile import compile_once
from atlas.task.retry import Retry, solve_again
from atlas.task.reuse import known_cells, solve_unknown
from atlas.task.solving import kernels_of
from workers import SOLVER_VERSION
from workers.results import REASON, REGIME, REGIMES, empty_results, reason_counts

_FULL = (errno.ENOSPC, errno.EDQUOT)
_FORBIDDEN = (errno.EROFS, errno.EACCES, errno.EPERM)


class RefusedError(RunError):
    """This worker must not or cannot do this run's tiles; another worker may."""


class StoreFullError(RunError):
    """There is no room for the store: no worker can go on."""


@dataclass(frozen=True)
class Job:
    """Which tile of which store. All that crosses the scheduler; ``attempt.run_job`` redoes it by hand.

    ``retry`` solves some cells of a finished tile again, in place of all of an unfinished one; ``patience`` is for how
    many seconds a store at a URL that does not answer is waited for. ``claim`` is the token of the run's claim of the
    store: a job whose run has lost it writes nothing. A job done by hand has none.
    """

    index: tuple[int, ...]
    store: str
    run_id: str
    solver_version: int
    retry: Retry | None = None
    patience: float = LONG
    claim: str = ""


@dataclass(frozen=True)
class Receipt:
    """What a finished tile reports.

    cells, counts, reasons          solved, in all and of each regime; those without a certain result by the reason
    taken                           cells copied from the store that this one extends
    solve_seconds, write_seconds    inside the solver; inside the store
    processor_seconds               of the solver's thread
    periods                         forcing periods simulated
    peak_bytes                      most memory that the worker's process ever had
    changed                         cells solved again that came out of another regime
    entry                           of the whole tile in the store's tally, see ``store.tally``
    """

    index: tuple[int, ...]
    cells: int
    counts: dict[str, int]
    reasons: dict[str, int]
    solve_seconds: float
    write_seconds: float
    periods: int
    peak_bytes: int
    taken: int = 0
    processor_seconds: float = 0.0
    changed: int = 0
    entry: tuple[float, ...] = ()


def solve_and_write(job: Job) -> Receipt:
    """Solve a tile and write it, here and now."""
    with file_errors(job.store):
        header = checked_header(job.store, job.run_id, job.solver_version, job.patience)
        spec, tile = header.spec, header.tiling.at(job.index)
        if job.retry is None:
            stored, unknown = known_cells(header, tile.slices)
        else:
            stored = finished_tile(header, job)
    compile_once(*kernels_of(spec))  # its own disk may be full, which is not the store's
    begin, busy = time.perf_counter(), time.thread_time()
    if job.retry is None:
        arrays, solved = solve_unknown(spec, tile.slices, stored, unknown), unknown
    else:
        cells = {name: np.broadcast_to(value, tile.shape) for name, value in spec.cell_params(tile.slices).items()}
        arrays, solved = solve_again(spec, cells, stored, job.retry)
    middle, processor = time.perf_counter(), time.thread_time() - busy
    with file_errors(job.store):
        # Another attempt may have finished meanwhile: what is stored then stays.
        if solved.any() if job.retry is not None else not is_done(header, job.index):
            commit(header, job, arrays)
        else:
            arrays = stored_tile(header, job.index)
    return replace(
        receipt_of(header, job.index, arrays, solved),
        taken=int((~solved).sum()) if job.retry is None else 0,
        changed=0 if job.retry is None else int((arrays[REGIME.name] != stored[REGIME.name])[solved].sum()),
        solve_seconds=middle - begin,
        processor_seconds=processor,
        write_seconds=time.perf_counter() - middle,
    )


def commit(header: Header, job: Job, arrays: dict[str, np.ndarray]) -> None:
    """Write a tile, unless the run of the job has lost its claim of the store while it was solved.

    What is not excluded is a worker that stands still for so long between this look and the end of its writes that
    another run replaces the claim. It then writes the bits that the other run writes too, except in a retry.
    """
    check_claim(header.place, job.claim)
    write_tile(header, job.index, arrays)


def check_claim(place: Place, token: str) -> None:
    """Raise RefusedError where the claim of a store is not the one of that token; one read, none for no token."""
    if token and claim_token(notes_of(place)) != token:
        raise RefusedError(f"{place}: the run of this tile has lost its claim of the store; nothing more is written")


def checked_header(store: str, run_id: str, solver_version: int, patience: float = BRIEF) -> Header:
    """The header of the store that a run asks this worker to work on.

    Raises RefusedError where this worker has another solver, or sees no store or another one at the path; OSError
    where the store's disk or server refused.
    """
    check_solver(solver_version)
    try:
        header = read_header(place_of(store, patience))
    except InputError as error:
        if isinstance(error.__cause__, OSError):  # the disk or the server is at fault, not the path
            raise error.__cause__ from None
        raise RefusedError(f"{error}; is the path the same on all hosts?") from None
    if header.run_id != run_id:
        raise RefusedError(f"{store} is not the store of run {run_id}; is the path the same on all hosts?")
    return header


def check_solver(version: int) -> None:
    """Raise RefusedError unless this worker has the solver version that a run needs."""
    if version != SOLVER_VERSION:
        raise RefusedError(f"this worker has solver version {SOLVER_VERSION}, the run needs {version}")


@contextmanager
def file_errors(store: str) -> Iterator[None]:
    """Errors of the file system by what they mean for the run: no room for anybody, or not for this worker.

    Others pass as they are: the tile may be tried again.
    """
    try:
        yield
    except OSError as error:
        what = f"{store}: {error.strerror or error}"
        if error.errno in _FULL:
            raise StoreFullError(what) from error
        if error.errno in _FORBIDDEN:
            raise RefusedError(what) from error
        raise


def finished_tile(header: Header, job: Job) -> dict[str, np.ndarray]:
    """``stored_tile`` of a tile that is to be solved again; an attempt that died may have left its new contents."""
    try:
        return stored_tile(header, job.index)
    except ChunkError:
        check_claim(header.place, job.claim)
        if not finish_replacement(header, job.index):
            raise
        return stored_tile(header, job.index)


def stored_tile(header: Header, index: tuple[int, ...]) -> dict[str, np.ndarray]:
    """All arrays of a finished tile: of results that an older store does not have, their fill values."""
    shape = header.tiling.at(index).shape
    blank = empty_results(header.spec.variables, shape, extra_sizes(header.spec))
    return blank | read_tile(header, index)


def receipt_of(header: Header, index: tuple[int, ...], arrays: dict[str, np.ndarray], solved: np.ndarray) -> Receipt:
    """The receipt of a tile with these arrays, whose cells ``solved`` count; without times."""
    arrays = header.leading(arrays)
    codes = arrays[REGIME.name][solved]
    counts = {regime.name: int(np.count_nonzero(codes == regime.code)) for regime in REGIMES}
    return Receipt(
        index=index,
        cells=int(solved.sum()),
        counts={name: count for name, count in counts.items() if count},
        reasons=reason_counts(arrays[REASON.name][solved]),
        solve_seconds=0.0,
        write_seconds=0.0,
        periods=int(arrays["periods_used"][solved].sum(dtype="int64")),
        peak_bytes=peak_memory(),
        entry=tuple(tile_entry(header.spec, header.tiling.at(index).slices, arrays).tolist()),
    )


def peak_memory() -> int:
    """Most bytes of memory that this process ever had.

    Linux has it in /proc; its getrusage would count what the parent had when it started this process.
    """
    try:
        found = re.search(r"^VmHWM:\s+(\d+) kB$", Path("/proc/self/status").read_text(encoding="ascii"), re.MULTILINE)
    except OSError:
        found = None
    if found:
        return 1024 * int(found[1])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
