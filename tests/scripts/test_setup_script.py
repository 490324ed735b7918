"""``scripts/setup`` asks before it uses sudo."""

import os
import pty
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.paths import ROOT

FAKES = {
    "id": "echo 1000",
    "sudo": 'echo "$@" >>"$SUDO_LOG"; exit 1',
    "apt-get": "exit 1",
    "python3": '[ "$1" != -m ]',  # a Python without venv, pip and virtualenv
}


@pytest.mark.parametrize(("answer", "used"), [(None, ""), ("n\n", ""), ("y\n", "-v\n")])
def test_sudo_is_used_only_by_who_says_yes_at_a_terminal(answer: str | None, used: str, tmp_path: Path) -> None:
    (tmp_path / "scripts").mkdir()
    for name in ("scripts/setup", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path / name)
    for name, body in FAKES.items():
        (tmp_path / name).write_text(f"#!/bin/bash\n{body}\n")
        (tmp_path / name).chmod(0o755)
    log = tmp_path / "sudo.log"
    log.touch()
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHON": "python3", "SUDO_LOG": str(log)}
    ours, terminal = pty.openpty()
    os.write(ours, (answer or "").encode())
    done = subprocess.run(
        [tmp_path / "scripts" / "setup"], env=environment, stdin=subprocess.DEVNULL if answer is None else terminal,
        capture_output=True, text=True,
    )  # fmt: skip
    os.close(ours)
    os.close(terminal)
    assert done.returncode == 1 and "cannot make a virtual environment" in done.stderr
    assert log.read_text() == used
