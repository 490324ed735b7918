"""A job of a run, and its attempt at a tile."""

import sys
from dataclasses import replace

import numpy as np

from atlas.errors import NetworkError
from atlas.store.sidecar import notes_of, put_attempt
from atlas.store.store import is_done
from atlas.task.site import file_errors
from atlas.task.task import (
    LABELS,
    Job,
    Made,
    Receipt,
    label_basins,
    make_chunk,
    receipt_of,
    solve_and_write,
    stored_record,
    stored_tile,
)

DEATHS = 2
"""Attempts at a tile in one run that did not live, after which it is not tried again."""


def do_job(job: Job) -> Receipt | Made:
    """Do any job of a run: a tile, a chunk of the overviews, or the labels of basins."""
    if job.level == LABELS:
        return label_basins(job)
    return make_chunk(job) if job.level else run_job(job)


def run_job(job: Job) -> Receipt:
    """Solve a tile and write it; RefusedError if this worker must not: another solver, or another store at the path.

    NetworkError if the store does not answer within the job's patience.

    While it runs, a note of the store has the token of this attempt. With another token in the note, of an
    attempt that began later, nothing more is written by this one, which its run may no longer reach. A note that is
    there is one of an attempt that did not live to remove it: after DEATHS of these in one run the tile is taken for
    one that kills its process. RunError then names the last, and the note stays, so that only another run tries again.
    """
    with file_errors(job.site.store):
        handle = job.handle()
        notes = notes_of(handle.place)
        if is_done(handle, job.index):  # its worker died after it was written, before its report
            solved = np.ones(handle.tiling.at(job.index).shape, dtype=bool)
            receipt = receipt_of(handle, job.index, stored_tile(handle, job.index), solved)
            return replace(receipt, record=stored_record(handle, job.index))
        attempt = put_attempt(notes, job.note, job.site.claim, DEATHS)
    try:
        job = replace(job, attempt=attempt.token)
        return solve_and_write(job, job.site.fenced(handle, job.note, job.attempt))
    finally:
        if not isinstance(sys.exception(), NetworkError):  # it would only be waited for once more
            with file_errors(job.site.store):
                attempt.remove(notes, job.note)
