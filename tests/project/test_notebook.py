"""Claims about a notebook: pictures show by themselves, once each. A kernel of its own runs every cell."""

import base64
import io
from pathlib import Path
from typing import Any

import nbclient
import nbformat
import pytest
from PIL import Image

from tests.synthetic import complete

pytestmark = pytest.mark.slow

OPEN = "import atlas\nds = atlas.open('plane.zarr')"


def images(folder: Path, *cells: str) -> list[list[bytes]]:
    """The PNG images that each cell of a fresh notebook shows, in a folder with a store ``plane.zarr``."""
    complete(folder / "plane.zarr")
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in (OPEN, *cells)])
    client = nbclient.NotebookClient(book, timeout=300, resources={"metadata": {"path": str(folder)}})
    client.execute()
    return [[base64.b64decode(data) for data in map(png, cell.outputs) if data] for cell in book.cells[1:]]


def png(output: Any) -> str:
    return str(output.get("data", {}).get("image/png", ""))


def test_a_picture_shows_once_without_any_magic_line(tmp_path: Path) -> None:
    shown = images(
        tmp_path, "ds.atlas.plot()", "ds.atlas.portrait(omega=4, b=0.5)", "figure = ds.atlas.plot()", "figure"
    )
    assert [len(found) for found in shown] == [1, 1, 0, 1]
    with Image.open(io.BytesIO(shown[0][0])) as image:
        assert image.width > image.height > 400


def test_a_picture_shows_once_beside_pyplot_and_its_magic_line(tmp_path: Path) -> None:
    shown = images(tmp_path, "%matplotlib inline\nimport matplotlib.pyplot as plt", "ds.atlas.plot('period')")
    assert [len(found) for found in shown] == [0, 1]


def test_a_picture_in_axes_of_pyplot_shows_once_with_their_figure(tmp_path: Path) -> None:
    drawn = "import matplotlib.pyplot as plt\nfigure, ax = plt.subplots()\nsame = ds.atlas.plot('period', ax=ax)"
    assert [len(found) for found in images(tmp_path, f"{drawn}\nassert same is ax")] == [1]
