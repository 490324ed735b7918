"""The coexistence map: how many attractors the initial states of each cell have reached."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.render import maps, overlays, style

COUNTS = {1: "#dfe8ee", 2: "#8fb8d8", 3: "#4a7fb5", 4: "#f0b13c", 5: "#d9622b"}
"""The colour of each number of attractors; the last of all larger ones."""
MOST = max(COUNTS) + 1
MORE = "#7a1f5c"


def figure(ds: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """The map as a figure; InputError where the atlas does not count attractors.

    A cell of which some initial states are undecided may have more: it is counted by those that are known.
    """
    plane = overlays.read(ds, ["attractors"], "attractors", options)
    with options.page.context():
        drawn, ax = maps.frame(ds, options.page)
        known = maps.determined(plane.regime)
        rgba, legend = paint(plane.regime, np.where(known, np.rint(plane["attractors"]), 0).astype(np.int64))
        maps.draw(ax, plane, rgba, options)
        entries: list[Artist] = [*legend, *overlays.draw(ax, ds, plane, options)]
        options.page.legend(drawn, entries, beside="")
    return drawn


def paint(regime: NDArray[np.int8], count: NDArray[np.int64]) -> tuple[NDArray[np.uint8], list[Patch]]:
    """The colour of every cell, (y, x, 4) in bytes, and legend entries for the numbers present."""
    rgba = np.zeros((*regime.shape, 4), dtype=np.uint8)
    legend = []
    colors = {**COUNTS, MOST: MORE}
    for number, color in colors.items():
        cells = count >= MOST if number == MOST else count == number
        if cells.any():
            rgba[cells] = style.rgb(color)
            what = "1 attractor" if number == 1 else f"{number} attractors"
            legend.append(style.swatch(color, f"{number} or more" if number == MOST else what))
    return rgba, legend + maps.paint_regimes(rgba, regime, count < 1)
