"""A map as data, before colours are applied: a style for each cell, and layers of numbers, hatches, points and labels.

Colours are applied last, so that a matplotlib figure and a web page can be made from the same layers.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import xarray as xr
from matplotlib.colors import Colormap, LogNorm, Normalize, TwoSlopeNorm
from matplotlib.patches import Patch
from matplotlib.typing import ColorType
from numpy.typing import NDArray

from atlas.query.plane import Cells, Plane
from atlas.render import style
from atlas.render.kinds import PictureKind
from atlas.render.layout import FigureLayout
from atlas.render.request import PictureRequest
from atlas.store.schema import REGIME_COLORS
from workers.results import NO_IMPACT, PENDING, REGIME, REGIMES

Array = NDArray[np.float64]
Colors = NDArray[np.uint8]
Class: TypeAlias = tuple[Cells, str, str]
"""A class of cells: mask (y, x), colour and name."""

LINEAR, LOG, TWO_SIDED = "linear", "log", "two-sided"
_FORMS = {Normalize: LINEAR, LogNorm: LOG, TwoSlopeNorm: TWO_SIDED}
"""Names of the norms, for web pages that apply the norms themselves."""


@dataclass(frozen=True)
class MapView:
    """All that a map is made from: the kind of map, the atlas, the cells of its plane, and the requested picture.

    kind      kind of map
    ds        dataset of the atlas
    plane     cells of the visible plane, with the variables that the map needs
    request   validated options of the picture
    """

    kind: PictureKind
    ds: xr.Dataset
    plane: Plane
    request: PictureRequest

    @property
    def page(self) -> FigureLayout:
        """The layout of the figure."""
        return self.request.page


@dataclass(frozen=True)
class LegendEntry:
    """An entry of a legend: a colour, optionally hatched or darkened.

    color           colour of the box
    label           text of the entry
    hatch           pattern over the colour, None for none
    hatch_color     colour of the hatch
    min_brightness  brightness at the dark end of a darkened entry
    regime          code of the regime that the entry explains, None for other entries
    """

    color: ColorType
    label: str
    hatch: str | None = None
    hatch_color: str = style.TEXTURE
    min_brightness: float = 1.0
    regime: int | None = None

    @classmethod
    def from_regime(cls, code: int) -> "LegendEntry":
        """Return the legend entry of cells that have the colour of a regime, with the regime's hatch if it has one.

        The dots of impact-free cells are left out, since they mark only cells that have another colour.
        """
        hatch = None if code == NO_IMPACT else style.HATCH.get(code)
        ink = style.HATCH_INK.get(code, style.TEXTURE)
        return cls(REGIME_COLORS[code], REGIME.meaning(code).text, hatch, ink, regime=code)

    def to_artist(self) -> Patch:
        """Return the entry as a matplotlib artist."""
        if self.min_brightness < 1.0:
            return style.GradientPatch(self.color, self.min_brightness, self.label)
        return style.swatch(self.color, self.label, self.hatch, self.hatch_color)


class CellStyle(NamedTuple):
    """How cells are drawn: in a colour, or with ``by_number`` in the colour that the map's colormap gives their number.

    ``regime`` is the code of a regime if the cells are drawn like all cells of the regime.
    """

    color: str = "#ffffff"
    by_number: bool = False
    regime: int | None = None


class HatchLayer(NamedTuple):
    """A hatch over the cells (y, x) of a mask; the cells' colours show through.

    ``outlined`` is a mask of cells with an outline, and ``entry`` the entry in the legend.
    """

    cells: Cells
    hatch: str
    hatch_color: str
    outlined: Cells | None = None
    entry: LegendEntry | None = None

    @classmethod
    def on_color(cls, color: Any, cells: Cells, hatch: str, label: str, outlined: Cells | None = None) -> "HatchLayer":
        """Return a hatch over ``cells``, in an ink that is visible on ``color``, with its legend entry ``label``."""
        ink = style.ink_on(color)
        return cls(cells, hatch, ink, outlined, LegendEntry(color, label, hatch, ink))


@dataclass(frozen=True, eq=False)
class ScalarLayer:
    """Numbers of cells (y, x), NaN for cells without a number, with a colormap and a norm.

    colormap  colours of the numbers
    norm      placement of the numbers on the colormap
    values    (y, x) the numbers
    label     label of the colorbar
    signs     colormaps for positive numbers and for both signs, if zero may lie inside the limits; ``colormap`` is the
              first, or a part of the second
    bar       True if the layer has a colorbar
    """

    colormap: Colormap
    norm: Normalize
    values: Array
    label: str
    signs: tuple[Colormap, Colormap] | None = None
    bar: bool = True

    @property
    def form(self) -> str | None:
        """The name of the norm by which a web page knows it; None if it has no name."""
        return _FORMS.get(type(self.norm))

    @property
    def ends(self) -> tuple[float, float]:
        """The lower and the upper colour limit."""
        return float(self.norm.vmin or 0.0), float(self.norm.vmax or 0.0)

    def colors(self, values: Array) -> Colors:
        """Return the colours (..., 4), in bytes, of values.

        On a logarithmic scale zero, which has no logarithm, gets the colour of the lower limit.
        """
        least = self.ends[0]
        placed = self.norm(np.where(np.isnan(values), least, np.maximum(values, least)))
        return np.asarray(self.colormap(placed, bytes=True))


class ShadingLayer(NamedTuple):
    """Darkening of the cells' colours by numbers (y, x); cells with NaN are not darkened.

    Brightness falls from 1 at ``low`` to ``min_brightness`` at ``high``.
    """

    values: Array
    low: float
    high: float
    min_brightness: float

    @property
    def brightness(self) -> Array:
        """The remaining brightness of each cell, from 1 to ``min_brightness``; NaN for cells that are not darkened."""
        return 1.0 - (1.0 - self.min_brightness) * np.clip(
            (self.values - self.low) / max(self.high - self.low, 1.0), 0.0, 1.0
        )


class PointLayer(NamedTuple):
    """Points (n, 2) over a map; ``look`` gives their marker, size and colours as arguments of ``style.mark``."""

    points: Array
    look: tuple[str, float, str, str, float]


@dataclass(frozen=True, eq=False)
class MapLayers:
    """All layers of a map.

    codes              (y, x) index of each cell's style in ``styles``
    styles             how cells of each code are drawn
    legend             entries for the styles
    scalar             numbers of cells with their colours; None if no cell is coloured by a number
    textures           hatch layers
    shade              darkening of the colours; None if there is none
    points             point layers
    point_entry        legend entry of the points: label, and arguments of ``style.mark``
    side_legend_title  title of a legend to the right of the map; None for a legend below
    names              masks (y, x) of cells with a label and the colour under it; a label is drawn where it fits
    """

    codes: NDArray[np.intp]
    styles: Sequence[CellStyle]
    legend: Sequence[LegendEntry]
    scalar: ScalarLayer | None = None
    textures: Sequence[HatchLayer] = ()
    shade: ShadingLayer | None = None
    points: Sequence[PointLayer] = ()
    point_entry: tuple[str, tuple[str, float, str, str, float]] | None = None
    side_legend_title: str | None = None
    names: Sequence[Class] = ()

    @property
    def entries(self) -> list[LegendEntry]:
        """The entries of the legend, without the entry of the points."""
        return [*self.legend, *(texture.entry for texture in self.textures if texture.entry is not None)]

    @property
    def bar(self) -> ScalarLayer | None:
        """The numbers of cells with their colours if the map has a colorbar for them, else None."""
        return self.scalar if self.scalar is not None and self.scalar.bar else None

    @property
    def cells_by_number(self) -> Cells:
        """The mask (y, x) of the cells whose colour is that of their number."""
        return np.isin(self.codes, [code for code, look in enumerate(self.styles) if look.by_number])

    def as_regime(self, regime: int) -> Cells:
        """Return the mask (y, x) of cells that are drawn in the colour of a regime, given by its code."""
        return np.isin(self.codes, [code for code, look in enumerate(self.styles) if look.regime == regime])


def build_layers(
    regime: NDArray[np.int8],
    classes: Iterable[Class] = (),
    scalar: ScalarLayer | None = None,
    numbered: tuple[NDArray[np.int64], Sequence[str]] | None = None,
    legend: Sequence[LegendEntry] = (),
    **others: Any,
) -> MapLayers:
    """Return the layers of a map of cells (y, x): classes cover numbers, and numbers cover numbered cells.

    regime    (y, x) codes of regimes; cells without any other style are drawn in the colour of their regime
    classes   classes of cells: mask, colour and name
    scalar    numbers that are coloured by a colormap
    numbered  index (y, x) of each cell's colour, -1 for none, and the list of colours
    legend    entries before those of the classes
    others    further fields of ``MapLayers``
    """
    number, colors = (np.full(regime.shape, -1), ()) if numbered is None else numbered
    codes, looks, entries = number.astype(np.intp), [CellStyle(color) for color in colors], [*legend]
    if scalar is not None:
        codes[~np.isnan(scalar.values)] = len(looks)
        looks.append(CellStyle(by_number=True))
    for cells, color, name in classes:
        if cells.any():
            codes[cells] = len(looks)
            looks.append(CellStyle(color))
            entries.append(LegendEntry(color, name))
    rest = codes < 0
    for entry in sorted(REGIMES, key=lambda regime: regime.code == PENDING):  # pending comes last in the legend
        cells = rest & (regime == entry.code)
        codes[cells] = len(looks)
        looks.append(CellStyle(REGIME_COLORS[entry.code], regime=entry.code))
        entries += [LegendEntry.from_regime(entry.code)] if cells.any() else []
    codes[codes < 0] = len(looks) - 1
    return MapLayers(codes, looks, entries, scalar, **others)


def paint(layers: MapLayers) -> Colors:
    """Return the colours of the cells of a map, (y, x, 4) in bytes.

    Cells that are not solved yet (pending) are transparent, to show the hatch below.
    """
    table = [style.rgb(look.color, alpha=0 if look.regime == PENDING else 255) for look in layers.styles]
    rgba = np.array(table, np.uint8)[layers.codes]
    if layers.scalar is not None:
        cells = layers.cells_by_number
        rgba[cells] = layers.scalar.colors(layers.scalar.values[cells])
    if layers.shade is not None:
        brightness = layers.shade.brightness
        shaded_mask = ~np.isnan(brightness)
        rgba[shaded_mask, :3] = (rgba[shaded_mask, :3] * brightness[shaded_mask][:, None]).astype(np.uint8)
    return rgba
