"""Sweeps of one axis: section values of the gap coordinate over the largest exponent; one sweep, or two together."""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.branches.table import Branches
from atlas.errors import InputError
from atlas.query import hysteresis, machine
from atlas.render import axes, branch, gap, style
from atlas.render.fit import TITLE
from atlas.render.page import STANDARD, Page
from workers.results import ERROR, LARGEST, NO_IMPACT, PENDING, PERIODIC, REGIME, REGIMES, SECTION

Panel: TypeAlias = Callable[[Axes, xr.Dataset, axes.DrawnAxis, Page], None]
"""Draws one panel of a sweep from what was read of it."""

LARGEST_LABEL = "largest Lyapunov exponent\n$\\lambda_1$ [per forcing period]"

LOST_NOTE = "(▾: $-\\infty$)"

COLORS = ("#0a6ebd", "#e8701a")
"""Colours of two sweeps drawn together."""
SHADES = {hysteresis.MIRRORED: "#f0eedd", hysteresis.DIFFERENT: "#d6cdea"}
"""Colours of the ground where two sweeps end on mirror images, and on different motions."""

_HEIGHT = {1: (1.25, 0.25), 2: (1.7, 0.5)}
"""Height in inches of a figure with one panel, or two, less a share of its width; that share."""
_FEW, _MANY = 2.2, 1.5
"""Least diameter in points of the points of an orbit, and of a cloud such as chaos."""


def figure(ds: xr.Dataset, page: Page = STANDARD, branches: Branches | None = None) -> Figure:
    """The sweep as a figure, each panel only if the atlas holds its variable; InputError if it holds neither."""
    panels: dict[str, Panel] = {SECTION.name: draw_section, LARGEST.name: _draw_largest}
    panels = {name: panel for name, panel in panels.items() if name in ds and ds[name].size}
    if not panels:
        raise InputError("kind 'sweep' draws 'section' or 'largest', and this atlas holds neither; see section_samples")
    # The error bars come with the exponents; an atlas of another origin may lack them.
    read, x = line(ds, [*panels, *([ERROR.name] if ERROR.name in ds else [])])
    with page.context():
        return stack(ds, read, x, panels, regime_legend(read[REGIME.name].values), page, branches)


def figure_of_two(
    ds: xr.Dataset, against: xr.Dataset, page: Page = STANDARD, branches: Branches | None = None
) -> Figure:
    """Two sweeps as one figure, shaded where they end on different motions; paler where those are mirror images.

    The rule is ``atlas.query.hysteresis.compare``. InputError unless they have the same axis and share something to
    draw.
    """
    hysteresis.check_same_axis(ds, against)
    atlases = (ds, against)
    names = [name for name in (SECTION.name, LARGEST.name) if all(name in each and each[name].size for each in atlases)]
    if not names:
        raise InputError("kind 'hysteresis' draws 'section' or 'largest', and the two atlases do not both hold either")
    optional = [name for name in hysteresis.COMPARED if all(name in each for each in atlases)]
    (first, x), (second, _) = (line(each, [*names, *optional]) for each in atlases)
    found = hysteresis.compare(first, second)

    def draw(name: str) -> Panel:
        def panel(ax: Axes, read: xr.Dataset, x: axes.DrawnAxis, page: Page) -> None:
            for what, color in SHADES.items():
                change = np.diff(np.pad(found == what, 1).astype(np.int8))
                for low, high in zip(np.flatnonzero(change == 1), np.flatnonzero(change == -1), strict=True):
                    ax.axvspan(x.edges[low], x.edges[high], color=color, linewidth=0, zorder=0)
            for number, each in enumerate((first, second)):
                values = machine.gap_values(each, x.name, each[name]) if name == SECTION.name else each[name].values
                # The second on top and smaller, so that both are seen where they agree.
                size = point_size(x, _FEW, page) * (1.5, 0.8)[number]
                draw_points(ax, x, values, COLORS[number], size, zorder=2 + number)
            if name == LARGEST.name:
                ax.axhline(0.0, color="black", linewidth=0.7, zorder=1)
            ax.set_ylabel(gap.gap_label(ds) if name == SECTION.name else LARGEST_LABEL)

        return panel

    with page.context():
        panels = {name: draw(name) for name in names}
        return stack(ds, first, x, panels, _legend_of_two(atlases, x, found), page, branches)


def line(ds: xr.Dataset, variables: Sequence[str]) -> tuple[xr.Dataset, axes.DrawnAxis]:
    """These variables and the regimes along the axis of a sweep in rising order, and that axis.

    The only place where the pictures of sweeps choose what they read.
    """
    read, (x,) = axes.rising(ds[[*dict.fromkeys(variables), REGIME.name]])
    return read, x


