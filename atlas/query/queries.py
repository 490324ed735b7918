"""Queries to an atlas: a point, the regimes of a window, borders between regimes.

Every function takes a dataset as ``atlas.open`` returns it, keeps no state, and reads as little as possible.
"""

from collections.abc import Iterable, Mapping
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError, check_names
from atlas.query.attractors import has_all_attractors, list_attractors, select_dominant
from atlas.query.cell_blocks import iter_cell_blocks
from atlas.query.read_counter import count_reads
from atlas.query.resample import read_view
from atlas.query.store_block import find_part
from atlas.query.totals import StoreTotals
from atlas.query.window import (
    Window,
    axis_names,
    axis_values,
    cell_edges,
    cell_widths,
    check_axis,
    columns,
    nearest,
    select_window,
    window_indices,
)
from atlas.spec.axis import number
from atlas.spec.laws import LawUse, law_names, law_uses, merged
from atlas.spec.points import POINT
from atlas.spec.system import stored_system
from workers.model.parameter import OMEGA
from workers.model.system import System
from workers.results import (
    AVERAGE,
    ERROR,
    LARGEST,
    NO_REASON,
    OF_MOTIONS,
    PENDING,
    PER_PERIOD,
    PER_TIME,
    REASON,
    REGIME,
    SPECTRUM,
    SUM_LAW_DEFECT,
    in_words,
    reason_counts,
)

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from numpy.typing import ArrayLike

_CODES = {regime.name: regime.code for regime in REGIME.codes}
_EXPONENTS = (LARGEST.name, ERROR.name, AVERAGE.name, SPECTRUM.name, SUM_LAW_DEFECT.name)

BOUNDARY_CELLS = 2000
"""Number of cells along each axis, approximately, on which boundaries are traced in larger windows."""


def nearest_cell(ds: "xr.Dataset", point: Mapping[str, float]) -> dict[str, Any]:
    """Return the cell nearest to a point: its coordinates, its distance from the point, and all its values.

    ``point`` has a value for every axis, inside the grid or at most half a cell beyond its ends. The nearest cell is
    determined for each axis separately, by ratio on a log axis: it is the cell that is drawn at the point. The keys
    are:

    (axis)      coordinate of the cell, for each axis; for a table of points also for each column
    distance    absolute distance from the point, by axis
    regime      name of the regime
    reason      reason in words, if there is one
    (variable)  value of every other variable with one value per cell
    coexisting  list of all attractors with all their values, the largest share first; only in an atlas of all
                attractors

    In an atlas of all attractors all other values are those of the attractor with the largest share. One chunk of each
    variable is read. Raise InputError for a missing or unknown axis, and for a point outside the grid.
    """
    every, ds = ds, select_dominant(ds)
    names = axis_names(ds)
    _check_axes(ds, point)
    index = {name: nearest(ds, name, number(name, point[name])) for name in names}
    variable_names = [name for name in ds.data_vars if set(ds[name].dims) == set(names)]
    cell = ds[variable_names].isel(index).load()
    results: dict[str, Any] = {name: float(cell[name]) for name in (*names, *columns(ds))}
    results["distance"] = {name: abs(results[name] - float(point[name])) for name in names}
    results |= in_words(
        {variable.name: cell[variable.name] for variable in (REGIME, REASON) if variable.name in variable_names}
    )
    results |= {str(name): cell[name].item() for name in variable_names if name not in (REGIME.name, REASON.name)}
    return results | ({"coexisting": list_attractors(every.isel(index).load())} if has_all_attractors(every) else {})


