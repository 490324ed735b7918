"""What differs between two planes in view: compared at the cells that both know at the same parameters, no others."""

from collections.abc import Callable, Collection, Iterable, Set
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from atlas.explore.chosen import Chosen, Ends, Range
from atlas.explore.compose import Index, atlas_cells, dataset
from atlas.explore.explorer import Explorer
from atlas.explore.known import Known
from atlas.explore.painter import Painted, Painter
from atlas.explore.style import KEY_WIDTH
from atlas.explore.subject import Plane, Subject
from atlas.explore.tiles import Arrays
from atlas.explore.view import STAGES, Sight, Stretch, TileKey
from atlas.explore.words import number
from atlas.query.extremes import regimes_with
from atlas.query.plane import determined
from atlas.render import has_scale
from atlas.render.change import CHANGE, change_of
from atlas.render.screen import Screen, screen
from atlas.text import plural
from workers.results import PENDING, REGIME

if TYPE_CHECKING:
    import xarray as xr

ULPS = 4.0
"""Parameters that differ by at most this number of units in the last place are the same: grids round differently."""


class Seen(NamedTuple):
    """A plane as it is seen: what is known of its subject, which plane, and the cells in view."""

    known: Known
    plane: Plane
    sight: Sight

    @property
    def points(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The parameters of the cells in view, along x and along y."""
        return self.known.subject.points(*self.sight)


def changes(here: Seen, there: Seen, chosen: Chosen) -> "tuple[xr.Dataset, str]":
    """The changes from the first plane to the second, as ``render.change`` draws them, and in words.

    They are those of the picture that is chosen, at the cells in view of the first. A cell that is not compared shows
    the change of the nearest compared cell of a coarser stage, as maps do while they are solved. InputError where one
    of both has no such variable.
    """
    kind = change_of(chosen.kind, chosen.variable)
    own = [name for name in kind.variables if name != CHANGE]
    names = [*dict.fromkeys([*own, REGIME.name])]
    one, found = exact(here, names), exact(there, names)
    other = there.known.subject.without_results(names, here.sight.shape)
    (j, to_j), (i, to_i) = (same_points(*pair) for pair in zip(here.points, there.points, strict=True))
    for name, values in found.items():
        other[name][np.ix_(i, j)] = values[np.ix_(to_i, to_j)]
    compared = determined(one[REGIME.name]) & determined(other[REGIME.name])
    if has_scale(chosen.kind):
        change, says = _numbers(one, other, own[0], compared)
    else:
        change, says = _classes(one, other, own, compared)
    other[REGIME.name][~compared] = PENDING
    _spread(other | {CHANGE: change}, compared, here.sight)
    made = dataset(there.known.subject, there.plane, *here.points, other)
    made[CHANGE] = (made[REGIME.name].dims, change)
    if not compared.any():
        return made, "no cell in view is known in both planes at the same parameters"
    return made, f"{says}, compared where both are known at the same parameters"


def exact(seen: Seen, names: Collection[str]) -> Arrays:
    """The cells in view (y, x) that are known at their own parameters; what is known only nearby is pending."""
    (known, plane, sight), subject = seen, seen.known.subject
    found = subject.without_results(names, sight.shape)
    tiles = [(min(key[:2]) >= 0, _tile(key, arrays, found)) for key, arrays in known.tiles.shown(plane, sight)]
    layers = [layer for finer, layer in tiles if not finer]  # in the order in which maps lay them
    if subject.ds is not None and plane == subject.plane:
        layers.append(_atlas(subject, subject.ds, found))
    for layer in [*layers, *(layer for finer, layer in tiles if finer)]:
        (columns, across), (rows, up) = _own(sight.x, layer.x), _own(sight.y, layer.y)
        if rows.size and columns.size and layer.names >= found.keys():
            part, place = layer.read(up, across), np.ix_(rows, columns)
            there = part[REGIME.name] != PENDING
            for name, values in found.items():
                values[place] = np.where(there, part[name], values[place])
    return found


class Layer(NamedTuple):
    """Cells that are known, by these names: which along each axis; and what reads some of them, (y, x)."""

    names: Set[str]
    x: Stretch
    y: Stretch
    read: Callable[[Index, Index], Arrays]


def _tile(key: TileKey, arrays: Arrays, wanted: Arrays) -> Layer:
    def read(up: Index, across: Index) -> Arrays:
        return {name: arrays[name][np.ix_(up, across)] for name in wanted}

    return Layer(arrays.keys(), key.columns, key.rows, read)


def _atlas(subject: Subject, ds: "xr.Dataset", wanted: Arrays) -> Layer:
    x, y = (Stretch(0, 0, ds.sizes[name]) for name in subject.axes)
    return Layer({*map(str, ds.data_vars)}, x, y, partial(atlas_cells, subject, wanted))


def _own(seen: Stretch, layer: Stretch) -> tuple[Index, Index]:
    """Which cells in view are cells of a layer too, along one axis, and which of the layer they are."""
    index, shift = seen.index, seen.level - layer.level
    at = (index >> shift if shift > 0 else index << -shift) - layer.first
    here = np.flatnonzero((index % (1 << max(shift, 0)) == 0) & (at >= 0) & (at < layer.count))
    return here, at[here]


def same_points(one: NDArray[np.float64], other: NDArray[np.float64]) -> tuple[Index, Index]:
    """The places of points that both have, rising, to ULPS units in the last place: in the one and in the other."""
    near = np.clip(np.searchsorted(0.5 * (other[1:] + other[:-1]), one), 0, other.size - 1)
    same = np.flatnonzero(np.abs(one - other[near]) <= ULPS * np.spacing(np.abs(one).max()))
    return same, near[same]


def _numbers(one: Arrays, other: Arrays, name: str, compared: NDArray[np.bool_]) -> tuple[NDArray[Any], str]:
    """The number there minus the number here, NaN where one has none."""
    values = []
    for arrays in (one, other):
        value = arrays[name].astype(np.float64)
        result = compared & np.isin(arrays[REGIME.name], list(regimes_with(name))) & np.isfinite(value)
        if name.startswith("impacts_"):
            result &= value >= 0.0  # without end, at rest on a stop
        values.append(np.where(result, value, np.nan))
    change = values[1] - values[0]
    known = change[np.isfinite(change)]
    if not known.size:
        return change, "no cell has this number in both planes"
    mean, size = number(float(known.mean()), 3), number(float(np.abs(known).mean()), 3)
    return change, f"{plural(known.size, 'cell')}: mean difference {mean}, mean size {size}"


def _classes(
    one: Arrays, other: Arrays, names: Iterable[str], compared: NDArray[np.bool_]
) -> tuple[NDArray[np.int8], str]:
    """Where the classes differ: the regimes, or what tells classes of one regime apart."""
    here, there = one[REGIME.name], other[REGIME.name]
    differ = here != there
    for name in names:
        differ |= (one[name] != other[name]) & np.isin(here, list(regimes_with(name)))
    differ &= compared
    return differ.astype(np.int8), f"{differ.sum()} of {plural(int(compared.sum()), 'cell')} differ"


def _spread(cells: Arrays, known: NDArray[np.bool_], sight: Sight) -> None:
    """Give cells that are not known, in place, what the nearest known cell of a coarser stage has."""
    left = ~known
    for stage in range(1, STAGES + 1):
        half, places, inside = (1 << stage) // 2, [], []
        for index in (sight.y.index, sight.x.index):
            place = (((index + half) >> stage) << stage) - index[0]
            inside.append((place >= 0) & (place < index.size))
            places.append(np.clip(place, 0, index.size - 1))
        near = np.ix_(*places)
        take = left & np.outer(*inside) & known[near]
        for values in cells.values():
            values[take] = values[near][take]
        left &= ~take


class DifferencePainter(Painter):
    """Paints the difference between a plane of the ``first`` explorer, ``Chosen.less``, and one of the other."""

    def __init__(
        self, explorer: Explorer, first: Explorer, deliver: Callable[[Painted], None], refuse: Callable[[str], None]
    ) -> None:
        self._first, self._note = first, ""
        self._here: Seen
        super().__init__(explorer, deliver, refuse)
        first.listen(self, self._told)

    def close(self) -> None:
        """See ``Painter``."""
        super().close()
        self._first.listen(self, None)

    def _concerns(self, chosen: Chosen, plane: Plane, key: TileKey) -> bool:
        return plane in (chosen.plane, chosen.less)

    def _find(self, stages: range) -> None:
        if self._asked is not None:
            (chosen, size), first = self._asked, self._first
            sight = first.subject.sight(chosen.x, chosen.y, size)
            self._here = Seen(first.known, chosen.less or chosen.plane, sight)
            first.known.look(self._here.plane, sight, chosen.names)
        super()._find(stages)

    def _cells(self, chosen: Chosen, sight: Sight) -> "xr.Dataset":
        found, self._note = changes(self._here, Seen(self._explorer.known, chosen.plane, sight), chosen)
        return found

    def _edges(self, chosen: Chosen, sight: Sight) -> tuple[Range, Range]:
        return self._first.subject.edges(self._here.sight)

    def _drawn(self, ds: "xr.Dataset", chosen: Chosen, pixels: tuple[int, int], ends: Ends) -> tuple[Screen, str]:
        kind = change_of(chosen.kind, chosen.variable)
        return screen(ds, kind, pixels, KEY_WIDTH, **chosen.scaled(ends)), self._note

    def _whole(self, chosen: Chosen) -> dict[tuple[object, ...], Range]:
        return {}
