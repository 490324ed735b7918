"""The tiles of a store: written whole, and read so that nothing missing or damaged goes unnoticed."""

import errno
import io
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from atlas.errors import ChunkError, RunError, message_of
from atlas.spec.spec import Slices
from atlas.store.digests import COVERED, DIGESTS, digest_of
from atlas.store.machine import this_machine
from atlas.store.machines import record_machine
from atlas.store.schema import ALLOWANCES, Allowance
from atlas.store.store import Header, chunk_key, is_done, open_arrays, open_group
from atlas.store.tiling import chunk_index
from workers.results import REGIME, Variable

REPLACED = f"{REGIME.name}/replaced/"
"""Where the new contents of finished tiles lie, each as one object, until their chunks are written."""


def write_tile(header: Header, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> None:
    """Write all variables that the store has of one tile as whole chunks, ``regime`` last: with it the tile is done.

    A finished tile that is written again stays as it is until all that is new lies beside it in one object. It is
    unfinished while its chunks are written, so that a kill leaves no mixture of two solutions; then
    ``finish_replacement`` writes them from that object.
    """
    group = open_group(header.place, "r+")
    if group.attrs.get("run_id") != header.run_id:
        raise RunError(f"{header.place}: not the store of run {header.run_id}; is the path the same on all hosts?")
    record_machine(header, this_machine())
    arrays = {each.name: _as_in_spec(header, index, each) for each in ALLOWANCES} | dict(arrays)
    replaced = is_done(header, index)
    if replaced:
        header.place.put(_replacement_key(index), _packed(arrays))
        drop_tile(header, index)
    for each in ALLOWANCES:
        if each.name in group:
            _write(group[each.name], index, arrays[each.name], sparse=True)
    _write_digest(group, header, index, arrays)
    for variable in header.variables:
        _write(group[variable.name], index, arrays[variable.name], variable.sparse)
    if replaced:
        header.place.remove(_replacement_key(index))


def finish_replacement(header: Header, index: tuple[int, ...]) -> bool:
    """Write a tile from what ``write_tile`` put beside it and did not live to write; False where there is nothing."""
    key = _replacement_key(index)
    packed = header.place.get(key)
    arrays = _unpacked(packed) if packed is not None else None
    if arrays is not None:
        write_tile(header, index, arrays)
    if packed is not None:
        header.place.remove(key)
    return arrays is not None


def replacements(header: Header) -> set[tuple[int, ...]]:
    """Indices of the tiles with contents beside them that are still to be written, from one listing."""
    keys = (key.removeprefix(REPLACED) for key in header.place.list_keys(REPLACED))
    found = (chunk_index(key, header.tiling.grid) for key in keys)
    return {index for index in found if index is not None}


def write_digest(header: Header, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> None:
    """Keep the digest of a tile's arrays, ``ALLOWANCES`` among them; nothing in a store that has no room for it."""
    _write_digest(open_group(header.place, "r+"), header, index, arrays)


def drop_tile(header: Header, index: tuple[int, ...]) -> None:
    """Make a tile unfinished, so that the next run solves it again. Its other chunks stay until they are rewritten."""
    header.place.remove(chunk_key(header.regime, index))


def read_tile(
    header: Header, index: tuple[int, ...], names: Iterable[str] | None = None, arrays: dict[str, Any] | None = None
) -> dict[str, np.ndarray]:
    """Arrays of a finished tile: those named, or all results and ``ALLOWANCES``, what each cell was given.

    They are read from ``arrays`` as ``open_arrays`` gives them. Names of results that the store has not are left out.

    Raises ChunkError, which names every bad chunk; OSError where the place cannot be read at all.
    """
    arrays = open_arrays(header) if arrays is None else arrays
    wanted = {each.name for each in (*header.variables, *ALLOWANCES)} if names is None else set(names)
    values: dict[str, np.ndarray] = {}
    faults: dict[str, str] = {}
    for variable in (*header.variables, *header.unknown):
        if variable.name not in wanted:
            continue
        key = chunk_key(variable, index)
        found = _read(arrays[variable.name], index)
        if isinstance(found, str):
            faults[key] = found
        # A missing chunk reads as fill values, so that only a chunk of nothing else has to be looked for.
        elif not variable.sparse and is_blank(found, variable) and not header.place.exists(key):
            faults[key] = "is missing"
        else:
            values[variable.name] = found
    for each in ALLOWANCES:
        if each.name not in wanted:
            continue
        found = _read(arrays[each.name], index) if each.name in arrays else _as_in_spec(header, index, each)
        if isinstance(found, str):
            faults[chunk_key(each, index)] = found
        else:
            values[each.name] = found
    if faults:
        raise ChunkError(header.place, faults)
    return values


def covered_variables(header: Header, digests: Any) -> list[Variable]:
    """The variables that the digests of a store cover, in their order; KeyError where it does not have one of them."""
    known = {variable.name: variable for variable in (*header.variables, *header.unknown, *ALLOWANCES)}
    return [known[name] for name in digests.attrs[COVERED]]


def digest_faults(
    header: Header, digests: Any, index: tuple[int, ...], values: dict[str, np.ndarray]
) -> tuple[str, ...]:
    """What speaks against ``values``, all variables covered, being those of that tile, by the array of digests."""
    stored = _read(digests, index)
    key = "/".join([digests.path, "c", *map(str, index)])
    if isinstance(stored, str):
        return (f"{key} {stored}",)
    if int(stored.item()) == digest_of(index, covered_variables(header, digests), values):
        return ()
    if not header.place.exists(key):
        return (f"{key} is missing",)
    return ("its chunks are not those that were written here together: exchanged with another tile's, or altered",)


def block(array: Any, index: tuple[int, ...]) -> Slices:
    """The cells of a tile in an array, from the array's own chunks, so that no write can be misaligned."""
    return tuple(slice(i * c, min((i + 1) * c, n)) for i, c, n in zip(index, array.chunks, array.shape, strict=False))


def _write(array: Any, index: tuple[int, ...], values: Any, sparse: bool = False) -> None:
    """Write a tile's chunk; one of nothing but fill values too, so that a missing one is always a missing result."""
    array.with_config({"write_empty_chunks": not sparse})[block(array, index)] = values


def _write_digest(group: Any, header: Header, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> None:
    digests = group.get(DIGESTS)
    if digests is not None:
        _write(digests, index, np.uint64(digest_of(index, covered_variables(header, digests), arrays)))


def _replacement_key(index: tuple[int, ...]) -> str:
    return REPLACED + "/".join(map(str, index))


def _packed(arrays: Mapping[str, np.ndarray]) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, **arrays)
    return file.getvalue()


def _unpacked(data: bytes) -> dict[str, np.ndarray] | None:
    """The inverse; None where the bytes are damaged, which the checksums of the archive's members show."""
    try:
        with np.load(io.BytesIO(data)) as arrays:
            return dict(arrays)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error):
        return None


def _as_in_spec(header: Header, index: tuple[int, ...], allowance: Allowance) -> np.ndarray:
    return np.full(header.tiling.at(index).shape, allowance.of_spec(header.spec), allowance.dtype)


def _read(array: Any, index: tuple[int, ...]) -> np.ndarray | str:
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


def is_blank(values: np.ndarray, variable: Variable) -> bool:
    """Whether there is nothing but fill values."""
    blank = np.isnan(values) if variable.fill != variable.fill else values == variable.fill
    return bool(np.all(blank))
