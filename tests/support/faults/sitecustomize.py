"""Fault injection: Python imports this module at start if its folder is on PYTHONPATH, so it reaches every process.

FAULTS names a folder. Its ``script.json`` maps a tile ("0-1") to the fates of its attempts in order: "ok", "fail" (an
exception), "die" (kill -9 of the process), "slow" (0.3 s more), "full", "forbidden" (errors of the disk); the last word
holds for all further attempts, and "*" for tiles not named. ``log`` gets a line for each attempt.
"""

import errno
import importlib.abc
import importlib.util
import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any


def _install(module: Any) -> None:
    whole = module.solve_and_write
    folder = Path(os.environ["FAULTS"])

    def faulty(job: Any, handle: Any) -> Any:
        tile = "-".join(map(str, job.index))
        with open(folder / "log", "a+") as log:
            log.seek(0)
            attempt = sum(line.split()[0] == tile for line in log)
            log.write(f"{tile} {os.getpid()}\n")
        script = json.loads((folder / "script.json").read_text())
        words = script.get(tile, script.get("*", ["ok"]))
        word = words[min(attempt, len(words) - 1)]
        if word == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if word == "fail":
            raise ZeroDivisionError(f"attempt {attempt + 1}")
        if word == "slow":
            time.sleep(0.3)
        with module.translate_file_errors(job.store_ref.store):
            if word in ("full", "forbidden"):
                number = errno.ENOSPC if word == "full" else errno.EROFS
                raise OSError(number, os.strerror(number))
        return whole(job, handle)

    module.solve_and_write = faulty


class _Finder(importlib.abc.MetaPathFinder):
    """Loads atlas.task.tile_job as usual, then changes it."""

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> Any:
        if name != "atlas.task.tile_job":
            return None
        sys.meta_path.remove(self)
        spec: Any = importlib.util.find_spec(name)
        load = spec.loader.exec_module

        def exec_module(module: Any) -> None:
            load(module)
            _install(module)

        spec.loader.exec_module = exec_module
        return spec


if "FAULTS" in os.environ:
    sys.meta_path.insert(0, _Finder())
