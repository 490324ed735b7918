"""What all pictures of a plane share: its cells read in drawing order, the frame around them, the legends."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy import ndimage

from atlas.errors import InputError
from atlas.query.resample import view
from atlas.render import axes, style
from atlas.render.fit import TITLE
from atlas.render.kinds import Kind
from atlas.render.page import STANDARD, Page
from atlas.render.style import DPI
from workers.results import (
    APERIODIC,
    CHAOTIC,
    FAILED,
    INVALID,
    NO_IMPACT,
    PENDING,
    QUASIPERIODIC,
    REGIME,
    REGIMES,
    UNDETERMINED,
)

PIXELS = (1500, 1100)
"""Least size, (x, y), of a map's plot area in a file of the standard page, in pixels: cells not smaller than these are
all drawn.
"""

_VISIBLE = 2.0
"""Points below which a cell on its own is lost to the eye."""
_MOST_MARKS = 300
"""Marks of such cells: where there are more, they are seen as a cloud anyway."""


@dataclass(frozen=True)
class Options:
    """What a map is drawn with besides the colours of its cells.

    overlays   names of lines over it
    page       what it is drawn on
    asked      size, (x, y), in pixels of the plot area that its cells are to fill, where it is not the page's
    curves     kinds of exact curves that are drawn, of CURVES; None for all
    names      whether names and levels stand on it
    """

    overlays: tuple[str, ...] = ()
    page: Page = STANDARD
    asked: tuple[int, int] | None = None
    curves: tuple[str, ...] | None = None
    names: bool = True

    @property
    def size(self) -> tuple[float, float]:
        """Nominal width and height of the plot area in points."""
        return self.page.plot_size(height(self.page))

    @property
    def pixels(self) -> tuple[int, int]:
        """Size, (x, y), of the plot area that the cells fill: finer ones are read from an overview."""
        if self.asked:
            return self.asked
        dots = self.page.dpi / DPI
        width, tall = (mine / standard for mine, standard in zip(self.size, _STANDARD_SIZE, strict=True))
        return max(1, round(PIXELS[0] * width * dots)), max(1, round(PIXELS[1] * tall * dots))


def height(page: Page) -> float:
    """Height of a map in inches where none is asked for."""
    return 1.2 + 0.5 * page.width


_STANDARD_SIZE = STANDARD.plot_size(height(STANDARD))
PLAIN = Options()


@dataclass(frozen=True)
class Plane:
    """The cells of a plane as arrays (y, x) with both axes rising: regimes, and the values of other variables."""

    x: axes.DrawnAxis
    y: axes.DrawnAxis
    regime: NDArray[np.int8]
    values: Mapping[str, NDArray[Any]]

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.values[name]


def read(
    ds: xr.Dataset, variables: Iterable[str], kind: str, pixels: tuple[int, int] = PIXELS, lacking: str = ""
) -> Plane:
    """Read these variables and the regimes of a plane, nothing else and not finer than pixels.

    InputError if the atlas does not hold one, with what is ``lacking``. No other function of maps reads an atlas.
    """
    names = [name for name in dict.fromkeys(variables) if name != REGIME.name]
    for name in names:
        if name not in ds:
            hint = f"; {lacking}" if lacking else ""
            raise InputError(f"kind {kind!r} draws the variable {name!r}, which this atlas does not hold{hint}")
    ds, (x, y) = axes.rising(view(ds, names, pixels=pixels))
    return Plane(x, y, ds[REGIME.name].values, {name: ds[name].values for name in names})


@dataclass(frozen=True)
class View:
    """What a kind is painted from: the atlas and its cells in view; the variable of a map of any, by its logarithm."""

    kind: Kind
    ds: xr.Dataset
    plane: Plane
    page: Page
    variable: str = ""
    log: bool = False


class Texture(NamedTuple):
    """A texture over cells (y, x), which lets their colours through; ``outlined`` are cells with a line around them."""

    cells: NDArray[np.bool_]
    hatch: str
    ink: str
    outlined: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class Bar:
    """A scale beside a map: the values that it was made for, and what is said along it and above it."""

    colormap: Colormap
    norm: Normalize
    values: NDArray[np.float64]
    label: str
    title: str = ""


@dataclass(frozen=True)
class Painted:
    """What a kind makes of a view: the colour of every cell, and what explains the colours.

    rgba       (y, x, 4) in bytes
    legend     entries for classes; ``beside``: a title where they stand to the right of the map
    bars       scales, from below
    textures   over cells
    over       draws what lies on the cells and returns its legend entries
    names      cells (y, x), their name, written into them where it fits, and the colour that it is seen on
    """

    rgba: NDArray[np.uint8]
    legend: Sequence[Artist]
    bars: Sequence[Bar] = ()
    textures: Sequence[Texture] = ()
    beside: str | None = None
    over: Callable[[Axes], list[Artist]] | None = None
    names: Sequence[tuple[NDArray[np.bool_], str, str]] = ()


def determined(regime: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Where the class of motion is known: what else a cell holds are averages that must not pass for results."""
    return ((regime >= NO_IMPACT) & (regime <= CHAOTIC)) | (regime == APERIODIC)


