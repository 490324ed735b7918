"""The combined map: the period where motion is periodic, the largest exponent where it is chaotic."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.render import exponent, maps, overlays, period, style
from workers.results import CHAOTIC, LARGEST

CLASSES: tuple[period.Class, ...] = (
    (1, 1, "#a9cbea"),
    (2, 2, "#6ea6da"),
    (3, 3, "#9d8fd6"),
    (4, 4, "#3672b4"),
    (5, 5, "#5fb7a8"),
    (6, 6, "#5a3fa3"),
    (7, 7, "#17776c"),
    (8, 8, "#1b4480"),
    (9, 16, "#0b2350"),
    (17, None, "#bf8fd0"),
)
"""First and last period of each class and its colour: cool ones, since warm ones are the chaos.

A period and its doubles share a hue and darken: 1, 2, 4, 8 blue; 3, 6 violet.
"""

COLORMAP = LinearSegmentedColormap.from_list("chaos", exponent.CHAOTIC_COLORS, N=512)


def figure(ds: xr.Dataset, overlaid: Sequence[str] = ()) -> Figure:
    """The combined map as a figure; InputError where the atlas lacks periods or exponents."""
    plane = maps.read(ds, ("period", LARGEST.name, *overlays.variables(overlaid)), "combined")
    largest = np.where(plane.regime == CHAOTIC, plane[LARGEST.name], np.nan)
    norm = Normalize(0.0, exponent.scale_ends(largest)[1])
    with rc_context(style.STYLE):
        drawn, ax = maps.frame(ds)
        rgba, legend = paint(plane.regime, plane["period"], largest, norm)
        maps.draw(ax, plane, rgba)
        entries: list[Artist] = [*legend, *overlays.draw(ax, ds, plane, overlaid)]
        bar = drawn.colorbar(
            ScalarMappable(norm, COLORMAP),
            ax=ax,
            extend=style.beyond(largest, 0.0, float(norm.vmax or 1.0)),
            aspect=28,
            pad=0.02,
            extendfrac=0.03,
        )
        bar.set_label(r"chaotic: $\lambda_1$ [per forcing period]")
        bar.outline.set_linewidth(0.6)
        maps.legend_below(drawn, entries)
    return drawn


def paint(
    regime: NDArray[np.int8], periods: NDArray[np.int32], largest: NDArray[np.float64], norm: Normalize
) -> tuple[NDArray[np.uint8], list[Patch]]:
    """The colour of every cell, (y, x, 4) in bytes, and legend entries for the classes present."""
    rgba, legend = period.paint(regime, periods, CLASSES)
    measured = (regime == CHAOTIC) & ~np.isnan(largest)
    rgba[measured] = COLORMAP(norm(largest[measured]), bytes=True)
    # The colour bar names the chaotic cells, unless one has no exponent and shows its regime's colour.
    all_measured = bool(np.all(measured[regime == CHAOTIC]))
    return rgba, [each for each in legend if not (all_measured and each.get_label() == style.name_of(CHAOTIC))]
