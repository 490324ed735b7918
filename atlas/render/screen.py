"""A map as pixels of a screen: the plot area alone, and beside it what explains its colours."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from atlas.query.window import axis_names, is_log
from atlas.render.kinds import Kind
from atlas.render.maps import draw_map
from atlas.render.options import Wanted
from atlas.render.page import page
from atlas.render.style import house

DPI = 110.0
SCALE = 0.85
"""The size of the type relative to that of the standard page."""
GAP = 16
"""Pixels between the plot area and what is beside it."""
BAR_ASPECT = 28.0
"""Height of a colour bar over its width, as all pictures have it."""
drawing = threading.Lock()
"""Held while something is drawn in one of several threads: Matplotlib's settings belong to the whole process."""
LEAST_TYPE = 2.0
"""Points of the type of a legend: nobody reads a smaller one, and on pixels it takes no less room."""
MOST_LEGEND = 0.9
"""Share of the height that a legend leaves no colour bar of."""


@dataclass(frozen=True)
class Screen:
    """Pixels of a map, (rows, columns, 4) in bytes from the top: its cells, and its colour bar and legend.

    ``ends`` are the ends of the one scale that it has; None without one, or with several.
    """

    cells: NDArray[np.uint8]
    key: NDArray[np.uint8]
    ends: tuple[float, float] | None


def screen(
    ds: xr.Dataset,
    kind: str | Kind,
    size: tuple[int, int],
    key_width: int,
    *,
    overlays: Sequence[str] = (),
    variable: str | None = None,
    log: bool = False,
    vmin: float | None = None,
    vmax: float | None = None,
) -> Screen:
    """Draw a map by the code that draws files, its cells on ``size`` (width, height) pixels, edge to edge.

    Logarithmic axes are evenly spaced in the logarithm, however short. Other arguments and errors as in ``figure``;
    ``kind`` may also be one that is in no table, such as ``change_of`` makes.
    """
    from atlas.render import figure

    width, height = size
    whole, settings = width + key_width, house(SCALE)
    with drawing, mpl.rc_context(settings):  # type: ignore[arg-type]
        drawn = Figure(figsize=(whole / DPI, height / DPI), dpi=DPI, facecolor="white")
        canvas = FigureCanvasAgg(drawn)
        area = (0.0, 0.0, width / whole, 1.0)
        ax = drawn.add_axes(area)
        look: Any = {"title": False, "vmin": vmin, "vmax": vmax}
        if isinstance(kind, Kind):
            draw_map(kind, ds, Wanted(page(ax=ax, **look), overlays=tuple(overlays), pixels=size))
        else:
            figure(ds, kind, overlay=overlays, pixels=size, variable=variable, log=log, ax=ax, **look)
        _bare(ax, ds)
        ax.set_position(area)
        bars = [each for each in drawn.axes if each is not ax]
        low = _move_legend(drawn, ax, (width + GAP) / whole)
        tall = 0.92 - low
        for bar in bars:  # of the proportions that a bar with pointed ends insists on
            bar.set_position(((width + GAP) / whole, low + 0.04, tall * height / BAR_ASPECT / whole, tall))
        room = 0.96 * (1.0 - low) * height  # above the legend
        for label in [bar.yaxis.label for bar in bars]:
            share = room / label.get_window_extent().height
            label.set_fontsize(float(label.get_fontsize()) * min(1.0, share))
        canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())
        low_end, high_end = bars[0].get_ylim() if len(bars) == 1 else (0.0, 0.0)
    ends = (float(low_end), float(high_end)) if len(bars) == 1 else None
    return Screen(pixels[:, :width].copy(), pixels[:, width:].copy(), ends)


def _move_legend(drawn: Figure, ax: Axes, left: float) -> float:
    """Put a plot's legend into the lower left of what is beside it, and return where it ends above."""
    legend = ax.get_legend()
    if legend is None:
        return 0.0
    look: dict[str, Any] = {
        "handles": legend.legend_handles, "labels": [text.get_text() for text in legend.get_texts()],
        "title": legend.get_title().get_text() or None, "alignment": "left",
        "loc": "lower left", "bbox_to_anchor": (left, 0.0), "borderaxespad": 0.3,
    }  # fmt: skip
    size = mpl.rcParams["legend.fontsize"]
    while True:
        made = drawn.legend(fontsize=size, **look)
        extent = made.get_window_extent()
        share = float(extent.height / drawn.bbox.height)
        excess = max(share, float(extent.width / (drawn.bbox.width * (1.0 - left))))
        if excess <= 1.0 or size <= LEAST_TYPE:
            break
        made.remove()
        size = max(LEAST_TYPE, 0.97 * size / excess)  # no entry may be lost above, no word beside
    legend.remove()
    return min(share, MOST_LEGEND)


def _bare(ax: Axes, ds: xr.Dataset) -> None:
    """Take away all of a plot but its area, and give it the scales of the screen."""
    ax.set(title="", xlabel="", ylabel="")
    x, y = axis_names(ds)
    if not ax.get_images():  # an image fits even axes alone, on which a short logarithmic one does not differ
        for name, change in ((x, ax.set_xscale), (y, ax.set_yscale)):
            change("log" if is_log(ds, name) else "linear")
    for each in (*ax.spines.values(), ax.xaxis, ax.yaxis):
        each.set_visible(False)
