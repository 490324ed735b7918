"""Claims about the kinds of map and their overlays: known cells in known colours, and lines where they belong."""

import math
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
import xarray as xr
from matplotlib import colors
from matplotlib.figure import Figure

from atlas import render
from atlas.errors import InputError
from atlas.query.plane import Plane, sort_axes
from atlas.query.queries import boundary
from atlas.render import class_maps, grazing, kinds, label_placement, maps, outlines, overlays, painters, scales
from atlas.render.coded_lines import names_on
from atlas.render.coded_maps import coded_map
from atlas.render.layers import paint
from atlas.render.looks import LegendEntry
from atlas.render.text import number
from tests.pictures import NAN, atlas, branches, colour, curves, keeping, labelled, labels, layers, pixel, plane
from workers import solve_tile
from workers.model.system import find_system
from workers.results import CHAOTIC, FAILED, INVALID, LOCKING, NO_IMPACT, PENDING, PERIODIC, UNDETERMINED

TWO_MASS = find_system("two-mass")

NUMBERS = ("error", "periods_used", "stuck_fraction", "share")
"""Variables that have colours of their own."""
MAPS = (*render.MAPS, *NUMBERS)
"""Every kind of map, and maps of these variables."""


@pytest.fixture(autouse=True)
def _curves() -> Iterator[None]:
    with keeping(curves()):
        yield


def rgb(color: str) -> tuple[int, ...]:
    return tuple(round(255 * part) for part in colors.to_rgb(color))


@cache
def map_of_plane(kind: str) -> Figure:
    """A map of ``plane``, only to be looked at."""
    return figure_of(plane(), kind)


def figure_of(ds: xr.Dataset, name: str) -> Figure:
    """A map of a kind or of a variable."""
    asked = {"kind": name} if name in render.MAPS else {"variable": name}
    made: Figure = render.figure(ds, **asked)
    return made


def drawn(figure: Figure) -> np.ndarray:
    """The colours (y, x, 4) of the cells of a map."""
    return np.asarray(figure.axes[0].images[0].get_array())


@pytest.mark.parametrize("kind", MAPS)
def test_what_has_no_result_looks_the_same_in_every_map(kind: str) -> None:
    cells = drawn(map_of_plane(kind))
    regime = plane()["regime"].values
    codes = (
        (UNDETERMINED, INVALID, FAILED) if kind != "periods_used" else (INVALID, FAILED)
    )  # what it did cost is known
    for code in codes:
        assert tuple(cells[regime == code][0]) == colour(code)
    assert cells[regime == PENDING][0, 3] == 0


@pytest.mark.parametrize("kind", ["period", "exponent"])
def test_a_written_map_shows_an_undetermined_cell_in_its_colour(tmp_path: Path, kind: str) -> None:
    path = render.render(plane(), tmp_path / "map.png", kind)
    assert pixel(path, render.figure(plane(), kind), 3.5, 0.1) == colour(UNDETERMINED)[:3]


@pytest.mark.parametrize("kind", MAPS)
def test_of_an_atlas_of_nothing_but_pending_cells_the_legend_says_that(kind: str) -> None:
    assert labels(figure_of(nothing(), kind)) == ["pending"]


@pytest.mark.parametrize("kind", ["period", "exponent"])
def test_overlays_are_drawn_over_nothing_but_pending_cells(tmp_path: Path, kind: str) -> None:
    assert render.render(nothing(), tmp_path / "map.svg", kind, overlay=render.MAP_OVERLAYS).exists()


def nothing() -> xr.Dataset:
    """The plane before its run."""
    ds = plane()
    ds["regime"] = ds["regime"] * 0 + np.int8(PENDING)
    for name in ("largest", "error", "stuck_fraction"):
        ds[name] = ds[name] * NAN
    return ds


@pytest.mark.parametrize("kind", ["exponent", "error", "stuck_fraction"])
def test_averages_of_an_undetermined_cell_do_not_pass_for_results(kind: str) -> None:
    ds = plane()
    for name in ("largest", "error", "stuck_fraction"):
        ds[name] = ds[name].fillna(0.3)
    assert tuple(drawn(figure_of(ds, kind))[ds["regime"].values == UNDETERMINED][0]) == colour(UNDETERMINED)


