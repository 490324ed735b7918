"""Ctrl-C again, and the SIGTERM of a batch system; test_cli.py has the first Ctrl-C."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.paths import ROOT
from tests.support.faults import ATLAS

pytestmark = pytest.mark.slow

SPEC = """
system = "two-mass"
[axes.omega]
start = 2.0
stop = 4.0
num = 12
[solve]
max_periods = 300
[store]
tile = [1]
"""
RESUME = "interrupted: finished work is kept; rerun the same command to resume"
STRUCK = """
import os, signal, sys
from atlas.cli import progress
from atlas.cli.main import main

class Striking(progress.LogReporter):
    struck = False

    def __call__(self, snapshot):
        super().__call__(snapshot)
        if not self.struck and snapshot.tiles_done >= 2 and snapshot.stage == "solving":
            self.struck = True
            os.kill(os.getpid(), getattr(signal, sys.argv[1]))
        if snapshot.stage.startswith("interrupted") and sys.argv[2] == "twice":
            os.kill(os.getpid(), getattr(signal, sys.argv[1]))

signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background starts with it ignored
progress.reporter = Striking
main(sys.argv[3:])
"""


RUN = ("run", "spec.toml", "-o", "out.zarr", "--workers", "1")


def strike(folder: Path, signal: str, often: str, *command: str) -> subprocess.CompletedProcess[str]:
    return atlas_in(folder, [sys.executable, "-c", STRUCK, signal, often], *command)


def atlas_in(folder: Path, program: list[str], *command: str) -> subprocess.CompletedProcess[str]:
    (folder / "spec.toml").write_text(SPEC)
    return subprocess.run(
        [*program, *command],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def test_ctrl_c_twice_leaves_at_once_and_the_next_run_goes_on(tmp_path: Path) -> None:
    struck = strike(tmp_path, "SIGINT", "twice", *RUN)
    assert struck.returncode == 130
    # Python's own helper process may say after it that it cleans up.
    assert "stopped at once: finished tiles are kept" in struck.stderr.splitlines()
    assert "Traceback" not in struck.stderr
    claim = tmp_path / ".out.zarr.run" / "claim"
    assert claim.exists()  # nobody was left to take it back
    again = atlas_in(tmp_path, ATLAS, *RUN)
    assert again.returncode == 0
    assert "which no longer runs" in again.stderr
    assert "12 of 12 tiles done" in again.stdout
    assert not claim.parent.exists()


def test_sigterm_ends_a_run_in_order(tmp_path: Path) -> None:
    struck = strike(tmp_path, "SIGTERM", "once", *RUN)
    assert struck.returncode == 130
    assert struck.stderr.splitlines()[-1] == RESUME
    assert not (tmp_path / ".out.zarr.run").exists()


def test_sigterm_ends_an_extension_in_order_and_the_same_line_goes_on(tmp_path: Path) -> None:
    line = ("extend", "out.zarr", "--refine", "3", "-o", "fine.zarr", "--workers", "1")
    assert atlas_in(tmp_path, ATLAS, *RUN).returncode == 0
    struck = strike(tmp_path, "SIGTERM", "once", *line)
    assert struck.returncode == 130
    assert struck.stderr.splitlines()[-1] == RESUME
    assert not (tmp_path / ".fine.zarr.run").exists()
    again = atlas_in(tmp_path, ATLAS, *line)
    assert again.returncode == 0
    assert "34 of 34 tiles done" in again.stdout
