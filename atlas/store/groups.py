"""Groups of arrays beside the results of a store, such as curves and tables; each group is written whole.

The metadata of a group are written last, with a checksum of its contents. A kill at any moment therefore leaves the
group whole or absent.
"""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import ChunkError, InputError, message_of
from atlas.store.schema import LARGEST_CHUNK, StoredArray, consolidate, coordinates, create_whole
from atlas.store.store import ROOT, AtlasStore, open_group
from workers.results import Variable

CURVES, ATTRACTORS, LABELS, STABILITY = "curves", "attractors", "labels", "stability"
"""Names of the groups: curves of a plane; the attractors of an atlas of basins; labels of coexisting attractors;
stability measures of cells. All but the first are tables.
"""
TABLES = (ATTRACTORS, LABELS, STABILITY)
ARRAYS, CHECKSUM = "arrays", "checksum"
"""Attributes of a group: the names of its arrays, and its checksum."""


def groups_of(handle: AtlasStore) -> tuple[str, ...]:
    """Return the names of the groups that a store with this spec may have."""
    spec = handle.spec
    return (CURVES, STABILITY, *[ATTRACTORS] * spec.basins, *[LABELS] * spec.coexistence)


def check_table_size(handle: AtlasStore, variables: Iterable[Variable]) -> None:
    """Raise InputError if a column of a table would exceed the largest chunk.

    A column has a value of one of ``variables`` for every attractor of every cell.
    """
    spec = handle.spec
    count = math.prod(spec.shape) * (spec.attractors.keep if spec.coexistence and spec.attractors else 1)
    for variable in variables:
        if (size := count * np.dtype(variable.dtype).itemsize) > LARGEST_CHUNK:
            raise InputError(
                f"{handle.backend}: {variable.name} needs {size} bytes in one chunk, must be at most {LARGEST_CHUNK}; "
                "choose an atlas with fewer cells"
            )


def write_group(
    handle: AtlasStore, group: str, arrays: Mapping[str, StoredArray], attributes: Mapping[str, Any]
) -> None:
    """Write a group, replacing an existing one."""
    drop_group(handle, group)
    root = open_group(handle.backend, "r+")
    for name in set(_names(handle, group)).difference(arrays):
        del root[f"{group}/{name}"]  # readers read every array of a group
    for name, array in arrays.items():
        create_whole(root, f"{group}/{name}", array)
    own = {**attributes, ARRAYS: list(arrays)}
    whole = {
        "zarr_format": 3,
        "node_type": "group",
        "attributes": own | {CHECKSUM: _checksum(handle, group, arrays, own)},
    }
    handle.backend.put(f"{group}/{ROOT}", json.dumps(whole).encode())


def write_table(
    handle: AtlasStore, table: str, columns: Mapping[str, StoredArray], attributes: Mapping[str, Any]
) -> None:
    """Write a table for xarray, with the coordinates of its dimensions, replacing an existing one."""
    dims = {dim for column in columns.values() for dim in column.dims}
    known = {name: array for name, array in coordinates(handle.spec).items() if name in dims and array.dims == (name,)}
    write_group(handle, table, known | dict(columns), {**attributes, "digest": handle.digest})
    root = open_group(handle.backend, "r+")
    consolidate(root, table)
    consolidate(root)  # xarray finds the group by the root's copy


def drop_group(handle: AtlasStore, group: str) -> None:
    """Make a group count as absent, by removing its metadata."""
    handle.backend.remove(f"{group}/{ROOT}")


def group_attributes(handle: AtlasStore, group: str) -> dict[str, Any] | None:
    """Return the attributes of a group; None if it does not exist. Raise ChunkError if they are damaged."""
    key = f"{group}/{ROOT}"
    stored = handle.backend.get(key)
    try:
        return None if stored is None else dict(json.loads(stored)["attributes"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ChunkError(handle.backend, {key: f"is damaged ({message_of(error)})"}) from None


def read_group(handle: AtlasStore, group: str) -> tuple[dict[str, NDArray[Any]], dict[str, Any]] | None:
    """Return the arrays of a group by name, and its attributes; None if it does not exist.

    Raise ChunkError, which names the missing or damaged objects, if the arrays were not written together.
    """
    attributes = group_attributes(handle, group)
    if attributes is None:
        return None
    names = attributes.get(ARRAYS) or _names(handle, group)
    arrays: dict[str, NDArray[Any]] = {}
    faults: dict[str, str] = {}
    for name in names:
        values = _read(handle, f"{group}/{name}")
        if isinstance(values, np.ndarray):
            arrays[name] = values
        else:
            faults |= values
    own = {name: value for name, value in attributes.items() if name != CHECKSUM}
    if not faults and attributes.get(CHECKSUM) != _checksum(handle, group, names, own):
        faults[f"{group}/{ROOT}"] = "is damaged or belongs to other arrays"
    if faults:
        raise ChunkError(handle.backend, faults)
    return arrays, attributes


def _names(handle: AtlasStore, group: str) -> list[str]:
    """Return the names of the arrays of a group, from a listing of its objects."""
    keys = (key.split("/") for key in handle.backend.list_keys(f"{group}/"))
    return sorted({parts[1] for parts in keys if len(parts) > 2 and parts[-1] == ROOT})


def _read(handle: AtlasStore, path: str) -> NDArray[Any] | dict[str, str]:
    """Return the values of an array of one chunk; if it is missing or damaged, return its fault by key."""
    key = f"{path}/{ROOT}"
    try:
        array: Any = open_group(handle.backend, "r")[path]
        key = "/".join([path, "c", *("0" for _ in array.shape)])
        if array.size and not handle.backend.exists(key):
            return {key: "is missing"}
        return np.asarray(array[...])
    except OSError:
        raise
    except KeyError:
        return {key: "is missing"}
    except Exception as error:  # damaged metadata, or a codec that reads damaged bytes, may raise anything
        return {key: f"is damaged ({message_of(error)})"}


def _checksum(handle: AtlasStore, group: str, names: Iterable[str], attributes: Mapping[str, Any]) -> str:
    """Return a digest of the attributes of a group and of all objects of its arrays."""
    digest = hashlib.sha256(json.dumps(attributes, sort_keys=True).encode())
    for name in names:
        for key in sorted(handle.backend.list_keys(f"{group}/{name}/")):
            digest.update(f"{key} ".encode() + hashlib.sha256(handle.backend.get(key) or b"").digest())
    return digest.hexdigest()
