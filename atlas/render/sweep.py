"""The sweep: the bifurcation diagram, section values of the first state, over the largest exponent, on one axis."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from atlas.branches.table import Branches
from atlas.errors import InputError
from atlas.render import axes, branch, machine, style
from atlas.render.fit import TITLE
from atlas.render.page import STANDARD, Page
from workers.results import ERROR, LARGEST, PENDING, REGIME, REGIMES, SECTION

Panel: TypeAlias = Callable[[Axes, xr.Dataset, axes.DrawnAxis, Page], None]
"""Draws one panel of a sweep from what was read of it."""

LARGEST_LABEL = "largest Lyapunov exponent\n$\\lambda_1$ [per forcing period]"

LOST_NOTE = "(▾: $-\\infty$)"

_HEIGHT = {1: (1.25, 0.25), 2: (1.7, 0.5)}
"""Height in inches of a figure with one panel, or two, less a share of its width; that share."""


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
    at = np.broadcast_to(x.values[:, None], section.shape)
    for code in np.unique(regime[regime != PENDING]):
        shown = np.isfinite(section) & (regime == code)[:, None]
        _points(ax, at[shown], section[shown], int(code), point_size(x, 1.1, page))
    ax.set_ylabel(machine.gap_label(ds))


def _draw_largest(ax: Axes, ds: xr.Dataset, x: axes.DrawnAxis, page: Page) -> None:
    regime = ds[REGIME.name].values
    largest = np.where(np.isfinite(ds[LARGEST.name].values), ds[LARGEST.name].values, np.nan)
    ax.axhline(0.0, color="black", linewidth=0.7, zorder=1)
    if ERROR.name in ds:
        error = np.nan_to_num(ds[ERROR.name].values)
        ax.fill_between(x.values, largest - error, largest + error, color="#b0b0b0", linewidth=0, zorder=1.5)
    ax.plot(x.values, largest, color="#a6a6a6", linewidth=0.5, zorder=2)
    for code in np.unique(regime[regime != PENDING]):
        shown = (regime == code) & np.isfinite(largest)
        _points(ax, x.values[shown], largest[shown], int(code), point_size(x, 1.8, page))
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


def _points(ax: Axes, at: NDArray[np.float64], values: NDArray[np.float64], code: int, size: float) -> None:
    ax.plot(at, values, ".", color=style.INK[code], markersize=size, markeredgewidth=0, zorder=3, rasterized=True)


def regime_legend(regime: NDArray[np.int8]) -> list[Artist]:
    """Legend entries for the regimes of points."""
    codes = [each.code for each in REGIMES if each.code != PENDING and np.any(regime == each.code)]
    return [
        Line2D([], [], linestyle="", marker="o", markersize=4, color=style.INK[code], label=style.name_of(code))
        for code in codes
    ]
