"""Lines over a map: where the impact-free motion would graze, where regimes meet, where exponents are equal, curves."""

from collections.abc import Callable

import numpy as np
from contourpy import contour_generator
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.contour import ContourSet
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query import machine
from atlas.query.grazing import grazing_lines
from atlas.query.tidy import outlined, smooth
from atlas.render import curves, layout, maps
from atlas.render.kinds import OverlayError
from atlas.render.maps import View
from workers.results import LARGEST

Array = NDArray[np.float64]

_CROWDED = 5.0
"""Distance in points below which two grazing lines are drawn solid: dashes side by side look like a bar code."""
_LEAST_LINE = 40.0
"""Length in points below which a piece of an isoline is left out."""
_SHADOW = "#3c4650"
"""The edge of an isoline, which is white to be told from a boundary, on pale cells."""


def draw(ax: Axes, view: View) -> list[Artist]:
    """Draw overlays over a map and return their legend entries; OverlayError for one that cannot be drawn."""
    entries: list[Artist] = []
    for name, lines in DRAW.items():
        if name in view.wanted.overlays:
            try:
                entries += lines(ax, view)
            except InputError as error:
                raise OverlayError(name, str(error)) from None
    return entries


def _grazing(ax: Axes, view: View) -> list[Artist]:
    x, y, size = view.plane.x, view.plane.y, view.page.map_size
    lines = grazing_lines(view.ds, x, y)
    symmetric = machine.twins_everywhere(view.ds, {x.name: x.values, y.name: y.values})
    label = r"grazing, $|Y| = b$" if symmetric else "impact-free motion\ngrazes a stop"
    dashes, halo = (0, (5, 2)), [withStroke(linewidth=2.8, foreground="white")]
    places = [maps.in_points(ax, line, size) for line in lines]
    cut = [(part, beside) for _, part, beside in layout.parts(lines, places, _CROWDED)]
    crowded, alone = ([part for part, beside in cut if beside is side] for side in (True, False))
    looks = ((lines, "white", 2.8, "solid"), (crowded, "black", 0.8, "solid"), (alone, "black", 1.3, dashes))
    for segments, color, width, look in looks:
        drawn = LineCollection(segments, colors=color, linewidths=width, linestyles=[look], zorder=3)
        ax.add_collection(drawn, autolim=False)
    label += "" if lines else ": not in this window"
    return [Line2D([], [], color="black", linewidth=1.3, linestyle=dashes, path_effects=halo, label=label)]


def _boundaries(ax: Axes, view: View) -> list[Artist]:
    regions, left_out = outlined(view.plane.regime, view.page.map_size)
    for code in np.unique(regions):
        maps.outline(ax, view.plane, regions == code, "#101418", 0.6)
    label = "regime boundary" + (",\nclouds of cells left out" if left_out else "")
    return [Line2D([], [], color="#101418", linewidth=0.9, label=label)]


def _isolines(ax: Axes, view: View) -> list[Artist]:
    plane, largest = view.plane, view.plane.known(LARGEST.name)
    if min(largest.shape) < 2:
        return []
    shown, levels = np.full(largest.shape, np.nan), set()
    # Each sign on its own: between them exponents jump, and lines there would show the jump and nothing else.
    for sign, width in ((-1.0, 1.5), (1.0, 2.5)):
        size = np.where(np.isfinite(largest) & (sign * largest > 0.0), np.abs(largest), np.nan)
        even = smooth(size, width)
        if np.isfinite(even).sum() >= 4:
            shown = np.where(np.isfinite(even), sign * even, shown)
            ticks = np.asarray(MaxNLocator(5).tick_values(0.0, float(np.nanpercentile(size, 98))))
            levels |= {sign * tick for tick in ticks[(ticks > np.nanmin(even)) & (ticks < np.nanmax(even))]}
    kept: dict[float, list[Array]] = {}
    lines = contour_generator(plane.x.values, plane.y.values, np.ma.masked_invalid(shown))
    for level in sorted(levels):
        for line in map(np.asarray, lines.lines(level)):
            _, along = layout.dense(maps.in_points(ax, line, view.page.map_size))
            if along[-1] >= _LEAST_LINE:
                kept.setdefault(level, []).append(line)
    if not kept:
        return []
    drawn = ContourSet(ax, [*kept], [*kept.values()], colors="white", linewidths=0.7, linestyles="solid", zorder=2.5)
    if view.wanted.names:
        named = drawn.clabel(fontsize=7.0 * view.page.scale, colors="black", inline=False, fmt=_level, zorder=3.5)
        for text in named:
            text.set_path_effects([withStroke(linewidth=1.6, foreground="white", alpha=0.85)])
    drawn.set_path_effects([withStroke(linewidth=1.5, foreground=_SHADOW)])
    shadow = [withStroke(linewidth=2.0, foreground=_SHADOW)]
    return [Line2D([], [], color="white", linewidth=1.0, path_effects=shadow, label=r"$\lambda_1$ constant")]


def _saddles(ax: Axes, view: View) -> list[Artist]:
    from atlas.render import saddles  # with it Numba

    return saddles.draw(ax, view)


def _level(value: float) -> str:
    return f"{value:g}".replace("-", "\N{MINUS SIGN}")


DRAW: dict[str, Callable[[Axes, View], list[Artist]]] = {
    "grazing": _grazing,
    "boundaries": _boundaries,
    "isolines": _isolines,
    "curves": curves.draw,
    "saddles": _saddles,
}
