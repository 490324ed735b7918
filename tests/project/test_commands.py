"""The claim that every command and every script of README.md and docs/ does what it is shown to do, as it stands.

All blocks of a page run in order in one folder, but those after a comment ``<!-- not run by tests: why -->``. What they
start from lies there: small specs under the names of the pages' own, a store of one of them, and the files that the
page itself shows.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest
from distributed import Client
from PIL import Image

import atlas
from tests.cli_runner import commands
from tests.project.test_docs import PAGES, ROOT, files, script_calls
from tests.support.faults import ATLAS

pytestmark = pytest.mark.slow

PLANE = """
system = "two-mass"
[axes.omega]
start = 2.0
stop = 4.0
num = 9
[axes.b]
start = 0.1
stop = 0.5
num = 6
[solve]
tolerance = 0.05
max_periods = 2000
[store]
tile = [3, 4]
"""
LINE = """
system = "two-mass"
[axes.omega]
start = 2.0
stop = 4.0
num = 20
{more}
[solve]
section_samples = 16
max_periods = 2000
"""


def coarse(example: str) -> str:
    """An example of the package on 4 x 3 cells, each with a small budget."""
    text = (ROOT / "atlas" / "examples" / f"{example}.toml").read_text()
    for num in ("4", "3"):
        text = re.sub(r"num = \d\d+", f"num = {num}", text, count=1)
    return re.sub(r"\[solve\].*", "[solve]\ntolerance = 0.1\nmax_periods = 500\nsurvival = 0\n", text, flags=re.DOTALL)


EXAMPLES = """
belt bistable-harvester bouncing-ball capsule chain-3 duffing-stop energy-harvester energy-sink friction-oscillator
gear-mesh hertz-ball impact-damper impact-pair rotor-rub shaken-base simpson-ghosh-2026 single-mass soft-impact
soft-suspension stick-slip stribeck-belt two-stops
"""
"""Of other systems, each with a plane of its own."""
POINTS = """
system = "two-mass"
[points]
file = "table.csv"
[solve]
tolerance = 0.05
max_periods = 2000
"""
FILES = {
    # A file goes before the example of that name in the package.
    "omega-b": PLANE,
    "omega-b-fine": PLANE,
    "plane.toml": PLANE,
    "wider.toml": PLANE.replace("stop = 4.0\nnum = 9", "stop = 4.5\nnum = 11"),
    "stack.toml": PLANE.replace("[solve]", "[axes.R]\nvalues = [0.7, 0.8]\n[solve]").replace("[3, 4]", "[1, 3, 4]"),
    "points.toml": POINTS,
    "table.csv": "omega,b,R\n2.5,0.1,0.8\n3.0,0.2,0.6\n",
    "fig6": LINE.format(more=""),
    "up.toml": LINE.format(more='continuation = "forward"'),
    "down.toml": LINE.format(more='continuation = "backward"'),
    **{name: coarse(name) for name in EXAMPLES.split()},
}
STORES = {"other.zarr": 0.7, "R7.zarr": 0.7, "R8.zarr": 0.8, "R9.zarr": 0.9}
"""Stores of the same plane at another R, made for the pages that name them."""
MOST = 10
SKIPPED = r"<!-- not run by tests: [^>]+ -->\n\n?"


def runnable(page: Path) -> list[tuple[str, str]]:
    """Language and text of the blocks of a page that can be run here, in order."""
    text = re.sub(SKIPPED + r"```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    return re.findall(r"^```(sh|python)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def forked(tmp_path_factory: pytest.TempPathFactory, one_processor: None) -> Iterator[Path]:
    """The command ``atlas`` without the time that imports take."""
    with commands(tmp_path_factory.mktemp("forked")) as made:
        yield made


@pytest.fixture(scope="module")
def command(tmp_path_factory: pytest.TempPathFactory, forked: Path) -> Iterator[None]:
    """The command ``atlas`` on the path: the first time of each subcommand a new process, later one that is forked."""
    bin_folder, called = (tmp_path_factory.mktemp(name) for name in ("bin", "called"))
    first = f'mkdir {called}/"command-$1" 2>/dev/null && exec {shlex.join(ATLAS)} "$@"'
    (bin_folder / "atlas").write_text(f'#!/bin/sh\n{first}\nexec {forked} "$@"\n')
    (bin_folder / "atlas").chmod(0o755)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", f"{bin_folder}{os.pathsep}{os.environ['PATH']}")
        patch.setenv("PYTHONPATH", str(ROOT))
        patch.setenv("MPLBACKEND", "agg")
        yield


@pytest.fixture(scope="module")
def stores(tmp_path_factory: pytest.TempPathFactory, client: Client) -> Callable[[str], Path]:
    """The store of a name that pages use, made when first asked for."""
    work = tmp_path_factory.mktemp("stores")

    @cache
    def store(name: str) -> Path:
        spec = FILES.get(f"{Path(name).stem}.toml", "")
        if name in STORES:
            spec = PLANE.replace("[axes.omega]", f"[parameters]\nR = {STORES[name]}\n[axes.omega]")
        (work / "table.csv").write_text(FILES["table.csv"])
        (work / "spec.toml").write_text(spec)
        atlas.run(atlas.Spec.from_toml(work / "spec.toml"), work / name, client=client)
        return work / name

    return store


def run(command: list[str], work: Path) -> None:
    ended = subprocess.run(command, cwd=work, capture_output=True, text=True, timeout=900)
    assert ended.returncode == 0, f"{shlex.join(command)}\n{ended.stdout}{ended.stderr}"


def coarser(spec: str) -> str:
    """A page's spec with at most MOST values along each axis."""
    return re.sub(r"^num = (\d+)", lambda found: f"num = {min(int(found[1]), MOST)}", spec, flags=re.MULTILINE)


