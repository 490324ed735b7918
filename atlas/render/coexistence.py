"""The bifurcation diagram with all attractors of every cell, over the shares that reach them."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from atlas.branches.table import Branches
from atlas.errors import InputError
from atlas.query import attractors as query
from atlas.query import machine
from atlas.render import axes, classes, gap, style, sweep
from atlas.render.page import STANDARD, Page
from workers.results import ATTRACTOR, LABEL, LARGEST, PENDING, REGIME, SECTION

INTERVAL = ("share_low", "share_high")
"""The ends of the interval of a share, which is drawn where an atlas has it."""
_PALE, _POINT = 0.3, 2.0
"""How opaque intervals are; the least diameter of a point in points of the page, which is still seen on white."""
LABELS = {"share": "share of the\ninitial states", LARGEST.name: sweep.LARGEST_LABEL}


def figure(ds: xr.Dataset, page: Page = STANDARD, branches: Branches | None = None) -> Figure:
    """The sections of all attractors in the colours of their regimes, under them their shares, or their exponents where
    no sections are kept. Where its attractors are labelled the colours of orbits are those of their labels.

    InputError where the atlas does not hold all attractors.
    """
    if ATTRACTOR not in ds.dims:
        raise InputError("kind 'coexistence' draws all attractors, and this atlas has one a cell; see [attractors]")
    has_sections = SECTION.name in ds and ds[SECTION.name].size > 0
    known = query.branches(ds) if LABEL.name in ds else None
    panels: dict[str, sweep.Panel] = {SECTION.name: _sections(known)} if has_sections else {}
    if not has_sections and LARGEST.name in ds:
        panels[LARGEST.name] = _numbers(LARGEST.name, known)
    panels["share"] = _numbers("share", known)
    ends = [name for name in INTERVAL if name in ds]
    read, x = sweep.line(ds, [*panels, *ends, *([LABEL.name] if known is not None else [])])
    with page.context():
        bars = [Line2D([], [], color="#404040", alpha=_PALE, linewidth=0.7, label="95 % interval")] if ends else []
        return sweep.stack(ds, read, x, panels, [*_legend(read, known), *bars], page, branches)


def _groups(here: xr.Dataset, known: xr.Dataset | None) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """Which cells have an attractor of one colour, and that colour; ``here`` is of one attractor a cell."""
    regime = here[REGIME.name].values
    label = here[LABEL.name].values if known is not None else np.full(regime.shape, -1)
    for code in np.unique(regime[(regime != PENDING) & (label < 0)]):
        yield (regime == code) & (label < 0), style.INK[int(code)]
    colors = np.array(classes.branch_colors(known, ink=True) if known is not None else [], dtype=str)
    for color in np.unique(colors[label[label >= 0]]):
        yield (label >= 0) & (colors[np.maximum(label, 0)] == color), str(color)


def _legend(read: xr.Dataset, known: xr.Dataset | None) -> list[Artist]:
    if known is None:
        return sweep.regime_legend(read[REGIME.name].values)
    label = read[LABEL.name].values
    return [*classes.branch_entries(known, label, ink=True), *sweep.regime_legend(read[REGIME.name].values[label < 0])]


def _sections(known: xr.Dataset | None) -> sweep.Panel:
    """The section values of the gap coordinate of every attractor; those of larger share lie on top."""

    def draw(ax: Axes, ds: xr.Dataset, x: axes.DrawnAxis, page: Page) -> None:
        for k in reversed(range(ds.sizes[ATTRACTOR])):
            here = ds.isel({ATTRACTOR: k})
            section = machine.gap_values(here, x.name, here[SECTION.name])
            at = np.broadcast_to(x.values[:, None], section.shape)
            for cells, color in _groups(here, known):
                shown = np.isfinite(section) & cells[:, None]
                _points(ax, at[shown], section[shown], color, sweep.point_size(x, 0.6 * _POINT, page))
        ax.set_ylabel(gap.gap_label(ds))

    return draw


def _numbers(name: str, known: xr.Dataset | None) -> sweep.Panel:
    """One number of every attractor."""

    def draw(ax: Axes, ds: xr.Dataset, x: axes.DrawnAxis, page: Page) -> None:
        for k in reversed(range(ds.sizes[ATTRACTOR])):
            here = ds.isel({ATTRACTOR: k})
            values = here[name].values
            for cells, color in _groups(here, known):
                shown = np.isfinite(values) & cells
                if name == "share" and INTERVAL[0] in here:
                    low, high = (here[end].values[shown] for end in INTERVAL)
                    look: dict[str, Any] = {
                        "color": color,
                        "linewidth": 0.7,
                        "alpha": _PALE,
                        "zorder": 2,
                        "rasterized": True,
                    }
                    ax.vlines(x.values[shown], low, high, **look)
                _points(ax, x.values[shown], values[shown], color, sweep.point_size(x, _POINT, page))
        ax.set_ylabel(LABELS[name])

    return draw


def _points(ax: Axes, at: NDArray[Any], values: NDArray[Any], color: str, size: float) -> None:
    ax.plot(at, values, "o", color=color, markersize=size, markeredgewidth=0, zorder=3, rasterized=True)
