"""Exact curves over a map, their points of codimension two marked and named.

Drawn is where the orbit of a curve is otherwise stable: there the curve bounds a region that attractors live in. The
rest passes through regions without changing what is seen in them, and is left out.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from atlas.curves import asking
from atlas.curves.table import Corner, Curve, Curves
from atlas.errors import InputError
from atlas.query.window import axis_names
from atlas.render import axes, maps
from atlas.render.events import LOOKS, corner_name, line_entry

Array = NDArray[np.float64]

WIDTH, HALO = 1.15, 1.5
"""Width in points of a curve, and what a white halo adds to it over a map."""
_MARKER, _TYPE = 4.0, 7.5
"""Size in points of the mark of a point of codimension two, and of its name."""
_SAME = 1.0
"""Distance in points below which two such points of one name are one."""


def of(ds: xr.Dataset, who: str) -> Curves:
    """The curves of a map; InputError, in one line, where ``who`` needs them and there are none."""
    try:
        found = asking.curves_of(ds)
    except InputError as error:
        raise InputError(f"{who}: {error}") from None
    if found.axes != axis_names(ds):
        raise InputError(f"{who}: curves over {', '.join(found.axes)}, found a map of {', '.join(axis_names(ds))}")
    return found


def draw(ax: Axes, ds: xr.Dataset, plane: maps.Plane, options: maps.Options) -> list[Artist]:
    """Draw the curves that the atlas keeps over a map, and return their legend entries."""
    return draw_lines(ax, of(ds, "overlay 'curves'"), options, HALO)


def wanted(found: Curves, options: maps.Options) -> Curves:
    """The curves of the kinds that are drawn."""
    if options.curves is None:
        return found
    kept = tuple(curve for curve in found if curve.kind in options.curves)
    return replace(found, curves=kept)


def draw_lines(ax: Axes, found: Curves, options: maps.Options, halo: float) -> list[Artist]:
    """Draw curves, each kind in its own colour and line style, and return the legend entries of those in view."""
    found = wanted(found, options)
    entries: list[Artist] = []
    for kind, look in LOOKS.items():
        lines = [line for curve in found.of_kind(kind) for line in bounding(curve) if _is_in_view(ax, line)]
        if not lines:
            continue
        if halo:
            back = LineCollection(lines, colors="white", linewidths=WIDTH + halo, zorder=3.1)
            ax.add_collection(back, autolim=False)
        front = LineCollection(lines, colors=look.color, linewidths=WIDTH, linestyles=[look.dashes], zorder=3.2)
        front.set_gid(kind)
        ax.add_collection(front, autolim=False)
        entries.append(line_entry(kind, WIDTH))
    if entries and (options.curves is None or "codimension_two" in options.curves):
        entries += _draw_corners(ax, found, options)
    return entries or [_nothing()]


def bounding(curve: Curve) -> Iterator[Array]:
    """The parts (N, 2) of a curve along which its orbit is otherwise stable."""
    stable = curve.bounding
    steps = stable[1:] & stable[:-1]
    ends = np.flatnonzero(np.diff(np.concatenate([[False], steps, [False]]).astype(np.int8)))
    for first, last in zip(ends[::2], ends[1::2], strict=True):
        yield curve.points[first : last + 1]


def corners(found: Curves) -> list[Corner]:
    """The points of codimension two at or beside a part that is drawn."""
    kept = []
    for curve in found:
        for corner in curve.corners:
            beside = curve.bounding[max(0, corner.after - 1) : corner.after + 2]
            if beside.any():
                kept.append(corner)
    return kept


def _draw_corners(ax: Axes, found: Curves, options: maps.Options) -> list[Artist]:
    """Mark points of codimension two in view, and name those whose name has room; the legend entry."""
    look: dict[str, Any] = {
        "linestyle": "", "marker": "o", "markersize": _MARKER * options.page.scale, "color": "white",
        "markeredgecolor": "black", "markeredgewidth": 0.9,
    }  # fmt: skip
    marked: list[tuple[str, Array]] = []
    for corner in corners(found):
        name = corner_name(corner.kind)
        at = axes.in_points(ax, np.array([[corner.x, corner.y]]), options.size)[0]
        if np.all((at >= 0.0) & (at <= options.size)) and not any(
            name == other and np.hypot(*(at - there)) < _SAME for other, there in marked
        ):
            marked.append((name, at))
            ax.plot(corner.x, corner.y, zorder=4.2, gid="corner", **look)
    if not marked:
        return []
    if options.names:
        lines = [_dense(axes.in_points(ax, line, options.size)) for curve in found for line in bounding(curve)]
        _name_all(ax, marked, np.concatenate(lines), options)
    return [Line2D([], [], label="codimension two", **look)]


def _name_all(ax: Axes, marked: list[tuple[str, Array]], lines: Array, options: maps.Options) -> None:
    """Write names beside marks, each where it covers no other and no mark, and the fewest points of the lines.

    All lengths and ``lines`` (N, 2) are in points from the corner of the plot. A name that finds no room is left out.
    """
    size, mark = _TYPE * options.page.scale, _MARKER * options.page.scale
    taken = [np.concatenate([at - 0.6 * mark, at + 0.6 * mark]) for _, at in marked]
    for name, at in marked:
        rows = name.split("\n")
        wide, tall = 0.5 * size * max(map(len, rows)), 1.15 * size * len(rows)
        best: tuple[int, int, int, Array] | None = None
        for across, up in _AROUND:
            middle = at + np.array([across * (0.8 * mark + wide / 2), up * (0.8 * mark + tall / 2)])
            half = np.array([wide / 2, tall / 2])
            box = np.concatenate([middle - half, middle + half])
            if np.any(box[:2] < 0.0) or np.any(box[2:] > options.size) or any(_overlap(box, each) for each in taken):
                continue
            covered = int(np.sum(np.all((lines > box[:2]) & (lines < box[2:]), axis=1)))
            if best is None or covered < best[0]:
                best = covered, across, up, box
        if best is None:
            continue
        _, across, up, box = best
        taken.append(box)
        place = ax.transData.inverted().transform(ax.transAxes.transform(at / options.size))
        ax.annotate(
            name, (float(place[0]), float(place[1])), xytext=(0.8 * mark * across, 0.8 * mark * up),
            textcoords="offset points", ha={1: "left", 0: "center", -1: "right"}[across],
            va={1: "bottom", 0: "center", -1: "top"}[up], fontsize=size, linespacing=0.95, zorder=4.3,
            path_effects=[withStroke(linewidth=2.0, foreground="white")], gid="corner name",
        )  # fmt: skip


_AROUND = ((1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1), (0, 1), (0, -1))
"""Where a name may stand beside its mark: to the right and left, above and below."""


def _overlap(one: Array, other: Array) -> bool:
    """Whether two boxes (left, low, right, high) meet."""
    return bool(np.all(one[:2] < other[2:]) and np.all(other[:2] < one[2:]))


def _dense(line: Array) -> Array:
    """The points (M, 2) of a line with others between them, about two points of the page apart at most."""
    steps = np.hypot(*np.diff(line, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.linspace(0.0, along[-1], 2 + int(along[-1] / 2.0))
    return np.column_stack([np.interp(at, along, line[:, i]) for i in range(2)])


def _is_in_view(ax: Axes, line: Array) -> bool:
    """Whether the box around a line meets the limits of the axes."""
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    (x0, y0), (x1, y1) = line.min(axis=0), line.max(axis=0)
    return bool(x1 >= left and x0 <= right and y1 >= low and y0 <= high)


def _nothing() -> Artist:
    return Line2D([], [], linestyle="", label="curves: none in this window")
