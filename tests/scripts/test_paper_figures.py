"""The figures of Li & Tan: their cells and what they show, and the example that draws them."""

from pathlib import Path

import pytest
from PIL import Image

from atlas.cell.trajectory import cell_orbit, describe
from scripts.published.entries.li_tan_2011 import CELLS, SETTINGS
from tests import naive
from tests.script import script


def test_the_cells_are_those_of_the_paper() -> None:
    for number in (3, 4, 5):
        assert naive.FIGURES[number].items() <= CELLS[f"fig{number}"].items() | {("R", 0.8)}


@pytest.mark.parametrize(
    ("name", "words"), [("fig3", "impacts 1 above and 1 below"), ("fig4", "impacts 2 above and 2 below")]
)
def test_figs_3_and_4_show_the_motions_that_the_paper_describes(name: str, words: str) -> None:
    assert words in describe(cell_orbit(CELLS[name]))


@pytest.mark.slow
def test_fig_5_is_solved_to_the_digits_of_the_paper() -> None:
    """Truth: 1.123, -1.577, -1.582, -4.38 within .002, and 2.637 impacts a period."""
    orbit = cell_orbit(CELLS["fig5"], settings=SETTINGS)
    assert orbit.cell["largest"] == pytest.approx(1.123, abs=0.007)
    assert orbit.cell["error"] <= 0.002
    assert orbit.cell["impacts_per_period"] == pytest.approx(2.637, abs=0.01)


@pytest.mark.slow
def test_all_figures_are_drawn_into_a_folder(tmp_path: Path) -> None:
    script("paper_figures", str(tmp_path / "paper"), "--light")
    for number in (3, 4, 5, 6):
        with Image.open(tmp_path / "paper" / f"fig{number}.png") as image:
            assert min(image.size) > 500
