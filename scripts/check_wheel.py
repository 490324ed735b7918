"""Build the sdist and, from it, the wheel; install the wheel in a fresh environment and use it far from the sources.

Runs on every system with nothing but Python, build and an index of packages. A line for each step; exit code 1 and the
output of the step that failed.

Usage: python scripts/check_wheel.py [--keep FOLDER]      FOLDER gets the two files
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
COARSER = 20
"""Every so-many-th column and row of the demo's plane is solved."""
HELD = (
    "atlas/py.typed", "workers/py.typed", "atlas/examples/omega-b.toml", "workers/model/systems/two-mass.toml",
    *(f"atlas/explore/static/{name}" for name in ("page.html", "page.css", "atlas.mjs", "cell.mjs", "page.mjs")),
    *(f"atlas/explore/front/{name}.mjs" for name in ("numbers", "colors", "plane", "words", "key", "canvas")),
    *(f"atlas/explore/live/{name}" for name in ("live.html", "live.css", "live.mjs", "state.mjs", "cell.mjs")),
    "atlas/explore/front/page.css",
)  # fmt: skip
PROGRAM = """
import atlas

if __name__ == "__main__":
    axes = {"omega": {"start": 2.0, "stop": 4.0, "num": 4}, "b": {"start": 0.05, "stop": 0.5, "num": 3}}
    atlas.run(atlas.Spec("two-mass", axes, {"R": 0.6}), "small.zarr")
    ds = atlas.open("small.zarr")
    ds.atlas.plot("period").savefig("period.pdf")
    print(atlas.__file__)
"""
"""The README's, with fewer cells."""


def run(*command: str | Path, folder: Path) -> str:
    """What a command prints, run in a folder without this project's sources on any path."""
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(
        list(map(str, command)), cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        encoding="utf-8", errors="replace", check=False,
    )  # fmt: skip
    print(f"{'ok' if done.returncode == 0 else 'FAILED'}: {' '.join(Path(word).name for word in map(str, command))}")
    if done.returncode:
        sys.exit(done.stdout[-4000:])
    return done.stdout


def check_content(wheel: Path) -> None:
    """The files that users and type checkers look for, the licence, and a description without dead links."""
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        metadata = archive.read(next(name for name in names if name.endswith("/METADATA"))).decode("utf-8")
    missing = [name for name in HELD if name not in names]
    missing += [] if any(name.endswith("licenses/LICENSE") for name in names) else ["LICENSE"]
    strangers = {name.partition("/")[0] for name in names} - {"atlas", "workers"}
    if missing or not all(name.endswith(".dist-info") for name in strangers):
        sys.exit(f"{wheel.name}: misses {missing}, has {sorted(strangers)}")
    if links := re.findall(r"\]\((?!https?://)[^)]*\)", metadata):
        sys.exit(f"{wheel.name}: its description links to {links}")
    if not wheel.name.endswith("-py3-none-any.whl"):
        sys.exit(f"{wheel.name}: must be pure")


def use(python: Path, folder: Path) -> None:
    """The first minute of a user."""
    atlas: tuple[str | Path, ...] = (python, "-m", "atlas")
    command = python.with_name("atlas.exe" if os.name == "nt" else "atlas")
    run(command, "--version", folder=folder)
    run(*atlas, "systems", folder=folder)
    text = run(*atlas, "example", "omega-b", folder=folder)
    coarse = re.sub(r"(?m)^num = (\d+)", lambda found: f"num = {int(found[1]) // COARSER}", text)
    (folder / "coarse.toml").write_text(coarse, encoding="utf-8")
    run(*atlas, "run", "coarse.toml", "-o", "coarse.zarr", folder=folder)
    run(*atlas, "plot", "coarse.zarr", "-o", "map.png", folder=folder)
    print(run(*atlas, "query", "coarse.zarr", folder=folder))
    run(*atlas, "cite", "coarse.zarr", folder=folder)
    run(*atlas, "explore", "coarse.zarr", "-o", "page.html", folder=folder)
    (folder / "program.py").write_text(PROGRAM, encoding="utf-8")
    found = Path(run(python, "program.py", folder=folder).splitlines()[-1])
    if ROOT in found.parents:
        sys.exit(f"the sources were used: {found}")


def main(arguments: list[str] | None = None) -> None:
    """Build, look, install and use."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--keep", type=Path, help="a folder that gets the sdist and the wheel")
    options = parser.parse_args(arguments)
    with TemporaryDirectory(prefix="check-wheel-") as name:
        folder = Path(name)
        run(sys.executable, "-m", "build", "--outdir", folder / "dist", ROOT, folder=folder)
        wheel = next((folder / "dist").glob("*.whl"))
        check_content(wheel)
        run(sys.executable, "-m", "venv", folder / "venv", folder=folder)
        python = folder / "venv" / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
        install = (python, "-m", "pip", "install", "--quiet", "--no-compile", "--constraint", ROOT / "constraints.txt")
        run(*install, wheel, folder=folder)  # most modules are never imported here
        use(python, folder)
        if options.keep is not None:
            shutil.copytree(folder / "dist", options.keep, dirs_exist_ok=True)
        print(f"{wheel.name}: built, installed and used")


if __name__ == "__main__":
    main()
