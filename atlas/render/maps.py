"""The way from a plane of cells to its map: read, paint, frame, draw, overlays, bars, legend, names."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib import axis as mpl_axis
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from numpy.typing import NDArray

from atlas.query.plane import Cells, Plane, PlaneAxis
from atlas.query.resample import view as in_view
from atlas.query.room import places
from atlas.query.tidy import borders, runs, specks
from atlas.render import style, words
from atlas.render.kinds import Kind
from atlas.render.options import Wanted
from atlas.render.page import DrawnPage
from workers.results import ATTRACTOR, FAILED, INVALID, LARGEST, NO_IMPACT, PENDING, REGIMES, UNDETERMINED

Colors = NDArray[np.uint8]

LABEL_SIZE = 7.5
"""Points of the type of names on a map."""
_VISIBLE = 2.0
"""Points below which a cell on its own is lost to the eye."""
_MOST_MARKS = 300
"""Marks of such cells: where there are more, they are seen as a cloud anyway."""
_ARROW = {
    "arrowstyle": "-|>,head_length=0.25,head_width=0.1", "linewidth": 0.5, "shrinkA": 0.5, "shrinkB": 0.0,
    "color": "#555555",
}  # fmt: skip
"""The arrow from a name to its region."""
_WITH_TEXTURE = [code for code in style.HATCH if code not in (PENDING, NO_IMPACT)]
_MARKED = (UNDETERMINED, INVALID, FAILED)


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


def draw_map(kind: Kind, ds: xr.Dataset, wanted: Wanted) -> Figure:
    """The map of a kind as a figure, with its overlays; InputError where the atlas does not hold what it draws."""
    view = read(kind, ds, wanted)
    return draw_painted(view, kind.painter(view))


def draw_painted(view: View, painted: PaintedView) -> Figure:
    """The map of a view in its colours as a figure, with its overlays."""
    from atlas.render import overlays, scales

    wanted, page = view.wanted, view.page
    with page.context():
        drawn, (ax,) = page.panels(page.map_height, 1, words.title_line(view.ds))
        entries = [*lay(ax, view.plane, painted, page), *overlays.draw(ax, view)]
        explain_pending(entries, view.ds)
        scales.draw_bars(drawn, [ax], painted.bars, page)
        page.legend(drawn, entries, beside=painted.beside)
        if painted.names and wanted.names:
            page.settle(drawn)
            name_regions(ax, view.plane, painted.names, [LABEL_SIZE * page.scale])
    return drawn


def read(kind: Kind, ds: xr.Dataset, wanted: Wanted) -> View:
    """Read the variables and the regimes that a map and its overlays draw, no others, and not finer than pixels.

    InputError if the atlas lacks one. No other function of maps reads an atlas.
    """
    names = [*kind.variables] if wanted.variable is None else [wanted.variable]
    names += [LARGEST.name] if "isolines" in wanted.overlays else []
    kind.require(ds, names)
    plane = Plane.of(in_view(ds, names, pixels=wanted.pixels or wanted.page.map_pixels), names)
    return View(kind, ds, plane, wanted)


def lay(ax: Axes, plane: Plane, painted: PaintedView, page: DrawnPage) -> list[Artist]:
    """Draw what was painted into a plot, and return its legend entries."""
    enlarged = draw_cells(ax, plane, painted.rgba, page)
    for entry in painted.legend:
        if entry.get_label() in enlarged:
            entry.set_label(f"{entry.get_label()},\nsingle cells enlarged")
    for each in painted.textures:
        hatch(ax, plane, each.cells, each.hatch, each.ink)
        if each.outlined is not None:
            outline(ax, plane, each.outlined, "#1a2433", 0.3)
    return [*painted.entries, *(painted.over(ax) if painted.over else [])]


def explain_pending(entries: Iterable[Artist], ds: xr.Dataset) -> None:
    """Say in a legend that cells without a result may have too few attractors for the one that the dataset holds."""
    for entry in entries:
        if ds.attrs.get(ATTRACTOR, 0) and entry.get_label() == words.name_of(PENDING):
            entry.set_label(f"not more than {ds.attrs[ATTRACTOR]}")


def paint_regimes(rgba: Colors, regime: NDArray[np.int8], where: Cells) -> list[Patch]:
    """Give cells the colour of their regime, in place, and return legend entries for those regimes.

    Pending cells turn transparent, so that the texture of the plot area shows.
    """
    entries = []
    for each in sorted(REGIMES, key=lambda regime: regime.code == PENDING):  # pending last in the legend
        cells = where & (regime == each.code)
        if cells.any():
            rgba[cells] = style.rgb(each.color, alpha=0 if each.code == PENDING else 255)
            entries.append(regime_entry(each.code, words.name_of(each.code)))
    return entries


def regime_entry(code: int, label: str) -> Patch:
    """The legend entry of cells that are drawn in the colour of this regime."""
    # An impact-free cell is textured only where it is not seen by its colour.
    pattern = None if code == NO_IMPACT else style.HATCH.get(code)
    return style.swatch(style.COLORS[code], label, pattern, style.HATCH_INK.get(code, style.TEXTURE))


def draw_cells(ax: Axes, plane: Plane, rgba: Colors, page: DrawnPage) -> set[str]:
    """Draw cells in colours (y, x, 4) from edge to edge, as pixels in vector files too; the names of enlarged regimes.

    An image where all cells are equal; quadrilaterals otherwise. Colours are never blended between cells. A cell
    in the colour of its regime has that regime's texture; such cells without a result that would be too small to be
    seen get a mark of a visible size.
    """
    # Pending cells, which no value has, are drawn transparent and let this texture through.
    ax.patch.set(facecolor="white", edgecolor=style.TEXTURE, hatch=style.HATCH[PENDING], linewidth=0.0)
    x, y = plane.x, plane.y
    if x.uniform and y.uniform:
        extent = (x.edges[0], x.edges[-1], y.edges[0], y.edges[-1])
        ax.imshow(rgba, origin="lower", extent=extent, aspect="auto", interpolation="nearest")
    else:
        ax.pcolormesh(x.edges, y.edges, rgba, rasterized=True)
    scale_axes(ax, x=x, y=y)
    enlarged = set()
    for code in (*_WITH_TEXTURE, UNDETERMINED):
        shown = (plane.regime == code) & (rgba == style.rgb(style.COLORS[code])).all(axis=-1)
        if code in _WITH_TEXTURE:
            hatch(ax, plane, shown, style.HATCH[code], style.HATCH_INK[code])
        if code in _MARKED and _mark_small(ax, plane, shown, style.COLORS[code], page.map_size):
            enlarged.add(words.name_of(code))
    return enlarged


def _mark_small(ax: Axes, plane: Plane, cells: Cells, color: str, size: tuple[float, float]) -> bool:
    """Mark the small ones of these cells unless they are seen anyway, or are too many; whether there are marks."""
    step = np.array(size[::-1]) / plane.regime.shape
    if step.max() >= _VISIBLE:
        return False
    small = specks(cells, plane.x.edges, plane.y.edges, step, _VISIBLE)
    if not 0 < len(small) <= _MOST_MARKS:
        return False
    ax.plot(*small.T, zorder=2.2, **style.mark("s", 0.9 * _VISIBLE, color, "black", 0.2))
    return True


def hatch(ax: Axes, plane: Plane, inside: Cells, pattern: str, color: str) -> None:
    """Cover a set of cells with a texture that lets their colours through."""
    rectangles = runs(inside, plane.x.edges, plane.y.edges)
    if len(rectangles):  # all rectangles are one path, so that the texture has no seams
        codes = np.tile([Path.MOVETO, Path.LINETO, Path.LINETO, Path.LINETO, Path.CLOSEPOLY], len(rectangles))
        path = Path(rectangles.reshape(-1, 2), codes)
        ax.add_patch(PathPatch(path, fill=False, hatch=pattern, edgecolor=color, linewidth=0, rasterized=True))


def outline(ax: Axes, plane: Plane, inside: Cells, color: str, width: float) -> None:
    """Draw the border of a set of cells along the cells' edges; the picture's own frame is left out."""
    ends = list(borders(inside, plane.x.edges, plane.y.edges))
    lines = LineCollection(ends, colors=color, linewidths=width, capstyle="projecting", rasterized=True)
    ax.add_collection(lines, autolim=False)


def in_points(ax: Axes, at: NDArray[np.float64], size: tuple[float, float]) -> NDArray[np.float64]:
    """Data coordinates in points from the lower left corner of the plot, by its nominal size: as a layout that
    is not made yet will have them, nearly.
    """
    return np.asarray(ax.transAxes.inverted().transform(ax.transData.transform(at)) * np.array(size))


def scale_axes(ax: Axes, labels: bool = True, **axes: PlaneAxis) -> None:
    """Give the axes ``x`` and ``y`` of a plot their scales, limits and ticks, and their labels if asked."""
    for each, axis in axes.items():
        if axis.log:
            ax.set(**{f"{each}scale": "log"})
            # Over few decades the default labels one or two powers of ten; 1, 2, 5 in plain numbers read better.
            if math.log10(axis.values[-1] / axis.values[0]) <= 3.0:
                plain_ticks(getattr(ax, f"{each}axis"), (1.0, 2.0, 5.0))
        ax.set(**{f"{each}lim": (axis.edges[0], axis.edges[-1])})
        if labels:
            ax.set(**{f"{each}label": words.axis_label(axis.name, axis.meaning)})


def plain_ticks(axis: mpl_axis.Axis, steps: Sequence[float]) -> None:
    """Label a logarithmic axis at these multiples of powers of ten, in plain numbers: 0.02, 5, 2000, 20 000."""

    def plain(value: float, _: int) -> str:
        return f"{value:,g}".replace(",", "\N{NARROW NO-BREAK SPACE}") if value >= 1e4 else f"{value:g}"

    axis.set_major_locator(LogLocator(subs=steps))
    axis.set_major_formatter(FuncFormatter(plain))
    axis.set_minor_locator(NullLocator())


def name_regions(
    ax: Axes,
    plane: Plane,
    named: Sequence[tuple[Cells, str, str]],
    type_sizes: Sequence[float],
    most: int = 2,
    free: Cells | None = None,
) -> None:
    """Write names into the largest regions of sets of cells (y, x): see ``places``. The plot must have its size.

    ``named``: cells, name, and the colour under the name.
    """
    if not all(axis.uniform or axis.log for axis in (plane.x, plane.y)):
        return  # cells differ in size, and distances in cells mean nothing
    extent, dots = ax.get_window_extent(), ax.figure.dpi / 72.0
    step = np.array([extent.height, extent.width]) / dots / plane.regime.shape  # points per cell

    def at(cell: tuple[int, int]) -> tuple[float, float]:
        return plane.x.values[cell[1]], plane.y.values[cell[0]]

    for number, cell, size, angle, region in places([each[:2] for each in named], step, type_sizes, most, free):
        _, name, color = named[number]
        look: dict[str, Any] = {"fontsize": size, "ha": "center", "zorder": 4}
        if region is None:
            look |= {"va": "center_baseline", "rotation": angle, "rotation_mode": "anchor"}  # turned about its middle
            ax.text(*at(cell), name, color=style.ink_on(color), **look)
        else:
            ax.annotate(name, at(region), at(cell), va="center", color=style.ink_on("white"), arrowprops=_ARROW, **look)
