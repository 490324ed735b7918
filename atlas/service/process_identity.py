"""Unique names of processes on this host, so that the end of a process is recognised with certainty."""

import os

import psutil

from atlas.platform import machine_name, process_start


def this_process() -> str:
    """Return the name of this process; empty on a system without process names."""
    return process_name(os.getpid())


def process_name(pid: int) -> str:
    """Return the machine (two words), process id and start time of a process; empty if they cannot be read."""
    try:
        return f"{machine_name()} {pid} {process_start(pid)}"
    except OSError:
        return ""


def is_name(text: str) -> bool:
    """Return True if a text can be the name of a process, or is empty."""
    return len(text.split()) in (0, 4)


def is_running(pid: int, name: str) -> bool | None:
    """Return True if the process with this id and name runs, False if it does not; None if this host cannot know."""
    here, there = this_process().split(), name.split()
    if not here or here[:2] != there[:2]:
        return None
    if not psutil.pid_exists(pid):
        return False
    try:
        return process_start(pid) == there[3]
    except OSError:
        return None
