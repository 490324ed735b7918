"""Drawing a picture of one atlas as a figure: a map with overlays, colorbar, legend and labels, or a sweep."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from atlas.query.plane import Plane
from atlas.render import colorbar, raster, style, sweep, text
from atlas.render.kinds import PictureKind
from atlas.render.label_placement import crowded_parts, place_names
from atlas.render.layers import MapLayers, MapView, Overlay, Spot
from atlas.render.layout import FigureLayout
from atlas.render.looks import Entry, MarkLook
from atlas.render.overlays import OVERLAYS, overlay_of
from atlas.render.painters import layers_of
from atlas.render.request import PictureRequest

LABEL_SIZE = 7.5
"""Type size of labels on a map, in points."""
_THIN = 0.68
"""Relative width of a line and of its edge where another line runs beside it."""
_CROWDING_DISTANCE = 6.0
"""Maximum distance in points at which two lines crowd each other."""
_END = MarkLook("end of a curve", "o", 2.6, "black", "white", 0.4)
_FEW, _SMALLEST = 12, 0.6
"""Number of marks from which on they are drawn smaller, and their minimum relative size."""
_MERGE_DISTANCE = 1.0
"""Distance in points below which two marks of the same kind are merged."""

FIGURES: Mapping[str, Callable[[xr.Dataset, PictureRequest], Figure]] = {
    "coexistence": sweep.figure_of_attractors, "sweep": sweep.figure,
    "spectrum": sweep.figure_of_all, "hysteresis": sweep.figure_of_two,
}  # fmt: skip
"""For each kind of picture that is no map, the function that returns the figure."""


def draw(kind: PictureKind, ds: xr.Dataset, request: PictureRequest) -> Figure:
    """Return the figure of a kind of picture, for a map with its overlays.

    Raise InputError if the atlas lacks the kind's variables.
    """
    if kind.name in FIGURES:
        return FIGURES[kind.name](ds, request)
    view = MapView.read(kind, ds, request)
    page, layers = view.page, layers_of(view)
    with page.context():
        drawn, (ax,) = page.panels(page.map_height, 1, text.title_line(view.ds))
        entries = lay(ax, view.plane, layers, page)
        for name in OVERLAYS:
            if name in request.overlays:
                entries += lay_over(ax, view.plane, overlay_of(view, name, page.map_size), page)
        if layers.bar is not None:
            colorbar.draw_bar(drawn, [ax], layers.bar)
        page.legend(drawn, entries, side_title=layers.side_legend_title)
        if layers.names and request.names:
            page.finalize(drawn)
            name_regions(ax, view.plane, layers, LABEL_SIZE * page.scale)
    return drawn


def lay(ax: Axes, plane: Plane, layers: MapLayers, layout: FigureLayout) -> list[Entry]:
    """Draw the layers of a map into the plot ``ax``, and return the entries of its legend."""
    enlarged = raster.draw_cells(ax, plane, layers, layout)
    for texture in layers.textures:
        raster.hatch(ax, plane, texture.cells, texture.hatch, texture.hatch_color)
        if texture.outlined is not None:
            raster.outline(ax, plane, texture.outlined, "#1a2433", 0.3)
    for at, look in layers.points:
        ax.plot(*at.T, zorder=4, scalex=False, scaley=False, **style.mark(look))
    entries: list[Entry] = [
        replace(entry, label=f"{entry.label},\nsingle cells enlarged") if entry.regime in enlarged else entry
        for entry in layers.entries
    ]
    return entries if layers.point_entry is None else [*entries, layers.point_entry]


def lay_over(ax: Axes, plane: Plane, overlay: Overlay, page: FigureLayout) -> list[Entry]:
    """Draw an overlay over a map, and return the entries of what is visible of it for the legend.

    Where lines run side by side, they and their edges are thinner, to show the map between them.
    """
    entries: list[Entry] = []
    if overlay.regions is not None:
        for look in overlay.looks.values():
            raster.outline(ax, plane, overlay.regions, look.color, look.width)
    seen = [one for one in overlay.lines if ax.viewLim.overlaps(Bbox([one.points.min(0), one.points.max(0)]))]
    lines = [one.points for one in seen]
    places = [raster.in_points(ax, points, page.map_size) for points in lines]
    parts = list(crowded_parts(lines, places, _CROWDING_DISTANCE))
    for kind, look in overlay.looks.items():
        of_kind = [(part, crowded) for k, part, crowded in parts if seen[k].kind == kind]
        if of_kind:
            segments, thin = [part for part, _ in of_kind], np.array([crowded for _, crowded in of_kind])
            widths, edges = (width * np.where(thin, _THIN, 1.0) for width in (look.width, look.width + style.EDGE))
            ax.add_collection(LineCollection(segments, colors=look.edge, linewidths=edges, zorder=3.1), autolim=False)
            dashes = [style.dashes_of(() if crowded and look.joins else look.dashes) for crowded in thin]
            drawn = LineCollection(segments, colors=look.color, linewidths=widths, linestyles=dashes, zorder=3.2)
            drawn.set_gid(kind)
            ax.add_collection(drawn, autolim=False)
        if of_kind or not overlay.lines:
            entries.append(look)
    visible = [spot for spot in overlay.corners if ax.viewLim.contains(*spot[1:])]
    size = page.scale * float(np.clip(np.sqrt(_FEW / max(len(visible), 1)), _SMALLEST, 1.0))
    for kind, usual in overlay.marks.items():
        mark, spots = usual._replace(size=usual.size * size), [spot for spot in visible if spot[0] == kind]
        entries += _draw_marks(ax, spots, page.map_size, kind, 4.2, mark)
    end = _END._replace(size=_END.size * page.scale)
    entries += _draw_marks(ax, overlay.ends, page.map_size, "end", 4.1, end)
    return entries or [overlay.none]


def _draw_marks(
    ax: Axes, spots: Iterable[Spot], size: tuple[float, float], gid: str, zorder: float, look: MarkLook
) -> list[Entry]:
    """Mark the visible ones of ``spots``, and return their legend entry, none if none is visible.

    Positions that coincide get one mark. ``size`` is the size of the plot in points, ``gid`` the marks' group name.
    """
    marked: list[Any] = []
    for _, x, y in spots:
        at = raster.in_points(ax, np.array([[x, y]]), size)[0]
        if np.all((at >= 0.0) & (at <= size)) and all(np.hypot(*(at - other)) >= _MERGE_DISTANCE for other in marked):
            marked.append(at)
            ax.plot(x, y, zorder=zorder, gid=gid, scalex=False, scaley=False, **style.mark(look))
    return [look] if marked else []


def name_regions(ax: Axes, plane: Plane, layers: MapLayers, type_size: float) -> None:
    """Write the names of classes of cells into their largest regions of a map.

    The plot must have its final size. ``type_size`` is in points.
    """
    extent, dots = ax.get_window_extent(), ax.figure.dpi / 72.0
    look: Any = {"fontsize": type_size, "ha": "center", "va": "center_baseline", "zorder": 4}
    for name in place_names(layers.names, plane, (extent.width / dots, extent.height / dots), type_size):
        turned: Any = {"rotation": name.angle, "rotation_mode": "anchor"}  # about its centre
        ax.text(name.x, name.y, name.text, color=name.color, **turned, **look)
