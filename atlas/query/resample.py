"""Reading cells for pictures and queries, at the overview level that matches the pixels.

``read_view`` returns a loaded dataset like that of ``atlas.open``, coarsened where cells are finer than pixels. Data
that do not come unmodified from a store (computed, changed or concatenated) are returned as they are.
"""

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.overview.coarsen import (
    CLASSES,
    REGIME_SHOWN,
    SHARE,
    Cells,
    coarsen,
    halve_widths,
)
from atlas.overview.coordinates import bounds_name, centres
from atlas.query.read_counter import count_reads
from atlas.query.store_block import StoreBlock, find_part
from atlas.query.window import LOG_SPAN, Window, axis_names, axis_values, is_log, select_window
from atlas.spec.cells import edges_of
from workers.results import (
    ERROR,
    FAILED,
    INVALID,
    LARGEST,
    NO_IMPACT,
    PENDING,
    PERIODIC,
    REGIME,
    SUM_LAW_DEFECT,
    UNDETERMINED,
)

if TYPE_CHECKING:
    import xarray as xr

_EXPONENTS = (LARGEST.name, ERROR.name, SUM_LAW_DEFECT.name)
_WITHOUT = (PENDING, UNDETERMINED, INVALID, FAILED)
"""Regimes whose cells have no exponent."""


def read_view(
    ds: "xr.Dataset",
    names: Iterable[str],
    window: Window | None = None,
    pixels: Sequence[int] | None = None,
    marks: bool = True,
) -> "xr.Dataset":
    """Return variables and regimes of an atlas in a window, coarsened to about one cell per pixel.

    names   names of the variables
    window  window; None for all cells
    pixels  size (x, y) of the area to fill; None for full resolution
    marks   True if coarse cells show ``regime_shown``, and no exponent, period or result that their regime lacks; False
            for the most frequent regime

    The cells are read at a level of the store's overviews, copies with ever fewer cells. The level is the finest whose
    widest cell is not finer than a pixel. The result is an atlas with the same names, dimensions and attributes, and
    ``encoding["level"]`` is its level. At coarser levels the axes have CF bounds that end at those of the window;
    ``overview.coarsen`` defines the values of coarse cells. Variables without overviews are read cell by cell. Raise
    InputError for an unknown axis, and for a window without a cell.
    """
    ds = select_window(ds, window)
    requested = list(dict.fromkeys([*names, REGIME.name]))
    part = find_part(ds, requested)
    if part is None:
        return ds[requested]
    known = {variable.name for variable in part.pyramid.variables}
    n_uncoarsened = part.pyramid.levels.n_uncoarsened
    free = len(part.cells) - n_uncoarsened
    steps = [0] * n_uncoarsened + (
        _steps(ds, pixels)[-free:] if pixels and free and known.issuperset(requested) else [0] * free
    )
    seen = _coarse(ds, part, requested, steps, marks) if max(steps) else _fine(ds, part, requested)
    block = tuple(2**count for count in reversed(steps[n_uncoarsened:]))
    count_reads(part.chunks_read, min(steps[n_uncoarsened:], default=0), block or (1,))
    return seen


def _steps(ds: "xr.Dataset", pixels: Sequence[int]) -> list[int]:
    """Return how often the number of cells along each dimension is halved for a picture of ``pixels`` (x, y).

    The widest cell is then not finer than a pixel. A quarter of a halving is tolerated: 1.19 cells per pixel are better
    than 0.6.
    """
    steps = []
    for name, size in zip(axis_names(ds), pixels, strict=False):
        values = axis_values(ds, name)
        log = is_log(ds, name)
        edges = edges_of(values, log)
        drawn = np.log(edges) if log and values[-1] / values[0] >= LOG_SPAN else edges
        cells = (drawn[-1] - drawn[0]) / np.diff(drawn).max()  # number of cells, if all were as wide as the widest
        steps.append(max(0, math.ceil(math.log2(cells / size) - 0.25)))
    return steps[::-1]


def _fine(ds: "xr.Dataset", part: StoreBlock, names: Sequence[str]) -> "xr.Dataset":
    read = {name: part.pyramid.read(0, name, part.cells) for name in names}
    pending = read[REGIME.name] == PENDING
    for name in names:
        if pending.any() and name != REGIME.name:  # a worker may be writing: no regime, no result
            read[name][pending] = part.pyramid.array(0, name).fill_value
    arrays = {name: (ds[name].dims, part.as_given(values), ds[name].attrs) for name, values in read.items()}
    return _dataset(ds, arrays, {name: ds[name] for name in axis_names(ds)}, 0)


