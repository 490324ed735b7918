"""Drawing the cells of a map into a plot: colours from edge to edge, hatches, borders, and marks on tiny cells."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import axis as mpl_axis
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from numpy.typing import NDArray

from atlas.query.plane import Cells, Plane, PlaneAxis
from atlas.render import looks, style, text
from atlas.render.layers import MARKED, MapLayers, paint
from atlas.render.layout import FigureLayout
from atlas.render.outlines import borders, row_rectangles, small_regions
from atlas.store.schema import REGIME_COLORS
from workers.results import PENDING

VISIBLE = 2.0
"""Size in points below which a single cell is invisible."""
MAX_MARKS = 300
"""Maximum number of cells of a regime that are marked because they are too small to be seen.

More cells are visible as a cloud anyway.
"""


def draw_cells(ax: Axes, plane: Plane, layers: MapLayers, layout: FigureLayout) -> set[int]:
    """Draw the cells of a map from edge to edge, as pixels also in vector files.

    Return the codes of the regimes whose tiny cells were enlarged by marks. Cells of equal size are drawn as an image,
    others as quadrilaterals. Colours are never blended between cells. Cells without a result that would be invisible
    get a mark of visible size.
    """
    x, y = plane.x, plane.y
    # Pending cells are transparent and show this hatch.
    ax.patch.set(facecolor="white", edgecolor=looks.TEXTURE, hatch=looks.HATCH[PENDING], linewidth=0.0)
    if x.uniform and y.uniform:
        extent = (x.edges[0], x.edges[-1], y.edges[0], y.edges[-1])
        ax.imshow(paint(layers), origin="lower", extent=extent, aspect="auto", interpolation="nearest")
    else:
        ax.pcolormesh(x.edges, y.edges, paint(layers), rasterized=True)
    scale_axes(ax, x=x, y=y)
    size = layout.map_size
    return {code for code in MARKED if _mark_small(ax, plane, layers.as_regime(code), REGIME_COLORS[code], size)}


def _mark_small(ax: Axes, plane: Plane, cells: Cells, color: str, size: tuple[float, float]) -> bool:
    """Mark the cells of a regime that are too small to be seen, and return True if there are marks.

    There are no marks if all cells are large enough, or if too many would be marked. ``size`` is the size of the plot
    in points.
    """
    step = np.array(size[::-1]) / plane.regime.shape
    if step.max() >= VISIBLE:
        return False
    small = small_regions(cells, plane.x.edges, plane.y.edges, step, VISIBLE)
    if not 0 < len(small) <= MAX_MARKS:
        return False
    ax.plot(*small.T, zorder=2.2, **style.mark(looks.MarkLook("", "s", 0.9 * VISIBLE, color, "black", 0.2)))
    return True


def hatch(ax: Axes, plane: Plane, inside: Cells, pattern: str, color: str) -> None:
    """Cover a set of cells with a hatch through which their colours show."""
    rectangles = row_rectangles(inside, plane.x.edges, plane.y.edges)
    if len(rectangles):  # all rectangles are one path, so the hatch has no seams
        codes = np.tile([Path.MOVETO, Path.LINETO, Path.LINETO, Path.LINETO, Path.CLOSEPOLY], len(rectangles))
        path = Path(rectangles.reshape(-1, 2), codes)
        ax.add_patch(PathPatch(path, fill=False, hatch=pattern, edgecolor=color, linewidth=0, rasterized=True))


def outline(ax: Axes, plane: Plane, regions: NDArray[Any], color: str, width: float) -> None:
    """Draw the borders between cells of different ``regions`` along the cells' edges, without the plane's frame."""
    ends = list(borders(regions, plane.x.edges, plane.y.edges))
    lines = LineCollection(ends, colors=color, linewidths=width, capstyle="projecting", rasterized=True)
    ax.add_collection(lines, autolim=False)


def in_points(ax: Axes, at: NDArray[np.float64], size: tuple[float, float]) -> NDArray[np.float64]:
    """Return data coordinates (N, 2) in points from the lower left corner of the plot.

    ``size`` is the expected size of the plot, so the result is approximate until the figure is laid out.
    """
    return np.asarray(ax.transAxes.inverted().transform(ax.transData.transform(at)) * np.array(size))


def scale_axes(ax: Axes, labels: bool = True, **axes: PlaneAxis) -> None:
    """Set scale, limits and ticks of the axes ``x`` and ``y`` of a plot, and with ``labels`` their labels."""
    for name, axis in axes.items():
        if axis.log:
            ax.set(**{f"{name}scale": "log"})
            # Over few decades the default labels only one or two powers of ten; 1, 2, 5 in plain numbers read better.
            if math.log10(axis.values[-1] / axis.values[0]) <= 3.0:
                plain_ticks(getattr(ax, f"{name}axis"), (1.0, 2.0, 5.0))
        ax.set(**{f"{name}lim": (axis.edges[0], axis.edges[-1])})
        if labels:
            ax.set(**{f"{name}label": text.axis_label(axis.name, axis.meaning)})


def plain_ticks(axis: mpl_axis.Axis, steps: Sequence[float]) -> None:
    """Label a logarithmic axis at the multiples ``steps`` of powers of ten, in plain numbers: 0.02, 5, 2000, 20 000."""

    def plain(value: float, _: int) -> str:
        return f"{value:,g}".replace(",", "\N{NARROW NO-BREAK SPACE}") if value >= 1e4 else f"{value:g}"

    axis.set_major_locator(LogLocator(subs=steps))
    axis.set_major_formatter(FuncFormatter(plain))
    axis.set_minor_locator(NullLocator())