def nearest_cells(ds: "xr.Dataset", points: "Mapping[str, ArrayLike]") -> "xr.Dataset":
    """Return the cells nearest to points, with all their values, as a loaded dataset.

    ``points`` has a number or a list of numbers for each axis, see ``nearest_cell``. Lists have one length; the dataset
    then has the dimension ``point``. The variables are those of the atlas, with ``regime`` and ``reason`` in words, and
    ``distance_NAME`` for each axis, the absolute distance of the cell from the point. In an atlas of all attractors
    results have the dimension ``attractor``, the largest share first. Raise InputError also for lists of different
    lengths.
    """
    import xarray

    names = axis_names(ds)
    _check_axes(ds, points)
    coordinates = {name: np.asarray(points[name], dtype=object) for name in names}
    shapes = {values.shape for values in coordinates.values() if values.ndim}
    if len(shapes) > 1 or any(len(shape) > 1 for shape in shapes):
        listed = ", ".join(f"{name} {list(values.shape)}" for name, values in coordinates.items())
        raise InputError(f"points: found the shapes {listed}, must be numbers, or lists of one length")
    dims, shape = (POINT,) if shapes else (), next(iter(shapes), ())
    index, distances = {}, {}
    for name, values in coordinates.items():
        at = np.array([number(name, value) for value in np.broadcast_to(values, shape).ravel()]).reshape(shape)
        places = np.array([nearest(ds, name, value) for value in at.ravel()], dtype=np.intp).reshape(shape)
        index[name] = xarray.DataArray(places, dims=dims)
        distances[f"distance_{name}"] = dims, np.abs(axis_values(ds, name)[places] - at)
    cells = ds.isel(index).load().assign(distances)
    names_of = {code.code: code.name for code in REGIME.codes}, {code.code: code.text for code in REASON.codes}
    for variable, words in zip((REGIME, REASON), names_of, strict=True):
        if variable.name in cells:
            codes = cells[variable.name]
            named = [words[code] if (variable, code) != (REASON, NO_REASON) else "" for code in codes.values.ravel()]
            cells[variable.name] = codes.dims, np.array(named, dtype=str).reshape(codes.shape)
    return cells


def _check_axes(ds: "xr.Dataset", point: Mapping[str, object]) -> None:
    """Raise InputError unless a point has values for all axes of an atlas, and for nothing else."""
    names = axis_names(ds)
    for name in point:
        check_axis(ds, name)
    missing = [name for name in names if name not in point]
    if missing:
        raise InputError(f"point: found no {', '.join(missing)}, must have a value for each axis: {', '.join(names)}")


def fractions(ds: "xr.Dataset", window: Window | None = None) -> dict[str, float]:
    """Return the fraction of the area of each regime that occurs, by name, in order of regime code; the sum is 1.

    A cell belongs to the window if its centre does, limits included (as in xarray's ``sel``). Axes that the window does
    not name are taken completely. Each cell counts with its area from edge to edge, as in ``cell_edges``, in the units
    of the axes. The fractions of one region therefore agree however its axes are spaced. On a log axis, too, a decade
    counts ten times as much as the decade below it, on any scale of the picture. Unsolved cells are the fraction
    ``pending``.

    Only regimes in the window are read. In a large window they are read from overviews, tile records, and cells along
    its border. Raise InputError for an unknown axis, and for a window without a cell.
    """
    selection = select_window(ds, window)
    part = find_part(selection, [REGIME.name])
    if part is None:
        areas = _areas_of_cells(selection, ds, window_indices(ds, window))
    else:
        areas = StoreTotals(part).areas()
        count_reads(part.chunks_read)
    total = sum(areas.values())
    return {name: area / total for name, code in _CODES.items() if (area := areas[code])}


def count_reasons(ds: "xr.Dataset", window: Window | None = None) -> dict[str, int]:
    """Return the number of cells of a window without a result, or with an uncertain one, by the reason in words.

    Windows and errors are as in ``fractions``. Raise InputError also for a dataset without the variable ``reason``.
    Tile records are read, and the reasons themselves along the border of the window.
    """
    axis_names(ds)
    ds = select_window(ds, window)
    if REASON.name not in ds:
        raise InputError(f"this dataset has no variable {REASON.name}; use the dataset that atlas.open returns")
    part = find_part(ds, [REGIME.name, REASON.name])
    if part is None:
        return reason_counts(ds[REASON.name].where(ds[REGIME.name] != PENDING, NO_REASON).values)
    counts = StoreTotals(part).reasons().tolist()
    count_reads(part.chunks_read)
    return {reason.text: n for reason, n in zip(REASON.codes, counts, strict=True) if n and reason.code != NO_REASON}