def test_a_locking_cell_has_a_name_and_a_colour_of_its_own_on_a_map_of_periods() -> None:
    found = layers("period", regime=np.array([[LOCKING, PERIODIC]]), period=np.array([[0, 1]]))
    assert tuple(paint(found)[0, 0]) == colour(LOCKING)
    assert [entry.label for entry in found.legend] == ["period 1", "locking"]


def test_exponents_of_locking_cells_are_textured_as_those_of_a_rest() -> None:
    values = {"regime": np.array([[LOCKING, PERIODIC, CHAOTIC]]), "largest": np.array([[-np.inf, -0.5, 0.5]])}
    (texture,) = layers("exponent", **values).textures
    assert texture.cells.tolist() == [[True, False, False]]


def test_averages_of_an_undetermined_cell_do_not_stretch_the_scale() -> None:
    ds = plane()
    ds["largest"] = ds["largest"].where(ds["regime"] != UNDETERMINED, 50.0)
    bars = [render.figure(dataset).axes[1].get_ylim() for dataset in (ds, plane())]
    assert bars[0] == bars[1]


def test_a_torus_is_textured_where_it_shows_its_class_and_not_where_it_shows_its_exponent() -> None:
    ds = plane()
    ds["largest"] = ds["largest"].fillna(1e-6)
    hatches = {
        kind: {patch.get_hatch() for patch in render.figure(ds, kind).axes[0].patches}
        for kind in ("period", "exponent")
    }
    assert "++" in hatches["period"]
    assert "++" not in hatches["exponent"]


def test_every_kind_has_one_function_that_draws_it() -> None:
    assert sorted([*painters.PAINTERS, *maps.FIGURES]) == sorted(kinds.KIND_TABLE)


# Impact pairs


def motions(*given: tuple[int, int, int]) -> tuple[np.ndarray, list[LegendEntry]]:
    """The colours of a row of motions, and the legend's entries."""
    n, p, q = (np.array([column], np.int32) for column in zip(*given, strict=True))
    regime = np.full(n.shape, PERIODIC, np.int8)
    found = layers("impacts", regime=regime, period=n, impacts_upper=p, impacts_lower=q)
    return paint(found), list(found.legend)


def test_motions_of_different_impacts_have_different_colours() -> None:
    rgba, legend = motions((1, 1, 1), (1, 2, 2), (2, 2, 2), (2, 2, 3))
    assert len({tuple(cell) for cell in rgba[0]}) == 4
    assert [entry.label for entry in legend] == ["1-1-1", "1-2-2", "2-2-2", "2-2-3"]


def test_mirror_images_share_a_hue_and_differ_in_lightness() -> None:
    rgba, _ = motions((1, 2, 1), (1, 1, 2))
    (hue, _, value), (mirrored, _, other) = (colors.rgb_to_hsv(cell[:3] / 255) for cell in rgba[0])
    assert hue == pytest.approx(mirrored, abs=0.05)
    assert abs(value - other) > 0.2


def test_motions_that_stick_are_one_class() -> None:
    rgba, legend = motions((1, -1, -1), (2, -1, -1), (1, 1, 1))
    assert tuple(rgba[0, 0]) == tuple(rgba[0, 1]) != tuple(rgba[0, 2])
    assert [entry.label for entry in legend] == ["1-1-1", "periodic, sticks"]


def test_a_motion_has_its_colour_whatever_else_there_is_on_the_plane() -> None:
    many = [(1, k, k) for k in range(1, 15)]
    alone, _ = motions((7, 9, 9))
    among, _ = motions(*many * 3, (7, 9, 9))
    assert tuple(alone[0, 0]) == tuple(among[0, -1])


def test_motions_that_share_a_colour_share_a_line_of_the_legend() -> None:
    many = [(n, 40, 40) for n in range(1, 60)]
    _, legend = motions(*many, (1, 1, 1))
    assert len(legend) == 1 + len(class_maps.UNLISTED)
    assert legend[0].label == "1-1-1"
    assert legend[1].label.count("-40-40") == 3 and legend[1].label.endswith(", …")


