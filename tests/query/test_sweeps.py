"""Claims about the spectrum of a sweep and about two sweeps drawn together."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from atlas import render
from atlas.errors import InputError
from atlas.render import outlines, sweep
from tests.pictures import labels, line, plane


def test_every_exponent_has_its_line() -> None:
    bottom = render.figure(line(), "spectrum").axes[1]
    drawn = {line.get_color(): line.get_ydata() for line in bottom.lines if len(line.get_xdata()) == 8}
    assert [drawn[sweep.color_of(i)][0] for i in range(4)] == pytest.approx([-0.4, -0.5, -0.6, -0.7])


def test_equal_exponents_take_turns_so_that_both_are_seen() -> None:
    values = np.stack([np.zeros(120), -np.ones(120), -2 * np.ones(120), -2 * np.ones(120)], axis=1)
    shown = outlines.interleave_exponents(values, 1e-9)
    assert shown[:, :2].all()
    assert (shown[:, 2] ^ shown[:, 3]).all()
    assert 40 < shown[:, 3].sum() < 80


def test_a_lost_direction_is_marked_and_not_drawn_as_a_number() -> None:
    ds = line()
    ds["spectrum"].values[2, 3] = -np.inf
    bottom = render.figure(ds, "spectrum").axes[1]
    marks = next(line for line in bottom.lines if line.get_marker() == "v")
    assert list(marks.get_xdata()) == [ds["omega"].values[2]]
    assert np.isnan(next(line for line in bottom.lines if line.get_color() == sweep.color_of(3)).get_ydata()[2])


def test_a_spectrum_that_is_not_stored_is_refused_with_the_setting_that_stores_it() -> None:
    with pytest.raises(InputError, match='exponents = "spectrum"'):
        render.figure(line().drop_vars("spectrum"), "spectrum")


def test_sweeps_both_ways_are_named_by_their_direction() -> None:
    found = labels(render.figure(line("forward", 5), against=line("backward", 3)))
    assert found == [r"rising $\omega$", r"falling $\omega$"]


def test_two_sweeps_are_told_apart_by_colour_alone() -> None:
    """Larger points of the first and smaller ones of the second: equal motions show as a ring."""
    figure = render.figure(line("forward", 5), against=line("backward", 3))
    for ax in figure.axes:
        assert not ax.patches
        sizes = {drawn.get_color(): drawn.get_markersize() for drawn in ax.lines if drawn.get_marker() == "."}
        assert [*sizes] == list(sweep.COLORS) and sizes[sweep.COLORS[0]] > sizes[sweep.COLORS[1]]


def test_a_picture_of_two_atlases_carries_both_digests(tmp_path: Path) -> None:
    path = render.render(line("forward"), tmp_path / "up.png", against=line("backward"))
    with Image.open(path) as image:
        assert image.info["Digest"] == "d1ge57-forward d1ge57-backward"


@pytest.mark.parametrize(
    ("other", "says"),
    [
        (line().isel(omega=slice(2, 5)), "different points on omega: 8 from 2 to 4, and 3"),
        (line().assign_coords(R=0.5), "differ in R: 0.8 and 0.5"),
        (plane(), "different axes: omega and omega, b"),
    ],
)
def test_sweeps_that_do_not_belong_together_are_refused(other: object, says: str) -> None:
    with pytest.raises(InputError, match=says):
        render.figure(line(), against=other)  # type: ignore[arg-type]


def test_hysteresis_of_one_atlas_is_refused() -> None:
    with pytest.raises(InputError, match="'hysteresis' needs a second atlas"):
        render.figure(line(), "hysteresis")


def test_two_maps_are_not_drawn_together() -> None:
    with pytest.raises(InputError, match="two atlases are drawn together as sweeps, found two axes"):
        render.figure(plane(), against=plane())


def test_an_overlay_of_a_sweep_is_refused() -> None:
    with pytest.raises(InputError, match="overlay 'grazing' is drawn over a map"):
        render.figure(line(), overlay=["grazing"])
