"""Claims about the spectrum of a sweep and about two sweeps drawn together."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import same_color, to_rgb
from PIL import Image
from scipy import stats

from atlas import render
from atlas.errors import InputError
from atlas.query import hysteresis, outlines
from atlas.render import sweep
from tests.pictures import atlas, labels, line, plane
from workers import Settings, solve_tile
from workers.results import CHAOTIC


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
    assert (hysteresis.compare(first, second) == hysteresis.DIFFERENT).all()
    first["error"] = first["error"] * 0 + 0.005
    assert (hysteresis.compare(first, second) == hysteresis.SAME).all()


def test_a_cell_that_is_not_known_in_both_is_not_distinguished() -> None:
    first, second = line(jump=8), line(jump=0)
    second["regime"].values[3] = -1
    first["regime"].values[4] = 4
    assert hysteresis.compare(first, second).tolist() == [2, 2, 2, 0, 0, 2, 2, 2]


def solved(x1: float, v1: float, samples: int = 16) -> xr.Dataset:
    """A sweep of one unsymmetric orbit: at these parameters the start decides which of two mirror images is reached."""
    omega = np.array([2.1, 2.2, 2.3])
    start = {"omega": omega, "b": 0.2, "x1": x1, "v1": v1}
    cells = solve_tile("two-mass", start, Settings(section_samples=samples))
    names = ["regime", "period", "impacts_upper", "impacts_lower", "largest", "error", "symmetric"]
    names += ["min_impact_speed", "section" if samples else "state"]
    return atlas({"omega": omega}, **{name: cells[name] for name in names})


@pytest.mark.parametrize("samples", [16, 0])
def test_mirror_images_with_equal_impact_counts_are_told_from_one_orbit(samples: int) -> None:
    one, other = solved(-0.15, -0.5, samples), solved(0.0, 0.0, samples)
    assert (one["impacts_upper"] == other["impacts_lower"]).all()
    assert hysteresis.compare(one, other).tolist() == [hysteresis.MIRRORED] * 3
    assert hysteresis.compare(one, one).tolist() == [hysteresis.SAME] * 3


def test_mirror_images_with_exchanged_impact_counts_are_mirror_images() -> None:
    one, other = solved(-0.15, 0.0), solved(0.15, 0.0)
    assert [int(orbit["impacts_upper"][0]) for orbit in (one, other)] == [2, 4]
    assert hysteresis.compare(one, other)[0] == hysteresis.MIRRORED


def test_an_orbit_is_the_same_wherever_its_samples_begin() -> None:
    one = solved(-0.15, 0.0).isel(omega=[0])
    turned = one.assign(section=one["section"].roll(sample=1))
    assert hysteresis.compare(one, turned).tolist() == [hysteresis.SAME]


def test_orbits_of_equal_counts_and_other_exponents_are_different() -> None:
    first, second = line(), line()
    second["largest"] = second["largest"] - 0.1
    assert (hysteresis.compare(first, second) == hysteresis.DIFFERENT).all()


def chaotic(shift: float, seed: int) -> xr.Dataset:
    """Chaos whose section is drawn by lot: only its distribution means anything."""
    ds = line()
    ds["regime"] = ds["regime"] * 0 + np.int8(CHAOTIC)
    ds["error"] = ds["error"] * 0 + 0.1
    return ds.assign(section=(ds["section"].dims, shift + np.random.default_rng(seed).normal(size=(8, 64, 4))))


def test_chaos_is_compared_by_its_distribution_and_not_point_by_point() -> None:
    one = chaotic(0.0, 1)
    assert hysteresis.compare(one, chaotic(0.0, 2)).tolist() == [hysteresis.SAME] * 8
    assert hysteresis.compare(one, chaotic(3.0, 3)).tolist() == [hysteresis.MIRRORED] * 8
    other = chaotic(0.0, 4)
    other["largest"] = other["largest"] + 1.0
    assert hysteresis.compare(one, other).tolist() == [hysteresis.DIFFERENT] * 8


def test_the_distance_of_two_samples_is_that_of_kolmogorov_and_smirnov() -> None:
    one, two = np.random.default_rng(5).normal(size=(2, 40))
    assert hysteresis._distance(one, two + 0.4) == pytest.approx(stats.ks_2samp(one, two + 0.4).statistic)


def test_mirror_images_are_shaded_paler_than_different_motions() -> None:
    pale, dark = (sum(to_rgb(sweep.SHADES[what])) for what in (hysteresis.MIRRORED, hysteresis.DIFFERENT))
    assert pale > dark
    figure = render.figure(solved(-0.15, -0.5), against=solved(0.0, 0.0))
    assert labels(figure)[-1] == "mirror images"
    assert same_color(figure.axes[0].patches[0].get_facecolor(), sweep.SHADES[hysteresis.MIRRORED])


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
