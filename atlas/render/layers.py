"""A map as data: codes of cells and their looks, fields on scales, textures, points, names; colours come last."""

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
from workers.results import NO_IMPACT, PENDING, REGIME, REGIMES

Array = NDArray[np.float64]
Colors = NDArray[np.uint8]
Class: TypeAlias = tuple[Cells, str, str]
"""Cells (y, x), their colour and their name."""

LINEAR, LOG, TWO_SIDED = "linear", "log", "two-sided"
_FORMS = {Normalize: LINEAR, LogNorm: LOG, TwoSlopeNorm: TWO_SIDED}
"""Placement of a number on a scale, for pages that do it themselves."""


@dataclass(frozen=True)
class MapView:
    """The cells of an atlas in view, a kind of map, and the look of its drawing."""

    kind: PictureKind
    ds: xr.Dataset
    plane: Plane
    wanted: PictureRequest

    @property
    def page(self) -> FigureLayout:
        """The page of the drawing."""
        return self.wanted.page


@dataclass(frozen=True)
class LegendEntry:
    """A legend entry: a colour with its texture, or one that darkens to a share of its brightness.

    ``regime``: the code of the regime that it explains.
    """

    color: ColorType
    label: str
    hatch: str | None = None
    hatch_color: str = style.TEXTURE
    min_brightness: float = 1.0
    regime: int | None = None

    @classmethod
    def from_regime(cls, code: int) -> "LegendEntry":
        """The entry of cells in the colour of this regime; impact-free cells in another colour get a texture."""
        hatch = None if code == NO_IMPACT else style.HATCH.get(code)
        ink = style.HATCH_INK.get(code, style.TEXTURE)
        return cls(style.COLORS[code], REGIME.meaning(code).text, hatch, ink, regime=code)

    def to_artist(self) -> Patch:
        """The entry as a matplotlib artist."""
        if self.min_brightness < 1.0:
            return style.GradientPatch(self.color, self.min_brightness, self.label)
        return style.swatch(self.color, self.label, self.hatch, self.hatch_color)


class CellStyle(NamedTuple):
    """The look of a code: a colour, or the number in the field with this index; ``regime``: the look of a regime."""

    color: str = "#ffffff"
    field: int | None = None
    regime: int | None = None


class HatchLayer(NamedTuple):
    """A texture over cells (y, x), through which their colours show.

    ``outlined`` are cells with a line around them; ``entry``: in the legend.
    """

    cells: Cells
    hatch: str
    hatch_color: str
    outlined: Cells | None = None
    entry: LegendEntry | None = None

    @classmethod
    def on_color(cls, color: Any, cells: Cells, hatch: str, label: str, outlined: Cells | None = None) -> "HatchLayer":
        """A texture in an ink that is visible on this colour, with its legend entry."""
        ink = style.ink_on(color)
        return cls(cells, hatch, ink, outlined, LegendEntry(color, label, hatch, ink))


@dataclass(frozen=True, eq=False)
class ScalarLayer:
    """Numbers of cells (y, x), NaN for none, on a scale of colours with a bar.

    title   of the bar, if there are several
    signs   the colours of positive numbers, and of both signs with zero in the middle, for a scale of both signs if
            zero lies between its ends: ``colormap`` is the first, or a part of the second
    bar     true if there is one
    """

    colormap: Colormap
    norm: Normalize
    values: Array
    label: str
    title: str = ""
    signs: tuple[Colormap, Colormap] | None = None
    bar: bool = True

    @property
    def form(self) -> str | None:
        """Placement of a number on the scale, None if it has no name."""
        return _FORMS.get(type(self.norm))

    @property
    def ends(self) -> tuple[float, float]:
        """The ends of the scale."""
        return float(self.norm.vmin or 0.0), float(self.norm.vmax or 0.0)

    def colors(self, values: Array) -> Colors:
        """The colours of values (..., 4) in bytes. Zero has no logarithm and gets the colour of the lower end."""
        least = self.ends[0]
        placed = self.norm(np.where(np.isnan(values), least, np.maximum(values, least)))
        return np.asarray(self.colormap(placed, bytes=True))