def laws(ds: "xr.Dataset", window: Window | None = None) -> dict[str, LawUse]:
    """Return how far the force laws of a machine were used by the motions in a window, by element of the machine.

    Only laws that a definition gives as expressions count. Windows and errors are as in ``fractions``. Only the
    variables with this information are read; none if no law is an expression.
    """
    system, part = stored_system(ds.attrs), select_window(ds, window)
    names = [name for name in (law_names(system) if system else ()) if name in ds]
    if system is None or not names:
        return {}
    return merged(law_uses(system, block.values) for block in iter_cell_blocks(part, names, OF_MOTIONS))


def is_regime(ds: "xr.Dataset", regimes: Iterable[str]) -> "xr.DataArray":
    """Return the mask of the cells, or attractors of cells, that have one of these regimes, given by name.

    Raise InputError for an unknown name of a regime.
    """
    return ds[REGIME.name].isin(codes_of(regimes))


def where_regime(ds: "xr.Dataset", regimes: Iterable[str]) -> "xr.Dataset":
    """Return the atlas with results only in cells of these regimes, and NaN in others; ``regime`` itself is unchanged.

    Integers and flags become floats, since they have no missing value. The masked variables are loaded: select
    variables and a window first if the atlas is large.
    """
    mask = is_regime(ds, regimes)
    numbers = {name: ds[name].astype(np.float64) if ds[name].dtype == bool else ds[name] for name in ds.data_vars}
    cells = set(ds[REGIME.name].dims)
    masked = {name: array.where(mask) for name, array in numbers.items() if cells <= set(array.dims)}
    return ds.assign({name: array for name, array in masked.items() if name != REGIME.name})


def boundary(ds: "xr.Dataset", regime: str, other: str | None = None, window: Window | None = None) -> "pd.DataFrame":
    """Return the lines between a regime and another one, by default any other: a frame with one row per point.

    Its columns are:

    line    number of the line, from 0; its points are in order
    (axis)  position, for each axis
    regime  the regime
    other   the regime on the other side

    The lines are contours half way between neighbouring cells, in the units of the axes, known to half a cell. If
    ``other`` is given, only borders between the two regimes are traced. Borders with pending cells are left out.
    Closed lines end at their first point. In windows of more than BOUNDARY_CELLS cells per side, lines are traced
    on the overview next in size. Raise InputError for an unknown regime or axis, for a window without a cell, and
    for an atlas without exactly two axes.
    """
    import contourpy
    import pandas as pd

    names = axis_names(ds)
    if len(names) != 2:
        raise InputError(f"a boundary needs two axes, found {len(names)} ({', '.join(names)})")
    (code,) = codes_of([regime])
    seen = read_view(ds, [], window, (BOUNDARY_CELLS,) * 2, marks=False)
    for name in names:
        if axis_values(seen, name).size > 1 and np.any(np.diff(axis_values(seen, name)) < 0):
            seen = seen.sortby(name)
    codes = seen[REGIME.name].transpose(*reversed(names)).values
    columns = ["line", *names, "regime", "other"]
    if min(codes.shape) < 2:
        return pd.DataFrame(columns=columns)
    hidden = codes == PENDING if other is None else ~np.isin(codes, codes_of([regime, other]))
    z = np.ma.masked_array((codes == code).astype(np.float64), hidden)
    lines = contourpy.contour_generator(z=z, corner_mask=True).lines(0.5)
    # In cell indices, so that half way between two cells is the edge between the cells on any axis.
    edges = [cell_edges(seen, name) for name in names]
    along = [(edge, np.arange(edge.size) - 0.5) for edge in edges]
    parts = [pd.DataFrame(columns=columns)] if not lines else []
    for k, line in enumerate(map(np.asarray, lines)):
        positions = {name: np.interp(line[:, i], *along[i][::-1]) for i, name in enumerate(names)}
        beyond = _beyond(np.where(hidden, PENDING, codes), code, line)
        parts.append(pd.DataFrame({"line": k, **positions, "regime": regime, "other": beyond}, columns=columns))
    return pd.concat(parts, ignore_index=True)