@pytest.mark.parametrize("page", [page for page in PAGES if runnable(page)], ids=lambda page: page.name)
def test_what_a_page_shows_can_be_run_as_it_stands(
    page: Path, tmp_path: Path, stores: Callable[[str], Path], command: None, forked: Path
) -> None:
    folder, shown = tmp_path, page.read_text()
    for name in ("plane.zarr", "stack.zarr", "points.zarr", *STORES):
        if name in shown:
            shutil.copytree(stores(name), folder / name)
    for name, text in FILES.items():
        (folder / name).write_text(text)
    for name, text in files(page).items():
        (folder / name).write_text(coarser(text) if name.endswith(".toml") else text)
    for number, (language, text) in enumerate(runnable(page)):
        if language == "sh":
            run(["sh", "-eu", "-c", text], folder)
        else:
            (folder / f"block{number}.py").write_text(text)
            starts_processes = re.search(r"atlas\.(run|extend|retry|find_|label_|measure_)|Cluster", text)
            new = page.name == "README.md" or starts_processes
            python = [sys.executable, "-W", "error"] if new else [str(forked)]
            run([*python, f"block{number}.py"], folder)
    for line in for_each_name(page):
        run(["sh", "-eu", "-c", line], folder)
    for name in pictures(page):
        if (folder / name).exists():
            with Image.open(folder / name) as image:
                image.verify()


@pytest.mark.parametrize("arguments", [["systems"], ["status", "nowhere.zarr"]], ids=lambda given: given[0])
def test_a_forked_command_says_what_a_new_process_says_and_ends_like_it(
    forked: Path, tmp_path: Path, arguments: list[str]
) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    ended = [
        subprocess.run([*line, *arguments], cwd=tmp_path, env=environment, capture_output=True, text=True)
        for line in ([str(forked)], ATLAS)
    ]
    assert len({(one.returncode, one.stdout, one.stderr) for one in ended}) == 1
    assert ended[0].returncode == (0 if arguments == ["systems"] else 2)


def pictures(page: Path) -> list[str]:
    return [Path(name).name for name in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", page.read_text())]


def written(page: Path) -> set[str]:
    """The files that the blocks and calls of scripts of a page write."""
    blocks = "".join(text for _, text in runnable(page))
    named = {Path(word).name for call in script_calls(page) for word in call}
    return named | set(re.findall(r"^atlas .* -o (\S+)", blocks, re.MULTILINE))


def for_each_name(page: Path) -> list[str]:
    """The commands that a page gives once for every NAME, of each picture that no other command writes."""
    lines = re.findall(r"^    (atlas .*\bNAME\b.*)", page.read_text(), re.MULTILINE)
    names = [Path(picture).stem for picture in pictures(page) if lines and picture not in written(page)]
    return [line.replace("NAME", name) for name in names for line in lines]


@pytest.mark.parametrize("page", [page for page in PAGES if pictures(page)], ids=lambda page: page.name)
def test_the_command_that_makes_a_picture_stands_beside_it(page: Path) -> None:
    """An ``atlas`` command that writes it, one for every NAME, or a call of a script that does."""
    found = written(page) | set(re.findall(r" -o (\S+)", "\n".join(for_each_name(page))))
    found.add("machine.svg")  # scripts/machine_drawing.py draws that and nothing else
    assert set(pictures(page)) <= found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_only_installations_clusters_clouds_and_servers_are_not_run(page: Path) -> None:
    reasons = set(re.findall(r"<!-- not run by tests: ([^>]+) -->", page.read_text()))
    assert reasons <= {"installs", "needs a cluster", "needs a cloud", "serves a page"}
