"""One tile: what is to be done, doing it here and now, and the receipt for it."""

import errno
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from atlas.errors import ChunkError, InputError, RunError
from atlas.overview.pyramid import opened
from atlas.platform import peak_memory
from atlas.spec.spec import Slices, Spec
from atlas.store.location import Place
from atlas.store.outage import BRIEF, LONG
from atlas.store.place import Fence
from atlas.store.records import read_record, single_records
from atlas.store.schema import extra_sizes
from atlas.store.sidecar import CLAIM, note_fence
from atlas.store.store import Header, is_done
from atlas.store.tiles import finish_replacement, read_tile, write_tile
from atlas.store.tiling import PART, Tiling
from atlas.task.basins import complete_basins
from atlas.task.compile import compile_once
from atlas.task.known import known_header
from atlas.task.retry import Retry, solve_again
from atlas.task.reuse import known_cells
from atlas.task.solving import kernels_of, solve_block
from workers import SOLVER_VERSION
from workers.results import REASON, REGIME, REGIMES, empty_results, reason_counts

_FULL = (errno.ENOSPC, errno.EDQUOT)
_FORBIDDEN = (errno.EROFS, errno.EACCES, errno.EPERM)
Arrays = dict[str, np.ndarray]
Solver = Callable[[Slices, Arrays, np.ndarray], Arrays]
"""Solves the cells of a mask in some slices, where it is given what is known of all of them."""

LABELS = -1
"""The level of the job that labels basins."""


class RefusedError(RunError):
    """This worker must not or cannot do this run's tiles; another worker may."""


class StoreFullError(RunError):
    """There is no room for the store: no worker can go on."""


@dataclass(frozen=True)
class Job:
    """Which tile of which store. All that crosses the scheduler; ``attempt.do_job`` does it by hand.

    With a ``level`` above 0 it is the chunk of that level of the overviews that has this index; at level LABELS, the
    last labels of basins. ``retry`` solves some cells of a finished tile again, in place of all of an unfinished one.
    ``replaced`` says that a killed attempt left the tile's new contents beside it. ``patience`` is how many seconds to
    wait for a store at a URL that does not answer. ``claim`` is the token of the run's claim of the store: a job whose
    run has lost the claim writes nothing. A job done by hand has none. ``attempt`` is the token of this attempt at the
    tile, which ``attempt.run_job`` gives it: of two attempts that live the first writes nothing more.
    """

    index: tuple[int, ...]
    store: str
    run_id: str
    solver_version: int
    retry: Retry | None = None
    patience: float = LONG
    claim: str = ""
    level: int = 0
    replaced: bool = False
    attempt: str = ""

    @property
    def note(self) -> str:
        """The name of the note that holds the token of the present attempt at the tile."""
        return "started-" + "-".join(map(str, self.index))


