"""Differences between operating systems: locks between processes, names of processes, memory, interrupts.

The rest of the package is the same on all of them; tests/project/test_portable.py holds it to that.
"""

import ctypes
import multiprocessing
import os
import platform
import re
import select
import signal
import sys
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

import psutil
from filelock import FileLock

_LOOKS = 0.01
"""Seconds between two looks at a lock that another process holds."""


def file_lock(path: Path) -> FileLock:
    """A lock that one process, and one thread of it, has at a time; a process that dies releases it.

    It is a file of its own: Windows lets nobody read a file that is locked, or remove one that is open. Who removes it
    holds it. ``acquire`` raises Timeout, an OSError, or another OSError where the file system has no locks.
    """
    return FileLock(path, poll_interval=_LOOKS, fallback_to_soft=False)


def is_unread(stream: TextIO) -> bool:
    """Whether the reader of a pipe has gone, as ``head`` does once it has its lines; True where that is not known."""
    if not hasattr(select, "poll"):
        return True
    watch = select.poll()
    watch.register(stream, 0)  # errors are reported unasked
    return bool(watch.poll(0))


def processors() -> int:
    """Processors that this process may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def processor_name() -> str:
    """The processor's name, where the system tells it."""
    if sys.platform == "linux":
        try:
            lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        except OSError:
            lines = []
        for line in lines:
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def give_back_memory() -> None:
    """Return memory that this process has freed to the system; where the C library is not glibc, nothing is done.

    It keeps what several threads have allocated and freed for later: gigabytes, after an hour of drawing.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(ctypes.c_size_t(0))


def peak_memory() -> int:
    """Most bytes of memory that this process ever had.

    On Linux getrusage would count what the parent had when it started this process.
    """
    if sys.platform == "win32":
        return int(psutil.Process().memory_info().peak_wset)
    if sys.platform == "linux":
        try:
            status = Path("/proc/self/status").read_text(encoding="utf-8", errors="replace")
        except OSError:
            status = ""
        if match := re.search(r"^VmHWM:\s+(\d+) kB$", status, re.MULTILINE):
            return 1024 * int(match[1])
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def machine_name() -> str:
    """Two words: no process number means two processes, one after the other or at once, where they are the same.

    OSError where that cannot be found out. On Linux the boot and the process namespace, since containers of one machine
    count their processes apart; elsewhere the computer.
    """
    if sys.platform == "linux":
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="utf-8").strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')}"
    return f"{uuid.getnode():x} {'-'.join(platform.node().split()) or '-'}"


def process_start(pid: int) -> str:
    """When a process began, as one word that stays the same; "dead" for one that only waits to be collected.

    OSError where there is no such process. On Linux in clock ticks from boot: the time of day that psutil makes of them
    moves with the clock.
    """
    if sys.platform == "linux":
        state, *rest = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return "dead" if state in "ZX" else rest[18]
    try:
        process = psutil.Process(pid)
        return "dead" if process.status() == psutil.STATUS_ZOMBIE else f"{process.create_time():.6f}"
    except psutil.NoSuchProcess:
        raise ProcessLookupError(f"no process {pid}") from None
    except psutil.AccessDenied:
        raise PermissionError(f"process {pid} of another user") from None


ORDERLY = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals by which somebody ends a process."""


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Ctrl-C reaches every process of a terminal; those started within do not hear it, and their parent ends them.

    Blocked is what threads and processes inherit, from whichever thread this is; ignoring is for the main thread alone.
    On Windows processes inherit that Ctrl-C is ignored.
    """
    if sys.platform == "win32":
        ctypes.windll.kernel32.SetConsoleCtrlHandler(None, True)
        try:
            yield
        finally:
            ctypes.windll.kernel32.SetConsoleCtrlHandler(None, False)
        return
    # Multiprocessing starts its resource tracker with the first lock, and unblocks these signals then: so not within.
    multiprocessing.get_context("spawn").Lock()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
