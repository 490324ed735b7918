"""Exact curves over a map, with their points of codimension two and the ends of what was followed.

Drawn is where the orbit of a curve is otherwise stable: there the curve bounds a region that attractors live in. The
rest passes through regions without changing what is seen in them, and is left out.
"""

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import replace
from string import ascii_lowercase
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from atlas.curves import asking
from atlas.curves.table import Corner, Curve, Curves
from atlas.errors import InputError
from atlas.query.window import axis_names
from atlas.render import axes, crowding, maps, names
from atlas.render.events import LOOKS, corner_name, line_entry

Array = NDArray[np.float64]

CASING = {False: 1.5, True: 0.7}
"""What a white casing adds to the width of a curve over a map, by whether another one runs beside it."""
_WIDTHS = {False: 1.1, True: 0.75}
"""Width in points of a curve, likewise."""
_BESIDE = 6.0
"""Distance in points within which two curves crowd each other."""
_MARKER, _END, _TYPE = 4.0, 2.6, 7.5
"""Size in points of the mark of a point of codimension two, of an end, and of the name of such a point."""
_KEY_WIDTH = 26
"""Letters in a line of the key to such names, at most where there are several in it."""
_HARD_SPACE = "\N{NO-BREAK SPACE}"
_SAME = 1.0
"""Distance in points below which two marks of one name are one."""


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
    return draw_lines(ax, of(ds, "overlay 'curves'"), options, CASING)


def wanted(found: Curves, options: maps.Options) -> Curves:
    """The curves of the kinds that are drawn."""
    if options.curves is None:
        return found
    kept = tuple(curve for curve in found if curve.kind in options.curves)
    return replace(found, curves=kept)


def draw_lines(ax: Axes, found: Curves, options: maps.Options, casing: dict[bool, float] | None = None) -> list[Artist]:
    """Draw curves, each kind in its own colour and line style, and return the legend entries of those in view.

    Where curves crowd, lines and casings are thinner, for the map to be seen between them.
    """
    found = wanted(found, options)
    every = [(curve.kind, line) for curve in found for line in bounding(curve) if _is_in_view(ax, line)]
    if not every:
        return [Line2D([], [], linestyle="", label="curves: none in this window")]
    lines = [line for _, line in every]
    places = [axes.in_points(ax, line, options.size) for line in lines]
    drawn: dict[str, list[tuple[Array, bool]]] = {}
    for number, part, crowded in crowding.parts(lines, places, _BESIDE):
        drawn.setdefault(every[number][0], []).append((part, crowded))
    entries: list[Artist] = []
    for kind in [kind for kind in LOOKS if kind in drawn]:
        segments, widths = [part for part, _ in drawn[kind]], np.array([_WIDTHS[each] for _, each in drawn[kind]])
        if casing:
            wide = widths + [casing[crowded] for _, crowded in drawn[kind]]
            ax.add_collection(LineCollection(segments, colors="white", linewidths=wide, zorder=3.1), autolim=False)
        look = LOOKS[kind]
        front = LineCollection(segments, colors=look.color, linewidths=widths, linestyles=[look.dashes], zorder=3.2)
        front.set_gid(kind)
        ax.add_collection(front, autolim=False)
        entries.append(line_entry(kind, _WIDTHS[False]))
    if options.curves is None or "codimension_two" in options.curves:
        dense = np.concatenate([crowding.dense(place)[0] for place in places])
        entries += _draw_corners(ax, found, dense, options)
    return entries + _draw_ends(ax, found, options)


def bounding(curve: Curve) -> Iterator[Array]:
    """The parts (N, 2) of a curve along which its orbit is otherwise stable."""
    for first, last in _stable(curve):
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


