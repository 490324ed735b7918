"""Claims about the pictures of docs/: each is of the present solver, and shows what that solver computes.

``scripts/pictures`` makes them anew.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from distributed import Client
from PIL import Image

import atlas
from atlas import render
from atlas.render.page import page
from scripts.make_pictures import DOCS, commands, pictures
from workers import SOLVER_VERSION

pytestmark = pytest.mark.slow

ALL = sorted(path.name for path in DOCS.glob("*.png"))


def words(path: Path) -> dict[str, str]:
    with Image.open(path) as image:
        return {str(name): str(value) for name, value in image.info.items()}


@pytest.mark.parametrize("name", ALL)
def test_a_picture_names_the_present_solver_and_the_spec_that_it_shows(name: str) -> None:
    found = words(DOCS / name)
    assert found.get("Solver") == str(SOLVER_VERSION), f"run scripts/pictures {name}"
    assert json.loads(found["Spec"])


@pytest.mark.parametrize("name", ALL)
def test_every_picture_is_shown_on_a_page_beside_the_commands_that_make_it(name: str) -> None:
    assert commands(name, pictures()[name])


def test_a_picture_shows_cell_by_cell_what_the_present_solver_computes(tmp_path: Path, client: Client) -> None:
    """Of the map that is computed fastest; everything inside its frame, after the spec in its own metadata."""
    name = "energy-harvester"
    *_, drawing = commands(f"{name}.png", pictures()[f"{name}.png"])
    assert drawing.endswith("--kind combined --width 5in --dpi 110")
    store = tmp_path / f"{name}.zarr"
    atlas.run(atlas.Spec.from_toml(name), store, client=client)
    ds = atlas.open(store)
    figure = ds.atlas.plot("combined", width="5in", dpi=110)
    render.render(ds, tmp_path / "new.png", "combined", width="5in", dpi=110)
    assert words(DOCS / f"{name}.png")["Spec"] == ds.attrs["spec"]
    with (
        page(width="5in", dpi=110).context(),
        Image.open(DOCS / f"{name}.png") as old,
        Image.open(tmp_path / "new.png") as new,
    ):
        figure.draw_without_rendering()
        frame = figure.axes[0].get_window_extent()
        shown = [np.asarray(image.convert("RGB")) for image in (old, new)]
    assert shown[0].shape == shown[1].shape
    height = shown[0].shape[0]
    rows = slice(int(height - frame.y1) + 2, int(height - frame.y0) - 2)
    columns = slice(int(frame.x0) + 2, int(frame.x1) - 2)
    assert np.array_equal(*(image[rows, columns] for image in shown))
