"""Functions that depend on the operating system, such as locks, processors and interrupts, and whole writes of files.

The rest of the package is the same on all systems; tests/project/test_portable.py checks this.
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
"""Interval, in seconds, between two attempts to get a lock that another process holds."""


def file_lock(path: Path) -> FileLock:
    """Return a lock that one thread of one process holds at a time; the system releases the lock of a dead process.

    The lock is a file of its own: Windows does not let other processes read a locked file or remove an open one. A
    process may remove the file only while it holds the lock. ``acquire`` raises Timeout, an OSError, or another OSError
    if the file system has no locks.
    """
    return FileLock(path, poll_interval=_LOOKS, fallback_to_soft=False)


@contextmanager
def temporary_beside(target: Path, prefix: str = "") -> Iterator[Path]:
    """Yield the path of a temporary file in the folder of a target, with a unique name that ends in ``.partial``.

    The file is removed at the end, unless it has been moved, as by ``move_whole``.
    """
    unfinished = target.with_name(f"{prefix}{target.name}.{uuid.uuid4().hex}.partial")
    try:
        yield unfinished
    finally:
        unfinished.unlink(missing_ok=True)


def flush(path: Path) -> None:
    """Flush a written file to the disk: after a crash it could otherwise be empty under its later name."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def move_whole(unfinished: Path, target: Path) -> None:
    """Flush a written file and move it to a target, which it replaces: the target appears whole or not at all."""
    flush(unfinished)
    os.replace(unfinished, target)


def is_unread(stream: TextIO) -> bool:
    """Return True if the reader of a pipe has closed it, as ``head`` does after its lines, or if this cannot be
    known.
    """
    if not hasattr(select, "poll"):
        return True
    watch = select.poll()
    watch.register(stream, 0)  # errors are always reported
    return bool(watch.poll(0))


def processors() -> int:
    """Return the number of processors that this process may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def processor_name() -> str:
    """Return the name of the processor, as far as the system reports one."""
    if sys.platform == "linux":
        try:
            lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        except OSError:
            lines = []
        for line in lines:
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def release_memory() -> None:
    """Return freed memory of this process to the system; do nothing if the C library is not glibc.

    glibc keeps memory that several threads have allocated and freed: gigabytes, after an hour of drawing.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(ctypes.c_size_t(0))


def peak_memory() -> int:
    """Return the peak memory of this process, in bytes.

    On Linux getrusage would include the memory of the parent at the start of this process.
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
    """Return an identifier, two words, of the host and its process numbering.

    While the identifier stays the same, a process number never means two processes, except one after the other with
    different start times. On Linux the words are the boot and the process namespace, since containers of one host
    number their processes separately; elsewhere they identify the computer. Raise OSError if the identifier cannot be
    found.
    """
    if sys.platform == "linux":
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="utf-8").strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')}"
    return f"{uuid.getnode():x} {'-'.join(platform.node().split()) or '-'}"


def process_start(pid: int) -> str:
    """Return the start time of a process as one word that never changes.

    The word is "dead" for a process that has ended but whose parent has not yet taken note of its end. Raise OSError if
    there is no such process. On Linux the time is in clock ticks since boot: psutil converts the ticks to a time of
    day, which moves with the clock.
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


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Shield processes and threads that are started within the block from Ctrl-C; their parent has to end them.

    Ctrl-C reaches every process of a terminal. A blocked signal is inherited by threads and processes from any thread,
    whereas only the main thread can ignore a signal. On Windows processes inherit that Ctrl-C is ignored.
    """
    if sys.platform == "win32":
        ctypes.windll.kernel32.SetConsoleCtrlHandler(None, True)
        try:
            yield
        finally:
            ctypes.windll.kernel32.SetConsoleCtrlHandler(None, False)
        return
    # Multiprocessing starts its resource tracker with the first lock and unblocks these signals, so do it before.
    multiprocessing.get_context("spawn").Lock()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def process_name(pid: int | None = None) -> str:
    """Return a name that identifies a process, by default this one, among all processes of all hosts; empty if unknown.

    It consists of the identifier of the machine (two words), the process id and the start time.
    """
    pid = os.getpid() if pid is None else pid
    try:
        return f"{machine_name()} {pid} {process_start(pid)}"
    except OSError:
        return ""


def is_running(pid: int, name: str) -> bool | None:
    """Return True if the process with this id and name runs, False if it does not; None if this host cannot know."""
    own_parts, name_parts = process_name().split(), name.split()
    if not own_parts or own_parts[:2] != name_parts[:2]:
        return None
    if not psutil.pid_exists(pid):
        return False
    try:
        return process_start(pid) == name_parts[3]
    except OSError:
        return None
