"""What all pictures of a plane share: its cells read in drawing order, the frame around them, the legends."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.render import axes, style
from atlas.view import view
from workers.results import PENDING, REGIME, REGIMES

HEIGHT = 4.7
"""Height of a map in inches."""

PIXELS = (1500, 1100)
"""Least size, (x, y), of a map's plot area in a file, in pixels: cells not smaller than these are all drawn."""


@dataclass(frozen=True)
class Plane:
    """The cells of a plane as arrays (y, x) with both axes rising: regimes, and the values of one more variable."""

    x: axes.Axis
    y: axes.Axis
    regime: NDArray[np.int8]
    values: NDArray[Any]


def read(ds: xr.Dataset, variable: str, kind: str) -> Plane:
    """Read one variable and the regimes of a plane, nothing else and not finer than PIXELS.

    InputError if the atlas does not hold the variable.
    """
    if variable not in ds:
        raise InputError(f"kind {kind!r} draws the variable {variable!r}, which this atlas does not hold")
    ds, (x, y) = axes.rising(view(ds, [variable], pixels=PIXELS))
    return Plane(x, y, ds[REGIME.name].values, ds[variable].values)


def frame(ds: xr.Dataset) -> tuple[Figure, Axes]:
    """A figure with one plot area under the title line of the fixed parameters."""
    figure = style.new_figure(HEIGHT)
    ax = figure.add_subplot()
    ax.set_title(style.title_line(ds), loc="left")
    # Cells without a value are transparent: what shows through them is this texture, which no value has.
    ax.patch.set(facecolor="white", edgecolor=style.TEXTURE, hatch=style.HATCH[PENDING], linewidth=0.0)
    return figure, ax


def paint_regimes(rgba: NDArray[np.uint8], regime: NDArray[np.int8], where: NDArray[np.bool_]) -> list[Patch]:
    """Give cells the colour of their regime, in place, and return legend entries for those regimes.

    Pending cells turn transparent, so that the texture of the plot area shows.
    """
    entries = []
    for each in sorted(REGIMES, key=lambda regime: regime.code == PENDING):  # pending last in the legend
        cells = where & (regime == each.code)
        if cells.any():
            rgba[cells] = style.rgb(each.color, alpha=0 if each.code == PENDING else 255)
            hatch = style.HATCH[PENDING] if each.code == PENDING else None
            entries.append(style.swatch(each.color, style.name_of(each.code), hatch))
    return entries
