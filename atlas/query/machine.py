"""The machines (mechanical systems at given parameters) of an atlas's cells: their gap coordinate and symmetry."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from atlas.spec.system import stored_system
from workers.model.mode_table import is_symmetric
from workers.model.oscillator import Oscillator
from workers.model.system import System
from workers.results import NO_REASON

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

POINTS_PER_BLOCK = 4096
"""Number of parameter points whose machines are built at a time; a block takes some megabytes."""


def fixed(ds: "xr.Dataset", system: System) -> dict[str, float]:
    """Return the parameters that have one value in all cells of an atlas, by name."""
    return {p.name: float(ds[p.name]) for p in system.parameters if p.name in ds.coords and ds[p.name].ndim == 0}


def oscillators(
    system: System, same: Mapping[str, float], points: Mapping[str, Array]
) -> Iterator[tuple[slice, Oscillator, NDArray[np.bool_]]]:
    """Yield the machines at N parameter points, in blocks of at most POINTS_PER_BLOCK points.

    system   the system
    same     parameters with equal values at all points
    points   values (N,) of the other parameters

    Each item is the slice of the points, the record of their machines, and the mask of the points at which a machine
    exists.
    """
    count = len(next(iter(points.values())))
    for low in range(0, count, POINTS_PER_BLOCK):
        part = slice(low, min(low + POINTS_PER_BLOCK, count))
        parameters = {name: np.full(part.stop - low, value) for name, value in same.items()}
        osc, reasons = system.build_many(parameters | {name: values[part] for name, values in points.items()})
        yield part, osc, reasons == NO_REASON


def has_twins(system: System, same: Mapping[str, float], points: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Return the mask of points (N,) at which the system has the symmetry x(t) -> -x(t + T/2) with forcing period T.

    There each motion has a mirror image, its twin. Arguments are those of ``oscillators``.
    """
    twins = np.zeros(len(next(iter(points.values()))), dtype=bool)
    for part, osc, exists in oscillators(system, same, points):
        twins[part] = exists & is_symmetric(osc)
    return twins


def twins_everywhere(ds: "xr.Dataset", axes: Mapping[str, Array]) -> bool:
    """Return True if the system has the symmetry x(t) -> -x(t + T/2) at all corners of a plane with these axes.

    The result is False for an atlas with an unknown system.
    """
    system = stored_system(ds.attrs)
    return system is not None and bool(np.all(has_twins(system, fixed(ds, system), corners(axes))))


def corners(axes: Mapping[str, Array]) -> dict[str, Array]:
    """Return the four corners of a plane, as values (4,) of the parameters of both axes, by name."""
    ends = np.meshgrid(*(values[[0, -1]] for values in axes.values()))
    return {name: points.ravel() for name, points in zip(axes, ends, strict=True)}


def gap_values(ds: "xr.Dataset", x: str, states: "xr.DataArray") -> Array:
    """Return the gap coordinate y = g . x, the displacement that the stops limit, of the states along a sweep.

    ds       the sweep
    x        name of its axis
    states   physical states (cell, ..., component)

    For an atlas with an unknown system the result is the first component.
    """
    system = stored_system(ds.attrs)
    if system is None:
        return np.asarray(states[..., 0].values, dtype=np.float64)
    rows = gap_rows(system, {**fixed(ds, system), x: np.asarray(ds[x].values, np.float64)})
    gap = np.zeros(states.shape[:-1])
    for i in np.flatnonzero(np.any(rows != 0.0, axis=0)):  # other components are not read
        gap += rows[:, i].reshape(-1, *[1] * (gap.ndim - 1)) * np.asarray(states[..., int(i)].values)
    return gap


def gap_rows(system: System, values: Mapping[str, float | Array]) -> Array:
    """Return the coefficients g (N, n) of the gap coordinate y = g . x, the displacement that the stops limit.

    ``values`` are parameters by name, each a number or N values.
    """
    count = max(np.size(value) for value in values.values())
    parameters = {
        name: np.broadcast_to(np.asarray(value, dtype=np.float64), (count,)) for name, value in values.items()
    }
    return system.definition.picture_rows(parameters)
