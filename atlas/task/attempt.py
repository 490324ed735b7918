"""Execute a job of a run on a worker, and count attempts at a tile that kill their process."""

import json
import os
import socket
import sys
from typing import Any

import numpy as np

from atlas.errors import NetworkError, RunError
from atlas.store.backend import StoreBackend
from atlas.store.sidecar import sidecar_of
from atlas.store.store import is_done
from atlas.task.store_ref import translate_file_errors
from atlas.task.tile_job import (
    LABELS,
    DerivedReport,
    RunJob,
    TileReport,
    label_basins,
    make_chunk,
    make_report,
    record_in_report,
    solve_and_write,
    stored_tile,
)

MAX_DEATHS = 2
"""Number of attempts at a tile in one run that die with their process, after which the run gives the tile up."""


def execute_job(job: RunJob) -> TileReport | DerivedReport:
    """Do any job of a run on this worker and return its report: a tile, a chunk of the overviews, or the labels of
    basins.
    """
    if job.level == LABELS:
        return label_basins(job)
    return make_chunk(job) if job.level else run_tile_job(job)


def run_tile_job(job: RunJob) -> TileReport:
    """Solve a tile, write it, and return its report.

    During the attempt a small file in the store's sidecar counts it. A file found at the start is left by an attempt
    that died. After MAX_DEATHS such attempts in one run the tile counts as one that kills its process. RunError then
    names the last attempt, and the file stays, so that only another run tries again. Of two attempts at the same time
    each writes the same bits.

    Raise WorkerRefusedError if this worker must not solve the tile: another solver, or another store at the path. Raise
    NetworkError if the store does not respond within the job's patience.
    """
    with translate_file_errors(job.store_ref.store):
        handle = job.handle()
        sidecar, name = sidecar_of(handle.backend), "started-" + "-".join(map(str, job.index))
        if is_done(handle, job.index):  # its worker died between writing and reporting
            solved = np.ones(handle.tiling.at(job.index).shape, dtype=bool)
            arrays = stored_tile(handle, job.index)
            return make_report(handle, job.index, arrays, solved, record_in_report(handle, job.index, arrays))
        _count_attempt(sidecar, name, job.store_ref.lease)
    try:
        return solve_and_write(job, handle)
    finally:
        if not isinstance(sys.exception(), NetworkError):  # removing it would only wait for the network again
            with translate_file_errors(job.store_ref.store):
                sidecar.remove(name)


def _count_attempt(sidecar: StoreBackend, name: str, run: str) -> None:
    """Count a new attempt at a tile in the sidecar file ``name``. Raise RunError if MAX_DEATHS earlier attempts have
    died.

    Attempts of other runs than ``run`` do not count.
    """
    try:
        before: dict[str, Any] = json.loads(sidecar.get(name) or b"{}")
        number, last = before["number"] if before["run"] == run else 0, before["process"]
        number = number if type(number) is int else 0
    except (ValueError, KeyError, TypeError, RecursionError):  # none, or damaged
        number, last = 0, ""
    if number >= MAX_DEATHS:
        raise RunError(f"its worker process has died {number} times, the last one was {last}")
    process = f"{socket.gethostname()}, process {os.getpid()}"
    sidecar.put(name, json.dumps({"run": run, "number": number + 1, "process": process}).encode())
