"""Cells of a map as numbers instead of colours, for viewers that change the ends of the scale."""

from dataclasses import dataclass

import numpy as np

from atlas.render.layers import LINEAR, LOG, TWO_SIDED, Colors, Field, Layers, paint
from workers.results import PENDING

SIGNED = "signed"
"""Placement of a number v between the ends a and b, as a share of the colours. LINEAR, LOG and TWO_SIDED are (v - a) /
(b - a); the same with logarithms; zero in the middle, v / b above it and v / a below. SIGNED has zero in the middle,
and v / max(-a, b) on both sides."""
MOST = 2**24 - 1
"""The largest code."""

__all__ = ["LINEAR", "LOG", "MOST", "SIGNED", "TWO_SIDED", "PixelScale", "numbered", "on_white", "scale_of"]


@dataclass(frozen=True)
class PixelScale:
    """The scale of pixels with numbers.

    form     LINEAR, LOG, TWO_SIDED or SIGNED
    colors   (N, 4) in bytes, from the lower end to the upper
    span     the numbers of the codes 0 and MOST, the least and the largest of the cells; codes between are evenly
             spaced, for LOG in the logarithm, with an error of at most half a step
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
    """The colours of cells as in ``on_white``, but three-byte codes without alpha for colours given by a number.

    No codes and no scale if layers have several bars or ``scale_of`` finds no scale.
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
    """The scale of a field; None if its numbers are all equal, or their placement has no name."""
    form, colormap = field.form, field.colormap
    if field.signs is not None and field.ends[0] < 0.0 < field.ends[1]:
        form, colormap = SIGNED, field.signs[1]
    known = field.values[np.isfinite(field.values) & ((field.values > 0.0) | (form != LOG))]
    if form is None or known.size == 0 or known.min() == known.max():
        return None
    colors = np.asarray(colormap(np.arange(colormap.N), bytes=True))
    return PixelScale(form, colors, (float(known.min()), float(known.max())))
