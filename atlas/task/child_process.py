"""Running Python code in child processes that see the same modules as this process."""

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from threading import Event


def run_python(code: str, *arguments: str, on_line: Callable[[str], None]) -> int:
    """Run code in a child process and return its exit status; ``on_line`` gets each output line, and may raise."""
    with subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        env=_environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        encoding="utf-8",
    ) as child:
        try:
            for line in child.stdout or ():
                on_line(line)
        except BaseException:
            child.kill()
            raise
        return child.wait()


def run_python_parallel(code: str, arguments: Sequence[str], on_line: Callable[[int, str], None]) -> list[int]:
    """Run code in parallel child processes, one per argument, and return their exit statuses.

    ``on_line`` gets the index of the child's argument and a line of its output, in this thread. If it raises, or the
    wait is interrupted, each child ends at its next line.
    """
    lines, given_up = SimpleQueue[tuple[int, str | None]](), Event()

    def heard(place: int, line: str) -> None:
        if given_up.is_set():
            raise InterruptedError
        lines.put((place, line))

    def watch(place: int) -> int:
        try:
            return run_python(code, arguments[place], on_line=lambda line: heard(place, line))
        finally:
            lines.put((place, None))

    with ThreadPoolExecutor(len(arguments)) as threads:
        running = [threads.submit(watch, place) for place in range(len(arguments))]
        try:
            under_way = len(running)
            while under_way:
                place, line = lines.get()
                if line is None:
                    under_way -= 1
                else:
                    on_line(place, line)
        except BaseException:
            given_up.set()
            raise
        return [future.result() for future in running]


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "PYTHONIOENCODING": "utf-8"}
