"""A plane of an atlas: its cells as arrays (y, x) with both axes rising, and the meaning of the axes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from atlas.query.window import LOG_SPAN, axis_names, cell_edges, is_log
from atlas.spec.cells import is_uniform
from atlas.spec.system import stored_system
from workers.results import APERIODIC, OF_MOTIONS, REGIME

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

_STEPS = 400
"""Minimum number of uniform steps that replace cells of unequal width."""


class CoordinateInfo(NamedTuple):
    """The meaning of a coordinate: words, symbol as mathtext, and unit in CF spelling; each is empty if unknown."""

    words: str
    symbol: str
    unit: str

    @classmethod
    def from_dataset(cls, ds: "xr.Dataset", name: str) -> "CoordinateInfo":
        """Return the meaning of a dataset's coordinate from its attributes, or else from the atlas's system."""
        system, metadata = stored_system(ds.attrs), ds[name].attrs
        known = next((p for p in system.parameters if p.name == name), None) if system else None
        names = (("long_name", "meaning"), ("symbol", "symbol"), ("units", "unit"))
        return cls(*(str(metadata.get(stored) or getattr(known, attribute, "")) for stored, attribute in names))


@dataclass(frozen=True)
class PlaneAxis:
    """One axis of a plane.

    name     name of the axis
    values   (n,) coordinates in rising order
    edges    (n + 1,) edges of the cells
    log      True if the axis is drawn on a log scale
    meaning  meaning of the coordinate
    """

    name: str
    values: Array
    edges: Array
    log: bool
    meaning: CoordinateInfo

    @property
    def uniform(self) -> bool:
        """True if all cells are drawn with equal width on a linear scale."""
        return not self.log and is_uniform(self.values)

    def even(self, count: int | None = None) -> "tuple[PlaneAxis, NDArray[np.intp]]":
        """Return the axis in steps that are drawn with equal width, and the index of the cell at each step's centre.

        By default the steps are the cells if they are uniform, and otherwise at least _STEPS. ``count`` is their
        number.
        """
        scale, back = (np.log, np.exp) if self.log else (np.asarray, np.asarray)
        cuts, n_cells = scale(self.edges), self.values.size
        every = np.linspace(cuts[0], cuts[-1], 2 * (count or n_cells) + 1)
        cells = np.clip(np.searchsorted(cuts, every[1::2], side="right") - 1, 0, n_cells - 1)
        if count is None and not np.array_equal(cells, np.arange(n_cells)):
            return self.even(max(n_cells, _STEPS))
        at = back(every)
        return replace(self, values=at[1::2], edges=at[::2]), cells


def sort_axes(ds: "xr.Dataset") -> "tuple[xr.Dataset, tuple[PlaneAxis, ...]]":
    """Return the dataset sorted so that every axis rises, and its axes, x first."""
    names, axes = axis_names(ds), []
    for name in names:
        if np.any(np.diff(ds[name].values) <= 0):
            ds = ds.sortby(name)
    for name in names:
        values = np.asarray(ds[name].values, dtype=np.float64)
        log = is_log(ds, name) and bool(values[-1] / values[0] >= LOG_SPAN)  # a plain bool, for JSON
        axes.append(PlaneAxis(name, values, cell_edges(ds, name), log, CoordinateInfo.from_dataset(ds, name)))
    return ds, tuple(axes)


def determined(regime: NDArray[np.int8]) -> Cells:
    """Return the mask of cells whose class of motion is known, such as periodic or chaotic."""
    return np.isin(regime, [*OF_MOTIONS, APERIODIC])


@dataclass(frozen=True)
class Plane:
    """The cells of a plane as arrays (y, x) with both axes rising.

    x       axis of the columns
    y       axis of the rows
    regime  regimes
    values  values of other variables, by name
    """

    x: PlaneAxis
    y: PlaneAxis
    regime: NDArray[np.int8]
    values: Mapping[str, NDArray[Any]]

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.values[name]

    @classmethod
    def from_dataset(cls, ds: "xr.Dataset", names: Sequence[str]) -> "Plane":
        """Return the plane of a loaded dataset, with the variables ``names``."""
        ds, (x, y) = sort_axes(ds)
        return cls(x, y, ds[REGIME.name].values, {name: ds[name].values for name in names})

    @property
    def determined_mask(self) -> Cells:
        """The mask of cells whose class of motion is known.

        Numbers of other cells are averages, which must not be shown as results.
        """
        return determined(self.regime)

    def known_values(self, name: str) -> Array:
        """Return the values of a variable in cells whose class of motion is known; NaN in other cells."""
        return np.where(self.determined_mask, self[name], np.nan)
