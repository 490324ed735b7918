"""The jobs of a run as they are sent to workers, the functions that do them, and their reports."""

import time
from dataclasses import dataclass, field, replace

import numpy as np

from atlas.errors import RunError
from atlas.overview.pyramid import pyramid_of
from atlas.platform import peak_memory
from atlas.spec.laws import LawUse, law_names, law_uses
from atlas.spec.spec import Slices, Spec
from atlas.store.store import AtlasStore, is_done
from atlas.store.tiles import copy_tile, read_tile, record_of, write_tile
from atlas.store.tiling import INNER_CHUNK, Tiling
from atlas.task.compile import compile_once
from atlas.task.label_basins import complete_basins
from atlas.task.reuse import reuse_cells
from atlas.task.solve_block import kernels_of, solve_missing
from atlas.task.store_ref import StoreRef, WorkerRefusedError, translate_file_errors
from workers.results import PENDING, REASON, REGIME, REGIMES, reason_counts

Arrays = dict[str, np.ndarray]

LABELS = -1
"""Value of ``RunJob.level`` for the job that gives the cells of an atlas of basins their final labels."""


@dataclass(frozen=True)
class RunJob:
    """A job of a run, as sent to a worker. ``execute_job`` executes it, also without a cluster.

    index       index of the tile, or of the chunk of an overview
    store_ref   reference to the store
    level       0 for a tile; above 0 for a chunk of that level of the overviews; LABELS for the final labels of basins
    """

    index: tuple[int, ...]
    store_ref: StoreRef
    level: int = 0

    def handle(self) -> AtlasStore:
        """Return the handle of the store in its present state, with a backend that confirms the lease of the run."""
        return self.store_ref.open()


@dataclass(frozen=True)
class TileReport:
    """The report of a finished tile.

    index               index of the tile
    cells               number of cells solved
    counts              number of solved cells by regime
    reasons             number of solved cells by the reason of an uncertain result
    solve_seconds       seconds inside the solver
    write_seconds       seconds inside the store
    periods             forcing periods simulated
    peak_bytes          peak memory of the worker's process, in bytes
    reused              number of cells copied from the origin of the store
    processor_seconds   processor time of the solver's thread, in seconds
    changed             number of cells solved again whose regime changed
    record              tile record, with the counts and the digest of all its cells, see ``store.record_format``
    laws                use of the laws that are expressions, in the cells solved
    """

    index: tuple[int, ...]
    cells: int
    counts: dict[str, int]
    reasons: dict[str, int]
    solve_seconds: float
    write_seconds: float
    periods: int
    peak_bytes: int
    reused: int = 0
    processor_seconds: float = 0.0
    changed: int = 0
    record: tuple[float, ...] = ()
    laws: dict[str, LawUse] = field(default_factory=dict)


@dataclass(frozen=True)
class DerivedReport:
    """The report of a job other than a tile: a chunk of the overviews, or the labels of basins.

    index     index of the job
    records   new tile records, as pairs of index and record
    fault     why the job failed; empty if it succeeded
    """

    index: tuple[int, ...]
    records: tuple[tuple[tuple[int, ...], tuple[float, ...]], ...] = ()
    fault: str = ""


def execute_job(job: RunJob) -> TileReport | DerivedReport:
    """Do any job of a run on this worker and return its report: a tile, a chunk of the overviews, or the labels of
    basins.
    """
    if job.level == LABELS:
        return label_basins(job)
    return make_chunk(job) if job.level else run_tile_job(job)


def make_chunk(job: RunJob) -> DerivedReport:
    """Build a chunk of the overviews, the coarser copies of the atlas, and return the report."""
    with translate_file_errors(job.store_ref.store):
        handle = job.handle()
        try:
            pyramid_of(handle).build_chunk(job.level, job.index)
        except WorkerRefusedError:
            raise
        except (RunError, ValueError) as error:  # damage below is not the worker's fault
            return DerivedReport(job.index, fault=str(error))
    return DerivedReport(job.index)


def label_basins(job: RunJob) -> DerivedReport:
    """Give the cells of an atlas of basins their final labels, write the table of its attractors, and return the
    report.
    """
    with translate_file_errors(job.store_ref.store):
        handle = job.handle()
        records = complete_basins(handle)
        return DerivedReport(job.index, tuple((index, tuple(row.tolist())) for index, row in records.items()))


