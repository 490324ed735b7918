"""Python in a process of its own, with the same modules as this one."""

import os
import subprocess
import sys


def python(code: str, *arguments: str, apart: bool = False) -> subprocess.CompletedProcess[str]:
    """Run code in a child process, its output captured; ``apart`` from the Ctrl-C of this process's terminal."""
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        start_new_session=apart,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
