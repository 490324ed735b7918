"""The tiles of a store: written whole, and read with every missing or damaged chunk found."""

import errno
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from atlas.errors import ChunkError, message_of
from atlas.spec.spec import Slices
from atlas.store.machine import this_machine
from atlas.store.machines import record_machine
from atlas.store.origin import ALLOWANCES, Allowance
from atlas.store.record import (
    COVERED,
    DIGEST,
    WIDTH,
    Rows,
    counted_row,
    digest_of,
    halves,
    packed,
    record_key,
)
from atlas.store.store import Atlas, chunk_key, open_arrays
from workers.results import LABEL, REGIME, Variable


def write_tile(handle: Atlas, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> Rows:
    """Write a tile as whole objects and return its record. ``regime`` is last, and with it the tile is done for good.

    The record comes right before. Another attempt at the tile writes the same bits.
    """
    to, whole = handle.declared, _with_allowances(handle, index, arrays)
    objects, done = dict[str, bytes](), dict[str, bytes]()
    for variable in _written(handle):
        array, values = to[variable.name], whole[variable.name]
        made = encoded(array, block(array, index), values, variable.sparse)
        (done if variable.name == REGIME.name else objects).update(made)
    row = _begin_tile(handle, index, whole)
    handle.place.put_all(objects)
    put_record(handle, index, row)
    handle.place.put_all(done)
    return row


def take_tile(handle: Atlas, origin: Atlas, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> Rows:
    """Write a tile as ``write_tile`` does, but take over its objects from a store of the same cells and tiles.

    ``arrays`` are what was read there, which has shown that the objects are whole.
    """
    row = _begin_tile(handle, index, _with_allowances(handle, index, arrays))
    *keys, last = [chunk_key(variable, index) for variable in _written(handle)]
    handle.place.take_all(origin.place, keys)
    put_record(handle, index, row)
    handle.place.take_all(origin.place, [last])
    return row


def _begin_tile(handle: Atlas, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> Rows:
    """Note which machine writes a tile, and remove what a lost tile left where there is to be no object; the record."""
    record_machine(handle, this_machine())
    sparse = (each for each in _written(handle) if each.sparse)
    absent = [chunk_key(each, index) for each in sparse if is_blank(arrays[each.name], each)]
    if absent:
        handle.place.remove_all(absent)
    return record_of(handle, index, arrays)


def _with_allowances(handle: Atlas, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Arrays of a tile with those that say how much each cell was given, by default what the spec says."""
    return {each.name: _as_in_spec(handle, index, each) for each in ALLOWANCES} | dict(arrays)


def _written(handle: Atlas) -> list[Variable]:
    """The variables of cells that the store has, ``regime`` last."""
    return [*handle.allowances, *handle.variables]


def relabel_tile(handle: Atlas, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> None:
    """Give a tile of basins the labels in ``arrays``, which are known once all tiles are; all else there is as stored.

    Meanwhile its record is empty, so that a kill leaves none that contradicts the tile.
    """
    array = handle.declared[LABEL.name]
    put_record(handle, index, np.zeros(WIDTH))
    handle.place.put_all(encoded(array, block(array, index), arrays[LABEL.name]))
    put_record(handle, index, record_of(handle, index, arrays))


def encoded(array: Any, block: Slices, values: Any, sparse: bool = False) -> dict[str, bytes]:
    """The objects, by key, that a Zarr array has where these values fill a block of whole objects.

    An object of nothing but fill values is among them unless ``sparse``, so that a missing one is a missing result.
    """
    from zarr import Array, AsyncArray
    from zarr.storage import MemoryStore, StorePath

    objects: dict[str, Any] = {}
    apart = AsyncArray(array.metadata, StorePath(MemoryStore(objects), array.path))  # nothing there to be read
    Array(apart).with_config({"write_empty_chunks": not sparse})[block] = values
    return {key: data.to_bytes() for key, data in objects.items()}


def record_of(handle: Atlas, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> Rows:
    """The record of a tile with these arrays, ``ALLOWANCES`` among them."""
    row = counted_row(handle.spec, handle.tiling.at(index).slices, handle.leading(arrays))
    covered = covered_variables(handle, handle.record["attributes"])
    row[DIGEST] = halves(digest_of(index, covered, arrays))
    return row


def put_record(handle: Atlas, index: tuple[int, ...], row: Rows) -> None:
    """Write the record of a tile."""
    handle.place.put(record_key(index), packed(row))


def drop_tile(handle: Atlas, index: tuple[int, ...]) -> None:
    """Make a tile unfinished, so that the next run solves it again. Its other chunks stay until they are rewritten.

    Its record goes first: an empty one replaces it, and takes precedence over the row in the records of all tiles.
    """
    put_record(handle, index, np.zeros(WIDTH))
    handle.place.remove(chunk_key(handle.regime, index))


def read_tile(
    handle: Atlas, index: tuple[int, ...], names: Iterable[str] | None = None, arrays: Mapping[str, Any] | None = None
) -> dict[str, np.ndarray]:
    """Arrays of a finished tile: the named ones, or all results and ``ALLOWANCES``.

    They are read from ``arrays``, see ``open_arrays``.

    Raises ChunkError, which names every bad chunk; OSError if the place cannot be read at all.
    """
    arrays = open_arrays(handle) if arrays is None else arrays
    wanted = {each.name for each in (*handle.variables, *ALLOWANCES)} if names is None else set(names)
    values: dict[str, np.ndarray] = {}
    faults: dict[str, str] = {}
    for variable in (*handle.variables, *ALLOWANCES):
        if variable.name not in wanted:
            continue
        if isinstance(variable, Allowance) and variable.name not in arrays:
            values[variable.name] = _as_in_spec(handle, index, variable)
            continue
        key, array = chunk_key(variable, index), arrays[variable.name]
        found = read_chunk(array, index)
        if isinstance(found, str):
            faults[key] = found
        # A missing chunk reads as fill values, so that only a chunk of nothing else has to be looked for.
        elif not variable.sparse and is_blank(found, variable) and (lost := _lost(handle, array, key)):
            faults[key] = lost
        else:
            values[variable.name] = found
    if faults:
        raise ChunkError(handle.place, faults)
    return values


def covered_variables(handle: Atlas, attributes: Mapping[str, Any]) -> list[Variable]:
    """The variables that digests cover, by the attributes of their array; KeyError for one that the store lacks."""
    known = {variable.name: variable for variable in (*handle.variables, *ALLOWANCES)}
    return [known[name] for name in attributes[COVERED]]


def block(array: Any, index: tuple[int, ...]) -> Slices:
    """The cells of a tile in an array, from the array's own objects, so that no write can be misaligned."""
    sides = object_shape(array)
    return tuple(slice(i * c, min((i + 1) * c, n)) for i, c, n in zip(index, sides, array.shape, strict=False))


def object_shape(array: Any) -> tuple[int, ...]:
    """The cells of an array in one object: a shard, or a chunk where there are no shards."""
    return tuple(array.shards or array.chunks)


def _as_in_spec(handle: Atlas, index: tuple[int, ...], allowance: Allowance) -> np.ndarray:
    return np.full(handle.tiling.at(index).shape, allowance.of_spec(handle.spec), allowance.dtype)


def read_chunk(array: Any, index: tuple[int, ...]) -> np.ndarray | str:
    """A tile's part of an array, or the fault of its chunk."""
    try:
        return np.asarray(array[block(array, index)])
    except OSError as error:
        if error.errno != errno.EIO:  # a bad sector is the chunk's fault, a lost network is not
            raise
        return f"cannot be read ({error.strerror})"
    except MemoryError:
        raise
    except Exception as error:  # a codec that meets bytes it never wrote may raise anything
        return f"is damaged ({message_of(error)})"


def _lost(handle: Atlas, array: Any, key: str) -> str:
    """The fault of an object that reads as fill values; of a shard, which does so too where it is empty."""
    if not array.shards:
        return "" if handle.place.exists(key) else "is missing"
    data = handle.place.get(key)
    return "is missing" if data is None else "" if data else "is damaged (it is empty)"


def is_blank(values: np.ndarray, variable: Variable) -> bool:
    """Whether there is nothing but fill values."""
    blank = np.isnan(values) if variable.fill != variable.fill else values == variable.fill
    return bool(np.all(blank))
