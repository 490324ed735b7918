"""Groups of arrays beside the results of a store, such as curves and tables; each group is written whole.

The metadata of a group are written after its arrays, with a checksum. They repeat the arrays' metadata and have a
digest of all values. A kill at any moment therefore leaves the group whole or absent.
"""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import ChunkError, InputError, message_of
from atlas.store.metadata import COMPRESSED, ROOT, Node, encode_node, encode_whole, members_of, sealed, unsealed
from atlas.store.schema import ATTRACTORS as ATTRACTORS
from atlas.store.schema import CURVES as CURVES
from atlas.store.schema import LABELS as LABELS
from atlas.store.schema import LARGEST_CHUNK, StoredArray, chunk_of_whole, coordinates, whole_node
from atlas.store.schema import STABILITY as STABILITY
from atlas.store.store import AtlasStore, array_by, write_root
from atlas.store.tiles import encode_chunks
from workers.results import Variable

ARRAYS, CONTENT = "arrays", "content"
"""Names of two attributes of a group: the list of its arrays, and the digest of their metadata and values."""


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
    """Write a group of arrays with attributes into a store, replacing an existing group of that name."""
    backend = handle.backend
    backend.confirm_lease()
    drop_group(handle, group)
    nodes = {name: whole_node(array, COMPRESSED) for name, array in arrays.items()}
    objects = {f"{group}/{name}/{ROOT}": encode_node(node) for name, node in nodes.items()}
    for name, array in arrays.items():
        if array.values.size:
            full_slices = tuple(map(slice, array.values.shape))
            objects |= encode_chunks(array_by(backend, f"{group}/{name}", nodes[name]), full_slices, array.values)
    backend.remove_all([key for key in backend.list_keys(f"{group}/") if key not in objects])
    backend.put_all(objects)
    stored_attributes = {
        **attributes,
        ARRAYS: list(arrays),
        CONTENT: _content(nodes, {n: a.values for n, a in arrays.items()}),
    }
    backend.commit(f"{group}/{ROOT}", sealed(stored_attributes, nodes))
    write_root(handle)  # xarray finds the group by the root's copy


def write_table(
    handle: AtlasStore, table: str, columns: Mapping[str, StoredArray], attributes: Mapping[str, Any]
) -> None:
    """Write columns and the coordinates of their dimensions as a group, which xarray opens as a dataset.

    An existing table of that name is replaced.
    """
    dims = {dim for column in columns.values() for dim in column.dims}
    known = {name: array for name, array in coordinates(handle.spec).items() if name in dims and array.dims == (name,)}
    write_group(handle, table, known | dict(columns), {**attributes, "digest": handle.digest})


def drop_group(handle: AtlasStore, group: str) -> None:
    """Make a group count as absent, by removing first the copy of its metadata in the root, then the metadata
    themselves.
    """
    if handle.backend.exists(f"{group}/{ROOT}"):
        write_root(handle, without=group)
        handle.backend.remove(f"{group}/{ROOT}")


def group_attributes(handle: AtlasStore, group: str) -> dict[str, Any] | None:
    """Return the attributes of a group; None if it does not exist. Raise ChunkError if they are damaged."""
    stored = handle.backend.get(f"{group}/{ROOT}")
    return None if stored is None else _attributes_in(handle, group, stored)


def read_group(handle: AtlasStore, group: str) -> tuple[dict[str, NDArray[Any]], dict[str, Any]] | None:
    """Return the arrays of a group by name, and the group's attributes; None if the group does not exist.

    Raise ChunkError, which names the missing or damaged objects, unless arrays and attributes agree with the group's
    digest.
    """
    data = handle.backend.get(f"{group}/{ROOT}")
    return None if data is None else _find_group(handle, group, data)[:2]


def group_layout(handle: AtlasStore, group: str, data: bytes) -> dict[str, bytes]:
    """Return the metadata that a group and its arrays must have, as bytes by key.

    They follow from ``data``, the stored metadata of the group. Raise ChunkError if the group is damaged, like
    ``read_group``.
    """
    _, attributes, nodes = _find_group(handle, group, data)
    arrays = {f"{group}/{name}/{ROOT}": encode_node(node) for name, node in nodes.items()}
    return {f"{group}/{ROOT}": sealed(attributes, nodes), **arrays}


def _find_group(
    handle: AtlasStore, group: str, data: bytes
) -> tuple[dict[str, NDArray[Any]], dict[str, Any], dict[str, Node]]:
    """Return the arrays and the attributes of a group, and the metadata of its arrays.

    ``data`` are the stored metadata of the group. The metadata of an array are stored twice, with the group and with
    the array: the group's digest tells which copy is right. Raise ChunkError if neither is.
    """
    attributes = _attributes_in(handle, group, data)
    faults: dict[str, str] = {}
    names = list(attributes.get(ARRAYS, ()))
    for nodes in (members_of(data), _own_nodes(handle, group, names)):
        arrays = {name: _read(handle, f"{group}/{name}", nodes.get(name)) for name in names}
        values = {name: array for name, array in arrays.items() if isinstance(array, np.ndarray)}
        if len(values) == len(names) and _content({name: nodes[name] for name in names}, values) == attributes[CONTENT]:
            return values, attributes, {name: nodes[name] for name in names}
        for result in arrays.values():
            faults |= {} if isinstance(result, np.ndarray) else result
    raise ChunkError(handle.backend, faults or {f"{group}/{ROOT}": "is damaged or belongs to other arrays"})


def _attributes_in(handle: AtlasStore, group: str, data: bytes) -> dict[str, Any]:
    if (attributes := unsealed(data)) is None:
        raise ChunkError(handle.backend, {f"{group}/{ROOT}": "is damaged (its checksum is wrong)"})
    return attributes


def _own_nodes(handle: AtlasStore, group: str, names: Iterable[str]) -> dict[str, Any]:
    nodes = {}
    for key, data in handle.backend.get_all(f"{group}/{name}/{ROOT}" for name in names).items():
        try:
            nodes[key.split("/")[1]] = json.loads(data)
        except (ValueError, RecursionError):
            continue
    return nodes


def _read(handle: AtlasStore, path: str, node: Node | None) -> NDArray[Any] | dict[str, str]:
    """Return the values of an array that is stored in one chunk.

    If the chunk is missing or damaged, return a dict with its key and a description of the fault.
    """
    key = f"{path}/{ROOT}"
    if node is None:
        return {key: "is missing"}
    try:
        array = array_by(handle.backend, path, node)
        key = chunk_of_whole(path, StoredArray(array, (), {}))
        if array.size and not handle.backend.exists(key):
            return {key: "is missing"}
        return np.asarray(array[...])
    except OSError:
        raise
    except Exception as error:  # damaged metadata, or a codec that reads damaged bytes, may raise anything
        return {key: f"is damaged ({message_of(error)})"}


def _content(nodes: Mapping[str, Node], arrays: Mapping[str, NDArray[Any]]) -> str:
    """Return the digest of the metadata and the values of a group's arrays."""
    digest = hashlib.sha256(json.dumps(nodes, sort_keys=True).encode())
    for name in sorted(arrays):
        digest.update(encode_whole(np.asarray(arrays[name])))
    return digest.hexdigest()