def frame(ds: xr.Dataset, page: Page) -> tuple[Figure, Axes]:
    """A figure with one plot area, or the axes that are given, under the title line of the fixed parameters."""
    figure, (ax,) = page.panels(height(page), 1)
    if page.title:
        ax.set_title(style.title_line(ds), loc="left", gid=TITLE)
    texture(ax)
    return figure, ax


def texture(ax: Axes) -> None:
    """Give a plot area the texture of pending cells, which no value has: drawn transparent, they let it through."""
    ax.patch.set(facecolor="white", edgecolor=style.TEXTURE, hatch=style.HATCH[PENDING], linewidth=0.0)


def paint_regimes(rgba: NDArray[np.uint8], regime: NDArray[np.int8], where: NDArray[np.bool_]) -> list[Patch]:
    """Give cells the colour of their regime, in place, and return legend entries for those regimes.

    Pending cells turn transparent, so that the texture of the plot area shows.
    """
    entries = []
    for each in sorted(REGIMES, key=lambda regime: regime.code == PENDING):  # pending last in the legend
        cells = where & (regime == each.code)
        if cells.any():
            rgba[cells] = style.rgb(each.color, alpha=0 if each.code == PENDING else 255)
            entries.append(regime_entry(each.code, style.name_of(each.code)))
    return entries


def regime_entry(code: int, label: str) -> Patch:
    """The legend entry of cells that are drawn in the colour of this regime."""
    # An impact-free cell is textured only where it is not seen by its colour.
    hatch = None if code == NO_IMPACT else style.HATCH.get(code)
    return style.swatch(style.COLORS[code], label, hatch, style.HATCH_INK.get(code, style.TEXTURE))


def lay(ax: Axes, plane: Plane, painted: Painted, options: Options) -> list[Artist]:
    """Draw what was painted into a plot, and return its legend entries."""
    enlarged = draw(ax, plane, painted.rgba, options)
    for entry in painted.legend:
        if entry.get_label() in enlarged:
            entry.set_label(f"{entry.get_label()},\nsingle cells enlarged")
    for cells, pattern, ink, outlined in painted.textures:
        axes.hatch(ax, plane.x, plane.y, cells, pattern, ink)
        if outlined is not None:
            axes.outline(ax, plane.x, plane.y, outlined, "#1a2433", 0.3)
    return [*painted.legend, *(painted.over(ax) if painted.over else [])]


def draw(ax: Axes, plane: Plane, rgba: NDArray[np.uint8], options: Options) -> set[str]:
    """Draw the cells in these colours (y, x, 4), with textures over those that show their regime's colour.

    Such cells without a result that would be too small to be seen get a mark of a visible size; the names of regimes
    that have such marks.
    """
    axes.draw_cells(ax, plane.x, plane.y, rgba)
    shown = {
        code: (plane.regime == code) & (rgba == style.rgb(style.COLORS[code])).all(axis=-1)
        for code in (QUASIPERIODIC, UNDETERMINED, INVALID, FAILED)
    }
    for code in (QUASIPERIODIC, INVALID, FAILED):
        axes.hatch(ax, plane.x, plane.y, shown[code], style.HATCH[code], style.HATCH_INK[code])
    without = (UNDETERMINED, INVALID, FAILED)
    return {style.name_of(code) for code in without if _mark_small(ax, plane, shown[code], code, options.size)}


def _mark_small(ax: Axes, plane: Plane, cells: NDArray[np.bool_], code: int, size: tuple[float, float]) -> bool:
    """Mark the small ones of these cells unless they are seen anyway, or are too many; whether there are marks."""
    width, height = np.array(size) / np.array(plane.regime.shape[::-1])
    if max(width, height) >= _VISIBLE:
        return False
    regions, _ = ndimage.label(cells)
    small = [
        (rows, columns)
        for rows, columns in ndimage.find_objects(regions)
        if (rows.stop - rows.start) * height < _VISIBLE and (columns.stop - columns.start) * width < _VISIBLE
    ]
    if not 0 < len(small) <= _MOST_MARKS:
        return False
    x = [0.5 * (plane.x.edges[columns.start] + plane.x.edges[columns.stop]) for _, columns in small]
    y = [0.5 * (plane.y.edges[rows.start] + plane.y.edges[rows.stop]) for rows, _ in small]
    look = {"markersize": 0.9 * _VISIBLE, "markeredgewidth": 0.2, "markeredgecolor": "black", "zorder": 2.2}
    ax.plot(x, y, "s", color=style.COLORS[code], **look)  # type: ignore[arg-type]
    return True
