"""One tile's work, as it runs on a worker: solve it, write it, give a receipt."""

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

from atlas.errors import InputError, NetworkError, RunError
from atlas.service.plan import make_plan
from atlas.store.location import place_of
from atlas.store.outage import LONG
from atlas.store.schema import BUDGET
from atlas.store.sidecar import notes_of
from atlas.store.store import Header, is_done, read_header, write_tile
from atlas.store.tally import tile_entry
from atlas.store.tiles import read_tile
from atlas.task.compile import compile_once
from atlas.task.retry import Retry, solve_again
from atlas.task.reuse import fill_tile, known_cells
from workers import SOLVER_VERSION
from workers.results import FAILED, PROCESS_ENDED, REASON, REGIME, REGIMES, reason_counts, result_variables

_FULL = (errno.ENOSPC, errno.EDQUOT)
_FORBIDDEN = (errno.EROFS, errno.EACCES, errno.EPERM)


class RefusedError(RunError):
    """This worker must not or cannot do this run's tiles; another worker may."""


class StoreFullError(RunError):
    """There is no room for the store: no worker can go on."""


@dataclass(frozen=True)
class Job:
    """Which tile of which store. All that crosses the scheduler; ``run_job`` redoes it by hand.

    ``retry`` solves some cells of a finished tile again, in place of all of an unfinished one; ``patience`` is for how
    many seconds a store at a URL that does not answer is waited for.
    """

    index: tuple[int, ...]
    store: str
    run_id: str
    solver_version: int
    retry: Retry | None = None
    patience: float = LONG


