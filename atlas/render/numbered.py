"""Pixels of a map that hold numbers instead of colours, for whoever shows them to change the ends of the scale."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray

from atlas.render import scales
from atlas.render.kinds import Kind
from atlas.render.painted import Colors, PaintedView, ScaleBar
from atlas.render.painters import PAINTERS
from atlas.render.scales import FORMS, both_signs

LINEAR, LOG, TWO_SIDED, SIGNED = *FORMS.values(), "signed"
"""How the place of a number v between the ends a and b is found, as a share of the colours: (v - a) / (b - a); the same
of logarithms; zero in the middle, v / b above it and v / a below; zero in the middle, v / max(-a, b) on both sides.
"""
MOST = 2**24 - 1
"""The largest code."""


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


def numbered(
    pixels: Colors, numbers: NDArray[np.int64], painted: PaintedView, kind: Kind
) -> tuple[Colors, PixelScale | None]:
    """A picture (rows, columns, 4) whose pixels have codes of three bytes and no alpha where a number coloured them.

    What was painted has one bar. ``numbers`` tells which cell each pixel shows, counted row by row. Pixels under lines
    and textures keep their colours, and so do all where ``scale_of`` finds no scale.
    """
    scale = scale_of(kind, painted.bars[0])
    if scale is None:
        return pixels, None
    values, colors = painted.bars[0].values.ravel(), painted.rgba.reshape(-1, 4)
    low, high = scale.span
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.log(values / low) / np.log(high / low) if scale.form == LOG else (values - low) / (high - low)
    is_number = np.isfinite(place)
    codes = np.rint(MOST * np.where(is_number, place, 0.0)).astype("<u4")[:, None].view(np.uint8)
    shown = is_number[numbers] & (pixels == colors[numbers]).all(axis=-1)
    return np.where(shown[..., None], codes[numbers], pixels), scale


def scale_of(kind: Kind, bar: ScaleBar) -> PixelScale | None:
    """The scale of a bar; None where its numbers do not differ, or are placed in no way that has a name."""
    form = FORMS.get(type(bar.norm))
    ends, colormap = (float(bar.norm.vmin or 0.0), float(bar.norm.vmax or 0.0)), bar.colormap
    if PAINTERS[kind.name] is scales.scalar and form == LINEAR and ends[0] < 0.0 < ends[1]:
        form, colormap = SIGNED, both_signs(kind.scale.colors)
    known = bar.values[np.isfinite(bar.values) & ((bar.values > 0.0) | (form != LOG))]
    if form is None or known.size == 0 or known.min() == known.max():
        return None
    colors = np.asarray(colormap(np.arange(colormap.N), bytes=True))
    return PixelScale(form, colors, (float(known.min()), float(known.max())))


def cell_numbers(canvas: FigureCanvasAgg, ax: Axes, shape: tuple[int, int]) -> NDArray[np.int64]:
    """Which cell of a map, counted row by row, each pixel of its figure shows. All but the cells leaves the figure."""
    cells = [*ax.get_images(), *ax.collections][0]
    for each in (*canvas.figure.axes, *canvas.figure.legends, *ax.get_children()):
        each.set_visible(each in (ax, cells))
    numbers = np.arange(shape[0] * shape[1], dtype="<u4")
    colors = numbers.view(np.uint8).reshape(*shape, 4).copy()
    colors[..., 3] = 255
    cells.set_array(colors)
    canvas.draw()
    found = np.ascontiguousarray(canvas.buffer_rgba()).view("<u4")[..., 0] & MOST
    return np.minimum(found, numbers.size - 1).astype(np.int64)
