"""Maps of numbers, each with a colormap and a labelled colorbar."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Colormap, LinearSegmentedColormap, ListedColormap, LogNorm, Normalize, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query.color_limits import number_ends, scale_ends
from atlas.query.extremes import variable_of
from atlas.query.outlines import without_dust
from atlas.render import class_maps, kinds, raster, style, text
from atlas.render.layers import Class, HatchLayer, MapLayers, MapView, ScalarLayer, build_layers
from atlas.render.layout import STANDARD, FigureLayout
from workers.results import (
    CHAOTIC,
    ERROR,
    FAILED,
    INVALID,
    LARGEST,
    NO_IMPACT,
    PENDING,
    PERIODIC,
    QUASIPERIODIC,
)

Array = NDArray[np.float64]

BELOW = ("#0b2520", "#1e4d44", "#3f7b70", "#6faaa0", "#a9d3cb")
"""Colours of negative numbers in a colormap of both signs, from the largest to the smallest."""
NEUTRAL = "#e4e2d6"
"""Colour of cells with known motion but without such a number, and of zero with a logarithmic norm."""


@cache
def colormap_of(colors: tuple[str, ...], steps: int = 512) -> LinearSegmentedColormap:
    """Return a colormap with these colours at even steps, interpolated between."""
    return LinearSegmentedColormap.from_list("scale", colors, N=steps)


def _part(name: str, low: float, high: float) -> Colormap:
    """Return a part of a matplotlib colormap without its ends.

    Colours near white are kept for cells without a value, black for failed cells.
    """
    return LinearSegmentedColormap.from_list(name, colormaps[name](np.linspace(low, high, 64)), N=512)


# The step in hue at zero keeps the border of chaos sharp between small exponents of both signs.
_PLACES = [*np.linspace(0.0, 0.5, len(kinds.STABLE)), *np.linspace(0.5, 1.0, len(kinds.CHAOTIC))]
EXPONENT = LinearSegmentedColormap.from_list(
    "exponent", list(zip(_PLACES, (*kinds.STABLE, *kinds.CHAOTIC), strict=True)), N=1024
)
CHAOS = colormap_of(kinds.CHAOTIC)
ERRORS = {
    "periodic": (_part("YlGnBu", 0.12, 0.95), (NO_IMPACT, PERIODIC)),
    "chaotic": (_part("YlOrRd", 0.10, 1.0), (CHAOTIC,)),
    "torus": (_part("PuRd", 0.2, 1.0), (QUASIPERIODIC,)),
}
"""Colours and regimes of each kind of error; the kinds differ by ten decades, too much for one colorbar."""


def exponent(view: MapView, norm: TwoSlopeNorm | None = None) -> MapLayers:
    """Return the layers of the chaos map: the largest Lyapunov exponent, blue if stable, orange to dark red for chaos.

    ``norm`` is common to several maps. Impact-free cells have exponents too, and a hatch.
    """
    regime, largest = view.plane.regime, view.plane.known_values(LARGEST.name)
    norm = norm or two_sided(view.page, *scale_ends(largest))
    layers = _scaled(view, ScalarLayer(EXPONENT, norm, largest, text.in_its_unit(view.ds, view.kind.scale.label)))
    quiet = (regime == NO_IMPACT) & ~np.isnan(largest)
    if not quiet.any():
        return layers
    color, name = EXPONENT(norm(np.median(largest[quiet]))), text.regime(view.ds).meaning(NO_IMPACT).text
    texture = HatchLayer.on_color(color, quiet, style.HATCH[NO_IMPACT], name, without_dust(quiet))
    return replace(layers, textures=[texture, *layers.textures])


def two_sided(layout: FigureLayout, low: float, high: float) -> TwoSlopeNorm:
    """Return the norm between these limits, or those of the layout. Raise InputError unless zero is between them."""
    low, high = layout.ends(low, high)
    if not low < 0.0 < high:
        raise InputError(f"colour limits of exponents: found {low:g} to {high:g}, must have zero between them")
    return TwoSlopeNorm(0.0, low, high)


def combined(view: MapView) -> MapLayers:
    """Return the layers with the period of periodic motion and the largest exponent of chaotic motion."""
    regime = view.plane.regime
    largest = np.where(regime == CHAOTIC, view.plane[LARGEST.name], np.nan)
    norm = Normalize(*view.page.ends(0.0, scale_ends(largest)[1]))
    # The colorbar names the chaotic cells; a chaotic cell without an exponent looks like its regime.
    field = ScalarLayer(CHAOS, norm, largest, text.in_its_unit(view.ds, view.kind.scale.label))
    return build_layers(regime, class_maps.by_period(view.plane), [field])


def number(view: MapView) -> MapLayers:
    """Return the layers of a number of each cell of known class of motion, with the colours of its kind."""
    return _numbers(view, view.plane.known_values(*view.kind.variables), view.kind.scale.label)


def cost(view: MapView) -> MapLayers:
    """Return the layers of the forcing periods simulated, also of undetermined cells, which cost the most."""
    solved = ~np.isin(view.plane.regime, (PENDING, INVALID, FAILED))
    label = text.variable_label(view.ds, "periods_used")
    return _numbers(view, np.where(solved, view.plane["periods_used"].astype(float), np.nan), label)


def _numbers(view: MapView, values: Array, label: str) -> MapLayers:
    """Return the layers of numbers (y, x) with the colours of their kind; no colorbar if all are a named 0."""
    scale = view.kind.scale
    norm, others = color_norm(values, scale.log, view.page), [(values == 0.0, *scale.zero)] if scale.zero else []
    shown = scale.zero is None or bool(np.any(values > 0.0))
    return _scaled(view, ScalarLayer(colormap_of(scale.colors), norm, values, label, bar=shown), others)


def scalar(view: MapView) -> MapLayers:
    """Return the layers of any variable, named or of the kind, from pale to dark, with two ranges around zero.

    Cells without such a number are NEUTRAL, with a hatch for -inf. Raise InputError for a logarithmic norm of negative
    numbers.
    """
    scale, plane = view.kind.scale, view.plane
    name = view.kind.variables[0] if view.kind.variables else str(view.wanted.variable)
    log, label = scale.log or view.wanted.log, scale.label or text.variable_label(view.ds, name)
    regime, values = plane.regime, plane.known_values(name).astype(np.float64)
    # Sticking orbits have infinitely many impacts, so their counts do not exist.
    meant = variable_of(view.ds, name)
    values[~np.isin(regime, list(meant.regimes)) | (meant.allows_infinite & (values < 0.0))] = np.nan
    if log and np.any(values < 0.0):
        raise InputError(f"{name!r} has values below zero, which a logarithmic scale cannot show")
    norm, known = color_norm(values, log, view.page), ~np.isnan(values)
    zero = known & (values == 0.0) & log
    none = ~known & plane.determined_mask & (regime != NO_IMPACT)
    meaning = " or ".join(word for word, cells in (("0", zero), ("no such number", none)) if cells.any())
    signs, shown = None if log else (colormap_of(scale.colors), both_signs(scale.colors)), np.isfinite(values).any()
    field = ScalarLayer(signed_colormap(norm, scale.colors), norm, values, label, signs=signs, bar=bool(shown))
    return _scaled(view, field, [(zero | none, NEUTRAL, meaning)])


def _scaled(view: MapView, field: ScalarLayer, others: Sequence[Class] = ()) -> MapLayers:
    """Return the layers of a scalar layer, with other cells in their colours; cells without a number look like their
    regime.

    Exponents of -inf, below any limit, have a hatch over the lowest colour.
    """
    lost, name = np.isneginf(field.values), rf"$-\infty$: {text.rest(view.ds)} erases disturbances"
    textures = [HatchLayer.on_color(field.colormap(0.0), lost, style.LOST_HATCH, name)] if lost.any() else []
    return build_layers(view.plane.regime, others, [field], textures=textures)


def color_norm(values: Array, log: bool, layout: FigureLayout = STANDARD) -> Normalize:
    """Return the norm of finite values, see ``number_ends``; colour limits of the layout are kept."""
    low, high = layout.ends(*number_ends(values, log))
    if log and low <= 0.0:
        raise InputError(f"vmin: found {low:g}, must be positive with a logarithmic norm")
    return LogNorm(low, high) if log else Normalize(low, high)


def signed_colormap(norm: Normalize, above: tuple[str, ...] = kinds.KIND_TABLE[kinds.SCALAR].scale.colors) -> Colormap:
    """Return the colormap for a norm: zero inside its limits is pale, and both sides darken equally with the distance
    from it.
    """
    low, high = float(norm.vmin or 0.0), float(norm.vmax or 0.0)
    if not low < 0.0 < high:
        return colormap_of(above)
    shares = np.linspace(low, high, 512) / max(-low, high)
    return ListedColormap(both_signs(above)(0.5 + 0.5 * shares), name="signed")


def both_signs(above: tuple[str, ...]) -> Colormap:
    """Return the colormap of negative and positive numbers, pale in the middle."""
    return colormap_of((*BELOW, "#f6f4f4", *above[1:]), 1024)


def error(view: MapView) -> MapLayers:
    """Return the layers of the error of the largest exponent, with a colorbar for each kind of error.

    The error is numerical for periodic or impact-free motion, a standard error for chaos, and the difference of two
    windows for a torus; see the table of variables in docs/data.md. Given colour limits apply to the standard error.
    """
    regime, known = view.plane.regime, view.plane.known_values(ERROR.name)
    # No error is below rounding, and a zero has no logarithm.
    known = np.where(known == 0.0, np.finfo(float).eps, np.maximum(known, np.finfo(float).tiny))
    known[~np.isfinite(known)] = np.nan
    fields = []
    for name, (colormap, codes) in ERRORS.items():
        values = np.where(np.isin(regime, codes), known, np.nan)
        if not np.all(np.isnan(values)):
            norm = color_norm(values, log=True, layout=view.page if CHAOTIC in codes else STANDARD)
            fields.append(ScalarLayer(colormap, norm, values, text.in_its_unit(view.ds, view.kind.scale.label), name))
    return build_layers(regime, fields=fields)


def draw_bars(
    fig: Figure,
    panels: Sequence[Axes],
    bars: Sequence[ScalarLayer],
    layout: FigureLayout = STANDARD,
    below: bool = False,
) -> None:
    """Draw the colorbars of plots to their right or below: one along all plots, or several stacked beside the first.

    Ends are pointed if values lie beyond the limits. The colorbar of exponents has a line at zero, where its step may
    change.
    """
    for place, bar in enumerate(bars):
        low, high = (default if end is None else end for end, default in ((bar.norm.vmin, 0.0), (bar.norm.vmax, 1.0)))
        values = bar.values[np.isfinite(bar.values) & (bar.values != 0.0)]  # zero has no logarithm, or its own entry
        beyond = int(np.any(values < low)) + 2 * int(np.any(values > high))
        extend, mappable = ("neither", "min", "max", "both")[beyond], ScalarMappable(bar.norm, bar.colormap)
        if bar.title:
            share, gap = 1.0 / len(bars), 0.13 if len(bars) > 1 else 0.05
            inset = panels[0].inset_axes((1.03, place * share, 0.035, share - gap))
            colorbar = fig.colorbar(mappable, cax=inset, extend=extend, extendfrac=0.05)
            size, pad = mpl.rcParams["legend.fontsize"], 3.0 + 5.0 * layout.scale
            inset.set_title(bar.title, loc="left", fontsize=size, pad=pad)
        else:
            side = "bottom" if below else "right"
            look: Any = {"aspect": 28, "pad": 0.02, "extendfrac": 0.03}
            beside: Any = panels[0] if len(panels) == 1 else list(panels)  # a single plot keeps its grid cell
            colorbar = fig.colorbar(mappable, ax=beside, location=side, extend=extend, **look)
            two = isinstance(bar.norm, TwoSlopeNorm) and -low != high
            colorbar.set_label(f"{bar.label}\n(two linear scales, joined at 0)" if two else bar.label)
        colorbar.outline.set_linewidth(0.6)
        if isinstance(bar.norm, LogNorm):
            _log_ticks(colorbar, low, high, limit=4 if len(bars) > 1 else 8)
        elif isinstance(bar.norm, TwoSlopeNorm):
            colorbar.set_ticks(_ticks(low, high, 3 if below else 5))  # numbers side by side need more room
            (colorbar.ax.axvline if below else colorbar.ax.axhline)(0.0, color="black", linewidth=0.7)
    if bars and bars[0].title:
        panels[0].annotate(
            bars[0].label, (1.065, 0.5), xycoords="axes fraction", xytext=(38.0 * layout.scale, 0.0),
            textcoords="offset points", rotation=90, va="center", fontsize=mpl.rcParams["axes.labelsize"],
        )  # fmt: skip


def _ticks(low: float, high: float, limit: int) -> list[float]:
    """Return round numbers on each half, whose steps may differ, and zero."""
    nice = MaxNLocator(limit, steps=[1, 2, 2.5, 5, 10])
    both = np.concatenate([nice.tick_values(low, 0.0), nice.tick_values(0.0, high)])
    return [float(tick) for tick in np.unique(both[(both >= low) & (both <= high)].round(12))]


def _log_ticks(bar: Colorbar, low: float, high: float, limit: int) -> None:
    """Set the ticks of a logarithmic colorbar: powers of ten over many decades, else 1, 2, 5 in plain numbers."""
    decades, axis = math.log10(high / low), bar.ax.yaxis
    if decades > 3.0 or high < 1e-3:
        bar.set_ticks(LogLocator(numticks=limit))
        if decades > 3.0:
            axis.set_minor_locator(NullLocator())
        axis.set_minor_formatter(NullFormatter())
        return
    fitting = [steps for steps in ((1.0, 2.0, 5.0), (1.0, 3.0), (1.0,)) if decades * len(steps) <= limit]
    raster.plain_ticks(axis, fitting[0] if fitting else (1.0,))
