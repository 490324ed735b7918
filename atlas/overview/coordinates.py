"""The coordinates of the overviews, coarser copies of an atlas: centres and edges of coarse cells.

Coarsened dimensions have their own names. ``xarray.open_datatree`` makes a tree of datasets from a store. There a group
must not have an ``omega`` that differs from the ``omega`` of the group above.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.spec.cells import edges_of
from atlas.spec.spec import Spec
from atlas.store.schema import StoredArray
from atlas.store.store import AtlasStore
from workers.results import REGIMES


def level_coordinates(handle: AtlasStore, level: int) -> dict[str, StoredArray]:
    """Return the coordinate arrays of an overview level by name.

    They are the centres and edges of cells along the axes, the fixed parameters, and the names of the regimes.
    """
    spec, base, arrays = handle.spec, handle.coordinates, {}
    for axis in reversed(spec.axes):
        if axis.name in spec.dims[: spec.n_uncoarsened_dims]:
            arrays[axis.name] = base[axis.name]
            continue
        edges = edges_of(np.array(axis.values), axis.scale == "log")
        edges, level_name = np.append(edges[: -1 : 2**level], edges[-1]), coarse_name(axis.name)
        bounds = bounds_name(level_name)
        attributes = {**base[axis.name].attributes, "bounds": bounds}
        arrays[level_name] = StoredArray(centres(edges, axis.scale == "log"), (level_name,), attributes)
        arrays[bounds] = StoredArray(np.stack([edges[:-1], edges[1:]], axis=1), (level_name, "bound"), {})
    for name in (name for name in spec.parameters if name in base):
        arrays[name] = StoredArray(np.asarray(base[name].values), (), base[name].attributes)
    named = np.array([regime.name for regime in REGIMES], dtype="T")
    return arrays | {"class": StoredArray(named, ("class",), {"long_name": "regime of motion"})}


def coarse_name(axis: str) -> str:
    """Return the name that a coarsened axis has in the overviews."""
    return f"{axis}_coarse"


def level_dims(spec: Spec) -> tuple[str, ...]:
    """Return the names of the dimensions of variables in every overview."""
    return (*spec.dims[: spec.n_uncoarsened_dims], *map(coarse_name, spec.dims[spec.n_uncoarsened_dims :]))


def multiscales(spec: Spec, levels: int) -> list[dict[str, Any]]:
    """Return the attribute by which viewers of multiscale images find all levels, that of the group of overviews.

    ``levels`` is the number of levels above the atlas itself, level 0, which is listed first.
    """
    scales = [
        [1 if k < spec.n_uncoarsened_dims else 2**level for k in range(len(spec.dims))] for level in range(levels + 1)
    ]
    paths = ["..", *map(str, range(1, levels + 1))]
    datasets = [{"path": path, "scale": scale} for path, scale in zip(paths, scales, strict=True)]
    return [{"name": "cells", "axes": list(spec.dims), "datasets": datasets}]


def bounds_name(axis: str) -> str:
    """Return the name of the variable with the edges of an axis's coarse cells."""
    return f"{axis}_bounds"


def centres(edges: NDArray[np.float64], log: bool) -> NDArray[np.float64]:
    """Return the centres of cells: midway between their edges, on a log axis the geometric mean."""
    return np.sqrt(edges[:-1] * edges[1:]) if log else 0.5 * (edges[:-1] + edges[1:])
