"""The sweep: the bifurcation diagram, section values of the first state, over the largest exponent, on one axis."""

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import numpy as np
import xarray as xr
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.render import axes, style
from workers.results import ERROR, LARGEST, PENDING, REGIME, REGIMES, SECTION

Panel: TypeAlias = Callable[[Axes, xr.Dataset, axes.DrawnAxis], None]
"""Draws one panel of a sweep from what was read of it."""

LARGEST_LABEL = "largest Lyapunov exponent\n$\\lambda_1$ [per forcing period]"

HEIGHT = {1: 3.0, 2: 5.2}
"""Height in inches of a figure with one panel, or two."""


def figure(ds: xr.Dataset) -> Figure:
    """The sweep as a figure, each panel only if the atlas holds its variable; InputError if it holds neither."""
    panels: dict[str, Panel] = {SECTION.name: draw_section, LARGEST.name: _draw_largest}
    panels = {name: panel for name, panel in panels.items() if name in ds and ds[name].size}
    if not panels:
        raise InputError("kind 'sweep' draws 'section' or 'largest', and this atlas holds neither; see section_samples")
    # The error bars come with the exponents; an atlas of another origin may lack them.
    read, x = line(ds, [*panels, *([ERROR.name] if ERROR.name in ds else [])])
    with rc_context(style.STYLE):
        return stack(ds, read, x, panels, regime_legend(read[REGIME.name].values))


def line(ds: xr.Dataset, variables: Sequence[str]) -> tuple[xr.Dataset, axes.DrawnAxis]:
    """These variables and the regimes along the axis of a sweep in rising order, and that axis.

    The only place where the pictures of sweeps choose what they read.
    """
    read, (x,) = axes.rising(ds[[*dict.fromkeys(variables), REGIME.name]])
    return read, x


def stack(
    ds: xr.Dataset, read: xr.Dataset, x: axes.DrawnAxis, panels: Mapping[str, Panel], legend: Sequence[Artist]
) -> Figure:
    """Panels over one shared axis, under the title line of the fixed parameters."""
    drawn = style.new_figure(HEIGHT[len(panels)])
    plots = drawn.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for ax, panel in zip(plots, panels.values(), strict=True):
        panel(ax, read, x)
        axes.scale_x(ax, x, label=ax is plots[-1])
    drawn.align_ylabels(plots)
    plots[0].set_title(style.title_line(ds), loc="left")
    drawn.legend(handles=list(legend), loc="outside lower center", ncols=max(1, len(legend)), handlelength=0.8)
    return drawn


def draw_section(ax: Axes, ds: xr.Dataset, x: axes.DrawnAxis) -> None:
    """The bifurcation diagram: section values of the first state in the colours of their regimes."""
    regime = ds[REGIME.name].values
    # The dimensions are cell, sample, component; only the first component is read.
    section = ds[SECTION.name][..., 0].values
    at = np.broadcast_to(x.values[:, None], section.shape)
    for code in np.unique(regime[regime != PENDING]):
        shown = np.isfinite(section) & (regime == code)[:, None]
        _points(ax, at[shown], section[shown], x, int(code))
    ax.set_ylabel(state_label(ds))


def _draw_largest(ax: Axes, ds: xr.Dataset, x: axes.DrawnAxis) -> None:
    regime = ds[REGIME.name].values
    largest = np.where(np.isfinite(ds[LARGEST.name].values), ds[LARGEST.name].values, np.nan)
    ax.axhline(0.0, color="black", linewidth=0.7, zorder=1)
    if ERROR.name in ds:
        error = np.nan_to_num(ds[ERROR.name].values)
        ax.fill_between(x.values, largest - error, largest + error, color="#b0b0b0", linewidth=0, zorder=1.5)
    ax.plot(x.values, largest, color="#a6a6a6", linewidth=0.5, zorder=2)
    for code in np.unique(regime[regime != PENDING]):
        shown = (regime == code) & np.isfinite(largest)
        _points(ax, x.values[shown], largest[shown], x, int(code), least=1.8)
    ax.set_ylabel(LARGEST_LABEL)


def point_size(x: axes.DrawnAxis, least: float) -> float:
    """The diameter of a point in points: as wide as a cell, within what is seen and what separates neighbours."""
    return float(np.clip(0.8 * style.WIDTH * 72.0 / x.values.size, least, 4.0))


def _points(
    ax: Axes, at: NDArray[np.float64], values: NDArray[np.float64], x: axes.DrawnAxis, code: int, least: float = 1.1
) -> None:
    size = point_size(x, least)
    ax.plot(at, values, ".", color=style.INK[code], markersize=size, markeredgewidth=0, zorder=3, rasterized=True)


def regime_legend(regime: NDArray[np.int8]) -> list[Artist]:
    """Legend entries for the regimes of points."""
    codes = [each.code for each in REGIMES if each.code != PENDING and np.any(regime == each.code)]
    return [
        Line2D([], [], linestyle="", marker="o", markersize=4, color=style.INK[code], label=style.name_of(code))
        for code in codes
    ]


def state_label(ds: xr.Dataset) -> str:
    """The first state's label; the system knows a state as the parameter that sets its initial value."""
    name = style.first_state(ds)
    initial = style.parameter_of(ds, name)
    if initial is None:
        return f"{name} at $t = kT$"
    meaning = initial.meaning.removeprefix("initial ")
    return f"{meaning}\n${initial.symbol.removesuffix('(0)')}$ at $t = kT$ [{style.unit_text(initial.unit)}]"
