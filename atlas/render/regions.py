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

from atlas.curves.table import Curve
from atlas.query import machine
from atlas.query.motions import VARIABLES, motions
from atlas.render import curves, layout, maps, overlays
from atlas.render.kinds import TABLE
from atlas.render.maps import Cells, DrawnAxis, Plane
from atlas.render.options import Wanted
from workers.results import CHAOTIC, NO_IMPACT, QUASIPERIODIC

OTHERS = {CHAOTIC: "chaos", QUASIPERIODIC: "tori", NO_IMPACT: "no impact"}
"""The names of regions of other motions."""
_TYPE = (9.0, 7.5, 6.0)
"""Points of the type of names: the first that fits."""
_MOST = 4
"""Regions of one name that get it, at most: the largest."""
_FINE = 1.0
"""Points between the places at which room for a name is looked for."""
_TITLE = "$n$-$p$-$q$: $n$ periods,\n$p$ impacts above, $q$ below"
_SIDES = "\ns: symmetric, u: unsymmetric"


def figure(ds: xr.Dataset, wanted: Wanted) -> Figure:
    """The region chart as a figure; InputError where the atlas keeps no curves or holds no impact counts."""
    sides, row = ("symmetric",) if "symmetric" in ds else (), TABLE["regions"]
    view = maps.read(replace(row, variables=(*row.variables, *sides)), ds, wanted)
    plane, page, size = view.plane, view.page, view.page.map_size
    found = curves.wanted(view, "kind 'regions'")
    twins = machine.twins_everywhere(ds, {plane.x.name: plane.x.values, plane.y.name: plane.y.values})
    rest = replace(wanted, overlays=tuple(name for name in wanted.overlays if name != "curves"))
    with page.context():
        drawn, ax = maps.frame(ds, page)
        maps.scale_axes(ax, plane)
        entries: list[Artist] = [*curves.draw_lines(ax, found, view), *overlays.draw(ax, replace(view, wanted=rest))]
        title = _TITLE + (_SIDES if wanted.names and sides and twins else "")
        page.legend(drawn, entries, beside=title, handlelength=2.6)
        if not wanted.names:
            return drawn
        page.settle(drawn)
        times = max(1, round(max(np.array(size) / plane.regime.shape[::-1]) / _FINE))
        fine = _finer(plane, times)
        taken = _crossed(ax, fine.regime.shape, found, size)
        filled = np.ones((2 * times + 1, 2 * times + 1))  # a cell of another motion here and there is no region
        named = [
            (ndimage.binary_closing(np.pad(cells, times, "edge"), filled)[times:-times, times:-times] & ~taken, name)
            for name, cells in regions(fine, twins)
        ]
        sizes = [each * page.scale for each in _TYPE]
        layout.name_regions(ax, fine, [(cells, name, "white") for cells, name in named], sizes, _MOST, ~taken)
    return drawn


def regions(plane: Plane, twins: bool) -> Iterator[tuple[str, Cells]]:
    """The name of every class of motion and its cells (y, x).

    Where motions have mirror images, which of the two a cell holds depends on the start: both are one class, named
    with the larger number of impacts above. With as many above as below, the motion that is its own mirror image has
    an s behind its name, others a u.
    """
    period, upper, lower = (plane[name] for name in VARIABLES)
    if twins:
        upper, lower = np.maximum(upper, lower), np.minimum(upper, lower)
    found, number = motions(plane.regime, period, upper, lower)
    for k, motion in enumerate(found):
        cells = number == k
        if twins and motion.p == motion.q >= 0 and "symmetric" in plane.values:
            own = plane["symmetric"].astype(bool)
            yield from ((f"{motion.label} {side}", cells & part) for side, part in (("s", own), ("u", ~own)))
        elif motion.p >= 0:
            yield motion.label, cells
    for code, name in OTHERS.items():
        yield name, plane.regime == code


def _crossed(ax: Axes, cells: tuple[int, ...], found: list[Curve], size: tuple[float, float]) -> Cells:
    """The cells (y, x), all drawn equally large, that a drawn curve or a mark runs through or beside."""
    inside = np.zeros(cells, dtype=bool)
    marked = [np.asarray(each.get_xydata()) for each in ax.lines if each.get_gid() == "corner"]
    reach = 3.0 * np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)])
    places = [layout.dense(maps.in_points(ax, line, size))[0] for curve in found for line in curve.stable_lines]
    places += [maps.in_points(ax, at, size) + reach for at in marked]
    for place in places:
        share = place / np.array(size)
        columns, rows = (share[np.all((share >= 0.0) & (share < 1.0), axis=1)] * cells[::-1]).astype(int).T
        inside[rows, columns] = True
    return ndimage.binary_dilation(inside, np.ones((3, 3)))


def _finer(plane: Plane, times: int) -> Plane:
    """The plane with each cell cut into ``times`` x ``times``."""

    def cut(axis: DrawnAxis) -> DrawnAxis:
        scale, back = (np.log, np.exp) if axis.log else (np.asarray, np.asarray)
        at = np.arange(2 * times * axis.values.size + 1) / (2 * times)
        every = back(np.interp(at, np.arange(axis.edges.size), scale(axis.edges)))
        return replace(axis, values=every[1::2], edges=every[::2])

    def repeated(values: NDArray[Any]) -> NDArray[Any]:
        return values.repeat(times, axis=0).repeat(times, axis=1)

    values = {name: repeated(each) for name, each in plane.values.items()}
    return Plane(cut(plane.x), cut(plane.y), repeated(plane.regime), values)
