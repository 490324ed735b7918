"""The error map: how well the largest exponent of every cell is known."""

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from atlas.render import maps, overlays, scalar
from workers.results import ERROR

# Without the ends of magma: near white is a cell without a value, black one that failed.
COLORMAP = LinearSegmentedColormap.from_list("error", colormaps["magma_r"](np.linspace(0.06, 0.86, 64)), N=512)
SCALE = scalar.Scale(COLORMAP, True, r"error of $\lambda_1$ [per forcing period]")


def figure(ds: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """The error map as a figure; InputError where the atlas holds no errors.

    Numerical where the motion is periodic or without impact, a standard error where it is chaotic, the difference
    of two windows on a torus: see the README's table of variables.
    """
    plane = overlays.read(ds, [ERROR.name], "error", options)
    error = np.where(maps.determined(plane.regime), plane[ERROR.name], np.nan)
    # Nothing is known better than to rounding; an error of zero would have no place on a log scale.
    known = np.where(np.isfinite(error), np.maximum(error, np.finfo(float).tiny), np.nan)
    return scalar.figure(ds, plane, np.where(error == 0.0, np.finfo(float).eps, known), SCALE, options)
