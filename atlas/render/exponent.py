"""The chaos map: the largest Lyapunov exponent over a plane, blue where motion is stable, yellow to red in chaos."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LinearSegmentedColormap, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy import ndimage

from atlas.errors import InputError
from atlas.render import axes, maps, overlays, style
from atlas.render.page import Page
from workers.results import LARGEST, NO_IMPACT

_STABLE = ("#06103a", "#123a7c", "#2c6fb3", "#6aa7d6", "#b3d4ec", "#eff6fc")
CHAOTIC_COLORS = ("#fff3c4", "#fdd27a", "#f79a3f", "#df5327", "#a81c24", "#4f0717")

_SHARE = 2.0
"""Per cent of each half's cells that may lie beyond the end of the scale: outliers must not flatten the rest."""


def _two_colours() -> LinearSegmentedColormap:
    # Each half has lightness of its own from zero outwards, so that it reads in grey and without red or green;
    # the small step at zero keeps the border of chaos sharp where exponents on both sides are small.
    stable = list(zip(np.linspace(0.0, 0.5, len(_STABLE)), _STABLE, strict=True))
    chaotic = list(zip(np.linspace(0.5, 1.0, len(CHAOTIC_COLORS)), CHAOTIC_COLORS, strict=True))
    return LinearSegmentedColormap.from_list("exponent", stable + chaotic, N=1024)


COLORMAP = _two_colours()
LABEL = r"largest Lyapunov exponent $\lambda_1$ [per forcing period]"


def figure(ds: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """The chaos map as a figure, with its overlays; InputError where the atlas holds no exponents."""
    plane = overlays.read(ds, [LARGEST.name], "exponent", options)
    largest = np.where(maps.determined(plane.regime), plane[LARGEST.name], np.nan)
    norm = two_sided(options.page, *scale_ends(largest))
    with options.page.context():
        drawn, ax = maps.frame(ds, options.page)
        rgba, legend = paint(plane.regime, largest, norm)
        maps.draw(ax, plane, rgba, options)
        entries: list[Artist] = [*legend, *mark_no_impact(ax, plane, norm), *mark_lost(ax, plane)]
        entries += overlays.draw(ax, ds, plane, options)
        colour_bar(drawn, [ax], norm, largest, LABEL)
        options.page.legend(drawn, entries)
    return drawn


def scale_ends(largest: NDArray[np.float64]) -> tuple[float, float]:
    """The ends of the scale's two halves, below and above zero, each as far out as all but 2 % of its cells need.

    A half without cells is as long as the other.
    """
    finite = largest[np.isfinite(largest)]
    below, above = -finite[finite < 0], finite[finite > 0]
    low, high = _reach(below), _reach(above)
    return -(low or high or 1.0), high or low or 1.0


def two_sided(page: Page, low: float, high: float) -> TwoSlopeNorm:
    """The scale between these ends, or those that the page gives; InputError unless zero is between them."""
    low, high = page.ends(low, high)
    if not low < 0.0 < high:
        raise InputError(f"the scale of exponents has zero in its middle: found {low:g} to {high:g}")
    return TwoSlopeNorm(0.0, low, high)


def paint(
    regime: NDArray[np.int8], largest: NDArray[np.float64], norm: TwoSlopeNorm
) -> tuple[NDArray[np.uint8], list[Patch]]:
    """The colour of every cell, (y, x, 4) in bytes, and legend entries for the regimes that have no exponent."""
    known = maps.determined(regime) & ~np.isnan(largest)
    rgba = COLORMAP(norm(np.where(known, largest, 0.0)), bytes=True)
    return rgba, maps.paint_regimes(rgba, regime, ~known)


def _reach(sizes: NDArray[np.float64]) -> float:
    """How far a half of the scale goes: the percentile, rounded up to two digits."""
    if sizes.size == 0:
        return 0.0
    reach = float(np.percentile(sizes, 100.0 - _SHARE))
    digit = 10.0 ** (np.floor(np.log10(reach)) - 1.0)
    return float(np.ceil(reach / digit - 1e-9) * digit)


def colour_bar(
    drawn: Figure,
    panels: Sequence[Axes],
    norm: TwoSlopeNorm,
    values: NDArray[np.float64],
    label: str,
    colormap: Colormap = COLORMAP,
    below: bool = False,
) -> None:
    """The scale of these values to the right of these plots, or below them, with a line at zero."""
    ends = float(norm.vmin or 0.0), float(norm.vmax or 0.0)
    bar = drawn.colorbar(
        ScalarMappable(norm, colormap),
        ax=list(panels),
        location="bottom" if below else "right",
        extend=style.beyond(values[np.isfinite(values)], *ends),
        ticks=_ticks(*ends, 3 if below else 5),  # numbers need more room side by side
        aspect=28,
        pad=0.02,
        extendfrac=0.03,
    )
    bar.set_label(label)
    bar.outline.set_linewidth(0.6)
    (bar.ax.axvline if below else bar.ax.axhline)(0.0, color="black", linewidth=0.7)


def _without_dust(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The cells less what is thinner than the eye separates, as between basins: outlined, that would turn black."""
    thin = min(cells.shape) // 150
    if thin == 0:
        return cells
    padded = np.pad(cells, 2 * thin, mode="symmetric")  # or the picture's frame would eat into them
    wide = ndimage.binary_opening(padded, structure=np.ones((3, 3)), iterations=thin)
    wide = ndimage.binary_closing(wide, structure=np.ones((3, 3)), iterations=thin)
    return np.asarray(wide[2 * thin : -2 * thin, 2 * thin : -2 * thin] & cells)


def _ticks(low: float, high: float, most: int) -> NDArray[np.float64]:
    """Round numbers on each half, which have scales of their own, and zero."""
    nice = MaxNLocator(most, steps=[1, 2, 2.5, 5, 10])
    both = np.concatenate([nice.tick_values(low, 0.0), nice.tick_values(0.0, high)])
    return np.unique(both[(both >= low) & (both <= high)].round(12))


def mark_no_impact(ax: Axes, plane: maps.Plane, norm: TwoSlopeNorm) -> list[Patch]:
    """Outline impact-free cells and dot them, since they have exponents as others do; the legend entry, if any."""
    quiet = (plane.regime == NO_IMPACT) & ~np.isnan(plane[LARGEST.name])
    if not quiet.any():
        return []
    color = COLORMAP(norm(np.median(plane[LARGEST.name][quiet])))
    ink = style.ink_on(color)
    axes.hatch(ax, plane.x, plane.y, quiet, style.HATCH[NO_IMPACT], ink)
    axes.outline(ax, plane.x, plane.y, _without_dust(quiet), "#1a2433", 0.3)
    return [style.swatch(color, style.name_of(NO_IMPACT), style.HATCH[NO_IMPACT], ink)]


def mark_lost(ax: Axes, plane: maps.Plane) -> list[Patch]:
    """Texture cells whose largest exponent is -inf: a single mass that comes to rest on a stop; the legend entry."""
    return maps.mark_lost(ax, plane, maps.determined(plane.regime) & np.isneginf(plane[LARGEST.name]), COLORMAP)
