"""Claims about the pictures of docs/: each is of the present solver, and shows what that solver computes.

``scripts/pictures`` makes them anew.
"""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from distributed import Client
from PIL import Image

import atlas
from atlas.cli.main import main
from tests.paths import ROOT
from tests.script import script
from workers import SOLVER_VERSION

pytestmark = pytest.mark.slow

DOCS = ROOT / "docs"
ALL = sorted(path.name for path in DOCS.glob("*.png"))
TIMED = {"work-precision.png"}
"""Of a benchmark, with the figures of the table below it; its page names the solver's version."""


def words(path: Path) -> dict[str, str]:
    with Image.open(path) as image:
        return {str(name): str(value) for name, value in image.info.items()}


def shown_by(path: Path) -> atlas.Spec:
    """The spec of a picture; settings newer than the picture have their defaults."""
    given = json.loads(words(path)["Spec"])
    axes = {axis.pop("name"): axis for axis in given.pop("axes")}
    return atlas.Spec.from_mapping(given | {"axes": axes})


@pytest.mark.parametrize("name", [name for name in ALL if name not in TIMED])
def test_a_picture_names_the_present_solver_and_the_spec_that_it_shows(name: str) -> None:
    found = words(DOCS / name)
    assert found.get("Solver") == str(SOLVER_VERSION), f"run scripts/pictures {name}"
    assert json.loads(found["Spec"])


@pytest.fixture(scope="module")
def commands() -> dict[str, list[str]]:
    """The commands that make each picture, in order, as scripts/pictures lists them."""
    blocks = re.findall(r"^(\S+\.png):\n((?:    .+\n)+)", script("make_pictures", "--list"), re.MULTILINE)
    return {name: lines.strip().split("\n    ") for name, lines in blocks}


def test_every_picture_is_shown_on_a_page_beside_the_commands_that_make_it(commands: dict[str, list[str]]) -> None:
    assert sorted(commands) == ALL


def test_a_picture_shows_cell_by_cell_what_the_present_solver_computes(
    commands: dict[str, list[str]], tmp_path: Path, client: Client
) -> None:
    """Of the map that is computed fastest. A cell has more than this share of the pixels, of which type has few."""
    name = "energy-harvester"
    drawing = commands[f"{name}.png"][-1]
    store, new = tmp_path / f"{name}.zarr", tmp_path / f"{name}.png"
    atlas.run(atlas.Spec.from_toml(name), store, client=client)
    places = {f"{name}.zarr": str(store), f"{name}.png": str(new)}
    drawn = CliRunner().invoke(main, [places.get(word, word) for word in shlex.split(drawing)[1:]])
    assert drawn.exit_code == 0, drawn.output
    assert shown_by(DOCS / f"{name}.png") == shown_by(new)
    with Image.open(DOCS / f"{name}.png") as one, Image.open(new) as other:
        shown = [np.asarray(image.convert("RGB")) for image in (one, other)]
    assert shown[0].shape == shown[1].shape
    assert np.mean(np.any(shown[0] != shown[1], axis=-1)) < 1e-4
