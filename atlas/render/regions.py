"""The region chart: the exact curves alone, and in the regions between them the names of their motions."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import ndimage

from atlas.curves.table import Curves
from atlas.query import machine
from atlas.render import axes, crowding, curves, maps, names, overlays, style
from atlas.render.impacts import ImpactPattern
from workers.results import CHAOTIC, NO_IMPACT, PERIODIC, QUASIPERIODIC

VARIABLES = ("period", "impacts_upper", "impacts_lower")

OTHERS = {CHAOTIC: "chaos", QUASIPERIODIC: "tori", NO_IMPACT: "no impact"}
"""What regions of other motions are called."""
_TYPE = (9.0, 7.5, 6.0)
"""Points of the type of names: the first that fits."""
_MOST = 4
"""Regions of one name that get it, at most: the largest."""
_FINE = 1.0
"""Points between the places at which room for a name is looked for."""
_TITLE = "$n$-$p$-$q$: $n$ periods,\n$p$ impacts above, $q$ below"
_SIDES = "\ns: symmetric, u: unsymmetric"


def figure(ds: xr.Dataset, options: maps.Options = maps.PLAIN) -> Figure:
    """The region chart as a figure; InputError where the atlas keeps no curves or holds no impact counts."""
    twins = ["symmetric"] if "symmetric" in ds else []
    plane = overlays.read(ds, [*VARIABLES, *twins], "regions", options)
    found, page = curves.wanted(curves.of(ds, "kind 'regions'"), options), options.page
    with page.context():
        drawn, ax = maps.frame(ds, page)
        ax.patch.set(facecolor="white", hatch=None)
        axes.scale_x(ax, plane.x)
        axes.scale_y(ax, plane.y)
        others = replace(options, overlays=tuple(name for name in options.overlays if name != "curves"))
        entries: list[Artist] = [*curves.draw_lines(ax, found, options), *overlays.draw(ax, ds, plane, others)]
        told_apart = options.names and twins and _has_twins(ds, plane)
        page.legend(drawn, entries, beside=_TITLE + (_SIDES if told_apart else ""), handlelength=2.6)
        if not options.names:
            return drawn
        page.fit(drawn)
        drawn.draw_without_rendering()  # from here on the plot has its size
        times = max(1, round(max(np.array(options.size) / plane.regime.shape[::-1]) / _FINE))
        fine = _finer(plane, times)
        taken = _crossed(ax, fine.regime.shape, found, options) | _covered(ax, fine)
        filled = np.ones((2 * times + 1, 2 * times + 1))  # a cell of another motion here and there is no region
        named = [
            (ndimage.binary_closing(np.pad(cells, times, "edge"), filled)[times:-times, times:-times] & ~taken, name)
            for name, cells in regions(ds, fine)
        ]
        sizes = [size * page.scale for size in _TYPE]
        names.in_regions(ax, fine, [(cells, name, "white") for cells, name in named], sizes, _MOST, ~taken)
    return drawn


def regions(ds: xr.Dataset, plane: maps.Plane) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """The name of every class of motion and its cells (y, x).

    Where motions have mirror images, which of the two a cell holds depends on the start: both are one class, named
    with the larger number of impacts above. With as many above as below, the motion that is its own mirror image has
    an s behind its name, others a u.
    """
    n, p, q = (plane[name] for name in VARIABLES)
    side = np.zeros(n.shape, dtype=np.int64)
    if _has_twins(ds, plane):
        p, q = np.maximum(p, q), np.minimum(p, q)
        if "symmetric" in plane.values:
            side = np.where(p == q, np.where(plane["symmetric"], 1, 2), 0)
    periodic = (plane.regime == PERIODIC) & (p >= 0) & (n >= 1)
    stacked = np.stack([n, p, q, side], axis=-1)
    for kind in np.unique(stacked[periodic], axis=0):
        motion = ImpactPattern(*map(int, kind[:3]))
        yield motion.label + ("", " s", " u")[int(kind[3])], periodic & (stacked == kind).all(axis=-1)
    for code, name in OTHERS.items():
        yield name, plane.regime == code


def _crossed(ax: Axes, cells: tuple[int, ...], found: Curves, options: maps.Options) -> NDArray[np.bool_]:
    """The cells (y, x), all drawn equally large, that a drawn curve runs through or beside."""
    inside = np.zeros(cells, dtype=bool)
    for line in (line for curve in found for line in curves.bounding(curve)):
        share = crowding.dense(axes.in_points(ax, line, options.size))[0] / np.array(options.size)
        share = share[np.all((share >= 0.0) & (share < 1.0), axis=1)]
        columns, rows = (share * cells[::-1]).astype(int).T
        inside[rows, columns] = True
    return ndimage.binary_dilation(inside, np.ones((3, 3)))


def _finer(plane: maps.Plane, times: int) -> maps.Plane:
    """The plane with each cell cut into ``times`` x ``times``."""

    def cut(axis: axes.DrawnAxis) -> axes.DrawnAxis:
        scale, back = (np.log, np.exp) if axis.log else (np.asarray, np.asarray)
        at = np.arange(2 * times * axis.values.size + 1) / (2 * times)
        every = back(np.interp(at, np.arange(axis.edges.size), scale(axis.edges)))
        return replace(axis, values=every[1::2], edges=every[::2])

    def repeated(values: NDArray[Any]) -> NDArray[Any]:
        return values.repeat(times, axis=0).repeat(times, axis=1)

    values = {name: repeated(each) for name, each in plane.values.items()}
    return maps.Plane(cut(plane.x), cut(plane.y), repeated(plane.regime), values)


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