@dataclass(frozen=True)
class Receipt:
    """What a finished tile reports.

    cells, counts, reasons          cells solved; by regime; by the reason why they have no certain result
    taken                           cells copied from the store that this one extends
    solve_seconds, write_seconds    inside the solver; inside the store
    processor_seconds               of the solver's thread
    periods                         forcing periods simulated
    peak_bytes                      peak memory of the worker's process
    changed                         cells solved again whose regime changed
    record                          of the whole tile, see ``store.record``; empty if unknown
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
    record: tuple[float, ...] = ()


@dataclass(frozen=True)
class Made:
    """What a job reports that is no tile: new records of tiles, and what it could not make."""

    index: tuple[int, ...]
    records: tuple[tuple[tuple[int, ...], tuple[float, ...]], ...] = ()
    fault: str = ""


def make_chunk(job: Job) -> Made:
    """Make a chunk of the overviews."""
    with file_errors(job.store):
        header = header_of(job)
        try:
            opened(header, job.claim).make(job.level, job.index)
        except RefusedError:
            raise
        except (RunError, ValueError) as error:  # damage below is not the worker's fault
            return Made(job.index, fault=str(error))
    return Made(job.index)


def label_basins(job: Job) -> Made:
    """Give the cells of an atlas of basins their last labels, and write the table of its attractors."""
    with file_errors(job.store):
        header = header_of(job)
        complete_basins(header)
        # All of them: an attempt that died may have written a tile again.
        return Made(job.index, tuple((index, stored_record(header, index)) for index in single_records(header)))


def solve_and_write(job: Job, solver: Solver | None = None) -> Receipt:
    """Solve a tile and write it. ``solver`` solves its parts, by default in this thread."""
    with file_errors(job.store):
        header = header_of(job)
        slices = header.tiling.at(job.index).slices
        stored, solved = stored_cells(header, job, slices)
    compile_once(*kernels_of(header.spec))  # its own disk may be full, which is not the store's
    begin, busy = time.perf_counter(), time.thread_time()
    arrays = solve_cells(header.spec, job, slices, stored, solved, solver)
    middle, processor = time.perf_counter(), time.thread_time() - busy
    with file_errors(job.store):
        # Another attempt may have finished meanwhile: what is stored then stays.
        if solved.any() if job.retry is not None else not is_done(header, job.index):
            record = commit(header, job, arrays)
        else:
            arrays, record = stored_tile(header, job.index), stored_record(header, job.index)
    changed = (header.leading(arrays)[REGIME.name] != header.leading(stored)[REGIME.name])[solved]
    return replace(
        receipt_of(header, job.index, arrays, solved, record),
        taken=int((~solved).sum()) if job.retry is None else 0,
        changed=0 if job.retry is None else int(changed.sum()),
        solve_seconds=middle - begin,
        processor_seconds=processor,
        write_seconds=time.perf_counter() - middle,
    )


def stored_cells(header: Header, job: Job, slices: Slices) -> tuple[Arrays, np.ndarray]:
    """What is known of some cells of the job's tile, as arrays, and the mask of the cells to solve."""
    if job.retry is None:
        return known_cells(header, slices)
    begins = [each.start for each in header.tiling.at(job.index).slices]
    within = tuple(slice(part.start - b, part.stop - b) for part, b in zip(slices, begins, strict=True))
    stored = {name: values[within] for name, values in finished_tile(header, job).items()}
    return stored, job.retry.selects(stored)


def solve_cells(
    spec: Spec, job: Job, slices: Slices, stored: Arrays, solved: np.ndarray, solver: Solver | None = None
) -> Arrays:
    """The arrays of ``stored_cells``, with the cells of its mask solved: part by part, which limits the memory."""
    solver = solver or partial(_solve_part, spec, job)
    if spec.continuation is not None or max(solved.shape) <= PART:  # a part of a line has no results of its own
        return solver(slices, stored, solved)
    arrays = {name: values.copy() for name, values in stored.items()}
    for part in Tiling(solved.shape, (PART,) * solved.ndim).tiles():
        at = part.slices
        if solved[at].any():
            cells = tuple(slice(s.start + p.start, s.start + p.stop) for s, p in zip(slices, at, strict=True))
            known = {name: values[at] for name, values in stored.items()}
            for name, values in solver(cells, known, solved[at]).items():
                arrays[name][at] = values
    return arrays


def _solve_part(spec: Spec, job: Job, slices: Slices, stored: Arrays, solved: np.ndarray) -> Arrays:
    """The arrays of some cells with those of the mask solved.

    A cell depends on nothing but its parameters, the settings and the solver, so that cells known from the store's
    origin have the values that they would get here.
    """
    from workers.tile import solve_tile

    if job.retry is None and solved.all():
        return solve_block(spec, slices)
    cells = {name: np.broadcast_to(value, solved.shape) for name, value in spec.cell_params(slices).items()}
    if job.retry is not None:
        return solve_again(spec, cells, stored, job.retry)
    if solved.any():
        params = {name: values[solved] for name, values in cells.items()}
        for name, values in solve_tile(spec.record, params, spec.settings).items():
            stored[name][solved] = values
    return stored


