"""Run the first stage of the tests with the oldest versions of all packages that pyproject.toml allows.

In a fresh environment and with a cache of kernels of its own. A line for each step; exit code 1 and the end of the
output of the step that failed.

Usage: python scripts/check_lower_bounds.py [FILE ...]      by default all tests that are not slow
"""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = ("cloud", "dashboard")
"""Optional packages at their lower bounds, beside the required ones; those of tests are as in any environment."""


def lower_bounds(project: Path = ROOT / "pyproject.toml") -> list[str]:
    """The required packages and those of EXTRAS, each at its lower bound."""
    table = tomllib.loads(project.read_text(encoding="utf-8"))["project"]
    lines = [*table["dependencies"], *(line for extra in EXTRAS for line in table["optional-dependencies"][extra])]
    return [re.sub(r"^([\w-]+)>=([\d.]+).*$", r"\1==\2", line) for line in lines]


def run(*command: str | Path, **variables: str) -> None:
    """Run a command; exit with the end of its output if it fails."""
    done = subprocess.run(
        list(map(str, command)), cwd=ROOT, env=os.environ | variables, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, encoding="utf-8", errors="replace", check=False,
    )  # fmt: skip
    words = " ".join(Path(word).name for word in map(str, command))
    print(f"{'ok' if done.returncode == 0 else 'FAILED'}: {words}", flush=True)
    if done.returncode:
        sys.exit(done.stdout[-8000:])


def main(*files: str) -> None:
    """Make the environment and run the tests in it."""
    with TemporaryDirectory(prefix="lower-bounds-") as name:
        folder = Path(name)
        (folder / "bounds.txt").write_text("\n".join(lower_bounds()) + "\n", encoding="utf-8")
        run(sys.executable, "-m", "venv", folder / "venv")
        python = folder / "venv" / ("Scripts" if os.name == "nt" else "bin") / "python"
        run(python, "-m", "pip", "install", "-q", "-c", folder / "bounds.txt", "-e", f"{ROOT}[dev]")
        tests = ("-m", "pytest", "-q", "-m", "not slow", "-p", "no:cacheprovider", "-n", "auto", "--dist", "loadfile")
        run(python, *tests, *files, NUMBA_CACHE_DIR=str(folder / "kernels"), OPENBLAS_NUM_THREADS="1")


if __name__ == "__main__":
    main(*sys.argv[1:])
