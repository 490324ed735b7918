"""Drawing a map as a figure: reading the cells, drawing its layers, overlays, colorbar, legend and labels."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from atlas.query.plane import Plane
from atlas.query.resample import read_view as in_view
from atlas.render import overlays, raster, scalar_maps, style, text
from atlas.render.kinds import PictureKind
from atlas.render.label_placement import places
from atlas.render.layers import Class, MapLayers, MapView
from atlas.render.layout import FigureLayout
from atlas.render.request import PictureRequest
from workers.results import ATTRACTOR, PENDING

LABEL_SIZE = 7.5
"""Type size of labels on a map, in points."""


def draw_layers(view: MapView, layers: MapLayers) -> Figure:
    """Return the figure of a map with its overlays; ``layers`` are the styles, numbers and hatches of its cells."""
    request, page, layers = view.request, view.page, with_legend_notes(layers, view.ds)
    with page.context():
        drawn, (ax,) = page.panels(page.map_height, 1, text.title_line(view.ds))
        entries = [*lay(ax, view.plane, layers, page), *overlays.draw(ax, view)]
        if layers.bar is not None:
            scalar_maps.draw_bar(drawn, [ax], layers.bar, page)
        page.legend(drawn, entries, side_title=layers.side_legend_title)
        if layers.names and request.names:
            page.finalize(drawn)
            name_regions(ax, view.plane, layers.names, LABEL_SIZE * page.scale)
    return drawn


def read(kind: PictureKind, ds: xr.Dataset, request: PictureRequest) -> MapView:
    """Read the variables and regimes that a map and its overlays need, at most at the resolution of the pixels.

    Raise InputError if the atlas lacks one of the variables. No other function of maps reads an atlas.
    """
    names = [*kind.variables] if request.variable is None else [request.variable]
    kind.require(ds, names)
    plane = Plane.from_dataset(in_view(ds, names, pixels=request.pixels or request.page.map_pixels), names)
    return MapView(kind, ds, plane, request)


def lay(ax: Axes, plane: Plane, layers: MapLayers, layout: FigureLayout) -> list[Artist]:
    """Draw the layers of a map into the plot ``ax``, and return the artists for its legend."""
    enlarged = raster.draw_cells(ax, plane, layers, layout)
    for texture in layers.textures:
        raster.hatch(ax, plane, texture.cells, texture.hatch, texture.hatch_color)
        if texture.outlined is not None:
            raster.outline(ax, plane, texture.outlined, "#1a2433", 0.3)
    for at, look in layers.points:
        ax.plot(*at.T, zorder=4, scalex=False, scaley=False, **style.mark(*look))
    entries: list[Artist] = [
        (
            replace(entry, label=f"{entry.label},\nsingle cells enlarged") if entry.regime in enlarged else entry
        ).to_artist()
        for entry in layers.entries
    ]
    if layers.point_entry is not None:
        label, look = layers.point_entry
        entries.append(Line2D([], [], label=label, **style.mark(*look)))
    return entries


def with_legend_notes(layers: MapLayers, ds: xr.Dataset) -> MapLayers:
    """Return the layers of a map with a legend that names regimes in the words of the atlas's system.

    If the atlas shows, say, the third attractor of each cell, the legend says of cells without a result that they may
    have fewer attractors.
    """
    labels = {meaning.code: meaning.text for meaning in text.regime(ds).codes}
    if ds.attrs.get(ATTRACTOR, 0):
        labels[PENDING] = f"not more than {ds.attrs[ATTRACTOR]}"
    legend = [entry if entry.regime is None else replace(entry, label=labels[entry.regime]) for entry in layers.legend]
    return replace(layers, legend=legend)


def name_regions(ax: Axes, plane: Plane, named: Sequence[Class], type_size: float) -> None:
    """Write the names of classes of cells into their largest regions of a map, as ``places`` finds positions for them.

    The plot must have its final size. ``type_size`` is in points.
    """
    (x, columns), (y, rows) = plane.x.even(), plane.y.even()
    even_index = np.ix_(rows, columns)
    extent, dots = ax.get_window_extent(), ax.figure.dpi / 72.0
    step = np.array([extent.height / rows.size, extent.width / columns.size]) / dots  # in points
    look: Any = {"fontsize": type_size, "ha": "center", "va": "center_baseline", "zorder": 4}
    for number, (row, column), angle in places(
        [(cells[even_index], name) for cells, name, _ in named], step, type_size
    ):
        _, name, color = named[number]
        turned: Any = {"rotation": angle, "rotation_mode": "anchor"}  # about its centre
        ax.text(x.values[column], y.values[row], name, color=style.ink_on(color), **turned, **look)