def _beyond(codes: NDArray[np.integer[Any]], code: int, line: NDArray[np.float64]) -> list[str]:
    """Return the names of the regimes on the other side of a border at N points along it.

    codes   regimes of the cells; pending for cells that bound nothing
    code    regime on this side of the border
    line    points (N, 2) in cell indices (x, y)

    A point lies between two cells of an edge or of a diagonal. Of the two diagonals, that with a border counts.
    """
    (left, low), (right, high) = np.floor(line).astype(int).T, np.ceil(line).astype(int).T
    one, two = codes[low, left], codes[high, right]
    turned = ((one == code) == (two == code)) | (one == PENDING) | (two == PENDING)
    one, two = np.where(turned, codes[low, right], one), np.where(turned, codes[high, left], two)
    return [REGIME.meaning(int(other)).name for other in np.where(one == code, two, one)]


def per_unit_time(ds: "xr.Dataset") -> "xr.Dataset":
    """Return the atlas with its exponents, and variables of their unit, per unit time instead of per forcing period.

    lambda_t = lambda / T with the forcing period T of each cell, 2 pi / omega, or a multiple of it if orders of the
    force's harmonics are ratios of whole numbers. The variables largest, error, spectrum and sum_law_defect are loaded
    and changed; their ``long_name`` has the new unit. Raise InputError if they are per unit time already, or if the
    forcing frequency is unknown.
    """
    present = [name for name in _EXPONENTS if name in ds]
    if any(rate_of(ds[name]) == PER_TIME for name in present):
        raise InputError(f"the exponents are {PER_TIME} already, not {PER_PERIOD}; nothing to convert")
    system = stored_system(ds.attrs)
    rate = _frequency(ds, system) / (2.0 * np.pi * (system.definition.turns if system else 1))
    converted = {}
    for name in present:
        converted[name] = (ds[name] * rate).transpose(*ds[name].dims)
        meaning = str(ds[name].attrs.get("long_name", f"{name} {PER_PERIOD}")).replace(PER_PERIOD, PER_TIME)
        converted[name].attrs = {**ds[name].attrs, "long_name": meaning}
    return ds.assign(converted)


def rate_of(exponents: "xr.DataArray") -> str:
    """Return the unit of time of exponents, PER_PERIOD as they are stored or PER_TIME if they were converted."""
    return PER_TIME if PER_TIME in str(exponents.attrs.get("long_name", "")) else PER_PERIOD


def codes_of(regimes: Iterable[str]) -> list[int]:
    """Return the codes of regimes by name. Raise InputError, with the nearest known name, for an unknown one."""
    names = list(regimes)
    check_names("regime", names, _CODES)
    return [_CODES[name] for name in names]


def _frequency(ds: "xr.Dataset", system: System | None) -> "xr.DataArray":
    """Return the forcing frequency omega of the cells, a parameter or 2 pi / period."""
    if OMEGA in ds.coords:
        return ds[OMEGA]
    if system is None or (period := system.definition.period) is None or not period.names <= {*ds.coords}:
        raise InputError("the forcing frequency of this atlas is not known: exponents per unit time need it")
    import xarray as xr

    names = sorted(period.names) or [OMEGA]
    grids = xr.broadcast(*(ds[name] if name in ds.coords else xr.DataArray(0.0) for name in names))
    values = {name: np.asarray(grid.values, np.float64) for name, grid in zip(names, grids, strict=True)}
    return grids[0].copy(data=system.definition.frequency(values))


def _areas_of_cells(
    selection: "xr.Dataset", ds: "xr.Dataset", cells: Mapping[str, NDArray[np.intp]]
) -> dict[int, float]:
    """Return the total area of the cells of each regime, by code.

    selection   the cells, part of ``ds``
    ds          the atlas, which gives the cell widths
    cells       indices of the cells along each axis
    """
    names = axis_names(ds)
    widths = {name: cell_widths(ds, name)[cells[name]] for name in names}
    codes = selection[REGIME.name].values
    first, area = PENDING, np.zeros(len(REGIME.codes))
    # One row at a time: weights of a whole plane would take eight times the memory of its regimes.
    heights = reduce(np.multiply.outer, [widths[name] for name in reversed(names[1:])], np.ones(1)).ravel()
    for height, row in zip(heights, codes.reshape(heights.size, -1), strict=True):
        area += height * np.bincount(row - first, weights=widths[names[0]], minlength=area.size)
    return {code: float(area[code - first]) for code in _CODES.values()}
