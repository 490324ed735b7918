"""Maps that colour cells by a number, each with a colour scale and a labelled colorbar.

The functions return layers: styles, numbers and hatches of cells, from which a figure is drawn.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query.extremes import variable_of
from atlas.render import class_maps, kinds, looks, scales, text
from atlas.render.layers import Class, HatchLayer, MapLayers, MapView, ScalarLayer, build_layers
from atlas.render.outlines import without_dust
from atlas.render.scales import ColorMapping
from workers.results import CHAOTIC, LARGEST, NO_IMPACT, UNDETERMINED

if TYPE_CHECKING:
    from atlas.render.layout import FigureLayout

Array = NDArray[np.float64]

NEUTRAL = "#e4e2d6"
"""Colour of cells whose motion is known but has no value of the mapped variable, and of 0 with a logarithmic norm."""


def exponent(view: MapView, ends: tuple[float, float] | None = None) -> MapLayers:
    """Return the layers of the chaos map: the largest Lyapunov exponent, blue if stable, orange to dark red for chaos.

    ``ends`` are given if several maps share their colour limits. Impact-free cells have exponents, too, and a hatch.
    """
    regime, largest = view.plane.regime, view.plane.known_values(LARGEST.name)
    scale = exponent_scale(*(ends or view.page.ends(*scales.scale_ends(largest))))
    layers = _scaled(view, ScalarLayer(scale, largest, text.in_its_unit(view.ds, view.kind.scale.label)))
    quiet = (regime == NO_IMPACT) & ~np.isnan(largest)
    if not quiet.any():
        return layers
    color, name = scale.hex(float(np.median(largest[quiet]))), text.regime(view.ds).meaning(NO_IMPACT).text
    texture = HatchLayer.on_color(color, quiet, looks.HATCH[NO_IMPACT], name, without_dust(quiet))
    return replace(layers, textures=[texture, *layers.textures])


def exponent_scale(low: float, high: float) -> ColorMapping:
    """Return the colour scale of exponents. Raise InputError unless zero lies between the limits."""
    if not low < 0.0 < high:
        raise InputError(f"colour limits of exponents: found {low:g} to {high:g}, must have zero between them")
    return ColorMapping(scales.TWO_SIDED, (low, high), scales.EXPONENT)


def combined(view: MapView) -> MapLayers:
    """Return the layers of a map of the period of periodic motion and the largest exponent of chaotic motion."""
    regime = view.plane.regime
    largest = np.where(regime == CHAOTIC, view.plane[LARGEST.name], np.nan)
    scale = ColorMapping(scales.LINEAR, view.page.ends(0.0, scales.scale_ends(largest)[1]), scales.CHAOS)
    # The colorbar names the chaotic cells; a chaotic cell without an exponent looks like its regime.
    field = ScalarLayer(scale, largest, text.in_its_unit(view.ds, view.kind.scale.label))
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
    known = ~np.isnan(values)
    zero = known & (values == 0.0) & (log or scale.zero is not None)
    none = ~known & plane.determined_mask & (regime != NO_IMPACT)
    zero_class = [(zero, *scale.zero)] if scale.zero else []
    unknown = none if zero_class else zero | none
    meaning = " or ".join(word for word, cells in (("0", zero & unknown), ("no such number", none)) if cells.any())
    has_bar = bool(np.isfinite(values[~zero]).any())
    numbers = number_scale(values, log, view.page, scale.colors)
    field = ScalarLayer(numbers, values, text.in_its_unit(view.ds, label), has_bar)
    return _scaled(view, field, [*zero_class, (unknown, NEUTRAL, meaning)])


def _scaled(view: MapView, field: ScalarLayer, others: Sequence[Class] = ()) -> MapLayers:
    """Return the layers of a map: cells in the colours of their numbers, and classes of other cells.

    Cells without a number have the colour of their regime. Exponents of -inf, below any limit, have a hatch over the
    lowest colour.
    """
    lost, name = np.isneginf(field.values), rf"$-\infty$: {text.rest(view.ds)} erases disturbances"
    textures = [HatchLayer.on_color(field.scale.hex(-np.inf), lost, looks.LOST_HATCH, name)] if lost.any() else []
    return build_layers(view.plane.regime, others, field, textures=textures)


def number_scale(
    values: Array, log: bool, layout: "FigureLayout", colors: tuple[str, ...] = kinds.NUMBERS.colors
) -> ColorMapping:
    """Return the colour scale of the finite values of an array, between the limits of the layout or of ``number_ends``.

    On a linear scale zero is pale if it lies inside the limits. ``colors`` are those of positive numbers.
    """
    low, high = layout.ends(*scales.number_ends(values, log))
    if log and low <= 0.0:
        raise InputError(f"vmin: found {low:g}, must be positive with a logarithmic norm")
    both = None if log else scales.both_signs(colors)
    return ColorMapping(scales.LOG if log else scales.LINEAR, (low, high), scales.color_table(colors), both)
