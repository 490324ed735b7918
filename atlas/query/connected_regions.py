"""Connected regions of cells of one class, such as the period-3 windows in chaos.

Cells are connected if they share an edge; a common corner is not enough.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from atlas.argument_checks import is_integer
from atlas.errors import InputError, brief_repr
from atlas.query.cell_blocks import iter_cell_blocks
from atlas.query.classes import CellClassifier, parse_class
from atlas.query.window import Window, axis_names, axis_values, cell_edges, check_not_points, select_window
from workers.results import PENDING, REGIME

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

_CELLS_PER_BLOCK = 1 << 20
"""Maximum number of cells whose areas are summed at a time."""


def regions(
    ds: "xr.Dataset", by: str = REGIME.name, value: object = None, window: Window | None = None, min_cells: int = 1
) -> list[dict[str, Any]]:
    """Return every connected region of equal regime, period or impact pattern, the largest area first.

    Each region is a dict with the keys:

    label           number of the region, from 1, as in ``labels``
    by (its value)  regime, period or impact pattern of the region, as in ``CellClassifier``
    cells           number of cells
    area            area of the cells, from edge to edge, in the units of the axes; for a sweep the length
    share           fraction of the area of ``window``, by default of the plane
    centre          centre of the area, by axis; may lie outside a bent region
    cell            parameters, by axis, of the cell nearest to the mean position of the cells, for ``at`` or
                    ``portrait``
    box             (low, high) edges of the bounding box, by axis
    cut             where the region may go on: ``lowest omega`` or ``highest b`` for an edge of the plane or of
                    ``window`` that it touches, and ``pending cells``; empty if the region is complete

    ``value`` selects one class, such as 3 for period 3; ``regions(ds, "chaotic")`` selects a regime. Regions of fewer
    than ``min_cells`` cells are left out. Raise InputError for an unknown axis or class, and for a ``window`` without a
    cell. Only variables that determine the class are read, and only tiles with such cells. The memory needed is about
    15 bytes per cell and 2 kB per region.
    """
    return _find(ds, by, value, window, min_cells).listed()


def flat(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return a region, a dict of ``regions``, as one row of a table.

    The row has a column for each axis of the region's centre, nearest cell and bounding box.
    """
    row = {key: entry[key] for key in entry if key not in ("centre", "cell", "box", "cut")}
    for key in ("centre", "cell"):
        row |= {f"{key}_{name}": value for name, value in entry[key].items()}
    for name, (low, high) in entry["box"].items():
        row |= {f"{name}_from": low, f"{name}_to": high}
    return row | {"cut": ", ".join(entry["cut"])}


def labels(
    ds: "xr.Dataset", by: str = REGIME.name, value: object = None, window: Window | None = None, min_cells: int = 1
) -> "xr.DataArray":
    """Return the label of the region that contains each cell, as in ``regions``; 0 if the cell is in no region.

    Arguments and errors are those of ``regions``.
    """
    import xarray

    regions, part = _find(ds, by, value, window, min_cells), select_window(ds, window)
    by = regions.by
    dims = part[REGIME.name].dims
    coords = {name: part[name] for name in dims} | {n: part[n] for n in part.coords if part[n].ndim == 0}
    attrs = {"long_name": f"label of the region of equal {by}", "units": "1"}
    return xarray.DataArray(regions.as_given(), coords, dims, "label", attrs)


@dataclass(frozen=True)
class _RegionAxis:
    """The selected cells along one axis of an atlas, in rising order.

    name    name of the axis
    order   indices that sort the cells
    points  coordinates of the cells
    low     lower edge of each cell
    high    upper edge of each cell
    """

    name: str
    order: NDArray[np.intp]
    points: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]

    def span(self, cells: slice) -> tuple[float, float]:
        """Return the outer edges of the consecutive cells ``cells``."""
        return float(self.low[cells.start]), float(self.high[cells.stop - 1])


@dataclass(frozen=True)
class _Regions:
    """The connected regions of the selected cells, numbered by labels from 1.

    by                 result that classifies the cells
    sides              axes of the regions, by dimension
    labels             label of each cell, with all dimensions rising; 0 for none
    values             class of each region
    sums               sums over the cells of each region, as ``_cells`` lists them
    labels_at_pending  labels of the regions with a pending neighbour cell
    """

    by: str
    sides: tuple[_RegionAxis, ...]
    labels: NDArray[np.int32]
    values: list[Any]
    sums: "pd.DataFrame"
    labels_at_pending: set[int]

    def as_given(self) -> NDArray[np.int32]:
        """Return the label of each cell in the order of the dataset's own axes, which may fall."""
        region_labels = np.empty_like(self.labels)
        region_labels[np.ix_(*(side.order for side in self.sides))] = self.labels
        return region_labels

    def listed(self) -> list[dict[str, Any]]:
        """Return the regions as the dicts that ``regions`` describes."""
        total = float(np.prod([(side.high - side.low).sum() for side in self.sides]))
        nearest, boxes = _nearest(self.labels, self.sides, self.sums), ndimage.find_objects(self.labels)
        sums, listed = self.sums.to_dict("list"), []
        along = list(enumerate(self.sides))[::-1]  # x first
        for k, (value, area) in enumerate(zip(self.values, sums["area"], strict=True)):
            listed.append({
                "label": k + 1,
                self.by: value,
                "cells": sums["cells"][k],
                "area": area,
                "share": area / total,
                "centre": {side.name: sums[f"moment {i}"][k] / area for i, side in along},
                "cell": {side.name: float(side.points[nearest[f"index {i}"].iloc[k]]) for i, side in along},
                "box": {side.name: side.span(boxes[k][i]) for i, side in along},
                "cut": [*self._cut(boxes[k]), *(["pending cells"] if k + 1 in self.labels_at_pending else [])],
            })  # fmt: skip
        return listed

    def _cut(self, box: tuple[slice, ...]) -> Iterator[str]:
        for side, along in reversed(list(zip(self.sides, box, strict=True))):
            if along.start == 0:
                yield f"lowest {side.name}"
            if along.stop == side.points.size:
                yield f"highest {side.name}"


