"""The kernels' compilation: once on a machine, by whichever process is first."""

import fcntl
import gc
import json
import sys
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

from atlas.task.child import python
from workers.model.system import DEFAULT
from workers.settings import Settings

YOUNG_OBJECTS = 50_000
"""So many new objects before Python looks for unreachable ones: a compiler's live until it ends, and looking through
them as often as is usual takes time."""


def warming() -> str:
    """What compile_once is about to do, for the user who waits for it."""
    marker = _marker()
    return "loading the kernels" if marker and marker.exists() else "compiling the kernels (kept for the next run)"


def compile_once(settings: Settings) -> None:
    """See to it that all kernels are in the cache on disk, which other processes read; they serve every system.

    Processes of one machine, or with one cache folder, wait for the first of them. It leaves that to a child, since
    compiling takes twice the memory that solving does. Nothing is done without a folder.
    """
    marker = _marker()
    if marker is None or marker.exists():
        return
    with marker.with_name("compiling.lock").open("w") as lock:
        with suppress(OSError):  # a file system without locks: each for itself
            fcntl.flock(lock, fcntl.LOCK_EX)
        if not marker.exists() and warm_up_in_child(settings):
            marker.touch()


def warm_up_in_child(settings: Settings) -> bool:
    """warm_up in a process of its own; whether that came to its end. If not, who needs a kernel compiles it."""
    return python("from atlas.task.compile import main; main()", json.dumps(asdict(settings))).returncode == 0


def main() -> None:
    """warm_up for settings that are given as JSON."""
    gc.set_threshold(YOUNG_OBJECTS)
    warm_up(Settings(**json.loads(sys.argv[1])))


def warm_up(settings: Settings) -> None:
    """Compile the kernels, or load them, by one period of the default cell: every kernel is called.

    What a kernel is compiled for depends neither on the system nor on the settings: they make arrays longer or empty.
    """
    from workers.tile import solve_cells

    solve_cells(DEFAULT, {}, replace(settings, method="adaptive", max_periods=1))


def _marker() -> Path | None:
    """The file that says that all has been compiled for this kind of processor; None without a folder for it."""
    import llvmlite.binding

    from workers.kernel.jit import CACHE

    return CACHE and CACHE / f"compiled-{llvmlite.binding.get_host_cpu_name()}"
