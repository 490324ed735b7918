"""Python in a process of its own, with the same modules as this one."""

import os
import subprocess
import sys
from collections.abc import Callable


def watched(code: str, *arguments: str, told: Callable[[str], None]) -> int:
    """The exit status of code run in a child process; each line that it writes goes to ``told``, which may raise."""
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
                told(line)
        except BaseException:
            child.kill()
            raise
        return child.wait()


def python(code: str, *arguments: str, own_session: bool = False) -> subprocess.CompletedProcess[str]:
    """Run code in a child process, its output captured; in a session of its own, Ctrl-C on this terminal spares it."""
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env=_environment(),
        start_new_session=own_session,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        encoding="utf-8",
        check=False,
    )


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "PYTHONIOENCODING": "utf-8"}