def _find(ds: "xr.Dataset", by: str, value: object, window: Window | None, min_cells: int) -> _Regions:
    if not is_integer(min_cells) or min_cells < 1:
        raise InputError(f"min_cells: found {brief_repr(min_cells)}, must be a whole number of cells, 1 or more")
    import pandas as pd

    check_not_points(ds, "regions")
    by, value = parse_class(by, value)
    classes, part = CellClassifier(ds, by, value), select_window(ds, window)
    sides = tuple(_side(ds, part, name) for name in reversed(axis_names(ds)))
    shape = tuple(side.points.size for side in sides)
    numbers, pending = np.zeros(shape, np.int32), np.zeros(shape, bool)
    for block in iter_cell_blocks(part, classes.names, {*classes.codes, PENDING}):
        numbers[block.cells], pending[block.cells] = classes.number(block), block.regime == PENDING
    rising = np.ix_(*(side.order for side in sides))
    numbers, pending = numbers[rising], pending[rising]
    label, values = label_components(numbers, classes.list_classes())
    sums = pd.concat([cells.groupby("label").sum() for cells in _cells(label, sides)]).groupby("label").sum()
    sums = sums[sums["cells"] >= min_cells].sort_values("area", ascending=False, kind="stable")
    renamed = np.zeros(len(values) + 1, np.int32)
    renamed[sums.index] = np.arange(1, len(sums) + 1)
    label = renamed[label]
    return _Regions(by, sides, label, [values[k - 1] for k in sums.index], sums, _beside(label, pending))


def _side(ds: "xr.Dataset", part: "xr.Dataset", name: str) -> _RegionAxis:
    """Return the axis ``name`` of the selected cells ``part``, with the cells' edges in the whole atlas ``ds``."""
    points, edges = axis_values(part, name), cell_edges(ds, name)
    order = np.argsort(points)
    index = np.searchsorted(np.sort(axis_values(ds, name)), points[order])
    return _RegionAxis(name, order, points[order], edges[:-1][index], edges[1:][index])


def label_components(
    numbers: NDArray[np.signedinteger[Any]], classes: list[tuple[int, Any]]
) -> tuple[NDArray[np.int32], list[Any]]:
    """Return a label for each connected set of cells with equal numbers above 0, and the class of each set.

    numbers   class number of each cell; 0 for cells without a class
    classes   the class numbers that occur, with their classes

    The first result is the label of every cell, from 1 in the order of ``classes``; 0 for cells without a class.
    """
    label = np.zeros(numbers.shape, np.int32)
    owners: list[Any] = []
    boxes = ndimage.find_objects(numbers)
    for number, value in classes:
        box = boxes[number - 1]
        part, count = ndimage.label(numbers[box] == number)
        label[box] += np.where(part > 0, part + len(owners), 0).astype(np.int32)
        owners += [value] * count
    return label, owners


def _cells(labels: NDArray[np.int32], sides: tuple[_RegionAxis, ...]) -> Iterator["pd.DataFrame"]:
    """Yield the cells of regions in blocks of rows, as tables with one row per cell: its label, 1, and its area.

    For each dimension follow the index of the cell, and the area times the cell's midpoint. ``labels`` is the label of
    every cell; cells with 0 are left out.
    """
    import pandas as pd

    rows = max(1, _CELLS_PER_BLOCK * labels.shape[0] // max(1, labels.size))
    for first in range(0, labels.shape[0], rows):
        at = np.nonzero(labels[first : first + rows])
        index = [at[0] + first, *at[1:]]
        area = np.prod([(side.high - side.low)[i] for side, i in zip(sides, index, strict=True)], axis=0)
        columns: dict[str, Any] = {"label": labels[tuple(index)], "cells": 1, "area": area}
        for k, (side, i) in enumerate(zip(sides, index, strict=True)):
            columns |= {f"index {k}": i, f"moment {k}": area * 0.5 * (side.low + side.high)[i]}
        yield pd.DataFrame(columns)


def _nearest(labels: NDArray[np.int32], sides: tuple[_RegionAxis, ...], sums: "pd.DataFrame") -> "pd.DataFrame":
    """Return the indices of the cell of each region that is nearest to the mean of the region's cells, by label.

    Of equal distances the first cell counts. Arguments are the fields of ``_Regions``.
    """
    import pandas as pd

    names = [f"index {k}" for k in range(len(sides))]
    middle, best = sums[names].to_numpy() / sums[["cells"]].to_numpy(), []
    for cells in _cells(labels, sides):
        away = ((cells[names].to_numpy() - middle[cells["label"] - 1]) ** 2).sum(axis=1)
        cells["away"] = away
        best.append(cells.loc[cells.groupby("label")["away"].idxmin()])
    nearest = pd.concat(best, ignore_index=True)
    return nearest.loc[nearest.groupby("label")["away"].idxmin()]


def _beside(label: NDArray[np.int32], pending: NDArray[np.bool_]) -> set[int]:
    """Return the labels of regions that have a pending (not yet solved) neighbour cell."""
    neighbours: set[int] = set()
    for axis in range(label.ndim):
        for one, other in ((slice(None, -1), slice(1, None)), (slice(1, None), slice(None, -1))):
            cut = (slice(None),) * axis
            neighbours |= set(np.unique(label[(*cut, one)][pending[(*cut, other)]]).tolist())
    return neighbours - {0}
