"""The combined map: the period where motion is periodic, the largest exponent where it is chaotic."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.render import exponent, maps, overlays, period, style
from workers.results import CHAOTIC, LARGEST

COLORMAP = LinearSegmentedColormap.from_list("chaos", exponent.CHAOTIC_COLORS, N=512)


def figure(ds: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """The combined map as a figure; InputError where the atlas lacks periods or exponents."""
    plane = overlays.read(ds, ["period", LARGEST.name], "combined", options)
    largest = np.where(plane.regime == CHAOTIC, plane[LARGEST.name], np.nan)
    norm = Normalize(*options.page.ends(0.0, exponent.scale_ends(largest)[1]))
    with options.page.context():
        drawn, ax = maps.frame(ds, options.page)
        rgba, legend = paint(plane.regime, plane["period"], largest, norm)
        maps.draw(ax, plane, rgba, options)
        entries: list[Artist] = [*legend, *overlays.draw(ax, ds, plane, options)]
        bar = drawn.colorbar(
            ScalarMappable(norm, COLORMAP),
            ax=ax,
            extend=style.beyond(largest, float(norm.vmin or 0.0), float(norm.vmax or 1.0)),
            aspect=28,
            pad=0.02,
            extendfrac=0.03,
        )
        bar.set_label(r"chaotic: $\lambda_1$ [per forcing period]")
        bar.outline.set_linewidth(0.6)
        options.page.legend(drawn, entries)
    return drawn


def paint(
    regime: NDArray[np.int8], periods: NDArray[np.int32], largest: NDArray[np.float64], norm: Normalize
) -> tuple[NDArray[np.uint8], list[Patch]]:
    """The colour of every cell, (y, x, 4) in bytes, and legend entries for the classes present."""
    rgba, legend = period.paint(regime, periods)
    measured = (regime == CHAOTIC) & ~np.isnan(largest)
    rgba[measured] = COLORMAP(norm(largest[measured]), bytes=True)
    # The colour bar names the chaotic cells, unless one has no exponent and shows its regime's colour.
    all_measured = bool(np.all(measured[regime == CHAOTIC]))
    return rgba, [each for each in legend if not (all_measured and each.get_label() == style.name_of(CHAOTIC))]
