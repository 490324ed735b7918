"""A view of cells and what is painted of it: colours, textures, scales and legend entries, before any is drawn."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, Normalize
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.query.plane import Cells, Plane
from atlas.render import style
from atlas.render.kinds import Kind
from atlas.render.page import DrawnPage
from atlas.render.wanted import Wanted
from workers.results import NO_IMPACT, PENDING, REGIMES

Colors = NDArray[np.uint8]


@dataclass(frozen=True)
class View:
    """The cells of an atlas that are in view, as a kind of map, and how they are to be drawn."""

    kind: Kind
    ds: xr.Dataset
    plane: Plane
    wanted: Wanted

    @property
    def page(self) -> DrawnPage:
        """What it is drawn on."""
        return self.wanted.page


class Texture(NamedTuple):
    """A texture over cells (y, x), which lets their colours through.

    ``outlined`` are cells with a line around them; ``entry`` stands in the legend.
    """

    cells: Cells
    hatch: str
    ink: str
    outlined: Cells | None = None
    entry: Artist | None = None

    @classmethod
    def on(cls, color: Any, cells: Cells, hatch: str, label: str, outlined: Cells | None = None) -> "Texture":
        """A texture in an ink that is seen on this colour, with its legend entry."""
        ink = style.ink_on(color)
        return cls(cells, hatch, ink, outlined, style.swatch(color, label, hatch, ink))


@dataclass(frozen=True)
class ScaleBar:
    """A scale beside a map: the values that it was made for, its label, and a title where there are several."""

    colormap: Colormap
    norm: Normalize
    values: NDArray[np.float64]
    label: str
    title: str = ""


@dataclass(frozen=True)
class PaintedView:
    """A view in colours.

    rgba       (y, x, 4) in bytes
    legend     entries for classes; ``beside``: a title where they stand to the right of the map
    bars       scales, from below
    textures   over cells
    over       draws what lies on the cells and returns its legend entries
    names      cells (y, x), their name, written into them where it fits, and the colour under it
    """

    rgba: Colors
    legend: Sequence[Artist]
    bars: Sequence[ScaleBar] = ()
    textures: Sequence[Texture] = ()
    beside: str | None = None
    over: Callable[[Axes], list[Artist]] | None = None
    names: Sequence[tuple[Cells, str, str]] = ()

    @property
    def entries(self) -> list[Artist]:
        """All entries of its legend."""
        return [*self.legend, *(each.entry for each in self.textures if each.entry is not None)]


def paint_regimes(rgba: Colors, regime: NDArray[np.int8], where: Cells) -> list[Patch]:
    """Give cells the colour of their regime, in place, and return legend entries for those regimes.

    Pending cells turn transparent, so that the texture of the plot area shows.
    """
    entries = []
    for each in sorted(REGIMES, key=lambda regime: regime.code == PENDING):  # pending last in the legend
        cells = where & (regime == each.code)
        if cells.any():
            rgba[cells] = style.rgb(each.color, alpha=0 if each.code == PENDING else 255)
            entries.append(regime_entry(each.code, each.text))
    return entries


def regime_entry(code: int, label: str) -> Patch:
    """The legend entry of cells that are drawn in the colour of this regime."""
    # An impact-free cell is textured only where it is not seen by its colour.
    pattern = None if code == NO_IMPACT else style.HATCH.get(code)
    return style.swatch(style.COLORS[code], label, pattern, style.HATCH_INK.get(code, style.TEXTURE))
