"""A tile in a process of its own, for one that is suspected to kill the process that solves it."""

import json
import signal
import sys
from dataclasses import asdict

from atlas.errors import NetworkError, RunError
from atlas.task.child import python
from atlas.task.retry import Retry
from atlas.task.task import Job, Receipt, RefusedError, StoreFullError, solve_and_write

ATTEMPTS = 2
_ORDERLY = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals by which somebody ends a process; the tile has no part in that."""

_KINDS = {kind.__name__: kind for kind in (RefusedError, StoreFullError, NetworkError)}


def run_isolated(job: Job) -> Receipt | str:
    """The receipt of a tile solved by a child process, or in words how that process died, each time it was tried.

    Raises RunError with the child's own words where it failed without dying.
    """
    for _ in range(ATTEMPTS):
        ended = python("from atlas.task.isolated import main; main()", json.dumps(asdict(job)), own_session=True)
        if ended.returncode == 0:
            answer = json.loads(ended.stdout.splitlines()[-1])
            if "error" in answer:
                raise _KINDS.get(answer["kind"], RunError)(answer["error"])
            return Receipt(**answer | {"index": tuple(answer["index"]), "entry": tuple(answer["entry"])})
        if -ended.returncode in _ORDERLY:
            raise RunError(f"the process of tile {job.index} was ended by {signal.Signals(-ended.returncode).name}")
    return f"the process that solved its tile died, each of {ATTEMPTS + 1} times ({_how(ended.returncode)})"


def main() -> None:
    """Solve and write the tile of the job given as JSON, print its receipt as JSON."""
    given = json.loads(sys.argv[1])
    retry = given["retry"] and Retry(**given["retry"] | {"regimes": tuple(given["retry"]["regimes"])})
    try:
        answer = asdict(solve_and_write(Job(**given | {"index": tuple(given["index"]), "retry": retry})))
    except Exception as error:
        kind = type(error).__name__
        answer = {"kind": kind, "error": str(error) if kind in _KINDS else f"{kind}: {error}"}
    print(json.dumps(answer))


def _how(code: int) -> str:
    return f"signal {-code}, {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
