"""The share map: of all initial states, the part that reaches the attractor of each cell."""

import numpy as np
import xarray as xr
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from atlas.render import maps, overlays, scalar

COLORMAP = LinearSegmentedColormap.from_list(
    "share", ("#4a1042", "#7d2f6b", "#ab5d8f", "#cf93b0", "#e8c8d2", "#f8f1ee"), N=512
)
SCALE = scalar.Scale(COLORMAP, False, "share of the initial states")


def figure(ds: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """The share map as a figure; InputError where the atlas does not hold shares.

    It is that of the attractor with the largest share unless another one was selected.
    """
    plane = overlays.read(ds, ["share"], "share", options)
    share = np.where(maps.determined(plane.regime), plane["share"], np.nan)
    return scalar.figure(ds, plane, share, SCALE, options)
