"""A map as plain data: a style for each cell, layers of numbers, hatches and points, labels, legend, and overlays.

Figures of Matplotlib and web pages are drawn from the same layers and overlays.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, Self, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from atlas.query.plane import Cells, Plane
from atlas.query.resample import read_view
from atlas.render.kinds import PictureKind
from atlas.render.looks import HATCH, HATCH_INK, LegendEntry, LineLook, MarkLook, ink_on, rgb
from atlas.render.request import PictureRequest
from atlas.render.scales import ColorMapping
from atlas.store.schema import REGIME_COLORS
from workers.results import FAILED, INVALID, NO_IMPACT, PENDING, REGIMES, UNDETERMINED

if TYPE_CHECKING:
    from atlas.render.layout import FigureLayout

Array = NDArray[np.float64]
Colors = NDArray[np.uint8]
Class: TypeAlias = tuple[Cells, str, str]
"""A class of cells: mask (y, x), colour and name."""

COVERED = tuple(code for code in HATCH if code not in (PENDING, NO_IMPACT))
"""Regimes with a hatch over their colour; the hatch of pending cells lies below them."""
MARKED = (UNDETERMINED, INVALID, FAILED)
"""Regimes whose cells are marked where they are too small to be seen."""


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
    def page(self) -> "FigureLayout":
        """The layout of the figure."""
        return self.request.page

    @classmethod
    def read(cls, kind: PictureKind, ds: xr.Dataset, request: PictureRequest) -> Self:
        """Read the variables and regimes that a map and its overlays need, at most at the resolution of the pixels.

        Raise InputError if the atlas lacks one of the variables. No other function of maps reads an atlas.
        """
        names = [*kind.variables] if request.variable is None else [request.variable]
        kind.require(ds, names)
        seen = read_view(ds, names, pixels=request.pixels or request.page.map_pixels)
        return cls(kind, ds, Plane.from_dataset(seen, names), request)


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
    def on_color(cls, color: str, cells: Cells, hatch: str, label: str, outlined: Cells | None = None) -> "HatchLayer":
        """Return a hatch over ``cells``, in an ink that is visible on ``color``, with its legend entry ``label``."""
        ink = ink_on(color)
        return cls(cells, hatch, ink, outlined, LegendEntry(color, label, hatch, ink))


@dataclass(frozen=True, eq=False)
class ScalarLayer:
    """Numbers of cells (y, x), NaN for cells without a number, with their colour scale.

    scale   colours of the numbers
    values  (y, x) the numbers
    label   label of the colorbar
    bar     True if the layer has a colorbar
    """

    scale: ColorMapping
    values: Array
    label: str
    bar: bool = True

    @property
    def ends(self) -> tuple[float, float]:
        """The lower and the upper colour limit."""
        return self.scale.ends


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
    """Points (n, 2) over a map, and how they are drawn."""

    points: Array
    look: MarkLook


class OverlayLine(NamedTuple):
    """A line of an overlay: its kind, and its points (N, 2)."""

    kind: str
    points: Array


Spot: TypeAlias = tuple[str, float, float]
"""A marked point of an overlay: its kind, x and y."""


@dataclass(frozen=True)
class Overlay:
    """Lines and marks over a map.

    looks    how the kinds of lines are drawn, in the order of the legend
    lines    the lines; lines outside the plane are left out when they are drawn
    marks    how the kinds of marked points are drawn, in the order of the legend
    corners  the marked points
    ends     ends of lines, with the kind of the line
    regions  (y, x) numbers of cells; the borders between different numbers are drawn as the only kind of ``looks``
    none     note in the legend if nothing of the overlay is visible
    """

    looks: Mapping[str, LineLook] = field(default_factory=dict)
    lines: Sequence[OverlayLine] = ()
    marks: Mapping[str, MarkLook] = field(default_factory=dict)
    corners: Sequence[Spot] = ()
    ends: Sequence[Spot] = ()
    regions: NDArray[np.int16] | None = None
    none: str = ""


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
    point_entry        legend entry of the points; None without points
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
    point_entry: MarkLook | None = None
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
    textures: Sequence[HatchLayer] = (),
    **others: Any,
) -> MapLayers:
    """Return the layers of a map of cells (y, x): classes cover numbers, and numbers cover numbered cells.

    regime    (y, x) codes of regimes; cells without any other style are drawn in the colour of their regime
    classes   classes of cells: mask, colour and name
    scalar    numbers that are coloured by a colormap
    numbered  index (y, x) of each cell's colour, -1 for none, and the list of colours
    legend    entries before those of the classes
    textures  hatches over those of the regimes
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
    rest, hatches = codes < 0, list[HatchLayer]()
    for entry in sorted(REGIMES, key=lambda regime: regime.code == PENDING):  # pending comes last in the legend
        cells = rest & (regime == entry.code)
        codes[cells] = len(looks)
        looks.append(CellStyle(REGIME_COLORS[entry.code], regime=entry.code))
        entries += [LegendEntry.from_regime(entry.code)] if cells.any() else []
        if entry.code in COVERED and cells.any():
            hatches.append(HatchLayer(cells, HATCH[entry.code], HATCH_INK[entry.code]))
    codes[codes < 0] = len(looks) - 1
    return MapLayers(codes, looks, entries, scalar, [*hatches, *textures], **others)


def paint(layers: MapLayers) -> Colors:
    """Return the colours of the cells of a map, (y, x, 4) in bytes.

    Cells that are not solved yet (pending) are transparent, to show the hatch below.
    """
    table = [(*rgb(look.color), 0 if look.regime == PENDING else 255) for look in layers.styles]
    rgba = np.array(table, np.uint8)[layers.codes]
    if layers.scalar is not None:
        cells = layers.cells_by_number
        rgba[cells, :3] = layers.scalar.scale.colors(layers.scalar.values[cells])
    if layers.shade is not None:
        brightness = layers.shade.brightness
        shaded_mask = ~np.isnan(brightness)
        rgba[shaded_mask, :3] = (rgba[shaded_mask, :3] * brightness[shaded_mask][:, None]).astype(np.uint8)
    return rgba
