"""One tile: what is to be done, doing it here and now, and the receipt for it."""

import errno
import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from atlas.errors import ChunkError, InputError, RunError
from atlas.overview.pyramid import opened
from atlas.platform import peak_memory
from atlas.spec.spec import Slices, Spec
from atlas.store.location import Place, place_of
from atlas.store.outage import BRIEF, LONG
from atlas.store.records import read_record
from atlas.store.schema import extra_sizes
from atlas.store.sidecar import claim_token, notes_of
from atlas.store.store import ROOT, Header, is_done, read_header
from atlas.store.tiles import finish_replacement, read_tile, write_tile
from atlas.store.tiling import PART, Tiling
from atlas.task.compile import compile_once
from atlas.task.retry import Retry, solve_again
from atlas.task.reuse import known_cells, solve_unknown
from atlas.task.solving import kernels_of
from workers import SOLVER_VERSION
from workers.results import REASON, REGIME, REGIMES, empty_results, reason_counts

_FULL = (errno.ENOSPC, errno.EDQUOT)
_FORBIDDEN = (errno.EROFS, errno.EACCES, errno.EPERM)
_headers: dict[tuple[str, str, float], tuple[Hashable, Header]] = {}
"""Headers of the stores of runs that this process works for, each with the state of the store's root."""


class RefusedError(RunError):
    """This worker must not or cannot do this run's tiles; another worker may."""


class StoreFullError(RunError):
    """There is no room for the store: no worker can go on."""


@dataclass(frozen=True)
class Job:
    """Which tile of which store. All that crosses the scheduler; ``attempt.run_job`` redoes it by hand.

    Where ``index`` begins with a negative number, it is a chunk of the overviews: minus its level, and its index there.
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
    record                          of the whole tile, see ``store.record``; empty where it is not known
    overview                        whether the chunk of level 1 of the overviews over it alone is made too
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
    overview: bool = False


@dataclass(frozen=True)
class MadeChunk:
    """What a job for a chunk of the overviews reports: its index, as the job has it, and why it could not be made.

    What lies below it may be damaged, which is not the worker's fault.
    """

    index: tuple[int, ...]
    fault: str = ""


def make_chunk(job: Job) -> MadeChunk:
    """Make a chunk of the overviews, here and now."""
    with file_errors(job.store):
        header = checked_header(job.store, job.run_id, job.solver_version, job.patience)
        try:
            opened(header, job.claim).make(-job.index[0], job.index[1:], held(header, job))
        except RefusedError:
            raise
        except (RunError, ValueError) as error:
            return MadeChunk(job.index, str(error))
    return MadeChunk(job.index)


def solve_and_write(job: Job) -> Receipt:
    """Solve a tile and write it, here and now."""
    with file_errors(job.store):
        header = checked_header(job.store, job.run_id, job.solver_version, job.patience)
        slices = header.tiling.at(job.index).slices
        stored, solved = stored_cells(header, job, slices)
    compile_once(*kernels_of(header.spec))  # its own disk may be full, which is not the store's
    begin, busy = time.perf_counter(), time.thread_time()
    arrays = solve_cells(header.spec, job, slices, stored, solved)
    middle, processor = time.perf_counter(), time.thread_time() - busy
    with file_errors(job.store):
        # Another attempt may have finished meanwhile: what is stored then stays.
        if solved.any() if job.retry is not None else not is_done(header, job.index):
            record, overview = commit(header, job, arrays)
        else:
            arrays, record, overview = stored_tile(header, job.index), stored_record(header, job.index), False
    return replace(
        receipt_of(header, job.index, arrays, solved),
        record=record,
        overview=overview,
        taken=int((~solved).sum()) if job.retry is None else 0,
        changed=0 if job.retry is None else int((arrays[REGIME.name] != stored[REGIME.name])[solved].sum()),
        solve_seconds=middle - begin,
        processor_seconds=processor,
        write_seconds=time.perf_counter() - middle,
    )


def stored_cells(header: Header, job: Job, slices: Slices) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """What is known of the cells of the job's tile, as arrays, and the mask of the cells to solve."""
    if job.retry is None:
        return known_cells(header, slices)
    within = tuple(
        slice(part.start - tile.start, part.stop - tile.start)
        for part, tile in zip(slices, header.tiling.at(job.index).slices, strict=True)
    )
    stored = {name: values[within] for name, values in finished_tile(header, job).items()}
    return stored, job.retry.selects(stored)


