"""Maps that colour cells by a number, each with a colormap and a labelled colorbar.

The functions return layers: styles, numbers and hatches of cells, from which a figure is drawn.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Colormap, LinearSegmentedColormap, ListedColormap, LogNorm, Normalize, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query.extremes import variable_of
from atlas.render import class_maps, kinds, raster, style, text
from atlas.render.color_limits import number_ends, scale_ends
from atlas.render.layers import Class, HatchLayer, MapLayers, MapView, ScalarLayer, build_layers
from atlas.render.layout import STANDARD, FigureLayout
from atlas.render.outlines import without_dust
from workers.results import CHAOTIC, LARGEST, NO_IMPACT, UNDETERMINED

Array = NDArray[np.float64]

BELOW = ("#0b2520", "#1e4d44", "#3f7b70", "#6faaa0", "#a9d3cb")
"""Colours of negative numbers in a colormap of both signs, from the largest to the smallest."""
_LOG_TICKS = 8
"""Maximum number of ticks of a logarithmic colorbar."""
NEUTRAL = "#e4e2d6"
"""Colour of cells whose motion is known but has no value of the mapped variable, and of 0 with a logarithmic norm."""


@cache
def colormap_of(colors: tuple[str, ...], steps: int = 512) -> LinearSegmentedColormap:
    """Return a colormap of ``steps`` colours, interpolated between the given colours, which are evenly spaced."""
    return LinearSegmentedColormap.from_list("scale", colors, N=steps)


# The step in hue at zero keeps the border of chaos sharp between small exponents of both signs.
_PLACES = [*np.linspace(0.0, 0.5, len(kinds.STABLE)), *np.linspace(0.5, 1.0, len(kinds.CHAOTIC))]
EXPONENT = LinearSegmentedColormap.from_list(
    "exponent", list(zip(_PLACES, (*kinds.STABLE, *kinds.CHAOTIC), strict=True)), N=1024
)
CHAOS = colormap_of(kinds.CHAOTIC)


def exponent(view: MapView, norm: TwoSlopeNorm | None = None) -> MapLayers:
    """Return the layers of the chaos map: the largest Lyapunov exponent, blue if stable, orange to dark red for chaos.

    ``norm`` is given if several maps share their colour limits. Impact-free cells have exponents, too, and a hatch.
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
    """Return the norm of exponents between ``low`` and ``high``, or the limits that the layout sets.

    Raise InputError unless zero lies between the limits.
    """
    low, high = layout.ends(low, high)
    if not low < 0.0 < high:
        raise InputError(f"colour limits of exponents: found {low:g} to {high:g}, must have zero between them")
    return TwoSlopeNorm(0.0, low, high)


def combined(view: MapView) -> MapLayers:
    """Return the layers of a map of the period of periodic motion and the largest exponent of chaotic motion."""
    regime = view.plane.regime
    largest = np.where(regime == CHAOTIC, view.plane[LARGEST.name], np.nan)
    norm = Normalize(*view.page.ends(0.0, scale_ends(largest)[1]))
    # The colorbar names the chaotic cells; a chaotic cell without an exponent looks like its regime.
    field = ScalarLayer(CHAOS, norm, largest, text.in_its_unit(view.ds, view.kind.scale.label))
    return build_layers(regime, class_maps.by_period(view.plane), field)


def scalar(view: MapView) -> MapLayers:
    """Return the layers of a map of the requested variable, in the colours of its row in ``SCALES``.

    A variable without a row is drawn from pale to dark. Unless the norm is logarithmic, there are two ranges of colours
    around zero. Cells without such a number have the colour NEUTRAL, with a hatch for -inf. Raise InputError for a
    logarithmic norm of negative numbers.
    """
    plane, name = view.plane, str(view.request.variable)
    scale, meant, regime = kinds.SCALES.get(name, kinds.NUMBERS), variable_of(view.ds, name), plane.regime
    log, label = scale.log or view.request.log, scale.label or text.variable_label(view.ds, name)
    counted = plane.determined_mask | (scale.undetermined & (regime == UNDETERMINED))
    values = np.where(counted & np.isin(regime, list(meant.regimes)), plane[name], np.nan).astype(np.float64)
    values[meant.allows_infinite & (values < 0.0)] = np.nan  # sticking orbits have infinitely many impacts
    if log and np.any(values < 0.0):
        raise InputError(f"{name!r} has values below zero, which a logarithmic scale cannot show")
    norm, known = color_norm(values, log, view.page), ~np.isnan(values)
    zero = known & (values == 0.0) & (log or scale.zero is not None)
    none = ~known & plane.determined_mask & (regime != NO_IMPACT)
    zero_class = [(zero, *scale.zero)] if scale.zero else []
    unknown = none if zero_class else zero | none
    meaning = " or ".join(word for word, cells in (("0", zero & unknown), ("no such number", none)) if cells.any())
    signs = None if log else (colormap_of(scale.colors), both_signs(scale.colors))
    has_bar = bool(np.isfinite(values[~zero]).any())
    colormap = signed_colormap(norm, scale.colors)
    field = ScalarLayer(colormap, norm, values, text.in_its_unit(view.ds, label), signs=signs, bar=has_bar)
    return _scaled(view, field, [*zero_class, (unknown, NEUTRAL, meaning)])


