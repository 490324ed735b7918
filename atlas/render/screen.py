"""A map as pixels of a screen: the plot area alone, and beside it the colour bar and legend."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Unpack

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from atlas.query.plane import Plane
from atlas.query.window import axis_names, is_log
from atlas.render.drawing import check_units
from atlas.render.kinds import CURVES
from atlas.render.layers import Colors, Layers
from atlas.render.maps import draw_layers, read
from atlas.render.numbered import PixelScale, numbered, on_white
from atlas.render.options import MapLook
from atlas.render.painters import FIGURES, PAINTERS
from atlas.render.style import drawing, house
from atlas.render.wanted import Wanted, check_overlays, chosen_kind

DPI = 110.0
SCALE = 0.85
"""The size of the type relative to that of the standard page."""
GAP = 16
"""Pixels between the plot area and the key beside it."""
BAR_ASPECT = 28.0
"""Height of a colour bar over its width, as all pictures have it."""
LEAST_TYPE = 2.0
"""Least points of the type of a legend: smaller type is unreadable and saves no pixels."""
MOST_LEGEND = 0.9
"""Share of the height that a legend leaves free of colour bars."""


@dataclass(frozen=True)
class Screen:
    """Pixels of a map, (rows, columns, 4) in bytes from the top: its cells, and its colour bar and legend.

    ends      the ends of its only scale; None without one, or with several
    dark_key  bar and legend for a dark page: the same colours, with white type on black
    scale     of pixels with numbers; None for pixels with colours
    lines     the kinds of curves drawn, of CURVES
    """

    cells: NDArray[np.uint8]
    key: NDArray[np.uint8]
    ends: tuple[float, float] | None
    dark_key: NDArray[np.uint8]
    scale: PixelScale | None = None
    lines: tuple[str, ...] = ()


def screen(
    ds: xr.Dataset,
    kind: str,
    size: tuple[int, int],
    key_width: int,
    *,
    numbers: bool = False,
    **options: Unpack[MapLook],
) -> Screen:
    """A map on ``size`` (width, height) pixels, its cells from edge to edge, under lines as in files.

    Logarithmic axes are evenly spaced in the logarithm, however short. With ``numbers``, pixels coloured by a number
    hold that number, see ``numbered``. Other options and errors as in ``figure``.
    """
    width, height = size
    whole, settings = width + key_width, house(SCALE)
    with drawing(settings):
        drawn = Figure(figsize=(whole / DPI, height / DPI), dpi=DPI, facecolor="white")
        canvas = FigureCanvasAgg(drawn)
        area = (0.0, 0.0, width / whole, 1.0)
        ax = drawn.add_axes(area)
        options |= {"ax": ax, "title": False}
        wanted = Wanted.of(kind, pixels=size, **options)
        fitting = chosen_kind(ds, wanted)
        check_overlays(ds, wanted.overlays)
        check_units(ds)
        layers = None
        if fitting.name in FIGURES:
            FIGURES[fitting.name](ds, wanted)
        else:
            view = read(fitting, ds, wanted)
            layers = PAINTERS[fitting.name](view)
            draw_layers(view, layers, cells=False)
            drawn.patch.set_visible(False)
            beside = Rectangle((area[2], 0.0), 1.0, 1.0, transform=drawn.transFigure, facecolor="white", zorder=-1.0)
            drawn.add_artist(beside)
        _bare(ax, ds)
        ax.set_position(area)
        bars = [axes for axes in drawn.axes if axes is not ax]
        low = _move_legend(drawn, ax, (width + GAP) / whole)
        tall = 0.92 - low
        room = 0.96 * (1.0 - low) * height  # above the legend
        for bar in bars:  # the fixed proportions of a bar with pointed ends
            bar.set_position(((width + GAP) / whole, low + 0.04, tall * height / BAR_ASPECT / whole, tall))
            label = bar.yaxis.label
            label.set_fontsize(float(label.get_fontsize()) * min(1.0, room / label.get_window_extent().height))
        canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())
        gids = {"codimension_two" if artist.get_gid() == "corner" else artist.get_gid() for artist in ax.get_children()}
        cells, key, scale = pixels[:, :width].copy(), pixels[:, width:].copy(), None
        dark = _dark(pixels, [*bars, *ax.child_axes], drawn.legends)[:, width:]
        ends = [(float(first), float(last)) for first, last in (bar.get_ylim() for bar in bars)]
        if layers is not None:
            cells, scale = _under(cells, layers, _cell_of_pixel(ax, view.plane, size), numbers)
    one = ends[0] if len(ends) == 1 else None
    return Screen(cells, key, one, dark, scale, tuple(kind for kind in CURVES if kind in gids))


def _cell_of_pixel(ax: Axes, plane: Plane, size: tuple[int, int]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The rows and columns of the cells in the middles of pixels, from the top and from the left."""
    places = []
    for along, axis in enumerate((plane.x, plane.y)):
        middles = np.full((size[along], 2), 0.5)
        middles[:, along] = (np.arange(size[along]) + 0.5) / size[along]
        at = ax.transData.inverted().transform(ax.transAxes.transform(middles))[:, along]
        places.append(np.clip(np.searchsorted(axis.edges, at, side="right") - 1, 0, axis.values.size - 1))
    return places[1][::-1], places[0]