def test_a_motion_is_named_inside_its_region() -> None:
    n = 60
    ds = atlas(
        {"omega": np.linspace(1, 2, n), "b": np.linspace(0.1, 0.2, n)},
        regime=np.full((n, n), PERIODIC, np.int8),
        period=np.full((n, n), 1, np.int32),
        impacts_upper=np.where(np.arange(n) < 30, 1, 2)[None, :] + np.zeros((n, 1), np.int32),
        impacts_lower=np.ones((n, n), np.int32),
    )
    names = {text.get_text(): text.get_position()[0] for text in render.figure(ds, "impacts").axes[0].texts}
    assert set(names) == {"1-1-1", "1-2-1"}
    assert names["1-1-1"] < 1.5 < names["1-2-1"]


def test_a_name_follows_a_slanted_band_and_stays_out_of_one_that_is_too_narrow() -> None:
    rows, columns = np.mgrid[:200, :200]
    band = np.abs(rows - columns) < 12
    row, column, angle = label_placement.label_spot(band, (1.0, 1.0), (20.0, 5.0)) or (0, 0, 0.0)
    assert angle == pytest.approx(45.0, abs=3.0)
    assert abs(row - column) < 6
    assert label_placement.label_spot(np.abs(rows - columns) < 4, (1.0, 1.0), (20.0, 5.0)) is None


# Combined


def test_the_combined_map_gives_periods_their_class_and_chaos_its_exponent() -> None:
    cells, ds = drawn(render.figure(plane(), "combined")), plane()
    assert tuple(cells[1, 0][:3]) == rgb(class_maps.PERIODS[0][2])
    assert tuple(cells[1, 4][:3]) == rgb(class_maps.PERIODS[1][2])
    chaotic = cells[ds["regime"].values == CHAOTIC][:, :3].astype(int)
    assert len({tuple(cell) for cell in chaotic}) > 2
    assert np.all(chaotic[:, 0] > chaotic[:, 2])


def test_the_combined_map_keeps_periods_cool_and_chaos_warm() -> None:
    for _, _, color in class_maps.PERIODS:
        red, _, blue = rgb(color)
        assert blue >= red
    assert np.all(scales.CHAOS[:, 0] > scales.CHAOS[:, 2])


def test_a_chaotic_cell_without_exponent_keeps_the_colour_and_name_of_chaos() -> None:
    ds = plane()
    ds["largest"] = ds["largest"] * NAN
    figure = render.figure(ds, "combined")
    assert tuple(drawn(figure)[4, 1]) == colour(CHAOTIC)
    assert "chaotic" in labels(figure)
    assert "chaotic" not in labels(render.figure(plane(), "combined"))


# Error, cost, sticking


def test_a_larger_error_is_darker() -> None:
    cells = drawn(figure_of(plane(), "error")).astype(int).sum(axis=-1)
    assert cells[1, 8] < cells[1, 2]


def test_a_cell_that_cost_nothing_differs_from_one_that_cost_little() -> None:
    figure = figure_of(plane(), "periods_used")
    assert "none needed" in labels(figure)
    assert tuple(drawn(figure)[5, 7][:3]) == (0xDD, 0xDD, 0xDD) != tuple(drawn(figure)[1, 7][:3])


def test_a_cell_that_rests_differs_from_those_that_do_not() -> None:
    figure = figure_of(plane(), "stuck_fraction")
    assert "never at rest" in labels(figure)
    assert tuple(drawn(figure)[2, 8]) != tuple(drawn(figure)[2, 7]) == tuple(drawn(figure)[2, 1])


def test_where_nothing_rests_there_is_no_scale_to_read() -> None:
    ds = plane()
    ds["stuck_fraction"] = ds["stuck_fraction"] * 0.0
    assert len(figure_of(ds, "stuck_fraction").axes) == 1


def test_ends_of_a_scale_that_are_equal_are_refused() -> None:
    with pytest.raises(InputError, match=r"colour limits: found 0\.5 to 0\.5, must increase; give vmin, vmax or both"):
        render.figure(plane(), "exponent", vmin=0.5, vmax=0.5)


@pytest.mark.parametrize(
    ("value", "shown"),
    [(math.pi, r"\pi"), (2.5 * math.pi, r"5\pi/2"), (-11.0 * math.pi / 6.0, r"-11\pi/6"), (13.0 * math.pi, "40.8407"),
     (0.0, "0"), (1.5e-7, r"1.5 \times 10^{-7}")],
)  # fmt: skip
def test_numbers_are_shown_to_six_digits_or_as_simple_multiples_of_pi(value: float, shown: str) -> None:
    assert number(value) == shown


