"""Claims about atlas.render, on atlases made by hand: what is drawn where, in which colour, and what the file says."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from atlas import render
from atlas.errors import InputError
from atlas.query.plane import CoordinateInfo
from atlas.query.window import cell_edges
from atlas.render import kinds, looks, scales, text
from atlas.render.class_maps import PERIODS
from atlas.render.layers import paint
from tests.pictures import NAN, atlas, colour, every_regime, labels, layers, pixel, section, sweep
from workers.model.system import System
from workers.results import CHAOTIC, FAILED, INVALID, NO_IMPACT, PENDING, PERIODIC, REGIMES, UNDETERMINED

# What the file is


@pytest.mark.parametrize("kind", ["exponent", "period"])
@pytest.mark.parametrize("suffix", ["png", "svg", "pdf", "PNG"])
def test_every_map_is_written_in_every_format(tmp_path: Path, kind: str, suffix: str) -> None:
    path = render.render(every_regime(), tmp_path / f"map.{suffix}", kind)
    start = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[suffix.lower()]
    assert path == tmp_path / f"map.{suffix}"
    assert path.read_bytes().startswith(start)


def test_a_png_carries_digest_and_software(tmp_path: Path) -> None:
    with Image.open(render.render(every_regime(), tmp_path / "map.png")) as image:
        text = image.info
    assert text["Digest"] == "d1ge57"
    assert text["Software"].startswith("impact-atlas ")
    assert text["Source"] == "computed by numpy 2"


def test_an_svg_carries_digest_and_software(tmp_path: Path) -> None:
    text = render.render(every_regime(), tmp_path / "map.svg").read_text()
    assert "<dc:identifier>d1ge57</dc:identifier>" in text
    assert re.search(r"impact-atlas [^<]*, matplotlib", text)


def test_a_pdf_carries_the_digest(tmp_path: Path) -> None:
    assert b"d1ge57" in render.render(every_regime(), tmp_path / "map.pdf").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_the_same_atlas_gives_the_same_bytes(tmp_path: Path, suffix: str) -> None:
    first, second = (render.render(every_regime(), tmp_path / f"{i}.{suffix}").read_bytes() for i in (1, 2))
    assert first == second


def test_cells_are_pixels_in_vector_files_however_many_there_are(tmp_path: Path) -> None:
    n = 300
    uneven = atlas(
        {"omega": np.linspace(1, 2, n) ** 2, "b": np.linspace(0.1, 0.2, n)},
        regime=np.full((n, n), CHAOTIC, np.int8),
        largest=np.random.default_rng(1).random((n, n)),
    )
    text = render.render(uneven, tmp_path / "map.svg").read_text()
    assert "<image" in text
    assert text.count("<path") < 2000


def test_rendering_leaves_matplotlib_as_it_was(tmp_path: Path) -> None:
    import matplotlib as mpl

    before = dict(mpl.rcParams)
    render.render(every_regime(), tmp_path / "map.png")
    assert dict(mpl.rcParams) == before


# What is asked wrongly


@pytest.mark.parametrize("name", ["map.gif", "map"])
def test_another_format_is_refused_with_those_possible(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"possible: \.png, \.svg, \.pdf$"):
        render.render(every_regime(), tmp_path / name)


def test_a_kind_for_other_axes_is_refused_with_those_possible(tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        render.render(every_regime(), tmp_path / "map.png", "sweep")
    assert str(error.value) == (
        "kind 'sweep' draws one axis, found two axes (omega, b); possible here: exponent, period, combined"
    )


def test_an_unknown_kind_is_refused_with_all_that_there_are(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"unknown kind of picture 'pie'; known: exponent, .*, sweep, "):
        render.render(sweep(largest=np.zeros(4)), tmp_path / "map.png", "pie")


@pytest.mark.parametrize(("kind", "variable"), [("exponent", "largest"), ("period", "period")])
def test_a_map_of_what_is_not_stored_is_refused(tmp_path: Path, kind: str, variable: str) -> None:
    with pytest.raises(InputError, match=f"kind '{kind}' needs the variable '{variable}'"):
        render.render(every_regime().drop_vars(variable), tmp_path / "map.png", kind)
    assert not (tmp_path / "map.png").exists()


def test_a_path_that_cannot_be_written_is_said_to_be_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"map\.png: cannot be written: there is no folder .*nowhere"):
        render.render(every_regime(), tmp_path / "nowhere" / "map.png")


# The chaos map


def test_zero_lies_in_the_middle_of_the_scale_and_each_half_has_its_own_end() -> None:
    low, high = scales.scale_ends(np.array([-4.0, -2.0, 0.5, NAN]))
    assert (low, high) == pytest.approx((-4.0, 0.5), rel=0.03)
    bar = render.figure(every_regime()).axes[1]
    assert bar.transAxes.inverted().transform(bar.transData.transform((0, 0.0)))[1] == pytest.approx(0.5)


def test_outliers_do_not_stretch_the_scale() -> None:
    values = np.concatenate([np.linspace(-1, 0, 1000), [-500.0, -np.inf], np.linspace(0, 2, 1000), [300.0]])
    assert scales.scale_ends(values) == pytest.approx((-1.0, 2.0), rel=0.05)


@pytest.mark.parametrize("values", [[0.0], [NAN], [-np.inf]])
def test_a_scale_exists_without_any_finite_sign(values: list[float]) -> None:
    assert scales.scale_ends(np.array(values)) == (-1.0, 1.0)


def test_a_sign_that_does_not_occur_gets_the_other_ones_range() -> None:
    assert scales.scale_ends(np.array([-0.5, -0.5])) == (-0.5, 0.5)


def test_stable_cells_are_blue_and_chaotic_ones_red_however_small_the_exponent() -> None:
    codes = np.array([[PERIODIC, CHAOTIC]], np.int8)
    rgba = paint(layers("exponent", (-2.0, 1.0), regime=codes, largest=np.array([[-1e-6, 1e-6]])))
    stable, chaotic = rgba[0].astype(int)
    assert stable[2] > stable[0]
    assert chaotic[0] > chaotic[2]


def test_cells_without_exponent_have_the_colour_of_their_regime() -> None:
    ds = every_regime()
    rgba = paint(layers("exponent", regime=ds.regime.values, largest=ds.largest.values))
    for code in (UNDETERMINED, INVALID, FAILED):
        assert tuple(rgba[ds.regime.values == code][0]) == colour(code)


def test_pending_cells_show_the_texture_behind_them() -> None:
    ds = every_regime()
    rgba = paint(layers("exponent", regime=ds.regime.values, largest=ds.largest.values))
    assert rgba[0, 0, 3] == 0
    assert render.figure(ds).axes[0].patch.get_hatch()


def test_the_legend_of_the_chaos_map_names_what_the_scale_does_not() -> None:
    assert labels(render.figure(every_regime())) == ["undetermined", "invalid", "failed", "pending", "no impact"]


def test_a_chaos_map_whose_scale_says_all_has_no_legend() -> None:
    ds = atlas({"omega": [1, 2], "b": [0.1, 0.2]}, regime=np.full((2, 2), PERIODIC, np.int8), largest=-np.ones((2, 2)))
    assert labels(render.figure(ds)) == []


def test_the_colour_bar_has_label_and_units_and_arrows_where_values_lie_beyond() -> None:
    values = np.append(np.linspace(-1, 1, 399), -50.0).reshape(20, 20)
    ds = atlas(
        {"omega": np.linspace(1, 2, 20), "b": np.linspace(0.1, 0.2, 20)},
        regime=np.full((20, 20), CHAOTIC, np.int8),
        largest=values,
    )
    figure = render.figure(ds)
    assert figure.axes[1].get_ylabel() == r"largest Lyapunov exponent $\lambda_1$ [per forcing period]"
    two = render.figure(ds, vmin=-2.0, vmax=1.0).axes[1].get_ylabel()
    assert two.endswith("\n(two linear scales, joined at 0)")
    assert figure.axes[1]._colorbar.extend == "both"  # type: ignore[attr-defined]


def test_a_written_chaos_map_shows_known_cells_in_their_colours(tmp_path: Path) -> None:
    ds = every_regime()
    path = render.render(ds, tmp_path / "map.png")
    figure = render.figure(ds)
    assert pixel(path, figure, 2.0, 0.2) == colour(UNDETERMINED)[:3]
    assert pixel(path, figure, 4.0, 0.2) == colour(FAILED)[:3]
    assert pixel(path, figure, 1.0, 0.2) == looks.rgb(kinds.CHAOTIC[-1])


# The period map


def test_every_regime_has_its_own_colour_in_the_period_map() -> None:
    codes = np.array([[regime.code for regime in REGIMES]], np.int8)
    found = layers("period", regime=codes, period=(codes == PERIODIC).astype(np.int32))
    rgba, legend = paint(found), found.legend
    assert len({tuple(cell) for cell in rgba[0]}) == len(legend) == len(REGIMES)
    assert "aperiodic" in [entry.label for entry in legend]


def test_every_class_of_periods_has_its_own_colour() -> None:
    periods = np.array([[1, 2, 3, 4, 5, 6, 7, 8, 9, 17, 65]], np.int32)
    found = layers("period", regime=np.full(periods.shape, PERIODIC, np.int8), period=periods)
    rgba, legend = paint(found), found.legend
    taken = {tuple(cell) for cell in rgba[0]} | {colour(regime.code) for regime in REGIMES if regime.code != PERIODIC}
    assert len(taken) == 9 + len(REGIMES) - 1
    assert [entry.label for entry in legend][-3:] == ["period 7–8", "period 9–16", "period ≥ 17"]


def test_periods_of_one_class_share_a_colour() -> None:
    rgba = paint(layers("period", regime=np.full((1, 2), PERIODIC, np.int8), period=np.array([[9, 16]], np.int32)))
    assert tuple(rgba[0, 0]) == tuple(rgba[0, 1])


def test_the_legend_of_the_period_map_names_the_classes_present_alone() -> None:
    ds = atlas(
        {"omega": [1, 2, 3], "b": [0.1]},
        regime=np.array([[PERIODIC, PERIODIC, CHAOTIC]], np.int8),
        period=np.array([[1, 3, 0]], np.int32),
    )
    assert labels(render.figure(ds, "period")) == ["period 1", "period 3", "chaotic"]


def test_impact_free_cells_are_their_own_class_and_not_period_1() -> None:
    codes = np.array([[NO_IMPACT, PERIODIC]], np.int8)
    rgba = paint(layers("period", regime=codes, period=np.ones((1, 2), np.int32)))
    assert tuple(rgba[0, 0]) == colour(NO_IMPACT)
    assert tuple(rgba[0, 1, :3]) == looks.rgb(PERIODS[0][2])


# Axes


def test_axes_have_symbols_and_units() -> None:
    ax = render.figure(every_regime()).axes[0]
    assert ax.get_xlabel() == r"forcing frequency $\omega$"
    assert ax.get_ylabel() == "clearance $b$"


def test_initial_values_of_a_system_of_ones_own_are_named_once() -> None:
    hammer = {
        "name": "hammer", "title": "a mass and a stop", "coordinates": ["x"], "velocities": ["v"], "mass": [[1.0]],
        "stiffness": [[1.0]], "force": ["1.0"], "gap": [1.0], "upper": 1.0, "restitution": 0.8,
    }  # fmt: skip
    x, v = (System.from_mapping(hammer).parameter(name) for name in ("x", "v"))
    attributes = {p.name: {"long_name": p.meaning, "units": p.unit, "symbol": p.symbol} for p in (x, v)}
    ds = xr.Dataset(coords={name: (name, [0.0, 1.0], attributes[name]) for name in ("x", "v")})
    assert text.axis_label("x", CoordinateInfo.from_dataset(ds, "x")) == "initial displacement $x(0)$"
    assert text.axis_label("v", CoordinateInfo.from_dataset(ds, "v")) == r"initial velocity $\dot x(0)$"


def test_the_title_names_the_fixed_parameters_and_leaves_out_a_state_of_rest() -> None:
    title = render.figure(every_regime()).axes[0].get_title(loc="left")
    assert title == r"$R = 0.8$,  $\zeta = 0.05$,  $\mu_m = 2$,  $\mu_k = 5$,  $f_2 = 0$,  $\tau = \pi$"


def test_the_title_names_an_initial_state_other_than_rest() -> None:
    assert "$x_1(0) = 0.1$" in text.title_line(every_regime().assign_coords(x1=0.1))


@pytest.mark.parametrize(
    ("value", "written"),
    [
        (0.8, "0.8"),
        (0.0, "0"),
        (np.pi, r"\pi"),
        (-np.pi / 2, r"-\pi/2"),
        (2e-7, r"2 \times 10^{-7}"),
        (3.1416, "3.1416"),
    ],
)
def test_numbers_read_as_they_are_written_by_hand(value: float, written: str) -> None:
    assert text.number(value) == written


def test_the_first_axis_is_drawn_to_the_right() -> None:
    ds = atlas({"b": [0.1, 0.2, 0.3], "omega": [1, 2]}, regime=np.full((2, 3), 1, np.int8), largest=-np.ones((2, 3)))
    assert render.figure(ds).axes[0].get_xlabel() == "clearance $b$"


def uneven(axes: dict[str, Any], scales: dict[str, str] | None = None) -> xr.Dataset:
    shape = tuple(len(values) for values in reversed(axes.values()))
    return atlas(axes, scales, regime=np.full(shape, 3, np.int8), largest=np.ones(shape))


def test_even_axes_are_drawn_as_an_image_from_edge_to_edge() -> None:
    ax = render.figure(every_regime()).axes[0]
    assert len(ax.images) == 1
    assert (*ax.get_xlim(), *ax.get_ylim()) == pytest.approx((0.5, 4.5, 0.05, 0.25))


def test_uneven_values_are_drawn_to_scale_with_edges_half_way() -> None:
    ax = render.figure(uneven({"omega": [1, 2, 5], "b": [0.1, 0.2]})).axes[0]
    edges = np.asarray(ax.collections[0].get_coordinates())[0, :, 0]
    assert edges == pytest.approx([0.5, 1.5, 3.5, 6.5])
    assert ax.get_xscale() == "linear"


def test_a_geometric_axis_is_drawn_on_a_log_scale_with_edges_at_geometric_means() -> None:
    ax = render.figure(uneven({"omega": np.geomspace(0.1, 10, 3), "b": [0.1, 0.2]})).axes[0]
    edges = np.asarray(ax.collections[0].get_coordinates())[0, :, 0]
    assert edges == pytest.approx([10**-1.5, 10**-0.5, 10**0.5, 10**1.5])
    assert ax.get_xscale() == "log"


def test_the_spec_decides_whether_an_axis_is_logarithmic() -> None:
    values = {"omega": [1.0, 4.0, 16.0], "b": [0.1, 0.2]}
    linear = uneven(values, {"omega": "linear", "b": "linear"})
    assert render.figure(linear).axes[0].get_xscale() == "linear"
    assert cell_edges(linear, "omega") == pytest.approx([-0.5, 2.5, 10.0, 22.0])
    by_hand = uneven({"omega": [1.0, 3.0, 16.0], "b": [0.1, 0.2]}, {"omega": "log", "b": "linear"})
    assert render.figure(by_hand).axes[0].get_xscale() == "log"


def test_a_log_axis_too_short_for_log_ticks_is_drawn_to_scale_on_a_linear_one() -> None:
    ds = uneven({"omega": np.geomspace(1, 2, 3), "b": [0.1, 0.2]}, {"omega": "log", "b": "linear"})
    ax = render.figure(ds).axes[0]
    assert ax.get_xscale() == "linear"
    assert ax.collections[0].get_coordinates()[0, 1, 0] == pytest.approx(2**0.25)


@pytest.mark.parametrize("axes", [{"omega": [1.0, 2.0], "b": [0.15]}, {"omega": [1.0], "b": [0.1, 0.4, 0.5]}])
@pytest.mark.parametrize("value", [0.0, 1.0])
def test_an_axis_with_one_point_is_drawn(tmp_path: Path, axes: dict[str, list[float]], value: float) -> None:
    ds = uneven(axes)
    ds["largest"] = ds["largest"] * value
    ds["regime"] = (ds["regime"] * 0).astype(np.int8)
    assert render.render(ds, tmp_path / "map.png").exists()


def test_falling_axes_are_drawn_rising_with_their_cells(tmp_path: Path) -> None:
    ds = every_regime()
    turned = ds.isel(omega=slice(None, None, -1), b=slice(None, None, -1))
    first, second = (
        render.render(dataset, tmp_path / f"{i}.png").read_bytes() for i, dataset in enumerate((ds, turned))
    )
    assert first == second


# Impact-free cells in the chaos map


def test_the_border_of_impact_free_cells_runs_along_their_edges() -> None:
    codes = np.array([[NO_IMPACT, PERIODIC], [NO_IMPACT, PERIODIC]], np.int8)
    ds = atlas({"omega": [1, 2], "b": [0.1, 0.2]}, regime=codes, largest=-np.ones((2, 2)))
    segments = np.array(render.figure(ds).axes[0].collections[0].get_segments())
    assert np.all(segments[:, :, 0] == 1.5)
    assert sorted(segments[:, :, 1].ravel()) == pytest.approx([0.05, 0.15, 0.15, 0.25])


def test_impact_free_cells_are_textured_and_keep_their_colour(tmp_path: Path) -> None:
    ds = every_regime()
    textures = {patch.get_hatch(): patch for patch in render.figure(ds).axes[0].patches}
    texture = textures[looks.HATCH[NO_IMPACT]]
    assert not texture.get_fill()
    assert texture.get_path().get_extents().bounds == pytest.approx((1.5, 0.05, 1.0, 0.1))


# Half done


def test_an_atlas_without_a_single_result_is_drawn_as_pending(tmp_path: Path) -> None:
    empty = atlas(
        {"omega": [1, 2], "b": [0.1, 0.2]},
        regime=np.full((2, 2), PENDING, np.int8),
        largest=np.full((2, 2), NAN),
        period=np.zeros((2, 2), np.int32),
    )
    assert labels(render.figure(empty)) == labels(render.figure(empty, "period")) == ["pending"]
    assert render.render(empty, tmp_path / "map.pdf").exists()


# The sweep


def test_a_sweep_draws_the_section_over_the_exponent_on_one_axis() -> None:
    top, bottom = render.figure(sweep(largest=[1.0, -1, -1, 1], error=[0.1] * 4, section=section())).axes
    assert top.get_ylabel() == "displacement of mass 1\n$x_1$ at $t = kT$"
    assert bottom.get_ylabel() == "largest Lyapunov exponent\n$\\lambda_1$ [per forcing period]"
    assert bottom.get_xlabel() == r"forcing frequency $\omega$"
    assert top.get_xlim() == bottom.get_xlim()


def test_points_of_the_diagram_have_the_colour_of_their_regime() -> None:
    top = render.figure(sweep(section=section())).axes[0]
    drawn = {line.get_color(): np.unique(line.get_xdata()).tolist() for line in top.lines}
    assert drawn == {looks.INK[CHAOTIC]: [2.0, 4.0], looks.INK[PERIODIC]: [2.5, 3.0]}
    assert sorted(np.unique(top.lines[0].get_ydata())) == pytest.approx([0.0, 0.1, 0.2])


def test_the_exponent_of_a_sweep_has_a_line_at_zero() -> None:
    bottom = render.figure(sweep(largest=[1.0, -1, -1, 1])).axes[0]
    assert list(bottom.lines[0].get_ydata()) == [0.0, 0.0]


def test_a_sweep_with_one_of_its_variables_draws_that_panel_alone(tmp_path: Path) -> None:
    for variables in ({"largest": [1.0, -1, -np.inf, NAN]}, {"section": section()}):
        assert len(render.figure(sweep(**variables)).axes) == 1
        assert render.render(sweep(**variables), tmp_path / "sweep.svg").exists()


def test_a_sweep_with_nothing_to_draw_is_refused() -> None:
    with pytest.raises(InputError, match="has neither"):
        render.figure(sweep())


def test_a_log_sweep_is_drawn_on_a_log_scale(tmp_path: Path) -> None:
    ds = atlas({"omega": np.geomspace(1, 100, 9)}, regime=np.full(9, 1, np.int8), largest=-np.ones(9))
    assert render.figure(ds).axes[0].get_xscale() == "log"
    assert render.render(ds, tmp_path / "sweep.png").exists()


def test_a_sweep_with_one_point_is_drawn(tmp_path: Path) -> None:
    ds = atlas({"omega": [2.0]}, regime=np.full(1, 3, np.int8), largest=[0.5], section=section()[:1])
    assert render.render(ds, tmp_path / "sweep.png").exists()


def test_pending_points_of_a_sweep_are_not_drawn() -> None:
    ds = atlas({"omega": [1.0, 2.0]}, regime=np.array([-1, 1], np.int8), section=section()[:2])
    figure = render.figure(ds)
    assert [line.get_xdata().tolist() for line in figure.axes[0].lines] == [[2.0] * 3]
    assert labels(figure) == ["periodic"]


# Reading


@pytest.mark.parametrize(("kind", "read"), [("exponent", {"regime", "largest"}), ("period", {"regime", "period"})])
def test_a_map_reads_its_variable_and_the_regimes_alone(kind: str, read: set[str]) -> None:
    ds = every_regime().assign(state=(("b", "omega", "component"), np.zeros((2, 4, 4))))
    seen: set[str] = set()
    lazy = xr.Dataset(
        {str(name): (array.dims, _Watched.wrap(str(name), array.values, seen)) for name, array in ds.data_vars.items()},
        ds.coords,
        ds.attrs,
    )
    render.figure(lazy, kind)
    assert seen == read


class _Watched(xr.backends.BackendArray):
    """An array on disk that notes when it is read."""

    def __init__(self, name: str, values: np.ndarray, seen: set[str]) -> None:
        self.name, self.values, self.seen = name, values, seen
        self.shape, self.dtype = values.shape, values.dtype

    @classmethod
    def wrap(cls, name: str, values: np.ndarray, seen: set[str]) -> "xr.core.indexing.LazilyIndexedArray":
        return xr.core.indexing.LazilyIndexedArray(cls(name, values, seen))

    def __getitem__(self, key: "xr.core.indexing.ExplicitIndexer") -> np.ndarray:
        self.seen.add(self.name)
        return self.values[key.tuple]
