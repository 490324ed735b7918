"""The axes of an open atlas, the cells along them, and selection of cells by windows."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.argument_checks import Window as Window
from atlas.argument_checks import validate_window
from atlas.errors import InputError
from atlas.query.attractors import select_attractor
from atlas.spec import cells
from atlas.spec.cells import edges_of, is_uniform
from atlas.spec.points import POINT
from atlas.spec.spec import MAX_AXES
from atlas.spec.system import stored_spec
from workers.results import ATTRACTOR, REGIME

if TYPE_CHECKING:
    import xarray as xr

LOG_SPAN = 4.0
"""Minimum ratio of the ends of a logarithmic axis that is drawn on a log scale; below it, log ticks are useless."""


def axis_names(ds: "xr.Dataset") -> tuple[str, ...]:
    """Return the names of an atlas's axes, x first; ``point`` for a table of points.

    Raise InputError unless there are one to three axes, for an empty selection, and for regimes that a mask has turned
    into floats, since NaN is no regime.
    """
    if REGIME.name not in ds:
        raise InputError(f"not an atlas: it has no variable {REGIME.name!r}")
    if ds[REGIME.name].dtype.kind == "f":
        right = "must be whole numbers; choose cells by .sel, a window or .atlas.where_regime, not by .where"
        raise InputError(f"{REGIME.name}: found {ds[REGIME.name].dtype}, {right}")
    empty = [str(name) for name in ds[REGIME.name].dims if ds.sizes[name] == 0]
    if empty:
        raise InputError(f"{empty[0]}: found a selection without cells, must have one or more")
    names = tuple(str(dim) for dim in reversed(ds[REGIME.name].dims) if dim != ATTRACTOR)
    if not 1 <= len(names) <= MAX_AXES:
        listed = f" ({', '.join(names)})" if names else ""
        raise InputError(f"found {len(names)} axes{listed}, must be 1 to 3; pick a value of the others with .sel")
    return names


def columns(ds: "xr.Dataset") -> tuple[str, ...]:
    """Return the parameters that are columns of a table of points, in their order; empty for other atlases."""
    if axis_names(ds) != (POINT,):
        return ()
    names = [str(name) for name in ds.coords if ds[name].dims == (POINT,) and name != POINT]
    stored = str(ds[REGIME.name].encoding.get("coordinates", "")).split()  # xarray keeps them in no order
    return tuple(sorted(names, key=lambda name: stored.index(name) if name in stored else len(stored)))


def check_not_points(ds: "xr.Dataset", what: str) -> None:
    """Raise InputError for a table of points, whose neighbouring rows are unrelated; ``what`` names the request."""
    if axis_names(ds) == (POINT,):
        raise InputError(f"{what}: this atlas is a table of points, whose rows are not neighbours in the parameters")


def select(ds: "xr.Dataset", point: Mapping[str, float]) -> "xr.Dataset":
    """Return the cells of an atlas nearest to given values of some axes: a plane of a stack, or a line of a plane.

    ``point`` has the values by axis. The key ``attractor`` selects an attractor of each cell by its rank; rank 0 has
    the largest share. Raise InputError for a value outside the grid, as in ``queries.nearest_cell``.
    """
    places = {}
    if ATTRACTOR in point:
        ds = select_attractor(ds, point[ATTRACTOR])
    for name, value in point.items():
        if name == ATTRACTOR:
            continue
        check_axis(ds, name)
        places[name] = nearest(ds, name, value)
    if places and len(places) == len(axis_names(ds)):
        raise InputError(f"one value of every axis ({', '.join(axis_names(ds))}) is one cell; use --at for one cell")
    return ds.isel(places)


def check_axis(ds: "xr.Dataset", name: str) -> None:
    """Raise InputError, with the names of the axes, unless the atlas has an axis ``name``."""
    names = axis_names(ds)
    if name in names:
        return
    if name in columns(ds):
        raise InputError(f"{name} is not an axis here but a column of points; give {POINT}, the row's number from 0 on")
    if name in ds.coords and ds[name].ndim == 0:
        raise InputError(f"{name} is not an axis here but fixed at {float(ds[name]):g}; axes: {', '.join(names)}")
    raise InputError(f"unknown axis {name!r}; the axes are: {', '.join(names)}")


def axis_values(ds: "xr.Dataset", name: str) -> NDArray[np.float64]:
    """Return the coordinates of the cells along an axis."""
    return np.asarray(ds[name].values, dtype=np.float64)


def is_log(ds: "xr.Dataset", name: str) -> bool:
    """Return True if an axis is logarithmic, by the atlas's spec.

    Without a spec an axis is logarithmic if its points grow by a constant factor.
    """
    stored = spec_of_axis(ds, name).get("scale")
    if stored is not None:
        return bool(stored == "log")
    values = axis_values(ds, name)
    return values.size > 2 and bool(values.min() > 0) and not is_uniform(values) and is_uniform(np.log(values))


def spec_of_axis(ds: "xr.Dataset", name: str) -> dict[str, Any]:
    """Return the entry of an axis in the spec that the atlas stores; empty if there is none."""
    axes = stored_spec(ds.attrs).get("axes", ())
    return next((axis for axis in axes if isinstance(axis, dict) and axis.get("name") == name), {})


def cell_edges(ds: "xr.Dataset", name: str) -> NDArray[np.float64]:
    """Return the n + 1 edges of the n cells along an axis, in rising order.

    They are the axis's CF bounds if it has any, else edges that ``edges_of`` computes from the coordinates.
    """
    bounds = ds[name].attrs.get("bounds")
    if bounds in ds.variables:
        pairs = np.asarray(ds[bounds].values, dtype=np.float64)
        return np.append(np.sort(pairs[:, 0]), pairs.max())
    return edges_of(np.sort(axis_values(ds, name)), is_log(ds, name))


def cell_widths(ds: "xr.Dataset", name: str) -> NDArray[np.float64]:
    """Return the width of each cell along an axis, in the order of the axis; 1 for all if all widths are equal.

    Widths are in the axis's unit.
    """
    values = axis_values(ds, name)
    if is_uniform(values) and ds[name].attrs.get("bounds") not in ds.variables:
        return np.ones_like(values)
    widths = np.empty_like(values)
    widths[np.argsort(values)] = np.diff(cell_edges(ds, name))
    return widths


def nearest(ds: "xr.Dataset", name: str, value: float) -> int:
    """Return the index of the cell along an axis that is drawn at a value of the axis.

    Raise InputError for a value more than half a cell beyond the ends.
    """
    return cells.nearest(name, axis_values(ds, name), cell_edges(ds, name), value)


def window_indices(ds: "xr.Dataset", window: Window | None) -> dict[str, NDArray[np.intp]]:
    """Return the indices, along every axis, of the cells whose centres lie in a window, limits included.

    Axes that the window does not name are taken completely. Raise InputError for an unknown axis, and for a window
    without a cell.
    """
    window = validate_window(window)
    for name in window:
        check_axis(ds, name)
    return {name: _between(name, axis_values(ds, name), window.get(name)) for name in axis_names(ds)}


def select_window(ds: "xr.Dataset", window: Window | None) -> "xr.Dataset":
    """Return the cells of an atlas in a window, not loaded yet; arguments and errors are as in ``window_indices``."""
    window = validate_window(window)
    if not window:
        return ds
    return ds.isel(
        {name: _as_slice(slices_of) for name, slices_of in window_indices(ds, window).items() if name in window}
    )


def _between(name: str, values: NDArray[np.float64], bounds: tuple[float, float] | None) -> NDArray[np.intp]:
    if bounds is None:
        return np.arange(values.size)
    low, high = min(bounds), max(bounds)
    places = np.flatnonzero((values >= low) & (values <= high))
    if places.size == 0:
        raise InputError(
            f"no cell centre with {name} from {low:g} to {high:g}; "
            f"the centres reach from {values.min():g} to {values.max():g}"
        )
    return places


def _as_slice(indices: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """Return consecutive indices as a slice, and other indices unchanged; a slice keeps a dataset unread."""
    first, last = int(indices[0]), int(indices[-1])
    return slice(first, last + 1) if last - first + 1 == indices.size else indices
