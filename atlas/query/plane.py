"""The cells of a plane as arrays (y, x) with both axes rising, and the meaning of its axes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from atlas.query.window import LOG_SPAN, axis_names, cell_edges, is_log
from atlas.spec.cells import is_uniform
from atlas.spec.system import stored_system
from workers.results import APERIODIC, CHAOTIC, LOCKING, NO_IMPACT, REGIME

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

_STEPS = 400
"""Least number of steps that take the place of cells which are not drawn equally wide."""


class CoordinateInfo(NamedTuple):
    """A coordinate's meaning: words, symbol as mathtext, CF unit; empty where unknown."""

    words: str
    symbol: str
    unit: str

    @classmethod
    def from_dataset(cls, ds: "xr.Dataset", name: str) -> "CoordinateInfo":
        """The meaning by the coordinate's attributes, or, where it lacks one, by the atlas's system."""
        system, own = stored_system(ds.attrs), ds[name].attrs
        known = next((p for p in system.parameters if p.name == name), None) if system else None
        names = (("long_name", "meaning"), ("symbol", "symbol"), ("units", "unit"))
        return cls(*(str(own.get(stored) or getattr(known, attribute, "")) for stored, attribute in names))


@dataclass(frozen=True)
class PlaneAxis:
    """One axis: its points in rising order, their cells' edges, whether it is drawn in the logarithm, its meaning."""

    name: str
    values: Array
    edges: Array
    log: bool
    meaning: CoordinateInfo

    @property
    def uniform(self) -> bool:
        """Whether all cells are drawn equally wide on a linear scale."""
        return not self.log and is_uniform(self.values)

    def even(self, count: int | None = None) -> "tuple[PlaneAxis, NDArray[np.intp]]":
        """The axis in ``count`` steps that are drawn equally wide, and the cell that has the middle of each.

        By default these are the cells themselves where they are drawn so, and else at least _STEPS.
        """
        scale, back = (np.log, np.exp) if self.log else (np.asarray, np.asarray)
        cuts, own = scale(self.edges), self.values.size
        every = np.linspace(cuts[0], cuts[-1], 2 * (count or own) + 1)
        cells = np.clip(np.searchsorted(cuts, every[1::2], side="right") - 1, 0, own - 1)
        if count is None and not np.array_equal(cells, np.arange(own)):
            return self.even(max(own, _STEPS))
        at = back(every)
        return replace(self, values=at[1::2], edges=at[::2]), cells


def sort_axes(ds: "xr.Dataset") -> "tuple[xr.Dataset, tuple[PlaneAxis, ...]]":
    """The dataset with every axis in rising order, and its axes, x first."""
    names, axes = axis_names(ds), []
    for name in names:
        if np.any(np.diff(ds[name].values) <= 0):
            ds = ds.sortby(name)
    for name in names:
        values = np.asarray(ds[name].values, dtype=np.float64)
        log = is_log(ds, name) and bool(values[-1] / values[0] >= LOG_SPAN)  # plain, as JSON wants it
        axes.append(PlaneAxis(name, values, cell_edges(ds, name), log, CoordinateInfo.from_dataset(ds, name)))
    return ds, tuple(axes)


def determined(regime: NDArray[np.int8]) -> Cells:
    """Where the class of motion is known."""
    return ((regime >= NO_IMPACT) & (regime <= CHAOTIC)) | (regime == APERIODIC) | (regime == LOCKING)


@dataclass(frozen=True)
class Plane:
    """The cells of a plane as arrays (y, x) with both axes rising: regimes, and the values of other variables."""

    x: PlaneAxis
    y: PlaneAxis
    regime: NDArray[np.int8]
    values: Mapping[str, NDArray[Any]]

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.values[name]

    @classmethod
    def from_dataset(cls, ds: "xr.Dataset", names: Sequence[str]) -> "Plane":
        """The plane of a dataset that is read."""
        ds, (x, y) = sort_axes(ds)
        return cls(x, y, ds[REGIME.name].values, {name: ds[name].values for name in names})

    @property
    def determined_mask(self) -> Cells:
        """Where the class of motion is known: what else a cell holds are averages that must not pass for results."""
        return determined(self.regime)

    def known_values(self, name: str) -> Array:
        """The values of a variable where the class of motion is known, NaN elsewhere."""
        return np.where(self.determined_mask, self[name], np.nan)

    def even(self, times: int | None = None) -> "Plane":
        """The plane in steps that are drawn equally wide, ``times`` as many as cells along each axis: see the axis."""
        x, columns = self.x.even(times and times * self.x.values.size)
        y, rows = self.y.even(times and times * self.y.values.size)
        place = np.ix_(rows, columns)
        return Plane(x, y, self.regime[place], {name: values[place] for name, values in self.values.items()})
