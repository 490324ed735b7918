"""Cells of a map that hold numbers instead of colours, for whoever shows them to change the ends of the scale."""

from dataclasses import dataclass

import numpy as np

from atlas.render.layers import LINEAR, LOG, TWO_SIDED, Colors, Field, Layers, paint
from workers.results import PENDING

SIGNED = "signed"
"""How the place of a number v between the ends a and b is found, as a share of the colours, besides LINEAR, LOG and
TWO_SIDED, which are (v - a) / (b - a); the same of logarithms; zero in the middle, v / b above it and v / a below. Here
zero is in the middle, and v / max(-a, b) on both sides.
"""
MOST = 2**24 - 1
"""The largest code."""

__all__ = ["LINEAR", "LOG", "MOST", "SIGNED", "TWO_SIDED", "PixelScale", "numbered", "on_white", "scale_of"]


@dataclass(frozen=True)
class PixelScale:
    """The scale of pixels that hold numbers.

    form     LINEAR, LOG, TWO_SIDED or SIGNED
    colors   (N, 4) in bytes, from the lower end to the upper
    span     the numbers of the codes 0 and MOST, which are the least and the largest of the cells; codes between are
             evenly spaced, of LOG in the logarithm, so that a number is off by half a step at most
    """

    form: str
    colors: Colors
    span: tuple[float, float]


def on_white(layers: Layers) -> Colors:
    """The colours of cells (y, x, 4) in bytes, pending ones white."""
    rgba = paint(layers)
    rgba[layers.as_regime(PENDING)] = 255
    return rgba


def numbered(layers: Layers) -> tuple[Colors, PixelScale | None]:
    """The colours of cells as in ``on_white``, but codes of three bytes without alpha where a number gives the colour.

    There are none, and no scale, where layers have several bars or ``scale_of`` finds no scale.
    """
    rgba, fields = on_white(layers), layers.fields
    scale = scale_of(fields[0]) if len(fields) == len(layers.bars) == 1 else None
    if scale is None:
        return rgba, None
    (low, high), values = scale.span, fields[0].values
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.log(values / low) / np.log(high / low) if scale.form == LOG else (values - low) / (high - low)
    coded = layers.on_field(0) & np.isfinite(place)
    rgba[coded] = np.rint(MOST * place[coded]).astype("<u4")[:, None].view(np.uint8)
    return rgba, scale


def scale_of(field: Field) -> PixelScale | None:
    """The scale of a field; None where its numbers do not differ, or are placed in no way that has a name."""
    form, colormap = field.form, field.colormap
    if field.signs is not None and field.ends[0] < 0.0 < field.ends[1]:
        form, colormap = SIGNED, field.signs[1]
    known = field.values[np.isfinite(field.values) & ((field.values > 0.0) | (form != LOG))]
    if form is None or known.size == 0 or known.min() == known.max():
        return None
    colors = np.asarray(colormap(np.arange(colormap.N), bytes=True))
    return PixelScale(form, colors, (float(known.min()), float(known.max())))
