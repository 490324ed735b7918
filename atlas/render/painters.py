"""The table of painters: for each kind of picture the function that makes its layers or its figure."""

from collections.abc import Callable, Mapping

import xarray as xr
from matplotlib.figure import Figure

from atlas.render import class_maps, maps, scalar_maps, sweep
from atlas.render.kinds import PictureKind
from atlas.render.layers import MapLayers
from atlas.render.request import PictureRequest

PAINTERS: Mapping[str, Callable[..., MapLayers]] = {
    "exponent": scalar_maps.exponent, "period": class_maps.period, "impacts": class_maps.motions,
    "combined": scalar_maps.combined, "attractors": class_maps.attractors, "labels": class_maps.labels,
    "basins": class_maps.basins, "scalar": scalar_maps.scalar,
}  # fmt: skip
"""For each kind of map, the function that returns the layers of the map."""

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
    view = maps.read(kind, ds, request)
    return maps.draw_layers(view, PAINTERS[kind.name](view))
