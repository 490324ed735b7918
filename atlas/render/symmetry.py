"""The symmetry map: which periodic motions are symmetric, and of the others which of two mirror images it is."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.render import maps, overlays, style
from workers.results import PERIODIC

SYMMETRIC, UPPER, LOWER, UNTOLD = "#90b8de", "#8a4fd0", "#f0b13c", "#2f3f58"
"""The colours: symmetric; broken with more impacts at the upper stop; at the lower; broken, and it cannot be told."""

NAMES = {
    SYMMETRIC: "symmetric",
    UPPER: "broken, twin A (more impacts above)",
    LOWER: "broken, twin B (more impacts below)",
    UNTOLD: "broken, as many impacts above as below",
}


def figure(ds: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """The symmetry map as a figure; InputError where the atlas does not hold what it needs.

    Symmetric: the motion is its own mirror image, x(t) = -x(t + T/2). A broken one has a twin, which another start
    reaches. Impact counts tell the two apart unless they are equal, or infinite where the mass comes to rest.
    """
    plane = overlays.read(ds, ["symmetric", "impacts_upper", "impacts_lower"], "symmetry", options)
    with options.page.context():
        drawn, ax = maps.frame(ds, options.page)
        rgba, legend = paint(plane.regime, plane["symmetric"], plane["impacts_upper"], plane["impacts_lower"])
        maps.draw(ax, plane, rgba, options)
        entries: list[Artist] = [*legend, *overlays.draw(ax, ds, plane, options)]
        options.page.legend(drawn, entries)
    return drawn


def paint(
    regime: NDArray[np.int8], symmetric: NDArray[np.bool_], upper: NDArray[np.int32], lower: NDArray[np.int32]
) -> tuple[NDArray[np.uint8], list[Patch]]:
    """The colour of every cell, (y, x, 4) in bytes, and legend entries for the classes present."""
    rgba = np.zeros((*regime.shape, 4), dtype=np.uint8)
    periodic = regime == PERIODIC
    broken = periodic & ~symmetric.astype(bool)
    classes = {
        SYMMETRIC: periodic & ~broken,
        UPPER: broken & (upper > lower),
        LOWER: broken & (upper < lower),
        UNTOLD: broken & (upper == lower),
    }
    legend = []
    for color, cells in classes.items():
        if cells.any():
            rgba[cells] = style.rgb(color)
            legend.append(style.swatch(color, NAMES[color]))
    return rgba, legend + maps.paint_regimes(rgba, regime, ~periodic)