class ShadingLayer(NamedTuple):
    """Darkening of colours by numbers of cells (y, x), NaN for none.

    From ``low`` to ``high``, where the share ``dark`` of the brightness is left.
    """

    values: Array
    low: float
    high: float
    min_brightness: float

    @property
    def brightness(self) -> Array:
        """The remaining brightness of each cell."""
        return 1.0 - (1.0 - self.min_brightness) * np.clip(
            (self.values - self.low) / max(self.high - self.low, 1.0), 0.0, 1.0
        )


class PointLayer(NamedTuple):
    """Points (n, 2) over a map, as arguments of ``style.mark``."""

    points: Array
    look: tuple[str, float, str, str, float]


@dataclass(frozen=True, eq=False)
class MapLayers:
    """A map as data, from which pictures and pages are made.

    codes      (y, x) indices into ``looks``
    legend     entries for them; ``beside``: title of a legend to the right of the map
    fields     numbers on scales; their bars from below
    textures   over cells
    points     over those, with their entry in the legend: label and look
    names      cells (y, x), their name, written into them if it fits, and the colour under it
    """

    codes: NDArray[np.intp]
    styles: Sequence[CellStyle]
    legend: Sequence[LegendEntry]
    fields: Sequence[ScalarLayer] = ()
    textures: Sequence[HatchLayer] = ()
    shade: ShadingLayer | None = None
    points: Sequence[PointLayer] = ()
    point_entry: tuple[str, tuple[str, float, str, str, float]] | None = None
    side_legend_title: str | None = None
    names: Sequence[Class] = ()

    @property
    def entries(self) -> list[LegendEntry]:
        """All entries of its legend except that of points."""
        return [*self.legend, *(texture.entry for texture in self.textures if texture.entry is not None)]

    @property
    def bars(self) -> list[ScalarLayer]:
        """The fields with a bar."""
        return [field for field in self.fields if field.bar]

    def cells_on_scalar(self, place: int) -> Cells:
        """The cells (y, x) whose look is a number in this field."""
        return np.isin(self.codes, [code for code, look in enumerate(self.styles) if look.field == place])

    def as_regime(self, regime: int) -> Cells:
        """The cells (y, x) with the look of this regime."""
        return np.isin(self.codes, [code for code, look in enumerate(self.styles) if look.regime == regime])


def build_layers(
    regime: NDArray[np.int8],
    classes: Iterable[Class] = (),
    fields: Sequence[ScalarLayer] = (),
    numbered: tuple[NDArray[np.int64], Sequence[str]] | None = None,
    legend: Sequence[LegendEntry] = (),
    **others: Any,
) -> MapLayers:
    """Layers of cells (y, x): classes over fields over coloured numbers; other cells have the look of their regime.

    ``numbered`` are numbers (y, x), -1 for none, and the colour of each. ``legend`` goes before the classes' entries.
    """
    number, colors = (np.full(regime.shape, -1), ()) if numbered is None else numbered
    codes, looks, entries = number.astype(np.intp), [CellStyle(color) for color in colors], [*legend]
    for place, field in enumerate(fields):
        codes[~np.isnan(field.values)] = len(looks)
        looks.append(CellStyle(field=place))
    for cells, color, name in classes:
        if cells.any():
            codes[cells] = len(looks)
            looks.append(CellStyle(color))
            entries.append(LegendEntry(color, name))
    rest = codes < 0
    for entry in sorted(REGIMES, key=lambda regime: regime.code == PENDING):  # pending last in the legend
        cells = rest & (regime == entry.code)
        codes[cells] = len(looks)
        looks.append(CellStyle(entry.color, regime=entry.code))
        entries += [LegendEntry.from_regime(entry.code)] if cells.any() else []
    codes[codes < 0] = len(looks) - 1
    return MapLayers(codes, looks, entries, fields, **others)


def paint(layers: MapLayers) -> Colors:
    """The colours of cells (y, x, 4) in bytes. Pending cells are transparent, to show the texture below."""
    table = [style.rgb(look.color, alpha=0 if look.regime == PENDING else 255) for look in layers.styles]
    rgba = np.array(table, np.uint8)[layers.codes]
    for place, field in enumerate(layers.fields):
        cells = layers.cells_on_scalar(place)
        rgba[cells] = field.colors(field.values[cells])
    if layers.shade is not None:
        brightness = layers.shade.brightness
        there = ~np.isnan(brightness)
        rgba[there, :3] = (rgba[there, :3] * brightness[there][:, None]).astype(np.uint8)
    return rgba
