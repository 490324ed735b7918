"""Scripts as their users run them: as commands."""

import os
import subprocess
import sys

from tests.paths import ROOT


def script(name: str, *arguments: str, code: int = 0) -> str:
    """The standard output of ``python -m scripts.NAME``, which has to end with that exit code."""
    command = [sys.executable, "-m", f"scripts.{name}", *arguments]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stderr[-3000:]
    return done.stdout if code != 2 else done.stderr
