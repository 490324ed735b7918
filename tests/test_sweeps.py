"""Claims about the spectrum of a sweep and about two sweeps drawn together."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from atlas import render
from atlas.errors import InputError
from atlas.render import hysteresis, spectrum
from tests.pictures import labels, line, plane


def test_every_exponent_has_its_line() -> None:
    bottom = render.figure(line(), "spectrum").axes[1]
    drawn = {each.get_color(): each.get_ydata() for each in bottom.lines if len(each.get_xdata()) == 8}
    assert [drawn[spectrum.color(i)][0] for i in range(4)] == pytest.approx([-0.4, -0.5, -0.6, -0.7])


def test_a_lost_direction_is_marked_and_not_drawn_as_a_number() -> None:
    ds = line()
    ds["spectrum"].values[2, 3] = -np.inf
    bottom = render.figure(ds, "spectrum").axes[1]
    marks = next(each for each in bottom.lines if each.get_marker() == "v")
    assert list(marks.get_xdata()) == [ds["omega"].values[2]]
    assert np.isnan(next(each for each in bottom.lines if each.get_color() == spectrum.color(3)).get_ydata()[2])


def test_a_spectrum_that_is_not_stored_is_refused_with_the_setting_that_stores_it() -> None:
    with pytest.raises(InputError, match='exponents = "spectrum"'):
        render.figure(line().drop_vars("spectrum"), "spectrum")


def test_sweeps_both_ways_are_named_by_their_direction() -> None:
    found = labels(render.figure(line("forward", 5), against=line("backward", 3)))
    assert found == [r"rising $\omega$", r"falling $\omega$", "different motions"]


def test_the_stretch_where_two_sweeps_differ_is_shaded() -> None:
    figure = render.figure(line("forward", 5), against=line("backward", 3))
    step = 2 / 7
    for ax in figure.axes:
        (span,) = ax.patches
        assert span.get_extents().transformed(ax.transData.inverted()).bounds[::2] == pytest.approx(
            (2 + 2.5 * step, 2 * step)
        )


def test_sweeps_that_agree_are_not_shaded() -> None:
    figure = render.figure(line("forward"), against=line("backward"))
    assert not figure.axes[0].patches
    assert labels(figure) == [r"rising $\omega$", r"falling $\omega$"]


def test_exponents_that_agree_within_their_errors_do_not_distinguish_motions() -> None:
    first, second = line(), line()
    second["largest"] = second["largest"] + 0.01
    assert hysteresis.differ(first, second).all()
    first["error"] = first["error"] * 0 + 0.005
    assert not hysteresis.differ(first, second).any()


def test_a_cell_that_is_not_known_in_both_is_not_distinguished() -> None:
    first, second = line(jump=8), line(jump=0)
    second["regime"].values[3] = -1
    first["regime"].values[4] = 4
    assert hysteresis.differ(first, second).tolist() == [True, True, True, False, False, True, True, True]


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
        render.figure(line(), overlays=["grazing"])
