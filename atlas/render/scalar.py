"""Maps of one number that has no natural middle: an even scale from pale to dark, by the same steps of lightness."""

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Colormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.render import maps, overlays, style
from atlas.render.page import STANDARD, Page

_SHARE = 0.5
"""Per cent of cells that may lie beyond each end of the scale."""


@dataclass(frozen=True)
class Scale:
    """How a number becomes a colour: its map, whether by its logarithm, and what the colour bar says."""

    colormap: Colormap
    log: bool
    label: str


def figure(
    ds: xr.Dataset,
    plane: maps.Plane,
    values: NDArray[np.float64],
    scale: Scale,
    options: maps.Options,
    zero: tuple[str, str] | None = None,
) -> Figure:
    """A map of ``values`` (y, x); cells that are NaN show their regime.

    ``zero``: colour and name of cells that are 0; where there are no others the figure has no colour bar.
    """
    norm = color_norm(values, scale.log, options.page)
    with options.page.context():
        drawn, ax = maps.frame(ds, options.page)
        rgba, legend = paint(plane.regime, values, norm, scale.colormap, zero)
        maps.draw(ax, plane, rgba, options)
        entries: list[Artist] = [*legend, *overlays.draw(ax, ds, plane, options)]
        if zero is None or np.any(values > 0.0):
            colour_bar(drawn, ax, values, norm, scale)
        options.page.legend(drawn, entries)
    return drawn


def paint(
    regime: NDArray[np.int8],
    values: NDArray[np.float64],
    norm: Normalize,
    colormap: Colormap,
    zero: tuple[str, str] | None = None,
) -> tuple[NDArray[np.uint8], list[Patch]]:
    """The colour of every cell, (y, x, 4) in bytes, and legend entries for what the scale does not say."""
    known = np.isfinite(values)
    # Zero has no logarithm; like all below the scale's lower end it has that end's colour.
    least = float(norm.vmin or 0.0)
    rgba = colormap(norm(np.where(known, np.maximum(values, least), least)), bytes=True)
    legend = []
    if zero is not None and np.any(values == 0.0):
        rgba[values == 0.0] = style.rgb(zero[0])
        legend.append(style.swatch(*zero))
    return rgba, legend + maps.paint_regimes(rgba, regime, ~known)


def color_norm(values: NDArray[np.float64], log: bool, page: Page = STANDARD) -> Normalize:
    """The scale of finite values, of positive ones where it is logarithmic: to percentiles near both ends.

    A logarithmic one spans a decade at least. Without such values, it is any. Ends that the page gives are kept.
    """
    finite = values[np.isfinite(values) & (values > 0.0)] if log else values[np.isfinite(values)]
    low, high = (0.1, 1.0) if log else (0.0, 1.0)
    if finite.size:
        low, high = (float(end) for end in np.percentile(finite, [_SHARE, 100.0 - _SHARE]))
        if log:
            # A scale within a decade has ticks that nobody reads.
            low, high = min(low, high / 10.0), max(high, low * 10.0 if low == high else high)
        elif high <= low:
            high = low + 1.0
    low, high = page.ends(low, high)
    if log and low <= 0.0:
        raise InputError(f"this scale is logarithmic: found vmin {low:g}, must be positive")
    return LogNorm(low, high) if log else Normalize(low, high)


def colour_bar(drawn: Figure, ax: Axes, values: NDArray[np.float64], norm: Normalize, scale: Scale) -> None:
    """The scale of these values to the right of a plot."""
    low, high = float(norm.vmin or 0.0), float(norm.vmax or 1.0)
    shown = values[values > 0.0] if scale.log else values[np.isfinite(values) & (values != 0.0)]
    extend = style.beyond(shown, low, high)
    mappable = ScalarMappable(norm, scale.colormap)
    bar = drawn.colorbar(mappable, ax=ax, extend=extend, aspect=28, pad=0.02, extendfrac=0.03)
    bar.set_label(scale.label)
    bar.outline.set_linewidth(0.6)
    if scale.log:
        log_ticks(bar)


def log_ticks(bar: Colorbar, most: int = 8) -> None:
    """Ticks of a logarithmic colour bar: powers of ten where it spans many, else 1, 2, 5 in plain numbers."""
    low, high = (float(end) for end in (bar.norm.vmin or 0.0, bar.norm.vmax or 1.0))
    decades = math.log10(high / low)
    axis = bar.ax.yaxis
    if decades > 3.0 or high < 1e-3:
        bar.set_ticks(LogLocator(numticks=most))
        if decades > 3.0:
            axis.set_minor_locator(NullLocator())
        axis.set_minor_formatter(NullFormatter())
        return
    steps = [1.0, 2.0, 5.0] if decades * 3.0 <= most else [1.0, 3.0] if decades * 2.0 <= most else [1.0]
    axis.set_major_locator(LogLocator(subs=steps))
    axis.set_major_formatter(FuncFormatter(lambda value, _: _plain(value)))
    axis.set_minor_locator(NullLocator())


def _plain(value: float) -> str:
    """A number as a colour bar shows it: 0.02, 5, 2000, 20\N{NARROW NO-BREAK SPACE}000."""
    return f"{value:,g}".replace(",", "\N{NARROW NO-BREAK SPACE}") if value >= 1e4 else f"{value:g}"
