"""The cost map: how many forcing periods were simulated for every cell."""

import numpy as np
import xarray as xr
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from atlas.render import maps, overlays, scalar
from workers.results import FAILED, INVALID, PENDING

COLORMAP = LinearSegmentedColormap.from_list(
    "cost", ("#fdf2e4", "#f8d3a4", "#ecab68", "#cf7f3a", "#9c5320", "#5a2a10"), N=512
)
SCALE = scalar.Scale(COLORMAP, True, "forcing periods simulated")


def figure(ds: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """The cost map as a figure; InputError where the atlas does not hold it.

    Cells that cost nothing have a colour of their own. An undetermined cell shows what it cost, which is the most that
    a cell may.
    """
    plane = overlays.read(ds, ["periods_used"], "cost", options)
    solved = ~np.isin(plane.regime, (PENDING, INVALID, FAILED))
    used = np.where(solved, plane["periods_used"].astype(float), np.nan)
    return scalar.figure(ds, plane, used, SCALE, options, zero=("#dddddd", "none needed"))