def solve_cells(
    spec: Spec, job: Job, slices: Slices, stored: dict[str, np.ndarray], solved: np.ndarray
) -> dict[str, np.ndarray]:
    """The arrays of ``stored_cells``, with the cells of its mask solved: part by part, so that memory stays small."""
    if spec.continuation is not None or max(solved.shape) <= PART:
        return _solve_part(spec, job, slices, stored, solved)
    arrays = {name: values.copy() for name, values in stored.items()}
    for part in Tiling(solved.shape, (PART,) * solved.ndim).tiles():
        at = part.slices
        if not solved[at].any():
            continue
        cells = tuple(slice(s.start + p.start, s.start + p.stop) for s, p in zip(slices, at, strict=True))
        known = {name: values[at] for name, values in stored.items()}
        for name, values in _solve_part(spec, job, cells, known, solved[at]).items():
            arrays[name][at] = values
    return arrays


def _solve_part(
    spec: Spec, job: Job, slices: Slices, stored: dict[str, np.ndarray], solved: np.ndarray
) -> dict[str, np.ndarray]:
    if job.retry is None:
        return solve_unknown(spec, slices, stored, solved)
    shape = stored[REGIME.name].shape
    cells = {name: np.broadcast_to(value, shape) for name, value in spec.cell_params(slices).items()}
    return solve_again(spec, cells, stored, job.retry)[0]


def commit(header: Header, job: Job, arrays: dict[str, np.ndarray]) -> tuple[tuple[float, ...], bool]:
    """Write a tile, unless the run of the job has lost its claim of the store, and the overview of it alone.

    Returns its record, and whether there is such an overview.

    What is not excluded is a worker that stands still between a look at the claim and the write that follows, for so
    long that another run replaces the claim: in a retry it writes one chunk then, else the bits of the other run.
    """
    header = checked_header(job.store, job.run_id, job.solver_version, job.patience)  # it may be another store by now
    record = write_tile(header, job.index, arrays, held(header, job))
    return tuple(record.tolist()), opened(header, job.claim).make_over(job.index, arrays, held(header, job))


def held(header: Header, job: Job) -> Callable[[], None]:
    """Raises RefusedError where the run of the job has lost its claim of the store; one read each time."""
    return partial(check_claim, header.place, job.claim)


def check_claim(place: Place, token: str) -> None:
    """Raise RefusedError where the claim of a store is not the one of that token; one read, none for no token."""
    if token and claim_token(notes_of(place)) != token:
        raise RefusedError(f"{place}: the run of this tile has lost its claim of the store; nothing more is written")


def prepare(job: Job) -> None:
    """Check what any job of a run needs of this worker, and see to it that its kernels are compiled."""
    with file_errors(job.store):
        header = checked_header(job.store, job.run_id, job.solver_version, job.patience)
    compile_once(*kernels_of(header.spec))


def forget(store: str, run_id: str, patience: float) -> None:
    """Drop what this process keeps of a run's store."""
    _headers.pop((store, run_id, patience), None)


def checked_header(store: str, run_id: str, solver_version: int, patience: float = BRIEF) -> Header:
    """The header of the store that a run asks this worker to work on: read once, and again where it has changed.

    Raises RefusedError where this worker has another solver, or sees no store or another one at the path; OSError
    where the store's disk or server refused.
    """
    check_solver(solver_version)
    place, known = place_of(store, patience), _headers.get((store, run_id, patience))
    version = place.version(ROOT)
    if known is not None and version == known[0]:
        return known[1]
    try:
        header = read_header(place)
    except InputError as error:
        if isinstance(error.__cause__, OSError):  # the disk or the server is at fault, not the path
            raise error.__cause__ from None
        raise RefusedError(f"{error}; is the path the same on all hosts?") from None
    if header.run_id != run_id:
        raise RefusedError(f"{store} is not the store of run {run_id}; is the path the same on all hosts?")
    _headers[store, run_id, patience] = version, header
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
        if not finish_replacement(header, job.index, held(header, job)):
            raise
        return stored_tile(header, job.index)


def stored_tile(header: Header, index: tuple[int, ...]) -> dict[str, np.ndarray]:
    """All arrays of a finished tile: of results that an older store does not have, their fill values."""
    shape = header.tiling.at(index).shape
    blank = empty_results(header.spec.variables, shape, extra_sizes(header.spec))
    return blank | read_tile(header, index)


def stored_record(header: Header, index: tuple[int, ...]) -> tuple[float, ...]:
    """The record of a tile that was finished before, as a receipt has it."""
    found = read_record(header, index)
    return () if found is None else tuple(found.tolist())


def receipt_of(header: Header, index: tuple[int, ...], arrays: dict[str, np.ndarray], solved: np.ndarray) -> Receipt:
    """The receipt of a tile with these arrays, whose cells ``solved`` count; without times and record."""
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
    )
