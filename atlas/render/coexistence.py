"""The bifurcation diagram with all attractors of every cell, over the shares that reach them."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from atlas.branches.table import Branches
from atlas.errors import InputError
from atlas.render import axes, machine, style, sweep
from atlas.render.page import STANDARD, Page
from workers.results import ATTRACTOR, LARGEST, PENDING, REGIME, SECTION

LABELS = {"share": "share of the\ninitial states", LARGEST.name: sweep.LARGEST_LABEL}


def figure(ds: xr.Dataset, page: Page = STANDARD, branches: Branches | None = None) -> Figure:
    """The sections of all attractors in the colours of their regimes, under them their shares, or their exponents where
    no sections are kept.

    InputError where the atlas does not hold all attractors.
    """
    if ATTRACTOR not in ds.dims:
        raise InputError("kind 'coexistence' draws all attractors, and this atlas has one a cell; see [attractors]")
    has_sections = SECTION.name in ds and ds[SECTION.name].size > 0
    panels: dict[str, sweep.Panel] = {SECTION.name: draw_sections} if has_sections else {}
    if not has_sections and LARGEST.name in ds:
        panels[LARGEST.name] = _draw_numbers(LARGEST.name)
    panels["share"] = _draw_numbers("share")
    read, x = sweep.line(ds, [*panels])
    with page.context():
        legend = sweep.regime_legend(read[REGIME.name].values)
        return sweep.stack(ds, read, x, panels, legend, page, branches)


def draw_sections(ax: Axes, ds: xr.Dataset, x: axes.DrawnAxis, page: Page) -> None:
    """The section values of the gap coordinate of every attractor; those of larger share lie on top."""
    for k in reversed(range(ds.sizes[ATTRACTOR])):
        here = ds.isel({ATTRACTOR: k})
        regime = here[REGIME.name].values
        section = machine.gap_values(here, x.name, here[SECTION.name])
        at = np.broadcast_to(x.values[:, None], section.shape)
        for code in np.unique(regime[regime != PENDING]):
            shown = np.isfinite(section) & (regime == code)[:, None]
            _points(ax, at[shown], section[shown], int(code), sweep.point_size(x, 1.1, page))
    ax.set_ylabel(machine.gap_label(ds))


def _draw_numbers(name: str) -> sweep.Panel:
    def draw(ax: Axes, ds: xr.Dataset, x: axes.DrawnAxis, page: Page) -> None:
        regime, values = ds[REGIME.name].values, ds[name].values
        at = np.broadcast_to(x.values[:, None], values.shape)
        for code in np.unique(regime[regime != PENDING]):
            shown = np.isfinite(values) & (regime == code)
            _points(ax, at[shown], values[shown], int(code), sweep.point_size(x, 1.8, page))
        ax.set_ylabel(LABELS[name])

    return draw


def _points(ax: Axes, at: NDArray[Any], values: NDArray[Any], code: int, size: float) -> None:
    ax.plot(at, values, ".", color=style.INK[code], markersize=size, markeredgewidth=0, zorder=3, rasterized=True)
