"""Reading and writing the tiles of a store; reading a tile finds every missing or damaged chunk."""

import errno
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from atlas.errors import ChunkError, message_of
from atlas.spec.spec import Slices
from atlas.store.host import current_host
from atlas.store.host_records import record_host
from atlas.store.origin import ALLOWANCES, BudgetVariable
from atlas.store.record_format import (
    DIGEST,
    Rows,
    count_row,
    digest_of,
    halves,
)
from atlas.store.store import AtlasStore, chunk_key
from workers.results import LABEL, REGIME, Variable


def write_tile(handle: AtlasStore, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> Rows:
    """Write the results of a tile as whole objects, ``regime`` last, and return the tile's record.

    The tile is finished once ``regime`` exists. Another attempt at the tile writes the same bits.
    """
    to, all_arrays = handle.arrays, _with_allowances(handle, index, arrays)
    objects, final_objects = dict[str, bytes](), dict[str, bytes]()
    for variable in _written(handle):
        array, values = to[variable.name], all_arrays[variable.name]
        chunks = encode_chunks(array, block(array, index), values, variable.sparse)
        (final_objects if variable.name == REGIME.name else objects).update(chunks)
    row = _begin_tile(handle, index, all_arrays)
    handle.backend.put_all(objects)
    for key, data in final_objects.items():
        handle.backend.commit(key, data)
    return row


def copy_tile(handle: AtlasStore, origin: AtlasStore, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> Rows:
    """Write a tile like ``write_tile``, but copy its objects from ``origin``, a store of the same cells and tiles.

    ``arrays`` are the results as read from the origin, whose objects must be intact.
    """
    row = _begin_tile(handle, index, _with_allowances(handle, index, arrays))
    *keys, last = [chunk_key(variable, index) for variable in _written(handle)]
    handle.backend.copy_all(origin.backend, keys)
    for key, data in origin.backend.get_all([last]).items():
        handle.backend.commit(key, data)
    return row


def _begin_tile(handle: AtlasStore, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> Rows:
    """Prepare writing a tile and return the tile's record.

    This host is recorded, and old objects that the tile no longer has are removed.
    """
    record_host(handle, current_host())
    sparse = (variable for variable in _written(handle) if variable.sparse)
    absent = [chunk_key(variable, index) for variable in sparse if is_blank(arrays[variable.name], variable)]
    if absent:
        handle.backend.remove_all(absent)
    return record_of(handle, index, arrays)


def _with_allowances(handle: AtlasStore, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Return the results of a tile with the budgets of its cells added; the default is the settings of the spec."""
    return {allowance.name: _as_in_spec(handle, index, allowance) for allowance in ALLOWANCES} | dict(arrays)


def _written(handle: AtlasStore) -> list[Variable]:
    """Return the variables of cells that the store has, ``regime`` last, in the order in which a tile is written."""
    return [*handle.allowances, *handle.variables]


def relabel_tile(handle: AtlasStore, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> Rows:
    """Write the labels in ``arrays`` into a tile of basins, once all tiles are finished, and return the tile's new
    record.

    Other arrays stay as stored. The table of records must not have an earlier record of the tile.
    """
    array = handle.arrays[LABEL.name]
    handle.backend.confirm_lease()
    handle.backend.put_all(encode_chunks(array, block(array, index), arrays[LABEL.name]))
    return record_of(handle, index, arrays)


def encode_chunks(array: Any, block: Slices, values: Any, sparse: bool = False) -> dict[str, bytes]:
    """Encode values of a block of a Zarr array as the objects to store, by key. The block consists of whole objects.

    Objects that hold fill values alone are included unless ``sparse``, so that a missing object is a missing result.
    """
    from zarr import Array, AsyncArray
    from zarr.storage import MemoryStore, StorePath

    objects: dict[str, Any] = {}
    apart = AsyncArray(array.metadata, StorePath(MemoryStore(objects), array.path))  # an empty store: nothing is read
    Array(apart).with_config({"write_empty_chunks": not sparse})[block] = values
    return {key: data.to_bytes() for key, data in objects.items()}


def record_of(handle: AtlasStore, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> Rows:
    """Return the record of a tile with these results, including the budgets ``ALLOWANCES``."""
    row = count_row(handle.spec, handle.tiling.at(index).slices, handle.dominant_arrays(arrays))
    row[DIGEST] = halves(digest_of(index, (*handle.variables, *ALLOWANCES), arrays))
    return row


def drop_tile(handle: AtlasStore, index: tuple[int, ...]) -> None:
    """Make a tile unfinished, by removing its ``regime``, so that the next run solves it again.

    Its other chunks stay until they are rewritten.
    """
    handle.backend.confirm_lease()
    handle.backend.remove(chunk_key(handle.regime, index))


def read_tile(
    handle: AtlasStore,
    index: tuple[int, ...],
    names: Iterable[str] | None = None,
) -> dict[str, np.ndarray]:
    """Return the results of a finished tile: those named, or all results and the budgets ``ALLOWANCES``.

    handle   handle of the store
    index    index of the tile
    names    names of the variables, None for all

    Raise ChunkError, which names every damaged chunk, or OSError if the backend cannot be read at all.
    """
    requested = {variable.name for variable in (*handle.variables, *ALLOWANCES)} if names is None else set(names)
    arrays = handle.arrays
    values: dict[str, np.ndarray] = {}
    faults: dict[str, str] = {}
    for variable in (*handle.variables, *ALLOWANCES):
        if variable.name not in requested:
            continue
        if isinstance(variable, BudgetVariable) and variable.name not in arrays:
            values[variable.name] = _as_in_spec(handle, index, variable)
            continue
        key, array = chunk_key(variable, index), arrays[variable.name]
        chunk = read_chunk(array, index)
        if isinstance(chunk, str):
            faults[key] = chunk
        # A missing chunk reads as fill values, so each chunk of fill values alone is looked up.
        elif not variable.sparse and is_blank(chunk, variable) and (lost := _lost(handle, array, key)):
            faults[key] = lost
        else:
            values[variable.name] = chunk
    if faults:
        raise ChunkError(handle.backend, faults)
    return values


def block(array: Any, index: tuple[int, ...]) -> Slices:
    """Return the slices of a tile's cells in a Zarr array.

    They follow from the shape of the array's own objects, shards or chunks, so that no write is misaligned.
    """
    sides = array.shards or array.chunks
    return tuple(slice(i * c, min((i + 1) * c, n)) for i, c, n in zip(index, sides, array.shape, strict=False))


def _as_in_spec(handle: AtlasStore, index: tuple[int, ...], allowance: BudgetVariable) -> np.ndarray:
    return np.full(handle.tiling.at(index).shape, allowance.from_spec(handle.spec), allowance.dtype)


def read_chunk(array: Any, index: tuple[int, ...]) -> np.ndarray | str:
    """Return the values of a tile in a Zarr array, or a text about the fault of its chunk."""
    try:
        return np.asarray(array[block(array, index)])
    except OSError as error:
        if error.errno != errno.EIO:  # a bad sector is the chunk's fault, a lost network is not
            raise
        return f"cannot be read ({error.strerror})"
    except MemoryError:
        raise
    except Exception as error:  # a codec that reads damaged bytes may raise anything
        return f"is damaged ({message_of(error)})"


def _lost(handle: AtlasStore, array: Any, key: str) -> str:
    """Return a text about the fault of an object that reads as fill values: it is missing, or an empty shard.

    The text is empty if the object exists.
    """
    if not array.shards:
        return "" if handle.backend.exists(key) else "is missing"
    data = handle.backend.get(key)
    return "is missing" if data is None else "" if data else "is damaged (it is empty)"


def is_blank(values: np.ndarray, variable: Variable) -> bool:
    """Return True if all values equal the fill value of the variable, that is, nothing was written."""
    blank = np.isnan(values) if variable.fill != variable.fill else values == variable.fill
    return bool(np.all(blank))