def stack(
    ds: xr.Dataset,
    read: xr.Dataset,
    x: axes.DrawnAxis,
    panels: Mapping[str, Panel],
    legend: Sequence[Artist],
    page: Page,
    branches: Branches | None = None,
) -> Figure:
    """Panels over one shared axis, under the title line of the fixed parameters; branches over the section."""
    least, share = _HEIGHT[len(panels)]
    drawn, plots = page.panels(least + share * page.width, len(panels))
    for ax, (name, panel) in zip(plots, panels.items(), strict=True):
        panel(ax, read, x, page)
        if name != SECTION.name:
            ax.set_ylim(page.vmin, page.vmax)
        if branches is not None and name == SECTION.name:
            legend = [*legend, *branch.draw(ax, branches, page)]
        axes.scale_x(ax, x, label=ax is plots[-1])
    drawn.align_ylabels(plots)
    if page.title:
        plots[0].set_title(style.title_line(ds), loc="left", gid=TITLE)
    page.legend(drawn, legend, handlelength=0.8)
    return drawn


def draw_section(ax: Axes, ds: xr.Dataset, x: axes.DrawnAxis, page: Page) -> None:
    """The bifurcation diagram: section values of the gap coordinate in the colours of their regimes."""
    regime = ds[REGIME.name].values
    section = machine.gap_values(ds, x.name, ds[SECTION.name])
    for code in np.unique(regime[regime != PENDING]):
        least = _FEW if code in (PERIODIC, NO_IMPACT) else _MANY
        shown = np.where((regime == code)[:, None], section, np.nan)
        draw_points(ax, x, shown, style.INK[int(code)], point_size(x, least, page))
    ax.set_ylabel(gap.gap_label(ds))


def _draw_largest(ax: Axes, ds: xr.Dataset, x: axes.DrawnAxis, page: Page) -> None:
    regime = ds[REGIME.name].values
    largest = np.where(np.isfinite(ds[LARGEST.name].values), ds[LARGEST.name].values, np.nan)
    ax.axhline(0.0, color="black", linewidth=0.7, zorder=1)
    if ERROR.name in ds:
        error = np.nan_to_num(ds[ERROR.name].values)
        ax.fill_between(x.values, largest - error, largest + error, color="#b0b0b0", linewidth=0, zorder=1.5)
    ax.plot(x.values, largest, color="#a6a6a6", linewidth=0.5, zorder=2)
    for code in np.unique(regime[regime != PENDING]):
        shown = np.where(regime == code, largest, np.nan)
        draw_points(ax, x, shown, style.INK[int(code)], point_size(x, _FEW, page))
    lost = np.isneginf(ds[LARGEST.name].values)
    ax.set_ylabel(LARGEST_LABEL + (f"\n{LOST_NOTE}" if lost.any() else ""))
    mark_lost(ax, x, lost)


def mark_lost(ax: Axes, x: axes.DrawnAxis, lost: Any) -> None:
    """Mark cells with an exponent of -inf, which has no place on the axis, at its foot."""
    if lost.any():
        foot = np.full(lost.sum(), 0.015)
        ax.plot(x.values[lost], foot, "v", color="black", markersize=2.5, transform=ax.get_xaxis_transform())


def point_size(x: axes.DrawnAxis, least: float, page: Page) -> float:
    """The diameter of a point in points: wider than a cell, but within what is seen and what tells points apart."""
    return float(np.clip(1.6 * page.plot_size(1.0)[0] / x.values.size, least, 4.0))


def draw_points(
    ax: Axes, x: axes.DrawnAxis, values: NDArray[np.float64], color: str, size: float, zorder: float = 3
) -> None:
    """Draw the values of cells (N,) or (N, n) that are finite as points, ``size`` in points."""
    at = np.broadcast_to(x.values if values.ndim == 1 else x.values[:, None], values.shape)
    shown = np.isfinite(values)
    look: Any = {"color": color, "markersize": size, "markeredgewidth": 0, "zorder": zorder, "rasterized": True}
    ax.plot(at[shown], values[shown], ".", **look)


def regime_legend(regime: NDArray[np.int8]) -> list[Artist]:
    """Legend entries for the regimes of points."""
    codes = [each.code for each in REGIMES if each.code != PENDING and np.any(regime == each.code)]
    return [_dot(style.INK[code], style.name_of(code), 4.0) for code in codes]


def _dot(color: str, label: str, size: float) -> Line2D:
    return Line2D([], [], linestyle="", marker="o", markersize=size, color=color, label=label)


def _legend_of_two(atlases: Sequence[xr.Dataset], x: axes.DrawnAxis, found: NDArray[np.int8]) -> list[Artist]:
    sweeps = zip(COLORS, atlases, (6.0, 3.5), strict=True)
    entries: list[Artist] = [_dot(color, _direction(each, x.name), size) for color, each, size in sweeps]
    names = {hysteresis.MIRRORED: "mirror images", hysteresis.DIFFERENT: "different motions"}
    shades = [(SHADES[what], name) for what, name in names.items() if np.any(found == what)]
    return entries + [Patch(facecolor=color, edgecolor="#a9a4b8", linewidth=0.4, label=name) for color, name in shades]


def _direction(ds: xr.Dataset, name: str) -> str:
    try:
        (found,) = (axis.get("continuation") for axis in json.loads(ds.attrs["spec"])["axes"] if axis["name"] == name)
    except (KeyError, TypeError, ValueError):
        found = None
    words = {"forward": "rising", "backward": "falling"}
    return f"{words[found]} ${style.symbol(ds, name)}$" if found in words else "each cell from its own start"
