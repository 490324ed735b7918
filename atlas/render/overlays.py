"""Overlays of a map: lines and marks over its cells.

They are the grazing of impact-free motion, borders between regimes, the exact curves of bifurcations and grazes that a
store has, with their ends and their points of codimension two, and over basins the saddles between them.

The orbit of a curve undergoes the curve's bifurcation or graze. A curve is drawn only where this orbit is otherwise
stable, since there it bounds a region with attractors. The rest crosses regions without an effect and is left out.
"""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.orbits.curves import queries
from atlas.orbits.curves.table import Curve
from atlas.query import machine
from atlas.query.open import handle_of
from atlas.query.window import axis_names
from atlas.render import raster, style
from atlas.render.grazing import grazing_lines
from atlas.render.kinds import OverlayError
from atlas.render.label_placement import crowded_parts
from atlas.render.layers import MapView
from atlas.render.outlines import simplify_regimes
from atlas.robustness.saddles import saddles_in

Array = NDArray[np.float64]

_CROWDED = 5.0
"""Distance in points below which two grazing lines are drawn solid: adjacent dashes look like a bar code."""
BOUNDARY = "#101418"
"""Colour of regime boundaries."""
CASING = {False: 1.5, True: 0.7}
"""Extra width, in points, of the white edge of a curve over a map, by whether another curve runs beside the curve."""
_WIDTHS = {False: 1.1, True: 0.75}
"""Width in points of a curve, by whether another curve runs beside it."""
_CROWDING_DISTANCE = 6.0
"""Maximum distance in points at which two curves crowd each other."""
_MARK, _END = 4.6, 2.6
"""Sizes, in points, of the marks of a point of codimension two and of the end of a curve."""
_FEW, _SMALLEST = 12, 0.6
"""Number of marks from which on they are drawn smaller, and their minimum relative size."""
_MERGE_DISTANCE = 1.0
"""Distance in points below which two marks of the same kind are merged."""


def draw(ax: Axes, view: MapView) -> list[Artist]:
    """Draw the requested overlays over a map and return their legend entries.

    Raise OverlayError if an overlay cannot be drawn.
    """
    entries: list[Artist] = []
    for name, lines in DRAW.items():
        if name in view.request.overlays:
            try:
                entries += lines(ax, view)
            except InputError as error:
                raise OverlayError(name, str(error)) from None
    return entries


def lines_of_grazing(view: MapView) -> list[Array]:
    """Return the lines (N, 2) along which motion without impact grazes a stop."""
    return grazing_lines(view.ds, view.plane.x, view.plane.y)


def grazing_label(view: MapView, lines: list[Array]) -> str:
    """Return the text of the legend for the grazing lines ``lines`` of a map."""
    x, y = view.plane.x, view.plane.y
    symmetric = machine.twins_everywhere(view.ds, {x.name: x.values, y.name: y.values})
    label = r"grazing, $|Y| = b$" if symmetric else "impact-free motion\ngrazes a stop"
    return label + ("" if lines else ": not in this window")


def _grazing(ax: Axes, view: MapView) -> list[Artist]:
    size, lines = view.page.map_size, lines_of_grazing(view)
    dashes, halo = (0, (5, 2)), [withStroke(linewidth=2.8, foreground="white")]
    places = [raster.in_points(ax, line, size) for line in lines]
    cut = [(part, is_crowded) for _, part, is_crowded in crowded_parts(lines, places, _CROWDED)]
    crowded, alone = ([part for part, is_crowded in cut if is_crowded is side] for side in (True, False))
    looks = ((lines, "white", 2.8, "solid"), (crowded, "black", 0.8, "solid"), (alone, "black", 1.3, dashes))
    for segments, color, width, look in looks:
        drawn = LineCollection(segments, colors=color, linewidths=width, linestyles=[look], zorder=3)
        ax.add_collection(drawn, autolim=False)
    legend_look: Any = {"linestyle": dashes, "path_effects": halo, "label": grazing_label(view, lines)}
    return [Line2D([], [], color="black", linewidth=1.3, **legend_look)]


def _boundaries(ax: Axes, view: MapView) -> list[Artist]:
    regions, left_out = simplify_regimes(view.plane.regime, view.page.map_size)
    for code in np.unique(regions):
        raster.outline(ax, view.plane, regions == code, BOUNDARY, 0.6)
    label = "regime boundary" + (",\nclouds of cells left out" if left_out else "")
    return [Line2D([], [], color=BOUNDARY, linewidth=0.9, label=label)]


def _curves(ax: Axes, view: MapView) -> list[Artist]:
    return draw_curves(ax, requested_curves(view, "overlay 'curves'"), view)


