"""The coordinates of the levels of overviews: middles and edges of coarse cells."""

import numpy as np
from numpy.typing import NDArray

from atlas.overview.coarsen import CODES
from atlas.spec.cells import edges_of
from atlas.store.schema import StoredArray
from atlas.store.store import Header
from workers.results import REGIMES


def level_coordinates(header: Header, level: int, classes: int = CODES.size) -> dict[str, StoredArray]:
    """The coordinates of a level by name: axes with their bounds, fixed parameters, the names of the classes."""
    spec, base, made = header.spec, header.coordinates, {}
    for axis in reversed(spec.axes):
        if axis.name in spec.dims[: spec.kept]:
            made[axis.name] = base[axis.name]
            continue
        edges = edges_of(np.array(axis.values), axis.scale == "log")
        edges, bounds = np.append(edges[: -1 : 2**level], edges[-1]), bounds_name(axis.name)
        attributes = {**base[axis.name].attributes, "bounds": bounds}
        made[axis.name] = StoredArray(centres(edges, axis.scale == "log"), (axis.name,), attributes)
        made[bounds] = StoredArray(np.stack([edges[:-1], edges[1:]], axis=1), (axis.name, "bound"), {})
    for name in (name for name in spec.parameters if name in base):
        made[name] = StoredArray(np.asarray(base[name].values), (), base[name].attributes)
    named = np.array([regime.name for regime in REGIMES[:classes]], dtype="T")
    return made | {"class": StoredArray(named, ("class",), {"long_name": "regime of motion"})}


def bounds_name(axis: str) -> str:
    """The name of the variable that holds the edges of an axis's coarse cells."""
    return f"{axis}_bounds"


def centres(edges: NDArray[np.float64], log: bool) -> NDArray[np.float64]:
    """The middles of cells: half way between their edges, on a log axis the geometric mean."""
    return np.sqrt(edges[:-1] * edges[1:]) if log else 0.5 * (edges[:-1] + edges[1:])
