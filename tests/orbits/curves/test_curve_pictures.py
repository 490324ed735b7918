"""Claims about curves over maps and alone as a region chart: what is drawn where; read off the artists."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

import atlas
from atlas import render
from atlas.errors import InputError
from atlas.orbits.curves.table import CodimTwoPoint, Curves
from atlas.render.looks import CORNERS, EVENT_STYLES, corner_look
from tests.pictures import curve, curves, keeping, labels, plane


def collection(ax: Axes, kind: str) -> LineCollection:
    """What is drawn of a kind of curve."""
    (found,) = [collection for collection in ax.collections if collection.get_gid() == kind]
    assert isinstance(found, LineCollection)
    return found


def lines(ax: Axes, kind: str) -> list[np.ndarray]:
    """The lines of a kind of curve, whole: parts that meet, of another width where lines crowd, are one."""
    whole: list[np.ndarray] = []
    for part in map(np.asarray, collection(ax, kind).get_segments()):
        if whole and np.array_equal(whole[-1][-1], part[0]):
            whole[-1] = np.concatenate([whole[-1], part[1:]])
        else:
            whole.append(part)
    return whole


def corners(ax: Axes) -> list[Line2D]:
    """The marks of points of codimension two."""
    return [line for line in ax.lines if line.get_gid() not in (None, "end")]


def drawn(found: Curves, kind: str = "period", **options: Any) -> Figure:
    with keeping(found):
        figure: Figure = render.figure(plane(), kind, overlay="curves", **options)
    return figure


@pytest.mark.slow
@pytest.mark.parametrize("kind", render.MAPS)
def test_every_map_takes_curves_and_draws_them_along_their_points(kind: str) -> None:
    ax = drawn(curves(), kind).axes[0]
    (fold,) = lines(ax, "fold")
    assert np.array_equal(fold, curves().curves[0].points)


def test_where_the_orbit_is_otherwise_unstable_a_curve_is_left_out() -> None:
    ax = drawn(curves()).axes[0]
    (doubling,), (graze,) = (lines(ax, kind) for kind in ("period_doubling", "graze"))
    assert (doubling[0, 0], doubling[-1, 0]) == (1.0, pytest.approx(3.0))
    assert (graze[0, 0], graze[-1, 0]) == (pytest.approx(3.0), 5.0)


def test_a_curve_that_is_stable_in_two_parts_is_drawn_in_two() -> None:
    x = np.linspace(1.0, 5.0, 9)
    broken = curve("fold", np.column_stack([x, 0.3 + 0.0 * x]), [0, 0, 0, 1, 1, 0, 0, 1, 0])
    found = lines(drawn(Curves(("omega", "b"), (broken,))).axes[0], "fold")
    assert [part[:, 0].tolist() for part in found] == [[1.0, 1.5, 2.0], [3.5, 4.0]]


def test_kinds_differ_in_line_style_not_in_colour_alone() -> None:
    assert len({str(look.dashes) for look in EVENT_STYLES.values()}) == len(EVENT_STYLES)
    assert len({look.marker for look in EVENT_STYLES.values()}) == len(EVENT_STYLES)


def test_the_legend_names_the_kinds_in_view_and_no_others() -> None:
    assert labels(drawn(curves()))[-4:] == ["fold", "period doubling", "graze", "graze–period doubling"]
    part = labels(drawn(curves(), window={"omega": (3.6, 5.0), "b": (0.2, 0.45)}))
    assert part[-2:] == ["fold", "graze"]


def test_curves_outside_the_window_are_said_to_be() -> None:
    away = Curves(("omega", "b"), (curve("fold", [[8.0, 0.1], [9.0, 0.2]]),))
    assert labels(drawn(away))[-1] == "curves: none in this window"


def test_a_point_of_codimension_two_of_several_curves_is_marked_once_and_named_in_the_legend() -> None:
    figure = drawn(curves())
    (mark,) = corners(figure.axes[0])
    assert (mark.get_xdata(), mark.get_ydata()) == ([3.0], [0.37])
    assert "graze–period doubling" in labels(figure)
    assert not figure.axes[0].texts


def test_each_kind_of_point_of_codimension_two_has_a_mark_of_its_own() -> None:
    points = np.column_stack([np.linspace(1.0, 5.0, 21), np.full(21, 0.3)])
    kinds = ("cusp", "resonance_1_2", "fold_flip", "cusp")
    marked = tuple(CodimTwoPoint(kind, 1.5 + k, 0.3, 5) for k, kind in enumerate(kinds))
    figure = drawn(Curves(("omega", "b"), (curve("fold", points, corners=marked),)))
    shapes = {float(corner.get_xdata()[0]): corner.get_marker() for corner in corners(figure.axes[0])}
    assert shapes[1.5] == shapes[4.5]
    assert len(set(shapes.values())) == 3
    assert labels(figure)[-3:] == ["cusp", "fold–flip", "1:2 resonance"]
    assert len({marker for _, marker in CORNERS.values()}) == len(CORNERS)


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("cusp", "cusp"), ("resonance_1_3", "1:3 resonance"), ("fold_flip", "fold–flip"), ("graze_fold", "graze–fold"),
        ("graze_neimark_sacker", "graze–Neimark–Sacker"), ("double_graze", "double graze"),
    ],
)  # fmt: skip
def test_points_of_codimension_two_are_named_in_words(kind: str, name: str) -> None:
    assert corner_look(kind).label == name


def test_the_kinds_of_curves_that_are_drawn_can_be_chosen() -> None:
    figure = drawn(curves(), curves="fold,graze")
    assert {collection.get_gid() for collection in figure.axes[0].collections} >= {"fold", "graze"}
    assert labels(figure)[-2:] == ["fold", "graze"]
    assert corners(figure.axes[0]) == []


def test_points_of_codimension_two_are_drawn_where_they_are_chosen() -> None:
    figure = drawn(curves(), curves=["graze", "codimension_two"])
    assert labels(figure)[-2:] == ["graze", "graze–period doubling"]


def test_kinds_of_curves_ask_for_the_overlay_by_themselves() -> None:
    with keeping(curves()):
        assert labels(render.figure(plane(), "period", curves="fold"))[-1] == "fold"


def test_an_unknown_kind_of_curve_is_refused_with_the_nearest_or_all_that_there_are() -> None:
    for name, hint in (("dashed", f"known: {', '.join(render.CURVES)}"), ("foldd", "did you mean 'fold'?")):
        with pytest.raises(InputError) as error:
            drawn(curves(), curves=f"fold,{name}")
        assert str(error.value) == f"unknown kind of curve {name!r}; {hint}"
    assert (*EVENT_STYLES, "codimension_two") == render.CURVES


def test_curves_can_be_drawn_without_names_and_without_a_legend() -> None:
    figure = drawn(curves(), names=False, legend=False)
    assert corners(figure.axes[0])
    assert (figure.axes[0].texts[:], labels(figure)) == ([], [])


def test_a_long_legend_beside_a_map_is_shown_whole() -> None:
    """A point of every kind: the page grows with the legend unless its height is asked for."""
    points = np.column_stack([np.linspace(1.0, 5.0, 21), np.full(21, 0.3)])
    every = tuple(CodimTwoPoint(kind, 1.2 + 0.2 * k, 0.3, 5) for k, kind in enumerate(CORNERS))
    found = Curves(("omega", "b"), tuple(curve(kind, points, corners=every) for kind in EVENT_STYLES))
    figure = drawn(found)
    figure.draw_without_rendering()
    (legend,) = figure.legends
    box = legend.get_window_extent()
    assert box.y0 >= 0.0 and box.y1 <= figure.bbox.y1


def test_curves_that_run_beside_each_other_are_thinner_than_one_alone() -> None:
    x = np.linspace(1.0, 5.0, 81)
    apart = np.column_stack([x, np.full(81, 0.5)])
    beside = [np.column_stack([x, np.full(81, height)]) for height in (0.2, 0.205)]
    found = Curves(("omega", "b"), tuple(curve("fold", line) for line in (apart, *beside)))
    ax = drawn(found).axes[0]
    front = collection(ax, "fold")
    (casing,) = [collection for collection in ax.collections if collection.get_zorder() == 3.1]
    for line in (front, casing):
        alone, one, other = line.get_linewidths()
        assert one == other < alone
    assert np.all(np.asarray(casing.get_linewidths()) > front.get_linewidths())


def test_lines_that_cross_keep_their_width() -> None:
    x = np.linspace(1.0, 5.0, 81)
    crossing = [np.column_stack([x, height]) for height in (0.1 + 0.1 * x, 0.7 - 0.1 * x)]
    found = Curves(("omega", "b"), tuple(curve("fold", line) for line in crossing))
    assert len(set(collection(drawn(found).axes[0], "fold").get_linewidths())) == 1


def test_an_end_that_no_point_of_codimension_two_explains_is_marked() -> None:
    points = np.column_stack([np.linspace(1.5, 4.5, 31), np.full(31, 0.3)])
    given = curve("fold", points, corners=(CodimTwoPoint("cusp", 1.5, 0.3, 0),))
    for ends, marked in ((("cusp", "budget"), [4.5]), (("cusp", "edge"), [])):
        figure = drawn(Curves(("omega", "b"), (replace(given, ends=ends),)))
        found = [line for line in figure.axes[0].lines if line.get_gid() == "end"]
        assert [float(line.get_xdata()[0]) for line in found] == marked
        assert ("end of a curve" in labels(figure)) == bool(marked)


def test_curves_of_other_axes_are_refused() -> None:
    with pytest.raises(InputError, match="overlay 'curves': curves over omega, R, found a map of omega, b"):
        drawn(Curves(("omega", "R"), ()))


def test_an_atlas_without_curves_says_which_command_finds_them(finished: Path) -> None:
    ds = atlas.open(finished)
    with pytest.raises(InputError, match=r"overlay 'curves': .*out\.zarr: has no curves yet; find them"):
        render.figure(ds, overlay="curves")


def test_many_marks_are_smaller_than_few_and_bury_no_map() -> None:
    points = np.column_stack([np.linspace(1.0, 5.0, 21), np.full(21, 0.3)])

    def size(count: int) -> float:
        marked = tuple(CodimTwoPoint("cusp", 1.0 + 4.0 * (k + 0.5) / count, 0.3, 5) for k in range(count))
        figure = drawn(Curves(("omega", "b"), (curve("fold", points, corners=marked),)))
        return float(corners(figure.axes[0])[0].get_markersize())

    few, some, many = size(3), size(24), size(60)
    assert size(12) == few and some == pytest.approx(few / np.sqrt(2.0)) and many == pytest.approx(0.6 * few)
