"""The region chart: the exact curves alone, and in the regions between them the names of their motions."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from atlas.curves.table import Curves
from atlas.render import axes, curves, machine, maps, overlays, style
from atlas.render.impacts import ImpactPattern, name_regions
from workers.results import CHAOTIC, NO_IMPACT, PERIODIC, QUASIPERIODIC

VARIABLES = ("period", "impacts_upper", "impacts_lower")

OTHERS = {CHAOTIC: "chaos", QUASIPERIODIC: "tori", NO_IMPACT: "no impact"}
"""What regions of other motions are called."""
_LABEL_SIZE = 9.0
_MOST = 4
"""Regions of one name that get it, at most: the largest."""


def figure(ds: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """The region chart as a figure; InputError where the atlas keeps no curves or holds no impact counts."""
    plane = overlays.read(ds, VARIABLES, "regions", options)
    found, page = curves.wanted(curves.of(ds, "kind 'regions'"), options), options.page
    with page.context():
        drawn, ax = maps.frame(ds, page)
        ax.patch.set(facecolor="white", hatch=None)
        axes.scale_x(ax, plane.x)
        axes.scale_y(ax, plane.y)
        others = replace(options, overlays=tuple(name for name in options.overlays if name != "curves"))
        entries: list[Artist] = [*curves.draw_lines(ax, found, options, 0.0), *overlays.draw(ax, ds, plane, others)]
        title = "$n$-$p$-$q$: $n$ periods,\n$p$ impacts above, $q$ below"
        page.legend(drawn, entries, beside=title, handlelength=2.6)
        if not options.names:
            return drawn
        page.fit(drawn)
        drawn.draw_without_rendering()  # from here on the plot has its size
        taken = crossed(plane, found) | _covered(ax, plane)
        names = [(cells & ~taken, name, "white") for name, cells in regions(ds, plane)]
        name_regions(ax, plane, names, _LABEL_SIZE * page.scale, _MOST)
    return drawn


def regions(ds: xr.Dataset, plane: maps.Plane) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """The name of every class of motion and its cells (y, x).

    Where motions have mirror images, which of the two a cell holds hangs on the start: both are one class, named with
    the larger number of impacts above.
    """
    n, p, q = (plane[name] for name in VARIABLES)
    if _has_twins(ds, plane):
        p, q = np.maximum(p, q), np.minimum(p, q)
    periodic = (plane.regime == PERIODIC) & (p >= 0) & (n >= 1)
    for kind in np.unique(np.stack([n, p, q], axis=-1)[periodic], axis=0):
        motion = ImpactPattern(*map(int, kind))
        yield motion.label, periodic & (n == motion.n) & (p == motion.p) & (q == motion.q)
    for code, name in OTHERS.items():
        yield name, plane.regime == code


def crossed(plane: maps.Plane, found: Curves) -> NDArray[np.bool_]:
    """The cells (y, x) that a drawn curve runs through, looked at twice a cell along it."""
    inside = np.zeros(plane.regime.shape, dtype=bool)
    for curve in found:
        for line in curves.bounding(curve):
            along, up = (
                np.interp(line[:, i], axis.edges, np.arange(len(axis.edges)), left=-1.0, right=np.inf)
                for i, axis in enumerate((plane.x, plane.y))
            )
            for k in range(len(line) - 1):
                ends = np.array([[along[k], up[k]], [along[k + 1], up[k + 1]]])
                if not np.all(np.isfinite(ends)) or np.any(ends < 0.0):
                    continue
                steps = 1 + int(np.ceil(2.0 * np.max(np.abs(ends[1] - ends[0]))))
                places = np.floor(ends[0] + np.linspace(0.0, 1.0, steps + 1)[:, None] * (ends[1] - ends[0]))
                columns, rows = np.minimum(places, np.array(inside.shape[::-1]) - 1).astype(int).T
                inside[rows, columns] = True
    return inside


def _covered(ax: Axes, plane: maps.Plane) -> NDArray[np.bool_]:
    """The cells (y, x) that names of points of codimension two stand on."""
    inside = np.zeros(plane.regime.shape, dtype=bool)
    for text in ax.texts:
        (left, low), (right, high) = ax.transData.inverted().transform(text.get_window_extent())
        columns = (plane.x.edges[1:] >= left) & (plane.x.edges[:-1] <= right)
        rows = (plane.y.edges[1:] >= low) & (plane.y.edges[:-1] <= high)
        inside |= rows[:, None] & columns
    return inside


def _has_twins(ds: xr.Dataset, plane: maps.Plane) -> bool:
    system = style.system_of(ds)
    if system is None:
        return False
    across, up = np.meshgrid(plane.x.values[[0, -1]], plane.y.values[[0, -1]])
    ends = {plane.x.name: across.ravel(), plane.y.name: up.ravel()}
    return bool(np.all(machine.has_twins(system, machine.fixed(ds, system), ends)))