def _scaled(view: MapView, field: ScalarLayer, others: Sequence[Class] = ()) -> MapLayers:
    """Return the layers of a map: cells in the colours of their numbers, and classes of other cells.

    Cells without a number have the colour of their regime. Exponents of -inf, below any limit, have a hatch over the
    lowest colour.
    """
    lost, name = np.isneginf(field.values), rf"$-\infty$: {text.rest(view.ds)} erases disturbances"
    textures = [HatchLayer.on_color(field.colormap(0.0), lost, style.LOST_HATCH, name)] if lost.any() else []
    return build_layers(view.plane.regime, others, field, textures=textures)


def color_norm(values: Array, log: bool, layout: FigureLayout = STANDARD) -> Normalize:
    """Return the norm of the finite values of an array, between the limits of the layout or else of ``number_ends``."""
    low, high = layout.ends(*number_ends(values, log))
    if log and low <= 0.0:
        raise InputError(f"vmin: found {low:g}, must be positive with a logarithmic norm")
    return LogNorm(low, high) if log else Normalize(low, high)


def signed_colormap(norm: Normalize, above: tuple[str, ...] = kinds.NUMBERS.colors) -> Colormap:
    """Return the colormap for a norm, pale at zero if zero lies inside its limits.

    Both sides then darken equally with the distance from zero. ``above`` are the colours of positive numbers.
    """
    low, high = float(norm.vmin or 0.0), float(norm.vmax or 0.0)
    if not low < 0.0 < high:
        return colormap_of(above)
    shares = np.linspace(low, high, 512) / max(-low, high)
    return ListedColormap(both_signs(above)(0.5 + 0.5 * shares), name="signed")


def both_signs(above: tuple[str, ...]) -> Colormap:
    """Return a colormap for limits symmetric about zero, pale in the middle; ``above`` colours positive numbers."""
    return colormap_of((*BELOW, "#f6f4f4", *above[1:]), 1024)


def draw_bar(
    fig: Figure, panels: Sequence[Axes], bar: ScalarLayer, layout: FigureLayout = STANDARD, below: bool = False
) -> None:
    """Draw the colorbar of the plots ``panels`` to their right or ``below`` them.

    Its ends are pointed if values lie beyond the limits. The colorbar of exponents has a line at zero, where the linear
    scales of its two halves meet.
    """
    low, high = bar.ends
    values = bar.values[np.isfinite(bar.values) & (bar.values != 0.0)]  # zero has no logarithm, or its own entry
    beyond = int(np.any(values < low)) + 2 * int(np.any(values > high))
    extend, mappable = ("neither", "min", "max", "both")[beyond], ScalarMappable(bar.norm, bar.colormap)
    look: Any = {"aspect": 28, "pad": 0.02, "extendfrac": 0.03, "location": "bottom" if below else "right"}
    host_axes: Any = panels[0] if len(panels) == 1 else list(panels)  # a single plot keeps its grid cell
    colorbar = fig.colorbar(mappable, ax=host_axes, extend=extend, **look)
    two = isinstance(bar.norm, TwoSlopeNorm) and -low != high
    colorbar.set_label(f"{bar.label}\n(two linear scales, joined at 0)" if two else bar.label)
    colorbar.outline.set_linewidth(0.6)
    if isinstance(bar.norm, LogNorm):
        _log_ticks(colorbar, low, high)
    elif isinstance(bar.norm, TwoSlopeNorm):
        colorbar.set_ticks(_ticks(low, high, 3 if below else 5))  # numbers side by side need more room
        (colorbar.ax.axvline if below else colorbar.ax.axhline)(0.0, color="black", linewidth=0.7)


def _ticks(low: float, high: float, limit: int) -> list[float]:
    """Return zero and round numbers from ``low`` to ``high``, with a step of its own on either side of zero."""
    nice = MaxNLocator(limit, steps=[1, 2, 2.5, 5, 10])
    both = np.concatenate([nice.tick_values(low, 0.0), nice.tick_values(0.0, high)])
    return [float(tick) for tick in np.unique(both[(both >= low) & (both <= high)].round(12))]


def _log_ticks(bar: Colorbar, low: float, high: float) -> None:
    """Set the ticks of a logarithmic colorbar: powers of ten over many decades, else 1, 2, 5 in plain numbers."""
    decades, axis = math.log10(high / low), bar.ax.yaxis
    if decades > 3.0 or high < 1e-3:
        bar.set_ticks(LogLocator(numticks=_LOG_TICKS))
        if decades > 3.0:
            axis.set_minor_locator(NullLocator())
        axis.set_minor_formatter(NullFormatter())
        return
    fitting = [steps for steps in ((1.0, 2.0, 5.0), (1.0, 3.0), (1.0,)) if decades * len(steps) <= _LOG_TICKS]
    raster.plain_ticks(axis, fitting[0] if fitting else (1.0,))
