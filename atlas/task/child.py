"""Python in a process of its own, with the same modules as this one."""

import os
import subprocess
import sys


def python(code: str, *arguments: str, own_session: bool = False) -> subprocess.CompletedProcess[str]:
    """Run code in a child process, its output captured; in a session of its own, Ctrl-C on this terminal spares it."""
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        start_new_session=own_session,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
