"""Processes of this machine by a name that nothing else ever has, so that a dead one is known for certain."""

import os
from pathlib import Path


def this_process() -> str:
    """The name of this process, empty on a system that does not give what it takes."""
    return process_name(os.getpid())


def process_name(pid: int) -> str:
    """Boot, process namespace, process and the moment it began; empty if that cannot be found out."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')} {pid} {_began(pid)}"
    except OSError:
        return ""


def is_name(text: str) -> bool:
    """Whether a text can be the name of a process, or says that it has none."""
    return len(text.split()) in (0, 4)


def is_running(pid: int, name: str) -> bool | None:
    """Whether the process of that number and name runs; None if this machine cannot know."""
    here, there = this_process().split(), name.split()
    if not here or here[:2] != there[:2]:
        return None
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    try:
        return _began(pid) == there[3]
    except OSError:
        return None


def _began(pid: int) -> str:
    """Clock ticks from boot to the start of a process; "dead" for one that only waits to be collected."""
    state, *rest = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return "dead" if state in "ZX" else rest[18]