def _under(
    lines: Colors, layers: Layers, at: tuple[NDArray[np.intp], NDArray[np.intp]], numbers: bool
) -> tuple[Colors, PixelScale | None]:
    """The cells of a map under its overlays, and the scale of numbers if there are none."""
    cells, place, opacity = on_white(layers), np.ix_(*at), lines[..., 3:] / 255.0
    mixed = np.rint(opacity * lines + (1.0 - opacity) * cells[place]).astype(np.uint8)
    mixed[..., 3] = 255
    coded, scale = numbered(layers) if numbers else (cells, None)
    return np.where(opacity > 0.0, mixed, coded[place]), scale


def _dark(pixels: Colors, bars: Sequence[Any], legends: Sequence[Legend]) -> Colors:
    """A key for a dark page: inverted except for the colours."""
    inverted = np.dstack([255 - pixels[..., :3], pixels[..., 3]])
    boxes = [bar.get_position(original=True).transformed(bar.figure.transFigure) for bar in bars]
    handles = [handle for legend in legends for handle in legend.legend_handles if handle is not None]
    boxes += [handle.get_window_extent().padded(2.0) for handle in handles]
    for box in boxes:
        left, right = math.floor(box.x0), math.ceil(box.x1)
        top, bottom = (pixels.shape[0] - end for end in (math.ceil(box.y1), math.floor(box.y0)))
        part = slice(max(0, top), max(0, bottom)), slice(max(0, left), max(0, right))
        inverted[part] = pixels[part]
    return inverted


def _move_legend(drawn: Figure, ax: Axes, left: float) -> float:
    """Put a plot's legend into the lower left of the key, and return the height of its top."""
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
        trial = drawn.legend(fontsize=size, **look)
        extent = trial.get_window_extent()
        share = float(extent.height / drawn.bbox.height)
        excess = max(share, float(extent.width / (drawn.bbox.width * (1.0 - left))))
        if excess <= 1.0 or size <= LEAST_TYPE:
            break
        trial.remove()
        size = max(LEAST_TYPE, 0.97 * size / excess)  # keeps all entries and words inside
    trial.remove()
    return min(share, MOST_LEGEND)


def _bare(ax: Axes, ds: xr.Dataset) -> None:
    """Remove everything from a plot but its area, and give it the scales of the screen."""
    ax.set(title="", xlabel="", ylabel="")
    for name, change in zip(axis_names(ds), (ax.set_xscale, ax.set_yscale), strict=True):
        change("log" if is_log(ds, name) else "linear")
    for part in (*ax.spines.values(), ax.xaxis, ax.yaxis):
        part.set_visible(False)
