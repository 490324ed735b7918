"""Attempts at a tile: the first in the worker itself, the next, after one that died, in a process of its own."""

import sys
from collections import Counter
from dataclasses import replace

import numpy as np

from atlas.errors import NetworkError
from atlas.spec.spec import Slices
from atlas.store.sidecar import notes_of
from atlas.store.store import Header, is_done
from atlas.store.tiling import PART, Tile, Tiling
from atlas.task.isolated import run_isolated, solve_isolated
from atlas.task.task import (
    Job,
    MadeChunk,
    Receipt,
    checked_header,
    commit,
    file_errors,
    make_chunk,
    receipt_of,
    solve_and_write,
    stored_cells,
    stored_record,
    stored_tile,
)
from workers.results import FAILED, PROCESS_ENDED, REASON, REGIME


def do_job(job: Job) -> Receipt | MadeChunk:
    """Do any job of a run: a tile, or a chunk of the overviews."""
    return make_chunk(job) if job.index[0] < 0 else run_job(job)


def run_job(job: Job) -> Receipt:
    """Solve a tile and write it; RefusedError where this worker must not: another solver, or another store at the path.

    NetworkError where the store does not answer for as long as the job's patience lasts.

    While it runs, a note of the store says so. A job that finds that note is the second attempt at a tile whose first
    did not live to remove it, and runs in a process of its own: a tile that kills its process takes no second
    worker with it, and where it kills that process too, the cells of the part that does are marked failed.
    """
    with file_errors(job.store):
        header = checked_header(job.store, job.run_id, job.solver_version, job.patience)
        notes, name = notes_of(header.place), "started-" + "-".join(map(str, job.index))
        if job.retry is None and is_done(header, job.index):
            return _receipt_of_stored(header, job.index)
        first = notes.put(name, b"1", expected=None)
    try:
        if first:
            return solve_and_write(job)
        outcome = run_isolated(job)
        return _solve_apart(header, job, outcome) if isinstance(outcome, str) else outcome
    finally:
        if not isinstance(sys.exception(), NetworkError):  # it would only be waited for once more
            with file_errors(job.store):
                notes.drop(name)


def _solve_apart(header: Header, job: Job, died: str) -> Receipt:
    """Write a tile that killed its processes, so that the rest of the atlas can be finished.

    It is solved part by part, each in a process of its own: only the cells of parts that die too are marked failed.
    """
    if job.retry is None and is_done(header, job.index):
        return _receipt_of_stored(header, job.index)
    tile = header.tiling.at(job.index)
    with file_errors(job.store):
        arrays, solved = stored_cells(header, job, tile.slices)
    before = arrays[REGIME.name].copy()
    parts = [part.slices for part in Tiling(tile.shape, (PART,) * len(tile.shape)).tiles()]
    failed, reasons = np.zeros(tile.shape, dtype=bool), Counter[str]()
    for part in parts:
        alone = len(parts) == 1 or header.spec.continuation is not None  # a part of a line has no results of its own
        found = died if alone else _solved_part(job, tile, part) if solved[part].any() else {}
        if isinstance(found, str):
            failed[part] = solved[part]
            reasons[found] += int(failed[part].sum())
        else:
            for name, values in found.items():
                arrays[name][part] = values
    _mark_failed(header, job, arrays, failed)
    with file_errors(job.store):
        record, overview = commit(header, job, arrays)
    others = receipt_of(header, job.index, arrays, solved & ~failed)
    return replace(
        receipt_of(header, job.index, arrays, solved),
        reasons=others.reasons | reasons,
        record=record,
        overview=overview,
        taken=0 if job.retry else int((~solved).sum()),
        changed=int((arrays[REGIME.name] != before)[solved].sum()) if job.retry else 0,
    )


def _solved_part(job: Job, tile: Tile, part: Slices) -> dict[str, np.ndarray] | str:
    begins = [each.start for each in tile.slices]
    return solve_isolated(job, tuple(slice(b + p.start, b + p.stop) for b, p in zip(begins, part, strict=True)))


def _mark_failed(header: Header, job: Job, arrays: dict[str, np.ndarray], failed: np.ndarray) -> None:
    """Mark cells in a tile's arrays as failed, with what a retry gave them."""
    if job.retry is not None:
        for name, given in job.retry.allowances(arrays).items():
            arrays[name] = np.where(failed, given, arrays[name])
    for variable in header.spec.variables:
        arrays[variable.name][failed] = variable.fill
    first = header.leading(arrays)  # views: what is written into them is in the tile
    first[REGIME.name][failed], first[REASON.name][failed] = FAILED, PROCESS_ENDED


def _receipt_of_stored(header: Header, index: tuple[int, ...]) -> Receipt:
    """The receipt of a tile that was finished before: its worker died after it was written, before it was reported."""
    arrays, solved = stored_tile(header, index), np.ones(header.tiling.at(index).shape, dtype=bool)
    return replace(receipt_of(header, index, arrays, solved), record=stored_record(header, index))
