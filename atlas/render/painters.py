"""The painters of kinds, and the picture of a kind."""

from collections.abc import Callable, Mapping

import xarray as xr
from matplotlib.figure import Figure

from atlas.render import classes, maps, regions, scales, sweep
from atlas.render.kinds import Kind
from atlas.render.layers import Layers
from atlas.render.wanted import Wanted

PAINTERS: Mapping[str, Callable[..., Layers]] = {
    "exponent": scales.exponent, "period": classes.period, "impacts": classes.motions, "symmetry": classes.symmetry,
    "combined": scales.combined, "error": scales.error, "cost": scales.cost, "sticking": scales.number,
    "attractors": classes.attractors, "share": scales.number, "labels": classes.labels, "basins": classes.basins,
    "return_time": scales.scalar, "reactivity": scales.scalar, "amplification": scales.scalar,
    "fatal_shock": scales.scalar, "margin": scales.scalar, "scalar": scales.scalar,
}  # fmt: skip
"""For each kind of map the function that makes the layers of a view."""

FIGURES: Mapping[str, Callable[[xr.Dataset, Wanted], Figure]] = {
    "regions": regions.figure, "coexistence": sweep.figure_of_attractors, "sweep": sweep.figure,
    "spectrum": sweep.figure_of_all, "hysteresis": sweep.figure_of_two,
}  # fmt: skip
"""For each other kind the function that draws it."""


def draw(kind: Kind, ds: xr.Dataset, wanted: Wanted) -> Figure:
    """The picture of a kind, for a map with its overlays; InputError if the atlas lacks its variables."""
    if kind.name in FIGURES:
        return FIGURES[kind.name](ds, wanted)
    view = maps.read(kind, ds, wanted)
    return maps.draw_layers(view, PAINTERS[kind.name](view))
