"""Attempts at a tile: the first in the worker itself, the next, after one that died, in a process of its own."""

import sys
from dataclasses import replace

import numpy as np

from atlas.errors import NetworkError
from atlas.store.sidecar import notes_of
from atlas.store.store import Header, is_done
from atlas.task.isolated import run_isolated
from atlas.task.reuse import known_cells
from atlas.task.task import (
    Job,
    Receipt,
    checked_header,
    commit,
    file_errors,
    finished_tile,
    receipt_of,
    solve_and_write,
    stored_tile,
)
from workers.results import FAILED, PROCESS_ENDED, REASON, REGIME


def run_job(job: Job) -> Receipt:
    """Solve a tile and write it; RefusedError where this worker must not: another solver, or another store at the path.

    NetworkError where the store does not answer for as long as the job's patience lasts.

    While it runs, a note of the store says so. A job that finds that note is the second attempt at a tile whose first
    did not live to remove it, and runs in a process of its own: a tile that kills its process takes no second
    worker with it, and where it kills that process too, its cells are marked failed.
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
        return _mark_failed(header, job, outcome) if isinstance(outcome, str) else outcome
    finally:
        if not isinstance(sys.exception(), NetworkError):  # it would only be waited for once more
            with file_errors(job.store):
                notes.remove(name, b"1")


def _mark_failed(header: Header, job: Job, died: str) -> Receipt:
    """Write the cells that were to be solved as failed, so that the rest of the atlas can be finished."""
    spec = header.spec
    if job.retry is None:
        stored, solved = known_cells(header, header.tiling.at(job.index).slices)
    else:
        stored = finished_tile(header, job)
        solved = job.retry.selects(stored)
        for name, given in job.retry.allowances(stored).items():
            stored[name] = np.where(solved, given, stored[name])
        for variable in spec.variables:
            stored[variable.name][solved] = variable.fill
    if job.retry is None and is_done(header, job.index):
        return _receipt_of_stored(header, job.index)
    first = header.leading(stored)  # views: what is written into them is in the tile
    first[REGIME.name][solved], first[REASON.name][solved] = FAILED, PROCESS_ENDED
    with file_errors(job.store):
        commit(header, job, stored)
    receipt = replace(receipt_of(header, job.index, stored, solved), reasons={died: int(solved.sum())})
    return receipt if job.retry else replace(receipt, taken=int((~solved).sum()))


def _receipt_of_stored(header: Header, index: tuple[int, ...]) -> Receipt:
    """The receipt of a tile that was finished before: its worker died after it was written, before it was reported."""
    arrays = stored_tile(header, index)
    return receipt_of(header, index, arrays, np.ones(header.tiling.at(index).shape, dtype=bool))
