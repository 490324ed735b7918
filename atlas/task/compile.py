"""The kernels' compilation: once on a machine, by whichever process is first."""

import fcntl
import gc
import json
import sys
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

from atlas.task.child import python
from workers.model.system import DEFAULT, System, find_system
from workers.settings import Settings

YOUNG_OBJECTS = 50_000
"""So many new objects before Python looks for unreachable ones: a compiler's live until it ends, and looking through
them as often as is usual takes time."""


def warming(system: str | System = DEFAULT) -> str:
    """What compile_once is about to do, for the user who waits for it."""
    marker = _marker(stand_in(system))
    return "loading the kernels" if marker and marker.exists() else "compiling the kernels (kept for the next run)"


def stand_in(system: str | System) -> str:
    """The packaged system that the kernels are compiled with for another one: of as many coordinates.

    A kernel is compiled for a number of coordinates. The default cells of these systems can be solved and have impacts.
    """
    n = len(find_system(system).states) // 2
    return {1: "single-mass", 2: "two-mass"}.get(n, f"chain-{n}")


def compile_once(system: str | System, settings: Settings) -> None:
    """See to it that all kernels for the system are in the cache on disk, which other processes read.

    Processes of one machine, or with one cache folder, wait for the first of them. It leaves that to a child, since
    compiling takes twice the memory that solving does. Nothing is done without a folder.
    """
    packaged = stand_in(system)
    marker = _marker(packaged)
    if marker is None or marker.exists():
        return
    with marker.with_name("compiling.lock").open("w") as lock:
        with suppress(OSError):  # a file system without locks: each for itself
            fcntl.flock(lock, fcntl.LOCK_EX)
        if not marker.exists() and warm_up_in_child(packaged, settings):
            marker.touch()


def warm_up_in_child(system: str, settings: Settings) -> bool:
    """warm_up in a process of its own; whether that came to its end. If not, who needs a kernel compiles it."""
    given = json.dumps({"system": system, "settings": asdict(settings)})
    return python("from atlas.task.compile import main; main()", given).returncode == 0


def main() -> None:
    """warm_up for what is given as JSON."""
    gc.set_threshold(YOUNG_OBJECTS)
    given = json.loads(sys.argv[1])
    warm_up(given["system"], Settings(**given["settings"]))


def warm_up(system: str | System, settings: Settings) -> None:
    """Compile the kernels, or load them, by one period of the default cell of ``stand_in``: every kernel is called.

    What a kernel is compiled for does not depend on the settings: they make arrays longer or empty.
    """
    from workers.tile import solve_cells

    solve_cells(stand_in(system), {}, replace(settings, method="adaptive", max_periods=1))


def _marker(system: str) -> Path | None:
    """The file that says that all has been compiled for a packaged system and this kind of processor.

    None without a folder for it.
    """
    import llvmlite.binding

    from workers.kernel.jit import CACHE

    return CACHE and CACHE / f"compiled-{system}-{llvmlite.binding.get_host_cpu_name()}"
