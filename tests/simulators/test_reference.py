"""One picture of each kind against a stored one: nothing has moved, vanished or changed its colour unnoticed."""

import shutil
from pathlib import Path

import pytest
from matplotlib.testing.compare import compare_images

from atlas import render
from tests.pictures import plane
from tests.reference import FOLDER, LINES, NUMBERS, PICTURES, write
from workers.results import CHAOTIC

TOLERANCE = 8.0
"""Root mean square over pixels and colours, of 255: builds of matplotlib differ by fractions of a pixel in letters."""


def against(name: str, picture: Path, tmp_path: Path) -> str | None:
    expected = shutil.copy(FOLDER / f"{name}.png", tmp_path / "expected.png")  # the differences are written beside it
    return compare_images(str(expected), str(picture), TOLERANCE)


def test_there_is_a_reference_of_every_kind() -> None:
    assert set(PICTURES) == {*render.KINDS, *NUMBERS, "portrait"}
    assert {path.stem for path in FOLDER.glob("*.png")} == set(PICTURES)


@pytest.mark.slow
@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_looks_as_it_did(name: str, tmp_path: Path) -> None:
    assert against(name, write(PICTURES[name](), tmp_path / "found.png"), tmp_path) is None


@pytest.mark.slow
@pytest.mark.parametrize("name", ["exponent", "period", "combined"])
def test_the_tolerance_is_finer_than_two_cells_of_another_regime(name: str, tmp_path: Path) -> None:
    """A comparison that could not fail would prove nothing."""
    ds = plane()
    ds["regime"].values[2, 4:6] = CHAOTIC
    ds["largest"].values[2, 4:6] = 0.9
    ds["error"].values[2, 4:6] = 1e-2
    overlays = LINES if name == "exponent" else ()
    changed = write(render.figure(ds, name, overlay=overlays), tmp_path / "found.png")
    assert against(name, changed, tmp_path) is not None


def test_the_tolerance_allows_a_shift_of_a_letter_s_edge(tmp_path: Path) -> None:
    figure = PICTURES["period"]()
    for text in (figure.axes[0].xaxis.label, figure.axes[0].yaxis.label, figure.axes[0].title):
        text.set_fontsize(text.get_fontsize() * 0.985)
    assert against("period", write(figure, tmp_path / "found.png"), tmp_path) is None
