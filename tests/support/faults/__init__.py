"""Fault injection for tests: the environment of a scripted process."""

import json
import os
import sys
from collections import Counter
from pathlib import Path

from tests.support import ROOT

ATLAS = [sys.executable, "-c", "import sys; from atlas.cli.main import main; main(sys.argv[1:])"]
"""The command, in a separate process."""


def environment(folder: Path, script: dict[str, list[str]]) -> dict[str, str]:
    """Variables for processes that meet the faults of a script; see sitecustomize.py."""
    folder.mkdir(exist_ok=True)
    (folder / "script.json").write_text(json.dumps(script))
    (folder / "log").touch()
    path = os.pathsep.join(map(str, (Path(__file__).parent, ROOT)))
    return dict(os.environ) | {"FAULTS": str(folder), "PYTHONPATH": path}


def attempts(folder: Path) -> Counter[str]:
    """Number of attempts at each tile."""
    return Counter(line.split()[0] for line in (folder / "log").read_text().splitlines())
