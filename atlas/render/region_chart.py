"""The region chart: exact curves, and the names of the motions in the regions between them."""

from dataclasses import replace

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from atlas.query import machine
from atlas.query.label_placement import crossed_cells, densify_line
from atlas.query.motions import regions
from atlas.query.outlines import fill_holes
from atlas.render import maps, overlays, raster, text
from atlas.render.kinds import KIND_TABLE
from atlas.render.request import PictureRequest

_TYPE = (9.0, 7.5, 6.0)
"""Type sizes of names in points; the first that fits is used."""
_MAX_REPEATS = 4
"""Maximum number of regions with the same name that are labelled: the largest ones."""
_FINE = 1.0
"""Distance in points between the positions tried for a name."""
_CORNER = 3.0 * np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)])
"""Corners, in points, of the box that the mark of a point of codimension two covers."""
_SIDES = "\ns: symmetric, u: unsymmetric"


def figure(ds: xr.Dataset, request: PictureRequest) -> Figure:
    """Return the region chart as a figure. Raise InputError if the atlas has no curves or no impact counts."""
    sides, row = ("symmetric",) if "symmetric" in ds else (), KIND_TABLE["regions"]
    view = maps.read(replace(row, variables=(*row.variables, *sides)), ds, request)
    plane, page, size = view.plane, view.page, view.page.map_size
    curves = overlays.requested_curves(view, "kind 'regions'")
    twins = machine.twins_everywhere(ds, {plane.x.name: plane.x.values, plane.y.name: plane.y.values})
    rest = replace(request, overlays=tuple(name for name in request.overlays if name != "curves"))
    with page.context():
        drawn, (ax,) = page.panels(page.map_height, 1, text.title_line(ds))
        raster.scale_axes(ax, x=plane.x, y=plane.y)
        entries: list[Artist] = [
            *overlays.draw_curves(ax, curves, view),
            *overlays.draw(ax, replace(view, wanted=rest)),
        ]
        title = text.motion_key(ds) + (_SIDES if request.names and sides and twins else "")
        page.legend(drawn, entries, beside=title, handlelength=2.6)
        if not request.names:
            return drawn
        page.finalize(drawn)
        times = max(1, round(max(np.array(size) / plane.regime.shape[::-1]) / _FINE))
        fine = plane.even(times)
        marked = [np.asarray(line.get_xydata()) for line in ax.lines if line.get_gid() == "corner"]
        places = [densify_line(raster.in_points(ax, line, size))[0] for curve in curves for line in curve.stable_lines]
        places += [raster.in_points(ax, at, size) + _CORNER for at in marked]
        covered = crossed_cells(places, size, fine.regime.shape)
        motions = regions(fine, twins, text.regime(ds))
        named = [(fill_holes(cells, times) & ~covered, name, "white") for name, cells in motions]
        maps.name_regions(ax, fine, named, [points * page.scale for points in _TYPE], _MAX_REPEATS, ~covered)
    return drawn
