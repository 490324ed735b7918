"""Exact curves over a map, their points of codimension two marked and named.

Drawn is where the orbit of a curve is otherwise stable: there the curve bounds a region that attractors live in. The
rest passes through regions without changing what is seen in them, and is left out.
"""

from collections.abc import Iterator

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from atlas.curves import stored
from atlas.curves.table import Corner, Curve, Curves
from atlas.errors import InputError
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
        return stored.stored_curves(ds)
    except InputError as error:
        raise InputError(f"{who}: {error}") from None


def draw(ax: Axes, ds: xr.Dataset, plane: maps.Plane, options: maps.Options) -> list[Artist]:
    """Draw the curves that the atlas keeps over a map, and return their legend entries."""
    return draw_lines(ax, of(ds, "overlay 'curves'"), options, HALO)


def draw_lines(ax: Axes, found: Curves, options: maps.Options, halo: float) -> list[Artist]:
    """Draw curves, each kind in its own colour and line style, and return the legend entries of those in view."""
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
    return [*entries, *_draw_corners(ax, found, options)] if entries else [_nothing()]


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
    width, height = options.size
    scale = options.page.scale
    taken: list[tuple[float, float, float, float]] = []
    marked: list[tuple[str, float, float]] = []
    for corner in corners(found):
        name = corner_name(corner.kind)
        across, up = axes.in_points(ax, np.array([[corner.x, corner.y]]), options.size)[0]
        inside = 0.0 <= across <= width and 0.0 <= up <= height
        if not inside or any(name == n and np.hypot(x - across, y - up) < _SAME for n, x, y in marked):
            continue
        marked.append((name, float(across), float(up)))
        ax.plot(
            corner.x, corner.y, marker="o", markersize=_MARKER * scale, color="white", markeredgecolor="black",
            markeredgewidth=0.9, zorder=4.2, gid="corner",
        )  # fmt: skip
    for _, across, up in marked:  # every mark keeps its place from names
        reach = 0.6 * _MARKER * scale
        taken.append((across - reach, up - reach, across + reach, up + reach))
    for name, across, up in marked:
        _name(ax, name, (across, up), taken, options)
    if not marked:
        return []
    return [
        Line2D(
            [], [], linestyle="", marker="o", markersize=_MARKER * scale, color="white", markeredgecolor="black",
            markeredgewidth=0.9, label="codimension two",
        )
    ]  # fmt: skip


def _name(
    ax: Axes,
    name: str,
    at: tuple[float, float],
    taken: list[tuple[float, float, float, float]],
    options: maps.Options,
) -> None:
    """Write a name beside a mark, right, left, above or below, where it covers none of the boxes taken; or nowhere."""
    size = _TYPE * options.page.scale
    wide, tall, gap = 0.52 * size * len(name), 1.1 * size, 0.75 * _MARKER * options.page.scale
    places = {
        ("left", "center"): (gap, 0.0, gap, -tall / 2),
        ("right", "center"): (-gap, 0.0, -gap - wide, -tall / 2),
        ("center", "bottom"): (0.0, gap, -wide / 2, gap),
        ("center", "top"): (0.0, -gap, -wide / 2, -gap - tall),
    }
    for (ha, va), (dx, dy, left, low) in places.items():
        box = (at[0] + left, at[1] + low, at[0] + left + wide, at[1] + low + tall)
        if box[0] < 0.0 or box[1] < 0.0 or box[2] > options.size[0] or box[3] > options.size[1]:
            continue
        if all(box[2] < b[0] or b[2] < box[0] or box[3] < b[1] or b[3] < box[1] for b in taken):
            taken.append(box)
            x, y = ax.transData.inverted().transform(
                ax.transAxes.transform((at[0] / options.size[0], at[1] / options.size[1]))
            )
            ax.annotate(
                name, (x, y), xytext=(dx, dy), textcoords="offset points", ha=ha, va=va, fontsize=size, zorder=4.3,
                path_effects=[withStroke(linewidth=2.0, foreground="white")], gid="corner name",
            )  # fmt: skip
            return


def _is_in_view(ax: Axes, line: Array) -> bool:
    """Whether the box around a line meets the limits of the axes."""
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    (x0, y0), (x1, y1) = line.min(axis=0), line.max(axis=0)
    return bool(x1 >= left and x0 <= right and y1 >= low and y0 <= high)


def _nothing() -> Artist:
    return Line2D([], [], linestyle="", label="curves: none in this window")