def loose_ends(found: Curves) -> list[Array]:
    """Where a drawn part (2,) ends inside the plane at no point of codimension two: the search gave up, the orbit
    ceased, or it is unstable beyond.
    """
    ends = []
    for curve in found:
        last_point = len(curve.points) - 1
        for part in _stable(curve):
            for k in part:
                why = {0: curve.ends[0], last_point: curve.ends[1]}.get(k)
                marked = any(abs(corner.after - k) <= 2 for corner in curve.corners)
                if not marked and why not in ("edge", "closed"):
                    ends.append(curve.points[k])
    return ends


def _stable(curve: Curve) -> Iterator[tuple[int, int]]:
    """The first and the last point of each part of a curve along which its orbit is otherwise stable."""
    steps = curve.bounding[1:] & curve.bounding[:-1]
    ends = np.flatnonzero(np.diff(np.concatenate([[False], steps, [False]]).astype(np.int8)))
    yield from zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True)


def _draw_corners(ax: Axes, found: Curves, lines: Array, options: maps.Options) -> list[Artist]:
    """Mark points of codimension two in view, and name those whose name has room; the legend entries.

    Resonances have their names, others a letter that the legend explains.
    """
    kinds = {corner_name(corner.kind): corner for corner in corners(found)}
    marked = _in_view(ax, [(corner_name(corner.kind), corner.x, corner.y) for corner in corners(found)], options)
    if not marked:
        return []
    look = _mark(_MARKER * options.page.scale, "white", 0.9)
    for _, _, (x, y) in marked:
        ax.plot(x, y, zorder=4.2, gid="corner", **look)
    entries: list[Artist] = [Line2D([], [], label="codimension two", **look)]
    if options.names:
        present = [name for name in kinds if ":" not in name and any(name == each for each, _, _ in marked)]
        letters = dict(zip(sorted(present), ascii_lowercase, strict=False))
        short = [(letters.get(name, name), at) for name, at, _ in marked]
        scale = options.page.scale
        names.beside_marks(ax, short, lines, _MARKER * scale, _TYPE * scale, options.size)
        key = "; ".join(f"{letter}: {name}".replace(" ", _HARD_SPACE) for name, letter in letters.items())
        lines_of_key = textwrap.fill(key, _KEY_WIDTH, break_long_words=False, break_on_hyphens=False)
        entries += [Line2D([], [], linestyle="", label=lines_of_key)] if key else []
    return entries


def _draw_ends(ax: Axes, found: Curves, options: maps.Options) -> list[Artist]:
    """Mark ends in view that no point of codimension two explains; the legend entry."""
    look = _mark(_END * options.page.scale, "black", 0.4) | {"markeredgecolor": "white"}
    marked = _in_view(ax, [("", *end) for end in loose_ends(found)], options)
    for _, _, (x, y) in marked:
        ax.plot(x, y, zorder=4.1, gid="end", **look)
    return [Line2D([], [], label="end of a curve", **look)] if marked else []


def _mark(size: float, color: str, edge: float) -> dict[str, Any]:
    return {
        "linestyle": "", "marker": "o", "markersize": size, "color": color, "markeredgecolor": "black",
        "markeredgewidth": edge,
    }  # fmt: skip


def _in_view(
    ax: Axes, places: Sequence[tuple[str, float, float]], options: maps.Options
) -> list[tuple[str, Array, tuple[float, float]]]:
    """The places in view, those of one name that lie on each other once: name, place in points, in data."""
    found: list[tuple[str, Array, tuple[float, float]]] = []
    for name, x, y in places:
        at = axes.in_points(ax, np.array([[x, y]]), options.size)[0]
        known = any(name == other and np.hypot(*(at - there)) < _SAME for other, there, _ in found)
        if np.all((at >= 0.0) & (at <= options.size)) and not known:
            found.append((name, at, (x, y)))
    return found


def _is_in_view(ax: Axes, line: Array) -> bool:
    """Whether the box around a line meets the limits of the axes."""
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    (x0, y0), (x1, y1) = line.min(axis=0), line.max(axis=0)
    return bool(x1 >= left and x0 <= right and y1 >= low and y0 <= high)