def test_a_log_scale_spans_a_decade_at_least() -> None:
    low, high = scales.number_ends(np.array([50.0, 60.0]), log=True)
    assert high / low >= 10


# Overlays


def test_the_grazing_line_lies_where_the_impact_free_response_reaches_the_stops() -> None:
    """Truth: |Y| from the transfer matrix, written out here."""
    axes_of = render.figure(plane(), overlay=["grazing"]).axes[0]
    line = next(layer for layer in axes_of.collections if layer.get_gid() == "grazing")
    points = np.concatenate([path.vertices for path in line.get_paths()])
    assert len(points) > 20
    for omega, b in points[:: len(points) // 10]:
        stiffness = np.array([[1.0, -1.0], [-1.0, 6.0]])
        dynamic = stiffness * (1 + 0.1j * omega) - omega**2 * np.diag([1.0, 2.0])
        assert abs(np.linalg.solve(dynamic, [1.0, 0.0])[0]) == pytest.approx(b, rel=2e-3)


def test_the_grazing_line_is_that_of_the_solver() -> None:
    """Just above it a start on the forced response stays impact-free, just below it cannot."""
    fixed = {p.name: p.default for p in TWO_MASS.parameters}
    ratio = grazing.grazing_ratio(TWO_MASS, fixed, ("omega", np.array([3.0])), ("b", np.array([0.2])))[0, 0]
    touching = 0.2 * math.exp(ratio)
    quiet = solve_tile("two-mass", {"omega": 3.0, "b": 0.6})["state"]
    start = dict(zip(("x1", "x2", "v1", "v2"), quiet, strict=True))
    found = solve_tile("two-mass", {"omega": 3.0, "b": touching * np.array([0.999, 1.001])} | start)["regime"]
    assert found[0] != NO_IMPACT
    assert found[1] == NO_IMPACT


def test_the_grazing_grid_is_the_same_with_and_without_the_short_cut() -> None:
    _, (x, y) = sort_axes(plane())
    fixed = {p.name: p.default for p in TWO_MASS.parameters}
    xs, ys, quick = grazing.grazing_grid(TWO_MASS, fixed, x, y, points=12)
    assert quick == pytest.approx(grazing.grazing_ratio(TWO_MASS, fixed, ("omega", xs), ("b", ys)), abs=1e-12)


def test_a_grazing_line_out_of_view_is_said_to_be() -> None:
    ds = plane().assign_coords(b=plane()["b"] * 1e4)
    assert labels(render.figure(ds, overlay=["grazing"]))[-1] == "grazing, $|Y| = b$: not in this window"


def test_the_grazing_line_exists_where_neither_axis_is_the_clearance() -> None:
    n = 5
    ds = atlas(
        {"omega": np.linspace(1, 4, n), "zeta": np.linspace(0.02, 0.4, n)},
        regime=np.full((n, n), PERIODIC, np.int8),
        largest=-np.ones((n, n)),
    )
    axes_of = render.figure(ds, overlay=["grazing"]).axes[0]
    assert any(layer.get_gid() == "grazing" and layer.get_paths() for layer in axes_of.collections)


def test_isolated_cells_are_outlined_and_clouds_of_them_are_not() -> None:
    regime = np.full((300, 300), PERIODIC, np.int8)
    regime[:, 150:] = CHAOTIC
    regime[10, 10] = CHAOTIC
    alone, left_out = outlines.simplify_regimes(regime, (400.0, 270.0))
    assert not left_out and alone[10, 10] == CHAOTIC
    regime[100:200:2, 20:120:2] = CHAOTIC
    among, left_out = outlines.simplify_regimes(regime, (400.0, 270.0))
    assert left_out and among[10, 10] == CHAOTIC
    assert (among[110:190, 30:110] == PERIODIC).all()


def test_boundaries_are_drawn_around_every_cell_that_the_query_finds() -> None:
    """Truth: the query ``boundary`` of the same plane."""
    n = 40
    regime = np.full((n, n), PERIODIC, np.int8)
    regime[7, 30] = CHAOTIC
    ds = atlas({"omega": np.linspace(1, 2, n), "b": np.linspace(0.1, 0.2, n)}, regime=regime, largest=-np.ones((n, n)))
    island = boundary(ds, "chaotic")[["omega", "b"]].to_numpy()
    edges = np.concatenate(render.figure(ds, overlay="boundaries").axes[0].collections[0].get_segments())
    assert (edges.min(axis=0), edges.max(axis=0)) == (
        pytest.approx(island.min(axis=0)),
        pytest.approx(island.max(axis=0)),
    )


def test_two_grazing_lines_side_by_side_are_solid_and_one_alone_is_dashed() -> None:
    n = 140
    ds = atlas(
        {"omega": np.linspace(0.5, 4.5, n), "b": np.linspace(0.05, 0.6, n)},
        regime=np.full((n, n), PERIODIC, np.int8), largest=-np.ones((n, n)),
    ).assign_coords(zeta=0.0005)  # fmt: skip
    (drawn,) = (layer for layer in render.figure(ds, overlay="grazing").axes[0].collections if layer.get_gid())
    parts = list(zip(drawn.get_segments(), drawn.get_linestyle(), strict=True))
    found = [
        np.concatenate([part for part, (_, dashes) in parts if (dashes is None) is solid]) for solid in (True, False)
    ]
    assert np.abs(found[0][:, 0] - 1.75).max() < 0.3  # beside the narrow resonance
    assert found[1][:, 0].max() > 3.0


def test_a_resonance_narrower_than_the_points_of_a_grid_has_one_line_around_it() -> None:
    """Truth: the response exceeds the clearance all along the ridge, so that nothing closes the line off."""
    n = 140
    ds = atlas(
        {"omega": np.linspace(0.5, 4.5, n), "mu_k": np.linspace(1.0, 5.0, n)},
        regime=np.full((n, n), PERIODIC, np.int8), largest=-np.ones((n, n)),
    ).assign_coords(zeta=0.002, b=1.5)  # fmt: skip
    _, (x, y) = sort_axes(ds)
    fixed = {p.name: float(ds[p.name]) for p in TWO_MASS.parameters if ds[p.name].ndim == 0}
    xs, _, ratio = grazing.grazing_grid(TWO_MASS, fixed, x, y)
    ridge = ratio[:, (xs > 1.2) & (xs < 2.2)].max(axis=1)
    assert np.mean(ridge > 0.0) > 0.95


UNEVEN = np.cumsum(np.concatenate([np.full(80, 0.01), np.linspace(0.01, 0.2, 60)])) + 0.05
"""Points that are drawn neither evenly nor in the logarithm."""


@pytest.mark.parametrize("logarithmic", [False, True])
@pytest.mark.parametrize("axis", [np.linspace(0.05, 6.0, 140), np.geomspace(0.05, 6.0, 140), UNEVEN])
def test_names_of_regions_lie_within_them_in_pictures_and_on_pages_however_wide_cells_are(
    axis: np.ndarray, logarithmic: bool
) -> None:
    """Truth: a disc in the middle of the plane as it is drawn has motion 1-2-1, the rest 1-1-1."""
    n = axis.size
    log = {"omega": "log", "b": "log"} if logarithmic else {}
    ds = atlas({"omega": axis, "b": axis}, log, regime=np.full((n, n), PERIODIC, np.int8))
    drawn = Plane.from_dataset(ds, ()).x
    (low, high), scale = drawn.edges[[0, -1]], np.log if drawn.log else np.asarray

    def away(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """How far from the middle, where the plane is one wide and one high."""
        x, y = ((scale(at) - scale(low)) / (scale(high) - scale(low)) - 0.5 for at in (x, y))
        return np.hypot(x, y)

    ds["period"] = ds["regime"] * 0 + np.int32(1)
    ds["impacts_lower"] = ds["regime"] * 0 + np.int32(1)
    ds["impacts_upper"] = (("b", "omega"), np.where(away(*np.meshgrid(axis, axis)) < 0.3, 2, 1).astype(np.int32))
    in_file = [(text.get_text(), *text.get_position()) for text in render.figure(ds, "impacts").axes[0].texts]
    coded = coded_map(ds, ds, "impacts")
    names = names_on(coded.layers, Plane.from_dataset(ds, ()), (1000.0, 800.0))
    on_page = [(name["text"], name["x"], name["y"]) for name in names]
    for found in (in_file, on_page):
        assert {text for text, *_ in found} == {"1-1-1", "1-2-1"}
        for text, x, y in found:
            assert away(x, y) < 0.28 if text == "1-2-1" else away(x, y) > 0.32


def test_the_legend_names_the_overlays() -> None:
    found = labels(render.figure(plane(), "period", overlay=render.MAP_OVERLAYS))
    assert found[-6:-4] == [r"grazing, $|Y| = b$", "regime boundary"]
    assert found[-4:] == ["fold", "period doubling", "graze", "graze–period doubling"]


def test_there_are_lines_for_every_overlay() -> None:
    assert tuple(overlays.OVERLAYS) == (*render.MAP_OVERLAYS, "saddles")


def test_every_curve_over_a_map_has_a_white_casing() -> None:
    """Without it some could not be told from the cells below them: see test_colors."""
    lines = [
        layer for layer in render.figure(plane(), "period", overlay="curves").axes[0].collections if layer.get_gid()
    ]
    cased = [layer for layer in render.figure(plane(), "period", overlay="curves").axes[0].collections
             if layer.get_zorder() == 3.1 and colors.same_color(layer.get_edgecolor(), "white")]  # fmt: skip
    assert len(lines) == len(cased) == 3


def test_an_unknown_overlay_is_refused_with_those_possible() -> None:
    with pytest.raises(InputError, match="unknown overlay 'grid'; possible: grazing, boundaries, cur"):
        render.figure(plane(), overlay=["grid"])


# Cells too small to be seen


def dense(code: int, cells: list[tuple[int, int]]) -> Figure:
    n = 400
    regime = np.full((n, n), PERIODIC, np.int8)
    for cell in cells:
        regime[cell] = code
    ds = atlas(
        {"omega": np.linspace(1, 2, n), "b": np.linspace(0.1, 0.2, n)},
        regime=regime,
        largest=np.where(regime == PERIODIC, -1.0, NAN),
    )
    return render.figure(ds)


@pytest.mark.parametrize("code", [UNDETERMINED, INVALID, FAILED])
def test_a_lone_cell_without_a_result_is_marked_where_it_is(code: int) -> None:
    (marks,) = dense(code, [(0, 399), (200, 100)]).axes[0].lines
    assert colors.same_color(marks.get_color(), np.array(colour(code)) / 255)
    assert np.sort(marks.get_xdata()) == pytest.approx([1 + 100 / 399, 2.0], rel=1e-3)


def test_the_legend_says_where_single_cells_are_drawn_larger_than_they_are() -> None:
    assert labels(dense(UNDETERMINED, [(0, 399)])) == ["undetermined,\nsingle cells enlarged"]
    assert labels(dense(UNDETERMINED, [(i, j) for i in range(20) for j in range(20)])) == ["undetermined"]


def test_cells_without_a_result_that_are_seen_anyway_are_not_marked() -> None:
    block = [(i, j) for i in range(20) for j in range(20)]
    assert not dense(FAILED, block).axes[0].lines
    assert not render.figure(plane()).axes[0].lines


def test_a_cloud_of_cells_without_a_result_is_not_covered_with_marks() -> None:
    cloud = [(2 * i, 2 * j) for i in range(20) for j in range(20)]
    assert not dense(UNDETERMINED, cloud).axes[0].lines


def test_impact_free_dust_keeps_its_colour_and_gets_no_outline() -> None:
    dust = [(3 * i, 3 * j) for i in range(50) for j in range(50)]
    n = 400
    regime = np.full((n, n), PERIODIC, np.int8)
    regime[:, 300:] = NO_IMPACT
    for cell in dust:
        regime[cell] = NO_IMPACT
    ds = atlas({"omega": np.linspace(1, 2, n), "b": np.linspace(1, 2, n)}, regime=regime, largest=-np.ones((n, n)))
    lines = np.array(render.figure(ds).axes[0].collections[0].get_segments())
    assert lines[:, :, 0] == pytest.approx(np.full(lines.shape[:2], 1 + 299.5 / 399))


def test_a_sweep_of_labelled_attractors_has_an_entry_for_each_branch() -> None:
    ds, (_, table) = branches(), labelled()
    periodic = ds["regime"].values == PERIODIC
    label = np.where(periodic, np.cumsum(periodic).reshape(periodic.shape) % 2, -1)
    with patch("atlas.render.sweep.branches_of", return_value=table):
        drawn = render.figure(ds.assign(label=(ds["regime"].dims, label)), "coexistence")
    (legend,) = drawn.legends
    assert [text.get_text() for text in legend.get_texts()][:2] == ["0: 1-1-1", "1: 2-2-2, mirrors 0"]
