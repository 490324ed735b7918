"""A part of a tile in a process of its own: for what is suspected to kill the process that solves it."""

import json
import signal
import sys
import tempfile
from dataclasses import asdict
from typing import Any

import numpy as np

from atlas.errors import NetworkError, RunError
from atlas.platform import ORDERLY
from atlas.spec.spec import Slices
from atlas.task.child import python
from atlas.task.retry import Retry
from atlas.task.task import Job, RefusedError, StoreFullError, file_errors, header_of, solve_cells, stored_cells

ATTEMPTS = 2
_KINDS = {kind.__name__: kind for kind in (RefusedError, StoreFullError, NetworkError)}


def solve_isolated(job: Job, slices: Slices) -> dict[str, np.ndarray] | str:
    """The arrays of some cells of the job's tile, solved by a child process, or in words how it died at each attempt.

    Raises RunError with the child's own words if it failed without dying.
    """
    with tempfile.TemporaryDirectory(prefix="atlas-part-") as folder:
        file = f"{folder}/part.npz"
        given = {"job": asdict(job), "slices": [(each.start, each.stop) for each in slices], "file": file}
        for _ in range(ATTEMPTS):
            # In a session of its own, so that Ctrl-C on this terminal spares it.
            ended = python("from atlas.task.isolated import main; main()", json.dumps(given), own_session=True)
            if -ended.returncode in ORDERLY:  # by somebody: the tile has no part in that
                raise RunError(f"the process of tile {job.index} was ended by {signal.Signals(-ended.returncode).name}")
            if ended.returncode == 0:
                break
        else:
            code = ended.returncode
            how = f"signal {-code}, {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
            return f"the process that solved them died each of {ATTEMPTS} times ({how})"
        answer: dict[str, Any] = json.loads(ended.stdout.splitlines()[-1])
        if "error" in answer:
            raise _KINDS.get(answer["kind"], RunError)(answer["error"])
        with np.load(file) as arrays:
            return dict(arrays)


def main() -> None:
    """Solve the cells that are given as JSON, write their arrays into a file, and print as JSON how that failed."""
    given = json.loads(sys.argv[1])
    fields, slices, answer = given["job"], tuple(slice(*each) for each in given["slices"]), {}
    retry = fields["retry"] and Retry(**fields["retry"] | {"regimes": tuple(fields["retry"]["regimes"])})
    job = Job(**fields | {"index": tuple(fields["index"]), "retry": retry})
    try:
        with file_errors(job.store):
            header = header_of(job)
            stored, solved = stored_cells(header, job, slices)
        np.savez(given["file"], allow_pickle=False, **solve_cells(header.spec, job, slices, stored, solved))
    except Exception as error:
        kind = type(error).__name__
        answer = {"kind": kind, "error": str(error) if kind in _KINDS else f"{kind}: {error}"}
    print(json.dumps(answer))