def _coarse(ds: "xr.Dataset", part: StoreBlock, names: Sequence[str], steps: list[int], marks: bool) -> "xr.Dataset":
    stored_names = [REGIME_SHOWN.name if marks and name == REGIME.name else name for name in names]
    cells, cuts = _coarsened(part, stored_names, steps)
    cells[REGIME.name] = cells[REGIME_SHOWN.name if marks else REGIME.name]
    if marks:
        _blank(cells)
    coords: dict[str, Any] = {}
    for (axis, s), cut in zip(part.axes, cuts[-len(part.axes) :], strict=True):
        if axis.name in part.handle.spec.dims[: part.pyramid.levels.n_uncoarsened]:
            coords[axis.name] = ds[axis.name]
            continue
        log = axis.scale == "log"
        edges = edges_of(np.array(axis.values), log)[np.clip(cut, s.start, s.stop)]
        bounds = bounds_name(axis.name)
        coords[axis.name] = (axis.name, centres(edges, log), {**ds[axis.name].attrs, "bounds": bounds})
        coords[bounds] = ((axis.name, "bound"), np.stack([edges[:-1], edges[1:]], axis=1))
    arrays = {name: (ds[name].dims, part.as_given(cells[name]), ds[name].attrs) for name in names}
    return _dataset(ds, arrays, coords, min(steps[part.pyramid.levels.n_uncoarsened :]))


def _coarsened(part: StoreBlock, names: Sequence[str], steps: Sequence[int]) -> tuple[Cells, list[NDArray[np.intp]]]:
    """Return variables of a block of cells, coarsened, and the cell indices of the coarse cells' edges.

    part    the block
    names   names of the variables
    steps   number of times that each dimension is halved

    Halvings common to all dimensions are read as a level of the overviews. A plane that is long and narrow in pixels is
    halved further along one dimension, a block of rows at a time. So is a plane with fewer pixels than the last level
    has cells.
    """
    coarse_start = part.pyramid.levels.n_uncoarsened
    level = min(*steps[coarse_start:], part.pyramid.levels.count)
    more = [*steps[:coarse_start], *(count - level for count in steps[coarse_start:])]
    level_shape = part.pyramid.levels.shape_of(level)
    ends = zip(part.cells, steps, more, level_shape, strict=True)
    piece = tuple(slice(s.start >> k << n, min(-(-s.stop >> k) << n, size)) for s, k, n, size in ends)
    cuts = [
        np.append(np.arange(p.start, p.stop, 2**n), p.stop) << k - n for p, k, n in zip(piece, steps, more, strict=True)
    ]
    if not any(more):
        return part.read(level, piece, names), cuts
    rows = math.lcm(part.pyramid.levels.chunk[coarse_start], 2 ** more[coarse_start])
    strips, whole_rows = [], piece[coarse_start]
    for first in range(whole_rows.start // rows * rows, whole_rows.stop, rows):
        strip = slice(max(first, whole_rows.start), min(first + rows, whole_rows.stop))
        block = (*piece[:coarse_start], strip, *piece[coarse_start + 1 :])
        cells = part.read(level, block, part.required_variables(names))
        widths = [w[b] for w, b in zip(part.pyramid.widths[level], block, strict=True)]
        for dim, count in enumerate(more):
            for _ in range(count):
                cells = coarsen(cells, tuple(widths), [dim])
                widths[dim] = halve_widths(widths[dim])
        strips.append({name: cells[name] for name in names})
    return {name: np.concatenate([cells[name] for cells in strips], axis=coarse_start) for name in names}, cuts


def _blank(cells: Cells) -> None:
    """Remove, in place, values of coarse cells that are no results of the coarse cell's regime.

    For example, a coarse cell that is shown as chaotic has no period.
    """
    regime = cells[REGIME.name]
    for name in cells.keys() - {REGIME.name, REGIME_SHOWN.name, SHARE.name}:
        if name in CLASSES:
            cells[name] = np.where(regime == PERIODIC, cells[name], 0)
        elif cells[name].dtype == np.float64:
            without = _WITHOUT if name in _EXPONENTS else (PENDING, FAILED)
            cells[name] = np.where(np.isin(regime, without), np.nan, cells[name])
    if "period" in cells:
        cells["period"] = np.where(regime == NO_IMPACT, 1, cells["period"])  # by definition


def _dataset(ds: "xr.Dataset", arrays: dict[str, Any], axes: dict[str, Any], level: int) -> "xr.Dataset":
    import xarray

    fixed = {name: ds[name] for name in ds.coords if ds[name].ndim == 0}
    dataset = xarray.Dataset(arrays, {**axes, **fixed}, ds.attrs)
    dataset.encoding["level"] = level
    return dataset
