"""Maps of any number that an atlas holds, on an even scale from pale to dark, or on two from a pale zero on."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.colors import Colormap, LinearSegmentedColormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.errors import InputError, check_names
from atlas.query.extremes import numbers_of_cells, regimes_with
from atlas.render import maps, overlays, scalar, style
from workers.results import NO_IMPACT

_ABOVE = ("#f3eaf5", "#d9bfe0", "#b690c6", "#8d5fa6", "#633382", "#36134f")
COLORMAP = LinearSegmentedColormap.from_list("variable", _ABOVE, N=512)
BELOW = ("#0b2520", "#1e4d44", "#3f7b70", "#6faaa0", "#a9d3cb")
"""Colours of numbers below zero in a scale of both signs, from the largest to the smallest."""
_BOTH = LinearSegmentedColormap.from_list("signed", (*BELOW, "#f6f4f4", *_ABOVE[1:]), N=1024)
NEUTRAL = "#e4e2d6"
"""The colour of cells whose motion is known but has no such number, and of zero, which has no logarithm."""


def figure(ds: xr.Dataset, name: str, log: bool = False, options: maps.Options = maps.PLAIN) -> Figure:
    """A map of this variable as a figure, on a linear or a logarithmic scale.

    Cells without a result have the colour of their regime; where the motion has no such number they are NEUTRAL, and
    textured where it is -inf: a legend says so.
    Raises InputError, with the nearest name, for what is no number of each cell, and for a logarithmic scale of
    numbers below zero.
    """
    check_variable(ds, name)
    plane = overlays.read(ds, [name], "scalar", options)
    values = known_values(name, plane)
    if log and np.any(values < 0.0):
        raise InputError(f"{name!r} has values below zero, which a logarithmic scale cannot show")
    norm = scalar.color_norm(values, log, options.page)
    colormap = colormap_of(norm)
    with options.page.context():
        drawn, ax = maps.frame(ds, options.page)
        rgba, legend = paint(plane.regime, values, norm, colormap, log)
        maps.draw(ax, plane, rgba, options)
        entries: list[Artist] = [*legend, *maps.mark_lost(ax, plane, np.isneginf(values), colormap)]
        entries += overlays.draw(ax, ds, plane, options)
        if np.isfinite(values).any():
            scalar.colour_bar(drawn, ax, values, norm, scalar.Scale(colormap, log, label(ds, name)))
        options.page.legend(drawn, entries)
    return drawn


def colormap_of(norm: Normalize) -> Colormap:
    """The colours of a scale: zero between its ends is pale, and equally far from it both sides are equally dark."""
    low, high = float(norm.vmin or 0.0), float(norm.vmax or 0.0)
    if not low < 0.0 < high:
        return COLORMAP
    shares = np.linspace(low, high, 512) / max(-low, high)
    return ListedColormap(_BOTH(0.5 + 0.5 * shares), name="signed")


def check_variable(ds: xr.Dataset, name: str) -> None:
    """InputError, with the nearest name, unless it names a number of each cell."""
    possible = numbers_of_cells(ds)
    if name in ds and name not in possible:
        raise InputError(f"variable {name!r} is no number of each cell; possible: {', '.join(possible)}")
    check_names("variable", [name], possible)


def known_values(name: str, plane: maps.Plane) -> NDArray[np.float64]:
    """The variable where it is a result, NaN elsewhere: in orbits alone for counts of an orbit, and not where it rests,
    which makes the number of impacts infinite.
    """
    values = plane[name].astype(np.float64)
    known = maps.determined(plane.regime) & np.isin(plane.regime, list(regimes_with(name)))
    if name.startswith("impacts_"):
        known &= values >= 0.0
    return np.where(known, values, np.nan)


def label(ds: xr.Dataset, name: str) -> str:
    """What the variable is and its unit, as a colour bar says it."""
    attributes = ds[name].attrs
    meaning = str(attributes.get("long_name", name)).split(";")[0]
    return f"{meaning} [{style.unit_text(str(attributes.get('units', '1')))}]"


def paint(
    regime: NDArray[np.int8], values: NDArray[np.float64], norm: Normalize, colormap: Colormap, log: bool
) -> tuple[NDArray[np.uint8], list[Patch]]:
    """The colour of every cell, (y, x, 4) in bytes, and legend entries for what the scale does not say."""
    known = ~np.isnan(values)
    least = float(norm.vmin or 0.0)
    rgba = colormap(norm(np.where(known, np.maximum(values, least), least)), bytes=True)
    legend = []
    zero = known & (values == 0.0) if log else np.zeros_like(known)
    none = ~known & maps.determined(regime) & (regime != NO_IMPACT)
    if zero.any() or none.any():
        rgba[zero | none] = style.rgb(NEUTRAL)
        words = [word for word, cells in (("0", zero), ("no such number", none)) if cells.any()]
        legend.append(style.swatch(NEUTRAL, " or ".join(words)))
    return rgba, legend + maps.paint_regimes(rgba, regime, ~known & ~none)
