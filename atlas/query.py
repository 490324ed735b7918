"""Questions to an atlas: what is at a point, and how much of a window belongs to each regime.

Every function takes the dataset as ``atlas.open`` returns it, keeps no state, and reads no more than it must.
"""

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from workers.results import REGIME, REGIMES

if TYPE_CHECKING:
    import xarray as xr

_NAMES = {regime.code: regime.name for regime in REGIMES}

LONE_CELL = 0.05
"""Half width of the cell of an axis with one point, relative to its value (absolute where that is 0)."""


def axis_names(ds: "xr.Dataset") -> tuple[str, ...]:
    """The names of an atlas's axes, x first; InputError unless there are one or two."""
    if REGIME.name not in ds:
        raise InputError(f"not an atlas: it has no variable {REGIME.name!r}")
    names = tuple(str(dim) for dim in reversed(ds[REGIME.name].dims))
    if len(names) not in (1, 2):
        listed = f" ({', '.join(names)})" if names else ""
        raise InputError(f"found {len(names)} axes{listed}, must be 1 or 2; pick a value of the others with .sel")
    return names


def is_log(ds: "xr.Dataset", name: str) -> bool:
    """Whether an axis is logarithmic: as the atlas's spec says, else if its points grow by a constant factor."""
    try:
        scales = {axis["name"]: axis["scale"] for axis in json.loads(ds.attrs["spec"])["axes"]}
        return bool(scales[name] == "log")
    except (KeyError, TypeError, ValueError):
        values = _values(ds, name)
        return values.size > 2 and bool(values.min() > 0) and not is_uniform(values) and is_uniform(np.log(values))


def is_uniform(values: NDArray[np.float64]) -> bool:
    """Whether points are evenly spaced, to the rounding that storing them may leave."""
    steps = np.diff(values)
    return bool(np.all(np.abs(steps - steps.mean()) <= 1e-6 * np.abs(steps.mean()))) if steps.size > 1 else True


def cell_edges(ds: "xr.Dataset", name: str) -> NDArray[np.float64]:
    """The n + 1 edges of the cells around an axis's n points, in rising order: half way between neighbours.

    Half way is the geometric mean on a logarithmic axis. The outermost cells reach as far beyond their point as they
    do towards the neighbour. A lone point gets a cell of +-LONE_CELL of its value.
    """
    values = np.sort(_values(ds, name))
    if values.size == 1:
        half = LONE_CELL * abs(float(values[0])) or LONE_CELL
        return np.array([values[0] - half, values[0] + half])
    if is_log(ds, name):
        return np.asarray(np.exp(_half_way(np.log(values))))
    return _half_way(values)


def at(ds: "xr.Dataset", point: Mapping[str, float]) -> dict[str, Any]:
    """The cell nearest to a point: its coordinates, its distance from the point, and every number it holds.

    Keys: each axis (the cell's own coordinate), ``distance`` (a dict, absolute, per axis), ``regime`` (its name),
    and every other variable with one value per cell. Nearest is per axis, in the axis's own units.
    Arguments: ``point`` gives a value for every axis, inside the grid or at most half a cell beyond its ends.
    Raises InputError, in one line, for a missing or unknown axis and for a point outside the grid.
    Reads one chunk of each variable.
    """
    names = axis_names(ds)
    for name in point:
        _known_axis(ds, names, name)
    missing = [name for name in names if name not in point]
    if missing:
        raise InputError(f"the point lacks {', '.join(missing)}; it needs a value for each axis: {', '.join(names)}")
    index = {name: _nearest(ds, name, float(point[name])) for name in names}
    whole = [name for name in ds.data_vars if set(ds[name].dims) == set(names)]
    cell = ds[whole].isel(index).load()
    found: dict[str, Any] = {name: float(cell[name]) for name in names}
    found["distance"] = {name: abs(found[name] - float(point[name])) for name in names}
    found[REGIME.name] = _NAMES[int(cell[REGIME.name])]
    return found | {str(name): cell[name].item() for name in whole if name != REGIME.name}


def fractions(ds: "xr.Dataset", window: Mapping[str, tuple[float, float]] | None = None) -> dict[str, float]:
    """The share of the area that belongs to each regime present, by name, in order of regime code; the sum is 1.

    A cell belongs to the window if its centre does, ends included (as in xarray's ``sel``); an axis that the window
    does not name is taken whole. Each cell counts with its area in the axes' own units, from edge to edge as in
    ``cell_edges``, so that the shares of one region agree however its axes are spaced (also on log axes).
    Cells that are not solved yet are the share ``pending``.
    Raises InputError, in one line, for an unknown axis and for a window without a cell.
    Reads the regimes in the window and nothing else.
    """
    names = axis_names(ds)
    window = window or {}
    for name in window:
        _known_axis(ds, names, name)
    inside = {name: _inside(ds, name, window.get(name)) for name in names}
    widths = {name: _widths(ds, name)[inside[name]] for name in names}
    codes = ds[REGIME.name].isel(inside).values
    first = min(_NAMES)
    area = np.zeros(max(_NAMES) - first + 1)
    # One row at a time: weights of a whole plane would take eight times the memory of its regimes.
    heights = widths[names[1]] if len(names) == 2 else np.ones(1)
    for height, row in zip(heights, codes.reshape(heights.size, -1), strict=True):
        area += height * np.bincount(row - first, weights=widths[names[0]], minlength=area.size)
    return {name: float(area[code - first] / area.sum()) for code, name in sorted(_NAMES.items()) if area[code - first]}


def _values(ds: "xr.Dataset", name: str) -> NDArray[np.float64]:
    return np.asarray(ds[name].values, dtype=np.float64)


def _widths(ds: "xr.Dataset", name: str) -> NDArray[np.float64]:
    values = _values(ds, name)
    if is_uniform(values):
        return np.ones_like(values)  # only ratios count, and these are free of the rounding of edges
    widths = np.empty_like(values)
    widths[np.argsort(values)] = np.diff(cell_edges(ds, name))
    return widths


def _half_way(values: NDArray[np.float64]) -> NDArray[np.float64]:
    middle = 0.5 * (values[:-1] + values[1:])
    return np.concatenate(([2.0 * values[0] - middle[0]], middle, [2.0 * values[-1] - middle[-1]]))


def _known_axis(ds: "xr.Dataset", names: tuple[str, ...], name: str) -> None:
    if name in names:
        return
    if name in ds.coords and ds[name].ndim == 0:
        raise InputError(f"{name} is no axis here but fixed at {float(ds[name]):g}; the axes are: {', '.join(names)}")
    raise InputError(f"unknown axis {name!r}; the axes are: {', '.join(names)}")


def _nearest(ds: "xr.Dataset", name: str, value: float) -> int:
    values = _values(ds, name)
    edges = cell_edges(ds, name)
    if not edges[0] <= value <= edges[-1]:
        raise InputError(f"{name} = {value:g} lies outside the grid; valid: {edges[0]:g} to {edges[-1]:g}")
    return int(np.argmin(np.abs(values - value)))


def _inside(ds: "xr.Dataset", name: str, bounds: tuple[float, float] | None) -> NDArray[np.intp]:
    values = _values(ds, name)
    if bounds is None:
        return np.arange(values.size)
    low, high = min(bounds), max(bounds)
    inside = np.flatnonzero((values >= low) & (values <= high))
    if inside.size == 0:
        raise InputError(
            f"no cell centre with {name} from {low:g} to {high:g}; "
            f"the centres reach from {values.min():g} to {values.max():g}"
        )
    return inside
