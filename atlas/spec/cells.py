"""The geometry of cells: edges, widths and areas around the points of an axis."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError

if TYPE_CHECKING:
    from atlas.spec.spec import Spec

LONE_CELL = 0.05
"""Half width of the cell of an axis with one point, relative to its value; absolute if the value is 0."""


def is_uniform(values: NDArray[np.float64]) -> bool:
    """Return True if points are evenly spaced, up to the rounding of storage."""
    steps = np.diff(values)
    return bool(np.all(np.abs(steps - steps.mean()) <= 1e-6 * np.abs(steps.mean()))) if steps.size > 1 else True


def edges_of(values: NDArray[np.float64], log: bool) -> NDArray[np.float64]:
    """Return the n + 1 edges of the cells around n rising points: midway, on a log axis at the geometric mean.

    The outermost cells are symmetric about their points. A single point gets a cell of +-LONE_CELL of its value.
    """
    if values.size == 1:
        half = LONE_CELL * abs(float(values[0])) or LONE_CELL
        return np.array([values[0] - half, values[0] + half])
    points = np.log(values) if log else values
    middle = 0.5 * (points[:-1] + points[1:])
    edges = np.concatenate(([2.0 * points[0] - middle[0]], middle, [2.0 * points[-1] - middle[-1]]))
    return np.asarray(np.exp(edges)) if log else edges


def nearest(name: str, values: NDArray[np.float64], edges: NDArray[np.float64], value: float) -> int:
    """Return the index of the point of an axis whose cell, as it is drawn, contains a value.

    name    name of the axis
    values  points of the axis
    edges   edges of the cells
    value   the value

    On a log axis, this is the point nearest in ratio. Raise InputError if the value lies beyond the outermost edges.
    """
    if not edges[0] <= value <= edges[-1]:
        raise InputError(f"{name} = {value:g} lies outside the grid; valid: {edges[0]:g} to {edges[-1]:g}")
    exact = np.flatnonzero(values == value)  # edges between neighbouring floats are rounded to one of the floats
    if exact.size:
        return int(exact[0])
    rank = int(np.searchsorted(edges[1:-1], value, side="right"))
    return int(np.argsort(values)[rank])


def widths_of(values: NDArray[np.float64], log: bool) -> NDArray[np.float64]:
    """Return the widths of the cells around n rising points, in the axis's own unit; 1 for equal widths.

    Only the ratios of widths count, and ones are free of rounding.
    """
    return np.ones_like(values) if is_uniform(values) else np.diff(edges_of(values, log))


def widths_along(spec: "Spec") -> tuple[NDArray[np.float64], ...]:
    """Return the relative widths of all cells of an atlas along each of its dimensions, see ``widths_of``."""
    return tuple(widths_of(np.array(axis.values), axis.scale == "log") for axis in reversed(spec.axes))
