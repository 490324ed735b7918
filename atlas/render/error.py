"""The error map: how well the largest exponent of every cell is known, on a scale for each kind of error."""

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LinearSegmentedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from atlas.render import maps, overlays, scalar, style
from atlas.render.page import STANDARD
from workers.results import CHAOTIC, ERROR, NO_IMPACT, PERIODIC, QUASIPERIODIC


def _part(name: str, low: float, high: float) -> Colormap:
    """A part of one of matplotlib's colour maps, without its ends: near white is a cell without a value, black one
    that failed.
    """
    return LinearSegmentedColormap.from_list(name, colormaps[name](np.linspace(low, high, 64)), N=512)


COLORMAPS = {
    "numerical": _part("YlGnBu", 0.12, 0.95),
    "statistical": _part("YlOrRd", 0.10, 1.0),
    "between windows": _part("PuRd", 0.2, 1.0),
}
"""The colour map of each kind of error: they differ by ten decades, and one scale would show none of them."""

REGIMES = {
    "numerical": (NO_IMPACT, PERIODIC),
    "statistical": (CHAOTIC,),
    "between windows": (QUASIPERIODIC,),
}
_LABELS = {
    "numerical": "periodic",
    "statistical": "chaotic",
    "between windows": "torus",
}


def figure(ds: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """The error map as a figure; InputError where the atlas holds no errors.

    Numerical where the motion is periodic or without impact, a standard error where it is chaotic, the difference
    of two windows on a torus: see the table of variables in docs/data.md. Ends of the scale, where they are given, are
    those of the standard error.
    """
    plane = overlays.read(ds, [ERROR.name], "error", options)
    known = known_errors(plane)
    parts = {kind: np.where(np.isin(plane.regime, codes), known, np.nan) for kind, codes in REGIMES.items()}
    present = [kind for kind, values in parts.items() if np.isfinite(values).any()]
    with options.page.context():
        drawn, ax = maps.frame(ds, options.page)
        rgba = np.zeros((*plane.regime.shape, 4), np.uint8)
        norms, scale = {}, options.page.scale
        for kind in present:
            ends = options.page if kind == "statistical" else STANDARD
            norms[kind] = scalar.color_norm(parts[kind], log=True, page=ends)
            cells = np.isfinite(parts[kind])
            least = float(norms[kind].vmin or 0.0)
            rgba[cells] = COLORMAPS[kind](norms[kind](np.maximum(parts[kind][cells], least)), bytes=True)
        legend = maps.paint_regimes(rgba, plane.regime, ~np.isfinite(known))
        maps.draw(ax, plane, rgba, options)
        entries: list[Artist] = [*legend, *overlays.draw(ax, ds, plane, options)]
        # One above the other beside the map, the largest errors on top.
        for place, kind in enumerate(present):
            share, gap = 1.0 / len(present), 0.13 if len(present) > 1 else 0.05
            box = (1.03, place * share, 0.035, share - gap)
            inset = ax.inset_axes(box)
            low, high = float(norms[kind].vmin or 0.0), float(norms[kind].vmax or 1.0)
            bar = ax.figure.colorbar(
                ScalarMappable(norms[kind], COLORMAPS[kind]),
                cax=inset,
                extend=style.beyond(parts[kind], low, high),
                extendfrac=0.05,
            )
            scalar.log_ticks(bar, most=4 if len(present) > 1 else 8)
            inset.set_title(_LABELS[kind], loc="left", fontsize=mpl.rcParams["legend.fontsize"], pad=3.0 + 5.0 * scale)
            bar.outline.set_linewidth(0.6)
        if present:
            ax.annotate(
                r"error of $\lambda_1$ [per forcing period]",
                (1.065, 0.5), xycoords="axes fraction", xytext=(38.0 * scale, 0.0), textcoords="offset points",
                rotation=90, va="center", fontsize=mpl.rcParams["axes.labelsize"],
            )  # fmt: skip
        options.page.legend(drawn, entries)
    return drawn


def known_errors(plane: maps.Plane) -> NDArray[np.float64]:
    """The error of every cell whose class is known, positive; NaN elsewhere."""
    error = np.where(maps.determined(plane.regime), plane[ERROR.name], np.nan)
    # Nothing is known better than to rounding; an error of zero would have no place on a log scale.
    known = np.where(np.isfinite(error), np.maximum(error, np.finfo(float).tiny), np.nan)
    return np.where(error == 0.0, np.finfo(float).eps, known)