def requested_curves(view: MapView, who: str) -> list[Curve]:
    """Return the stored curves of the kinds that are requested on a map.

    Raise InputError, in the name of ``who``, if the atlas has no curves or curves over other axes.
    """
    try:
        stored = queries.curves_of(view.ds)
    except InputError as error:
        raise InputError(f"{who}: {error}") from None
    if stored.axes != axis_names(view.ds):
        axes = ", ".join(axis_names(view.ds))
        raise InputError(f"{who}: curves over {', '.join(stored.axes)}, found a map of {axes}")
    return [curve for curve in stored if view.request.curves is None or curve.kind in view.request.curves]


def draw_curves(ax: Axes, curves: list[Curve], view: MapView) -> list[Artist]:
    """Draw stored curves over a map, each kind in its own colour and line style, and return their legend entries.

    Only visible curves have an entry. Where curves run side by side, they and their white edges are thinner, to show
    the map between them.
    """
    size, scale = view.page.map_size, view.page.scale
    every = [(curve.kind, line) for curve in curves for line in curve.stable_lines]
    every = [(kind, line) for kind, line in every if ax.viewLim.overlaps(Bbox([line.min(axis=0), line.max(axis=0)]))]
    if not every:
        return [Line2D([], [], linestyle="", label="curves: none in this window")]
    lines, entries = [line for _, line in every], list[Artist]()
    parts = list(crowded_parts(lines, [raster.in_points(ax, line, size) for line in lines], _CROWDING_DISTANCE))
    halo = [withStroke(linewidth=_WIDTHS[False] + 1.4, foreground="white")]
    for kind, look in style.EVENT_STYLES.items():
        kind_parts = [(part, crowded) for number, part, crowded in parts if every[number][0] == kind]
        if not kind_parts:
            continue
        segments, widths = [part for part, _ in kind_parts], np.array([_WIDTHS[crowded] for _, crowded in kind_parts])
        wide = widths + [CASING[crowded] for _, crowded in kind_parts]
        ax.add_collection(LineCollection(segments, colors="white", linewidths=wide, zorder=3.1), autolim=False)
        drawn = LineCollection(segments, colors=look.color, linewidths=widths, linestyles=[look.dashes], zorder=3.2)
        drawn.set_gid(kind)
        ax.add_collection(drawn, autolim=False)
        legend_look: Any = {"color": look.color, "linestyle": look.dashes, "label": look.label}
        entries.append(Line2D([], [], linewidth=_WIDTHS[False], path_effects=halo, **legend_look))
    if view.request.curves is None or "codimension_two" in view.request.curves:
        corners = sorted({(corner.kind, corner.x, corner.y) for curve in curves for corner in curve.stable_corners})
        corners = [corner for corner in corners if ax.viewLim.contains(*corner[1:])]
        size_of_all = _MARK * scale * float(np.clip(np.sqrt(_FEW / max(len(corners), 1)), _SMALLEST, 1.0))
        looks = {kind: style.corner_look(kind, size_of_all) for kind, _, _ in corners}
        for kind in sorted(looks, key=[*style.CORNERS, *looks].index):
            places = [(x, y) for mark, x, y in corners if mark == kind]
            entries += _draw_marks(ax, places, size, "corner", 4.2, looks[kind])
    end = style.mark("o", _END * scale, "black", "white", 0.4) | {"label": "end of a curve"}
    return entries + _draw_marks(ax, [at for curve in curves for at in curve.loose_ends], size, "end", 4.1, end)


def _draw_marks(
    ax: Axes, places: Iterable[Any], size: tuple[float, float], gid: str, zorder: float, style: dict[str, Any]
) -> list[Artist]:
    """Mark the visible positions among ``places`` (x, y), and return their legend entry, empty if none is visible.

    Positions that coincide get one mark. ``size`` is the size of the plot in points; ``gid`` and ``style`` are the
    group name and the arguments of ``Axes.plot``.
    """
    marked: list[Array] = []
    for x, y in places:
        at = raster.in_points(ax, np.array([[x, y]]), size)[0]
        if np.all((at >= 0.0) & (at <= size)) and all(np.hypot(*(at - other)) >= _MERGE_DISTANCE for other in marked):
            marked.append(at)
            ax.plot(x, y, zorder=zorder, gid=gid, **style)
    return [Line2D([], [], **style)] if marked else []


def _saddles(ax: Axes, view: MapView) -> list[Artist]:
    saddles = saddles_in(view.ds, handle_of(view.ds).spec, (view.plane.x.name, view.plane.y.name))
    look = style.mark("X", 7.0, "black", "white", 0.8)
    for states in saddles:
        ax.plot(*states.T, zorder=4.2, scalex=False, scaley=False, gid="saddle", **look)
    if not saddles:
        return [Line2D([], [], linestyle="", label="no saddle found between basins")]
    return [Line2D([], [], label="saddle: unstable orbit", **look)]


DRAW: dict[str, Callable[[Axes, MapView], list[Artist]]] = {
    "grazing": _grazing,
    "boundaries": _boundaries,
    "curves": _curves,
    "saddles": _saddles,
}
