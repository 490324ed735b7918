"""A tile, or a part of one, in a process of its own: for what is suspected to kill the process that solves it."""

import json
import signal
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from atlas.errors import NetworkError, RunError
from atlas.platform import ORDERLY
from atlas.spec.spec import Slices
from atlas.task.child import python
from atlas.task.retry import Retry
from atlas.task.task import (
    Job,
    Receipt,
    RefusedError,
    StoreFullError,
    checked_header,
    file_errors,
    solve_and_write,
    solve_cells,
    stored_cells,
)

ATTEMPTS = 2
_KINDS = {kind.__name__: kind for kind in (RefusedError, StoreFullError, NetworkError)}


def run_isolated(job: Job) -> Receipt | str:
    """The receipt of a tile solved by a child process, or in words how that process died, each time it was tried.

    Raises RunError with the child's own words where it failed without dying.
    """
    for _ in range(ATTEMPTS):
        answer = _answer("main", job, "")
        if isinstance(answer, dict):
            return Receipt(**answer | {"index": tuple(answer["index"]), "record": tuple(answer["record"])})
    return f"the process that solved its tile died, each of {ATTEMPTS + 1} times ({answer})"


def solve_isolated(job: Job, slices: Slices) -> dict[str, np.ndarray] | str:
    """The arrays of some cells of the job's tile, solved by a child process, or in words how that process died."""
    with tempfile.TemporaryDirectory(prefix="atlas-part-") as folder:
        file = f"{folder}/part.npz"
        part = {"slices": [(each.start, each.stop) for each in slices], "file": file}
        answer = _answer("solve_part", job, json.dumps(part))
        if isinstance(answer, str):
            return f"the process that solved its part of the tile died ({answer})"
        with np.load(file) as arrays:
            return dict(arrays)


def main() -> None:
    """Solve and write the tile of the job given as JSON, print its receipt as JSON."""
    _print(lambda job: asdict(solve_and_write(job)))


def solve_part() -> None:
    """Solve cells of the tile of the job given as JSON, and write their arrays into a file."""
    part = json.loads(sys.argv[2])
    slices = tuple(slice(*each) for each in part["slices"])

    def solve(job: Job) -> dict[str, Any]:
        with file_errors(job.store):
            header = checked_header(job.store, job.run_id, job.solver_version, job.patience)
            stored, solved = stored_cells(header, job, slices)
        np.savez(part["file"], allow_pickle=False, **solve_cells(header.spec, job, slices, stored, solved))
        return {}

    _print(solve)


def _answer(function: str, job: Job, more: str) -> dict[str, Any] | str:
    """What a function of this module prints in a process of its own, or in words how that process died."""
    code = f"from atlas.task.isolated import {function}; {function}()"
    ended = python(code, json.dumps(asdict(job)), more, own_session=True)
    if -ended.returncode in ORDERLY:  # by somebody: the tile has no part in that
        raise RunError(f"the process of tile {job.index} was ended by {signal.Signals(-ended.returncode).name}")
    if ended.returncode != 0:
        return _how(ended.returncode)
    answer: dict[str, Any] = json.loads(ended.stdout.splitlines()[-1])
    if "error" in answer:
        raise _KINDS.get(answer["kind"], RunError)(answer["error"])
    return answer


def _print(act: Callable[[Job], dict[str, Any]]) -> None:
    """Print as JSON what is done for the job given as JSON, or how it failed."""
    given = json.loads(sys.argv[1])
    retry = given["retry"] and Retry(**given["retry"] | {"regimes": tuple(given["retry"]["regimes"])})
    try:
        answer = act(Job(**given | {"index": tuple(given["index"]), "retry": retry}))
    except Exception as error:
        kind = type(error).__name__
        answer = {"kind": kind, "error": str(error) if kind in _KINDS else f"{kind}: {error}"}
    print(json.dumps(answer))


def _how(code: int) -> str:
    return f"signal {-code}, {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
