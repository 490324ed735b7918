"""The isoperiodic map: the forcing periods of each cell's orbit, and the regime where it never closes."""

from typing import TypeAlias

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.render import maps, overlays, style
from workers.results import PERIODIC

Class: TypeAlias = tuple[int, int | None, str]
"""First period, last period (None: no last) and colour."""

CLASSES: tuple[Class, ...] = (
    (1, 1, style.COLORS[PERIODIC]),
    (2, 2, "#38ad83"),
    (3, 3, "#a467ff"),
    (4, 4, "#06493b"),
    (5, 5, "#5bedff"),
    (6, 6, "#b5a3b7"),
    (7, 8, "#594e6e"),
    (9, 16, "#8faefc"),
    (17, None, "#0314cf"),
)
"""First and last period of each class and its colour, the same in every picture: cool ones, since warm ones are chaos.

Chosen, with the colours of the regimes and of the chaos, for the greatest least difference (CIEDE2000) between any two:
above 20 among periods, above 12 as seen without red, green or blue receptors.
"""


def figure(ds: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """The isoperiodic map as a figure; InputError where the atlas holds no periods."""
    plane = overlays.read(ds, ["period"], "period", options)
    with options.page.context():
        drawn, ax = maps.frame(ds, options.page)
        rgba, legend = paint(plane.regime, plane["period"])
        maps.draw(ax, plane, rgba, options)
        entries: list[Artist] = [*legend, *overlays.draw(ax, ds, plane, options)]
        options.page.legend(drawn, entries, beside="")
    return drawn


def paint(regime: NDArray[np.int8], period: NDArray[np.int32]) -> tuple[NDArray[np.uint8], list[Patch]]:
    """The colour of every cell, (y, x, 4) in bytes, and legend entries for the classes present."""
    rgba = np.zeros((*regime.shape, 4), dtype=np.uint8)
    counted = (regime == PERIODIC) & (period >= 1)
    legend = []
    for first, last, color in CLASSES:
        cells = counted & (period >= first) & (period <= (last or np.iinfo(np.int32).max))
        if cells.any():
            rgba[cells] = style.rgb(color)
            legend.append(style.swatch(color, _label(first, last)))
    return rgba, legend + maps.paint_regimes(rgba, regime, ~counted)


def _label(first: int, last: int | None) -> str:
    if last is None:
        return f"period ≥ {first}"
    return f"period {first}" if first == last else f"period {first}–{last}"
