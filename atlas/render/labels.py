"""The map of labels: which branch the attractor of each cell is on, in colours that persist from cell to cell."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.query.attractors import branches
from atlas.render import maps, overlays, style
from atlas.render.basins import colors_of
from workers.results import LABEL, NO_IMPACT

PALETTE = ("#4477aa", "#e0a83a", "#5fa36a", "#b65c8f", "#7f6bb3", "#c9703f", "#3aa6a6", "#8c7a2e")
"""Colours of the branches of largest share; each also in a paler tone, of its mirror image."""
REST = "#7d7d7d"
"""The colour of all other branches."""


def figure(ds: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """The map as a figure, of the attractor with the largest share unless another one was selected.

    A mirror image has a paler tone of its twin's hue; chaos and tori, which have no label, the colour of their regime.
    InputError where the attractors of the atlas are not labelled.
    """
    if LABEL.name not in ds or "share" not in ds:
        raise InputError("kind 'labels' draws labels, and this atlas has none; label its attractors by atlas label")
    return picture(ds, branches(ds), options)


def picture(ds: xr.Dataset, known: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """As ``figure``, with the table of the branches given."""
    plane = overlays.read(ds, [LABEL.name], "labels", options)
    with options.page.context():
        drawn, ax = maps.frame(ds, options.page)
        rgba, legend = paint(plane.regime, np.rint(plane[LABEL.name]).astype(np.int64), known)
        maps.draw(ax, plane, rgba, options)
        entries: list[Artist] = [*legend, *overlays.draw(ax, ds, plane, options)]
        options.page.legend(drawn, entries, beside="")
    return drawn


def paint(
    regime: NDArray[np.int8], label: NDArray[np.int64], known: xr.Dataset
) -> tuple[NDArray[np.uint8], list[Patch]]:
    """The colour of every cell, (y, x, 4) in bytes, and legend entries for what is present."""
    rgba = np.zeros((*regime.shape, 4), dtype=np.uint8)
    table = np.array([style.rgb(color) for color in colors(known)], dtype=np.uint8).reshape(-1, 4)
    there = label >= 0
    rgba[there] = table[label[there]]
    return rgba, entries(known, label) + maps.paint_regimes(rgba, regime, ~there)


def colors(known: xr.Dataset) -> list[str]:
    """The colour of every branch, by its label; small ones share one."""
    return colors_of(known, PALETTE, REST)


def entries(known: xr.Dataset, label: NDArray[np.int64]) -> list[Patch]:
    """Legend entries of the branches among these labels."""
    there, own = np.unique(label[label >= 0]), colors(known)
    named = [k for k in there.tolist() if own[k] != REST]
    made = [style.swatch(own[k], f"{k}: {name_of(known, k)}") for k in named]
    return made + ([style.swatch(REST, f"{len(there) - len(named)} others")] if len(there) > len(named) else [])


def name_of(known: xr.Dataset, label: int) -> str:
    """A branch in a few words: n-p-q, periods, impacts at either stop; and whose mirror image it is."""
    one = known.isel(branch=label)
    if int(one["regime"]) == NO_IMPACT:
        return style.name_of(NO_IMPACT)
    name = "-".join(str(int(one[each])) for each in ("period", "impacts_upper", "impacts_lower"))
    return name + (f", mirrors {int(one['mirror'])}" if 0 <= int(one["mirror"]) < label else "")
