"""The tiles of a store: written whole, and read so that nothing missing or damaged goes unnoticed."""

import errno
import io
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from atlas.errors import ChunkError, message_of
from atlas.spec.spec import Slices
from atlas.store.machine import this_machine
from atlas.store.machines import record_machine
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
from atlas.store.schema import ALLOWANCES, Allowance
from atlas.store.store import Header, chunk_key, done_tiles, is_done, open_arrays
from atlas.store.tiling import chunk_index
from workers.results import REGIME, Variable

REPLACED = f"{REGIME.name}/replaced/"
"""Where the new contents of finished tiles lie, each as one object, until their chunks are written."""


def write_tile(header: Header, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> Rows:
    """Write a tile as whole objects and return its record. ``regime`` is last, and with it the tile is done.

    The record comes right before. No object is removed before it is written. A finished tile that is written again
    stays as it is until its new contents lie beside it in one object. It is unfinished while its objects are written,
    so that a kill leaves no mixture of two solutions; then ``finish_replacement`` writes them from that object.
    """
    to, place = header.writable, header.place
    record_machine(header, this_machine())
    arrays = {each.name: _as_in_spec(header, index, each) for each in ALLOWANCES} | dict(arrays)
    row = record_of(header, index, arrays)
    replaced = is_done(header, index)
    if replaced:
        place.put(_replacement_key(index), _packed(arrays))
        drop_tile(header, index)
    objects: dict[str, bytes] = {}
    for variable in (*(each for each in ALLOWANCES if each.name in to), *header.variables):
        made = encoded(to[variable.name], block(to[variable.name], index), arrays[variable.name], variable.sparse)
        if variable.name == REGIME.name:
            place.put_all(objects)
            put_record(header, index, row)
            place.put_all(made)
        elif not made:  # sparse, and here without a value
            place.remove(chunk_key(variable, index))
        objects |= made
    if replaced:
        place.remove(_replacement_key(index))
    return row


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


def record_of(header: Header, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> Rows:
    """The record of a tile with these arrays, ``ALLOWANCES`` among them."""
    row = counted_row(header.spec, header.tiling.at(index).slices, header.leading(arrays))
    covered = covered_variables(header, header.record["attributes"])
    row[DIGEST] = halves(digest_of(index, covered, arrays))
    return row


def put_record(header: Header, index: tuple[int, ...], row: Rows) -> None:
    """Write the record of a tile."""
    header.place.put(record_key(index), packed(row))


def finish_replacement(header: Header, index: tuple[int, ...]) -> bool:
    """Write a tile from what ``write_tile`` put beside it and did not live to write; False if there is nothing."""
    key = _replacement_key(index)
    packed = header.place.get(key)
    arrays = _unpacked(packed) if packed is not None else None
    if arrays is not None:
        write_tile(header, index, arrays)
    if packed is not None:
        header.place.remove(key)
    return arrays is not None


def listed_tiles(header: Header) -> tuple[set[tuple[int, ...]], set[tuple[int, ...]]]:
    """Indices of the finished tiles, and of those with contents beside them still to be written, from one listing."""
    keys = list(header.place.list_keys(f"{REGIME.name}/"))
    replaced = (chunk_index(key.removeprefix(REPLACED), header.tiling.grid) for key in keys if key.startswith(REPLACED))
    return done_tiles(header, keys), {index for index in replaced if index is not None}


def drop_tile(header: Header, index: tuple[int, ...]) -> None:
    """Make a tile unfinished, so that the next run solves it again. Its other chunks stay until they are rewritten.

    Its record goes first: an empty one replaces it, and takes precedence over the row in the records of all tiles.
    """
    put_record(header, index, np.zeros(WIDTH))
    header.place.remove(chunk_key(header.regime, index))


def read_tile(
    header: Header, index: tuple[int, ...], names: Iterable[str] | None = None, arrays: dict[str, Any] | None = None
) -> dict[str, np.ndarray]:
    """Arrays of a finished tile: the named ones, or all results and ``ALLOWANCES``.

    They are read from ``arrays``, see ``open_arrays``. Names of results that the store lacks are left out.

    Raises ChunkError, which names every bad chunk; OSError if the place cannot be read at all.
    """
    arrays = open_arrays(header) if arrays is None else arrays
    wanted = {each.name for each in (*header.variables, *ALLOWANCES)} if names is None else set(names)
    values: dict[str, np.ndarray] = {}
    faults: dict[str, str] = {}
    for variable in (*header.variables, *header.unknown, *ALLOWANCES):
        if variable.name not in wanted:
            continue
        if isinstance(variable, Allowance) and variable.name not in arrays:
            values[variable.name] = _as_in_spec(header, index, variable)
            continue
        key, array = chunk_key(variable, index), arrays[variable.name]
        found = read_chunk(array, index)
        if isinstance(found, str):
            faults[key] = found
        # A missing chunk reads as fill values, so that only a chunk of nothing else has to be looked for.
        elif not variable.sparse and is_blank(found, variable) and (lost := _lost(header, array, key)):
            faults[key] = lost
        else:
            values[variable.name] = found
    if faults:
        raise ChunkError(header.place, faults)
    return values


def covered_variables(header: Header, attributes: Mapping[str, Any]) -> list[Variable]:
    """The variables that digests cover, by the attributes of their array; KeyError for one that the store lacks."""
    known = {variable.name: variable for variable in (*header.variables, *header.unknown, *ALLOWANCES)}
    return [known[name] for name in attributes[COVERED]]


def block(array: Any, index: tuple[int, ...]) -> Slices:
    """The cells of a tile in an array, from the array's own objects, so that no write can be misaligned."""
    sides = object_shape(array)
    return tuple(slice(i * c, min((i + 1) * c, n)) for i, c, n in zip(index, sides, array.shape, strict=False))


def object_shape(array: Any) -> tuple[int, ...]:
    """The cells of an array in one object: a shard, or a chunk where there are no shards."""
    return tuple(array.shards or array.chunks)


def _replacement_key(index: tuple[int, ...]) -> str:
    return REPLACED + "/".join(map(str, index))


def _packed(arrays: Mapping[str, np.ndarray]) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, **arrays)
    return file.getvalue()


def _unpacked(data: bytes) -> dict[str, np.ndarray] | None:
    """The inverse; None if the bytes are damaged, which the checksums of the archive's members show."""
    try:
        with np.load(io.BytesIO(data)) as arrays:
            return dict(arrays)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error):
        return None


def _as_in_spec(header: Header, index: tuple[int, ...], allowance: Allowance) -> np.ndarray:
    return np.full(header.tiling.at(index).shape, allowance.of_spec(header.spec), allowance.dtype)


def read_chunk(array: Any, index: tuple[int, ...]) -> np.ndarray | str:
    """A tile's part of an array, or what is wrong with its chunk."""
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


def _lost(header: Header, array: Any, key: str) -> str:
    """What is wrong with an object that reads as fill values; of a shard, which does so too where it is empty."""
    if not array.shards:
        return "" if header.place.exists(key) else "is missing"
    data = header.place.get(key)
    return "is missing" if data is None else "" if data else "is damaged (it is empty)"


def is_blank(values: np.ndarray, variable: Variable) -> bool:
    """Whether there is nothing but fill values."""
    blank = np.isnan(values) if variable.fill != variable.fill else values == variable.fill
    return bool(np.all(blank))
