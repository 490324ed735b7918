"""Exact curves over a map, with their points of codimension two and their ends.

A curve is drawn where its orbit is otherwise stable: there it bounds a region with attractors. The rest passes through
regions without changing them, and is left out.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from atlas.curves import asking
from atlas.curves.table import Curve
from atlas.errors import InputError
from atlas.query.window import axis_names
from atlas.render import layout, maps, style
from atlas.render.maps import View

Array = NDArray[np.float64]

CASING = {False: 1.5, True: 0.7}
"""What a white casing adds to the width of a curve over a map, by whether another one runs beside it."""
_WIDTHS = {False: 1.1, True: 0.75}
"""Width in points of a curve, likewise."""
_BESIDE = 6.0
"""Distance in points within which two curves crowd each other."""
_MARK, _END = 4.6, 2.6
"""Size in points of the mark of a point of codimension two, and of an end."""
_SAME = 1.0
"""Distance in points below which two marks of one kind are one."""


def wanted(view: View, who: str) -> list[Curve]:
    """The curves of a map that are to be drawn; InputError where ``who`` needs them and there are none."""
    try:
        found = asking.curves_of(view.ds)
    except InputError as error:
        raise InputError(f"{who}: {error}") from None
    if found.axes != axis_names(view.ds):
        raise InputError(f"{who}: curves over {', '.join(found.axes)}, found a map of {', '.join(axis_names(view.ds))}")
    return [curve for curve in found if view.wanted.curves is None or curve.kind in view.wanted.curves]


def draw(ax: Axes, view: View) -> list[Artist]:
    """Draw the curves that the atlas keeps over a map, and return their legend entries."""
    return draw_lines(ax, wanted(view, "overlay 'curves'"), view, CASING)


def draw_lines(ax: Axes, found: list[Curve], view: View, casing: dict[bool, float] | None = None) -> list[Artist]:
    """Draw curves, each kind in its own colour and line style, and return the legend entries of those in view.

    Where curves crowd, lines and casings are thinner, for the map to be seen between them.
    """
    size, scale = view.page.map_size, view.page.scale
    every = [(curve.kind, line) for curve in found for line in curve.stable_lines if _is_in_view(ax, line)]
    if not every:
        return [Line2D([], [], linestyle="", label="curves: none in this window")]
    lines = [line for _, line in every]
    drawn: dict[str, list[tuple[Array, bool]]] = {}
    for number, part, crowded in layout.parts(lines, [maps.in_points(ax, line, size) for line in lines], _BESIDE):
        drawn.setdefault(every[number][0], []).append((part, crowded))
    entries: list[Artist] = []
    for kind, look in style.LOOKS.items():
        parts, widths = drawn.get(kind, []), np.array([_WIDTHS[crowded] for _, crowded in drawn.get(kind, [])])
        if not parts:
            continue
        segments = [part for part, _ in parts]
        if casing:
            wide = widths + [casing[crowded] for _, crowded in parts]
            ax.add_collection(LineCollection(segments, colors="white", linewidths=wide, zorder=3.1), autolim=False)
        front = LineCollection(segments, colors=look.color, linewidths=widths, linestyles=[look.dashes], zorder=3.2)
        front.set_gid(kind)
        ax.add_collection(front, autolim=False)
        entries.append(style.line_entry(kind, _WIDTHS[False]))
    kinds = view.wanted.curves
    if kinds is None or "codimension_two" in kinds:
        corners = sorted({(each.kind, each.x, each.y) for curve in found for each in curve.stable_corners})
        looks = {kind: style.corner_look(kind, _MARK * scale) for kind, _, _ in corners}
        for kind in sorted(looks, key=[*style.CORNERS, *looks].index):
            places = [(x, y) for each, x, y in corners if each == kind]
            entries += _draw_marks(ax, places, size, "corner", 4.2, looks[kind])
    end = style.mark("o", _END * scale, "black", "white", 0.4) | {"label": "end of a curve"}
    return entries + _draw_marks(ax, [at for curve in found for at in curve.loose_ends], size, "end", 4.1, end)


def _draw_marks(
    ax: Axes, places: Iterable[Any], size: tuple[float, float], gid: str, zorder: float, look: dict[str, Any]
) -> list[Artist]:
    """Mark the places (x, y) in view, those that lie on each other once; the legend entry."""
    seen: list[Array] = []
    for x, y in places:
        at = maps.in_points(ax, np.array([[x, y]]), size)[0]
        if np.all((at >= 0.0) & (at <= size)) and all(np.hypot(*(at - other)) >= _SAME for other in seen):
            seen.append(at)
            ax.plot(x, y, zorder=zorder, gid=gid, **look)
    return [Line2D([], [], **look)] if seen else []


def _is_in_view(ax: Axes, line: Array) -> bool:
    """Whether the box around a line meets the limits of the axes."""
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    (x0, y0), (x1, y1) = line.min(axis=0), line.max(axis=0)
    return bool(x1 >= left and x0 <= right and y1 >= low and y0 <= high)