@dataclass(frozen=True)
class Receipt:
    """What a finished tile reports.

    cells, counts, reasons          solved, in all and of each regime; those without a result by the reason in words
    taken                           cells taken over from the store that this one extends
    solve_seconds, write_seconds    inside the solver; inside the store
    processor_seconds               of the solver's thread
    periods                         forcing periods simulated
    peak_bytes                      most memory that the worker's process ever had
    entry                           what the store's tally is to say of the whole tile, see ``store.tally``
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
    entry: tuple[float, ...] = ()


def run_job(job: Job) -> Receipt:
    """Solve a tile and write it; RefusedError where this worker must not: another solver, or another store at the path.

    NetworkError where the store does not answer for as long as the job's patience lasts.

    While it runs, a note beside the store says so. A job that finds that note is the second attempt at a tile whose
    first did not live to remove it, and runs in a process of its own: a tile that kills its process takes no second
    worker with it, and where it kills that process too, its cells are marked failed.
    """
    with _told_apart(job):
        header = _checked_header(job)
        notes, name = notes_of(header.place), "started-" + "-".join(map(str, job.index))
        if job.retry is None and is_done(header, job.index):
            return _receipt_of_stored(header, job.index)
        first = notes.put(name, b"1", expected=None)
        try:
            if first:
                return solve_and_write(job)
            from atlas.task.isolated import run_apart

            died = run_apart(job)
            return _mark_failed(header, job, died) if isinstance(died, str) else died
        finally:
            if not isinstance(sys.exception(), NetworkError):  # it would only be waited for once more
                notes.remove(name, b"1")


def solve_and_write(job: Job) -> Receipt:
    """Solve a tile and write it, here and now."""
    with _told_apart(job):
        header = _checked_header(job)
        spec = header.spec
        tile = make_plan(spec, workers=1, tile=header.tile).at(job.index)
        params = spec.cell_params(tile.slices)
        compile_once(spec.system, spec.settings)
        begin, busy = time.perf_counter(), time.thread_time()
        if job.retry is None:
            arrays, solved = fill_tile(header, tile.slices)
        else:
            stored = _stored(header, job.index)
            shape = stored[REGIME.name].shape
            cells = {name: np.broadcast_to(value, shape) for name, value in params.items()}
            begin, busy = time.perf_counter(), time.thread_time()
            arrays, solved = solve_again(spec, cells, stored, job.retry)
        middle, processor = time.perf_counter(), time.thread_time() - busy
        # Another attempt may have finished meanwhile: what is stored then stays.
        if solved.any() if job.retry is not None else not is_done(header, job.index):
            write_tile(header, job.index, arrays)
        else:
            arrays = _stored(header, job.index)
        receipt = _receipt(header, job.index, arrays, solved)
        taken = int((~solved).sum()) if job.retry is None else 0
        return replace(
            receipt,
            taken=taken,
            solve_seconds=middle - begin,
            processor_seconds=processor,
            write_seconds=time.perf_counter() - middle,
        )


def _checked_header(job: Job) -> Header:
    if job.solver_version != SOLVER_VERSION:
        raise RefusedError(f"this worker has solver version {SOLVER_VERSION}, the run needs {job.solver_version}")
    try:
        header = read_header(place_of(job.store, job.patience))
    except InputError as error:
        if isinstance(error.__cause__, OSError):  # the store's disk or server has a say, not its path
            raise error.__cause__ from None
        raise RefusedError(f"{error}; is the path the same on all hosts?") from None
    if header.run_id != job.run_id:
        raise RefusedError(f"{job.store} is not the store of run {job.run_id}; is the path the same on all hosts?")
    return header


@contextmanager
def _told_apart(job: Job) -> Iterator[None]:
    """Errors of the file system by what they mean for the run: no room for anybody, or none of this worker's business.

    Others go through as they are: the tile may be tried again.
    """
    try:
        yield
    except OSError as error:
        what = f"{job.store}: {error.strerror or error}"
        if error.errno in _FULL:
            raise StoreFullError(what) from error
        if error.errno in _FORBIDDEN:
            raise RefusedError(what) from error
        raise


def _mark_failed(header: Header, job: Job, died: str) -> Receipt:
    """Write the cells that were to be solved as failed, so that the rest of the atlas can be finished."""
    spec = header.spec
    if job.retry is None:
        tile = make_plan(spec, workers=1, tile=header.tile).at(job.index)
        stored, solved = known_cells(header, tile.slices)
    else:
        stored = _stored(header, job.index)
        solved = job.retry.selects(stored)
        stored[BUDGET.name] = np.where(solved, job.retry.budgets(stored), stored[BUDGET.name])
        for variable in result_variables(spec.settings):
            stored[variable.name][solved] = variable.fill
    if job.retry is None and is_done(header, job.index):
        return _receipt_of_stored(header, job.index)
    stored[REGIME.name][solved], stored[REASON.name][solved] = FAILED, PROCESS_ENDED
    write_tile(header, job.index, stored)
    receipt = replace(_receipt(header, job.index, stored, solved), reasons={died: int(solved.sum())})
    return receipt if job.retry else replace(receipt, taken=int((~solved).sum()))


def _stored(header: Header, index: tuple[int, ...]) -> dict[str, np.ndarray]:
    """The arrays of a finished tile, reasons too where an older store keeps none."""
    arrays = read_tile(header, index)
    arrays.setdefault(REASON.name, np.full(arrays[REGIME.name].shape, REASON.fill, REASON.dtype))
    return arrays


def _receipt_of_stored(header: Header, index: tuple[int, ...]) -> Receipt:
    """The receipt of a tile that was finished before: its worker died after the writing, before the telling."""
    arrays = _stored(header, index)
    return _receipt(header, index, arrays, np.ones(arrays[REGIME.name].shape, dtype=bool))


def _receipt(header: Header, index: tuple[int, ...], arrays: dict[str, np.ndarray], solved: np.ndarray) -> Receipt:
    slices = make_plan(header.spec, workers=1, tile=header.tile).at(index).slices
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
        entry=tuple(tile_entry(header.spec, slices, arrays).tolist()),
    )


def peak_memory() -> int:
    """Most bytes of memory that this process ever had.

    Linux tells it in /proc; its getrusage would count what the parent had when it started this process.
    """
    try:
        told = re.search(r"^VmHWM:\s+(\d+) kB$", Path("/proc/self/status").read_text(encoding="ascii"), re.MULTILINE)
    except OSError:
        told = None
    if told:
        return 1024 * int(told[1])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