def commit(header: Header, job: Job, arrays: Arrays) -> tuple[float, ...]:
    """Write a tile, unless the job may not any more, and the overview over it alone; return its record.

    One case is not excluded: a worker that stands still between a look at the notes and the write that follows, until
    another run or another attempt has written the tile. In a retry it then writes one object, else the same bits.
    """
    header = header_of(job)  # it may be another store by now
    record = write_tile(header, job.index, arrays)
    opened(header, job.claim).make_over(job.index, arrays)
    return tuple(record.tolist())


def guarded(place: Place, claim: str, note: str = "", attempt: str = "") -> Place:
    """A place behind the fence of a job: its run has the claim, and a tile's note holds the token of the attempt.

    Without a token nothing is looked at. RefusedError where another run has the claim; RunError where there was another
    attempt, since nothing is wrong with this worker.
    """
    fences: list[Fence] = []
    if claim:
        lost = "the run of this tile has lost its claim of the store; nothing more is written"
        fences.append(note_fence(place, CLAIM, claim, RefusedError, lost))
    if attempt:
        lost = "another attempt at this tile has begun; nothing more is written"
        fences.append(note_fence(place, note, attempt, RunError, lost))

    def fence() -> None:
        for each in fences:
            each()

    return place.behind(fence) if fences else place


def prepare(job: Job) -> None:
    """Check what any job of a run needs of this worker, and see to it that its kernels are compiled."""
    with file_errors(job.store):
        header = header_of(job)
    compile_once(*kernels_of(header.spec))


def header_of(job: Job) -> Header:
    """The header of a job's store, see ``checked_header``, behind the fence of the job."""
    header = checked_header(job.store, job.run_id, job.solver_version, job.patience)
    _ = header.spec, header.writable  # read once for all jobs
    return header.at(guarded(header.place, job.claim, job.note, job.attempt))


def checked_header(store: str, run_id: str, solver_version: int, patience: float = BRIEF) -> Header:
    """The header of the store that a run asks this worker to work on, see ``known_header``.

    Raises RefusedError if this worker has another solver, or sees no store or another one at the path; OSError
    where the store's disk or server refused.
    """
    check_solver(solver_version)
    try:
        header = known_header(store, patience)
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
    """Turn errors of the file system into what they mean: no room for anybody, or not for this worker; others pass."""
    try:
        yield
    except OSError as error:
        what = f"{store}: {error.strerror or error}"
        if error.errno in _FULL:
            raise StoreFullError(what) from error
        if error.errno in _FORBIDDEN:
            raise RefusedError(what) from error
        raise


def finished_tile(header: Header, job: Job) -> Arrays:
    """``stored_tile`` of a tile to be solved again; an attempt that died may have left its new contents."""
    try:
        return stored_tile(header, job.index)
    except ChunkError:
        if not finish_replacement(header, job.index):
            raise
        return stored_tile(header, job.index)


def stored_tile(header: Header, index: tuple[int, ...]) -> Arrays:
    """All arrays of a finished tile: of results that an older store does not have, their fill values."""
    shape = header.tiling.at(index).shape
    blank = empty_results(header.spec.variables, shape, extra_sizes(header.spec))
    return blank | read_tile(header, index)


def stored_record(header: Header, index: tuple[int, ...]) -> tuple[float, ...]:
    """The record of a tile that was finished before, as a receipt has it."""
    found = read_record(header, index)
    return () if found is None else tuple(found.tolist())


def receipt_of(
    header: Header, index: tuple[int, ...], arrays: Arrays, solved: np.ndarray, record: tuple[float, ...] = ()
) -> Receipt:
    """The receipt of a tile with these arrays, for its cells ``solved``, without times."""
    leading = header.leading(arrays)
    codes = leading[REGIME.name][solved]
    counts = {regime.name: int(np.count_nonzero(codes == regime.code)) for regime in REGIMES}
    return Receipt(
        index=index,
        cells=int(solved.sum()),
        counts={name: count for name, count in counts.items() if count},
        reasons=reason_counts(leading[REASON.name][solved]),
        solve_seconds=0.0,
        write_seconds=0.0,
        periods=int(leading["periods_used"][solved].sum(dtype="int64")),
        peak_bytes=peak_memory(),
        record=record,
    )
