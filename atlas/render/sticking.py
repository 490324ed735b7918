"""The sticking map: the share of time that the impacting mass rests on a stop."""

import numpy as np
import xarray as xr
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from atlas.render import maps, overlays, scalar

COLORMAP = LinearSegmentedColormap.from_list(
    "sticking", ("#cfeee9", "#8fd3cb", "#4db0ab", "#1f8588", "#0d5a66", "#06323f"), N=512
)
SCALE = scalar.Scale(COLORMAP, False, "share of the time at rest on a stop")


def figure(ds: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """The sticking map as a figure; InputError where the atlas does not hold it. Cells that never rest are pale."""
    plane = overlays.read(ds, ["stuck_fraction"], "sticking", options)
    share = np.where(maps.determined(plane.regime), plane["stuck_fraction"], np.nan)
    return scalar.figure(ds, plane, share, SCALE, options, zero=("#f3f1ea", "never at rest"))
