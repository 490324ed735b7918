"""The kernels' compilation: once on a machine, by whichever process is first."""

import fcntl
import gc
import json
import sys
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from atlas.task.child import python
from workers.model.system import DEFAULT
from workers.settings import Settings

ONE_ORBIT = {"omega": 1.643, "b": 0.52}
"""A cell of the default system whose initial states all reach one orbit, soon."""

YOUNG_OBJECTS = 50_000
"""So many new objects before Python looks for unreachable ones: a compiler's live until it ends, and looking through
them as often as is usual takes time."""


def warming(attractors: bool = False) -> str:
    """What compile_once is about to do, for the user who waits for it."""
    marker = _marker(attractors)
    return "loading the kernels" if marker and marker.exists() else "compiling the kernels (kept for the next run)"


def compile_once(settings: Settings, attractors: bool = False) -> None:
    """See to it that all kernels are in the cache on disk, which other processes read; they serve every system.

    With ``attractors`` those too by which motions are compared with known attractors. Processes of one machine, or
    with one cache folder, wait for the first of them. It leaves that to a child, since compiling takes twice the memory
    that solving does. Nothing is done without a folder.
    """
    marker = _marker(attractors)
    if marker is None or marker.exists():
        return
    with marker.with_name("compiling.lock").open("w") as lock:
        with suppress(OSError):  # a file system without locks: each for itself
            fcntl.flock(lock, fcntl.LOCK_EX)
        if not marker.exists() and warm_up_in_child(settings, attractors):
            marker.touch()


def warm_up_in_child(settings: Settings, attractors: bool = False) -> bool:
    """warm_up in a process of its own; whether that came to its end. If not, who needs a kernel compiles it."""
    given = json.dumps([asdict(settings), attractors])
    return python("from atlas.task.compile import main; main()", given).returncode == 0


def main() -> None:
    """warm_up for arguments that are given as JSON."""
    gc.set_threshold(YOUNG_OBJECTS)
    settings, attractors = json.loads(sys.argv[1])
    warm_up(Settings(**settings), attractors)


def warm_up(settings: Settings, attractors: bool = False) -> None:
    """Compile the kernels, or load them, by one period of the default cell: every kernel is called.

    Those of attractors by all of a cell with one orbit, and by means over a section state, which chaos alone has.

    What a kernel is compiled for depends neither on the system nor on the settings: they make arrays longer or empty.
    """
    from workers.tile import solve_cells

    solve_cells(DEFAULT, {}, replace(settings, method="adaptive", max_periods=1))
    if attractors:
        from workers.attractors import solve_attractors
        from workers.identity import batch_moments
        from workers.starts import Starts

        solve_attractors(DEFAULT, ONE_ORBIT, Settings(exponents="none", survival=0), Starts(4))
        batch_moments(np.zeros((1, 1, 1, 2)), np.zeros(1, dtype=np.int64), 1)


def _marker(attractors: bool = False) -> Path | None:
    """The file that says that all has been compiled for this kind of processor; None without a folder for it."""
    import llvmlite.binding

    from workers.kernel.jit import CACHE

    what = "compiled-attractors" if attractors else "compiled"
    return CACHE and CACHE / f"{what}-{llvmlite.binding.get_host_cpu_name()}"
