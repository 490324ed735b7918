"""Attempts at a tile: in the worker itself; after two that died, its parts in processes of their own."""

import sys
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from atlas.errors import NetworkError
from atlas.spec.spec import Slices
from atlas.store.sidecar import notes_of, put_token, remove_token
from atlas.store.store import Header, is_done
from atlas.store.tiles import finish_replacement
from atlas.task.isolated import solve_isolated
from atlas.task.task import (
    LABELS,
    Arrays,
    Job,
    Made,
    Receipt,
    file_errors,
    header_of,
    label_basins,
    make_chunk,
    receipt_of,
    solve_and_write,
    stored_record,
    stored_tile,
)
from workers.results import FAILED, PROCESS_ENDED, REASON, REASONS, REGIME

DEATHS = 2
"""Attempts at a tile that did not live, after which it is suspected to kill its workers."""


def do_job(job: Job) -> Receipt | Made:
    """Do any job of a run: a tile, a chunk of the overviews, or the labels of basins."""
    if job.level == LABELS:
        return label_basins(job)
    return make_chunk(job) if job.level else run_job(job)


def run_job(job: Job) -> Receipt:
    """Solve a tile and write it; RefusedError if this worker must not: another solver, or another store at the path.

    NetworkError if the store does not answer within the job's patience.

    While it runs, a note of the store says so, with the token of this attempt. A job that finds that note is the next
    attempt at a tile whose last did not live to remove it, or lives where its run cannot reach it. With its own token
    in the note nothing more is written by the last. A worker may be evicted in the middle of any tile: the attempt
    after DEATHS that did not live suspects the tile, and solves it part by part, each in a process of its own, so that
    only the cells of a part that kills again are marked failed.
    """
    with file_errors(job.store):
        header = header_of(job)
        notes = notes_of(header.place)
        if job.replaced:
            finish_replacement(header, job.index)
        if job.retry is None and is_done(header, job.index):  # its worker died after it was written, before its report
            solved = np.full(header.tiling.at(job.index).shape, not job.replaced)
            receipt = receipt_of(header, job.index, stored_tile(header, job.index), solved)
            return replace(receipt, taken=int((~solved).sum()), record=stored_record(header, job.index))
        token, number = put_token(notes, job.note)
        job = replace(job, attempt=token)
        header = header_of(job)
    try:
        return solve_and_write(job) if number <= DEATHS else _solve_apart(header, job)
    finally:
        if not isinstance(sys.exception(), NetworkError):  # it would only be waited for once more
            with file_errors(job.store):
                remove_token(notes, job.note, token, number)


def _solve_apart(header: Header, job: Job) -> Receipt:
    """Solve a tile part by part, each in a process of its own, and write it; see ``run_job``."""
    died = Counter[str]()

    def solve(slices: Slices, stored: Arrays, solved: np.ndarray) -> Arrays:
        found = solve_isolated(job, slices)
        if not isinstance(found, str):
            return found
        died[found] += int(solved.sum())
        return _failed(header, job, stored, solved)

    receipt = solve_and_write(job, solve)
    if not died:
        return receipt
    unnamed = next(reason.text for reason in REASONS if reason.code == PROCESS_ENDED)
    reasons = {text: count for text, count in receipt.reasons.items() if text != unnamed}
    return replace(receipt, reasons=reasons | died)


def _failed(header: Header, job: Job, stored: Arrays, failed: np.ndarray) -> dict[str, Any]:
    """Arrays with some cells marked as failed, with what a retry gave them."""
    arrays = {name: values.copy() for name, values in stored.items()}
    if job.retry is not None:
        for name, given in job.retry.allowances(arrays).items():
            arrays[name] = np.where(failed, given, arrays[name])
    for variable in header.spec.variables:
        arrays[variable.name][failed] = variable.fill
    first = header.leading(arrays)  # views: what is written into them is in the arrays
    first[REGIME.name][failed], first[REASON.name][failed] = FAILED, PROCESS_ENDED
    return arrays