def run_tile_job(job: RunJob) -> TileReport:
    """Solve a tile, write it, and return its report. Of two attempts at the same time each writes the same bits.

    Raise WorkerRefusedError if this worker must not solve the tile: another solver, or another store at the path. Raise
    NetworkError if the store does not respond within the job's patience.
    """
    with translate_file_errors(job.store_ref.store):
        handle = job.handle()
        if is_done(handle, job.index):  # its worker died between writing and reporting
            arrays = read_tile(handle, job.index)
            solved = np.ones(handle.tiling.at(job.index).shape, dtype=bool)
            return make_report(handle, job.index, arrays, solved, tuple(record_of(handle, job.index, arrays).tolist()))
    return solve_and_write(job, handle)


def solve_and_write(job: RunJob, handle: AtlasStore) -> TileReport:
    """Solve the cells of a tile that the store does not take over from its origin, write the tile, and return its
    report.
    """
    with translate_file_errors(job.store_ref.store):
        slices = handle.tiling.at(job.index).slices
        known = reuse_cells(handle, slices)
    compile_once(*kernels_of(handle.spec))  # its own disk may be full, which is not the store's fault
    begin, busy = time.perf_counter(), time.thread_time()
    arrays = solve_cells(handle.spec, slices, known.arrays, known.missing)
    middle, processor = time.perf_counter(), time.thread_time() - busy
    with translate_file_errors(job.store_ref.store):
        handle = job.handle()  # the store may have been replaced
        if is_done(handle, job.index):  # another attempt has finished it: the stored tile stays
            arrays = read_tile(handle, job.index)
            record = tuple(record_of(handle, job.index, arrays).tolist())
        else:
            record = commit(handle, job, arrays, known.source if not known.missing.any() else None)
    before, after = known.regime[known.missing], handle.dominant_arrays(arrays)[REGIME.name][known.missing]
    return replace(
        make_report(handle, job.index, arrays, known.missing, record),
        reused=int((~known.missing).sum()),
        changed=int(((before != PENDING) & (before != after)).sum()),
        solve_seconds=middle - begin,
        processor_seconds=processor,
        write_seconds=time.perf_counter() - middle,
    )


def solve_cells(spec: Spec, slices: Slices, known: Arrays, due: np.ndarray) -> Arrays:
    """Solve the cells of the mask ``due`` and return the results of all cells in ``slices``.

    ``known`` are results of the other cells. Cells are solved chunk by chunk to limit the memory.
    """
    if spec.continuation is not None or max(due.shape) <= INNER_CHUNK:  # cells of a line depend on earlier ones
        return solve_missing(spec, slices, known, due)
    arrays = {name: values.copy() for name, values in known.items()}
    for part in Tiling(due.shape, (INNER_CHUNK,) * due.ndim).tiles():
        at = part.slices
        if due[at].any():
            cells = tuple(slice(s.start + p.start, s.start + p.stop) for s, p in zip(slices, at, strict=True))
            for name, values in solve_missing(spec, cells, {n: v[at] for n, v in known.items()}, due[at]).items():
                arrays[name][at] = values
    return arrays


def commit(handle: AtlasStore, job: RunJob, arrays: Arrays, source: AtlasStore | None = None) -> tuple[float, ...]:
    """Write a tile, if its run still leases the store, and return the tile's record.

    The chunk of the first overview over the tile is written, too, if it covers no other tile. ``source`` is a store
    with the same tile, whose objects are copied. A worker that is suspended between the confirmation of the lease and
    the write writes too late, but the same bits as any other worker.
    """
    record = write_tile(handle, job.index, arrays) if source is None else copy_tile(handle, source, job.index, arrays)
    pyramid_of(handle).build_chunk_over(job.index, arrays)
    return tuple(record.tolist())


def make_report(
    handle: AtlasStore, index: tuple[int, ...], arrays: Arrays, solved: np.ndarray, record: tuple[float, ...] = ()
) -> TileReport:
    """Return the report of a tile, without times, from the results of its cells.

    handle  the store
    index   index of the tile
    arrays  results of its cells
    solved  mask of the cells that were solved, to which the report refers
    record  record of the tile
    """
    leading, system = handle.dominant_arrays(arrays), handle.spec.system_def
    codes = leading[REGIME.name][solved]
    counts = {regime.name: int(np.count_nonzero(codes == regime.code)) for regime in REGIMES}
    return TileReport(
        index=index,
        cells=int(solved.sum()),
        counts={name: count for name, count in counts.items() if count},
        reasons=reason_counts(leading[REASON.name][solved]),
        solve_seconds=0.0,
        write_seconds=0.0,
        periods=int(leading["periods_used"][solved].sum(dtype="int64")),
        peak_bytes=peak_memory(),
        record=record,
        laws=law_uses(system, {name: leading[name][solved] for name in law_names(system) if name in leading}),
    )
