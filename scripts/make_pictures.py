"""Make the pictures of docs/ anew, each by its command on its page, or by those that the page gives for every NAME.

Usage: python -m scripts.make_pictures [PICTURE...] [--list]

Without a PICTURE all are made. Stores lie in demo/pictures-N, N the solver's version: what was computed before with the
same solver is not computed again. The explorer's picture needs Playwright and chromium, work-precision.png heyoka.
"""

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from tests.support import ROOT
from workers import SOLVER_VERSION

DOCS = ROOT / "docs"
FOLDER = ROOT / "demo" / f"pictures-{SOLVER_VERSION}"
BESIDE = {
    "chaos-map.png": [
        "atlas run omega-b-fine -o omega-b-fine.zarr",
        "atlas plot omega-b-fine.zarr -o chaos-map.png --overlay grazing",
    ],
    "explorer.png": [
        "atlas run omega-b -o plane.zarr",
        "python -m scripts.explorer_picture plane.zarr explorer.png",
    ],
}
"""The commands of pictures whose page shows none, or another store's."""
NEEDS = {"work-precision.png": "heyoka", "explorer.png": "playwright"}
"""What a picture needs beside the development tools."""


def pictures() -> dict[str, Path]:
    """The PNGs that pages show, each with the first page that shows it."""
    found: dict[str, Path] = {}
    for page in sorted([ROOT / "README.md", *DOCS.rglob("*.md")]):
        for name in re.findall(r"!\[[^\]]*\]\(([^)]+\.png)\)", page.read_text()):
            found.setdefault(Path(name).name, page)
    return {name: page for name, page in found.items() if (DOCS / name).exists()}


def commands(picture: str, page: Path) -> list[str]:
    """What makes a picture, in order: the stores that it is drawn from, what they are to keep, and the picture."""
    if picture in BESIDE:
        return BESIDE[picture]
    text = page.read_text().replace("\\\n", " ")
    lines = [line.split("  #")[0].strip() for line in re.findall(r"^(?:atlas|python -m) .*", text, re.MULTILINE)]
    lines += re.findall(r"`(python -m scripts\.[^`]*)`", text)
    lines += [
        line.replace("NAME", Path(picture).stem)
        for line in re.findall(r"^    (atlas .*\bNAME\b.*)", text, re.MULTILINE)
    ]
    own = [line for line in lines if re.search(rf"(?:^|[ /]){re.escape(picture)}(?: |$)", line)]
    if not own:
        raise SystemExit(f"{page.name}: no command beside {picture}")
    store = next((re.escape(word) for word in shlex.split(own[0]) if word.endswith(".zarr")), None)
    made = [line for line in lines if store and re.search(rf"^atlas .* -o {store}$", line)][:1]
    keeps = rf"atlas (find curves|attractors label|attractors measure) {store}"
    kept = [line for line in lines if store and re.fullmatch(keeps, line)]
    return [*made, *kept, own[0]]


def specs(page: Path) -> dict[str, str]:
    """The whole files that a page shows, by the name in their first line."""
    blocks = re.findall(r"^```toml\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL)
    return {named[1]: block for block in blocks if (named := re.match(r"# ([\w-]+\.toml)\n", block))}


def make(picture: str, page: Path, done: set[str]) -> None:
    """Run what makes a picture and move it to docs/; ``done`` are commands that ran before."""
    for name, text in specs(page).items():
        (FOLDER / name).write_text(text)
    (FOLDER / "docs").mkdir(exist_ok=True)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "PYTHONPATH": str(ROOT)}
    for line in commands(picture, page):
        if line not in done:
            print(f"== {line}", flush=True)
            subprocess.run(shlex.split(line), cwd=FOLDER, env=environment, check=True)
            done.add(line)
    written = next(path for path in (FOLDER / picture, FOLDER / "docs" / picture) if path.exists())
    shutil.move(written, DOCS / picture)
    done.discard(commands(picture, page)[-1])


def main() -> None:
    """Make the pictures that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture", nargs="*", help="a file's name in docs/; default: all")
    parser.add_argument("--list", action="store_true", help="print the commands and run none")
    given = parser.parse_args()
    known = pictures()
    unknown = sorted(set(given.picture) - set(known))
    if unknown:
        parser.error(f"no picture of docs/: {', '.join(unknown)}; possible: {', '.join(known)}")
    FOLDER.mkdir(parents=True, exist_ok=True)
    done: set[str] = set()
    missing = {name: need for name, need in NEEDS.items() if find_spec(need) is None}
    for picture in given.picture or known:
        if given.list:
            print(f"{picture}:", *commands(picture, known[picture]), sep="\n    ")
        elif picture not in missing:
            make(picture, known[picture], done)
    left_out = [name for name in given.picture or known if name in missing and not given.list]
    if left_out:
        raise SystemExit("\n".join(f"{name}: not made, it needs {missing[name]}" for name in left_out))


if __name__ == "__main__":
    main()
