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

from atlas.errors import InputError
from atlas.query import machine
from atlas.query.attractors import branches as branches_of
from atlas.render import classes, style, sweep, words
from atlas.render.maps import DrawnAxis
from atlas.render.options import Wanted
from atlas.render.page import Page
from atlas.spec.system import stored_system
from workers.results import ATTRACTOR, LABEL, LARGEST, PENDING, REGIME, SECTION

INTERVAL = ("share_low", "share_high")
"""The ends of the interval of a share, which is drawn where an atlas has it."""
_PALE, _POINT = 0.3, 2.0
"""How opaque intervals are; the least diameter of a point in points of the page, which is still seen on white."""
LABELS = {"share": "share of the\ninitial states", LARGEST.name: sweep.LARGEST_LABEL}


def figure(ds: xr.Dataset, wanted: Wanted) -> Figure:
    """The sections of all attractors in the colours of their regimes, under them their shares, or their exponents where
    no sections are kept. Where its attractors are labelled the colours of orbits are those of their labels.

    InputError where the atlas does not hold all attractors.
    """
    if ATTRACTOR not in ds.dims:
        raise InputError("kind 'coexistence' draws all attractors, and this atlas has one a cell; see [attractors]")
    known = branches_of(ds) if LABEL.name in ds else None
    has_sections = SECTION.name in ds and ds[SECTION.name].size > 0
    names = [SECTION.name] if has_sections else [LARGEST.name] if LARGEST.name in ds else []
    panels = {name: _panel(name, known) for name in [*names, "share"]}
    ends = [name for name in INTERVAL if name in ds]
    read = sweep.line(ds, [*panels, *ends, *([] if known is None else [LABEL.name])])
    regime, entries = read[0][REGIME.name].values, list[Artist]()
    if known is not None:
        label = read[0][LABEL.name].values
        entries, regime = [*classes.branch_entries(known, label, ink=True)], regime[label < 0]
    entries += sweep.regime_legend(regime)
    if ends:
        entries.append(Line2D([], [], color="#404040", alpha=_PALE, linewidth=0.7, label="95 % interval"))
    return sweep.stack(ds, read, panels, entries, wanted)


def _panel(name: str, known: xr.Dataset | None) -> sweep.Panel:
    """Section values or one number of every attractor; those of larger share lie on top."""

    def draw(ax: Axes, ds: xr.Dataset, x: DrawnAxis, page: Page) -> None:
        for k in reversed(range(ds.sizes[ATTRACTOR])):
            here, section = ds.isel({ATTRACTOR: k}), name == SECTION.name
            values = machine.gap_values(here, x.name, here[name]) if section else here[name].values
            size = sweep.point_size(x, 0.6 * _POINT if section else _POINT, page)
            for cells, color in _groups(here, known):
                if name == "share" and INTERVAL[0] in here:
                    shown = np.isfinite(values) & cells
                    low, high = (here[end].values[shown] for end in INTERVAL)
                    look: dict[str, Any] = {"color": color, "linewidth": 0.7, "alpha": _PALE, "rasterized": True}
                    ax.vlines(x.values[shown], low, high, zorder=2, **look)
                own = np.where(cells[:, None] if section else cells, values, np.nan)
                sweep.draw_points(ax, x, own, color, size, "o")
        ax.set_ylabel(words.gap_label(stored_system(ds.attrs)) if name == SECTION.name else LABELS[name])

    return draw


def _groups(here: xr.Dataset, known: xr.Dataset | None) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """Which cells have an attractor of one colour, and that colour; ``here`` is of one attractor a cell."""
    regime = here[REGIME.name].values
    label = here[LABEL.name].values if known is not None else np.full(regime.shape, -1)
    for code in np.unique(regime[(regime != PENDING) & (label < 0)]):
        yield (regime == code) & (label < 0), style.INK[int(code)]
    colors = np.array(classes.branch_colors(known, ink=True) if known is not None else [], dtype=str)
    for color in np.unique(colors[label[label >= 0]]):
        yield (label >= 0) & (colors[np.maximum(label, 0)] == color), str(color)
