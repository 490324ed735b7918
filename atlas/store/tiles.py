"""Reading a finished tile so that nothing missing or damaged in it goes unnoticed."""

import errno
from collections.abc import Iterable
from typing import Any

import numpy as np

from atlas.errors import ChunkError, message_of
from atlas.store.digests import digest_of
from atlas.store.schema import BUDGET
from atlas.store.store import Header, block, chunk_key, open_arrays
from workers.results import REGIME, Variable, result_variables


def read_tile(
    header: Header, index: tuple[int, ...], names: Iterable[str] | None = None, arrays: dict[str, Any] | None = None
) -> dict[str, np.ndarray]:
    """Arrays of a finished tile: those named, or all results and ``budget``, what each cell may cost in periods.

    They are read from ``arrays`` as ``open_arrays`` gives them. Reasons are left out where an older store has none.

    Raises ChunkError, which tells of every bad chunk; OSError where the place cannot be read at all.
    """
    arrays = open_arrays(header) if arrays is None else arrays
    values: dict[str, np.ndarray] = {}
    faults: dict[str, str] = {}
    for variable in (*result_variables(header.spec.settings), BUDGET):
        if names is not None and variable.name not in names:
            continue
        if variable is BUDGET and BUDGET.name not in arrays:
            shape = tuple(part.stop - part.start for part in block(arrays[REGIME.name], index))
            values[BUDGET.name] = np.full(shape, header.spec.settings.max_periods, BUDGET.dtype)
            continue
        if variable.sparse and variable.name not in arrays:
            continue
        key = chunk_key(variable, index)
        found = _read(header, arrays[variable.name], index)
        if isinstance(found, str):
            faults[key] = found
        # A missing chunk reads as fill values, so that only a chunk of nothing else has to be looked for.
        elif not variable.sparse and _is_blank(found, variable) and not header.place.exists(key):
            faults[key] = "is missing"
        else:
            values[variable.name] = found
    if faults:
        raise ChunkError(header.place, faults)
    return values


def digest_faults(
    header: Header, digests: Any, index: tuple[int, ...], values: dict[str, np.ndarray]
) -> tuple[str, ...]:
    """What speaks against all that ``read_tile`` gave of a tile being that tile's, by the array of digests."""
    stored = _read(header, digests, index)
    key = "/".join([digests.path, "c", *map(str, index)])
    if isinstance(stored, str):
        return (f"{key} {stored}",)
    found = digest_of(header.spec, index, values)
    if int(stored.item()) == found:
        return ()
    if not header.place.exists(key):
        return (f"{key} is missing",)
    return ("its chunks are not those that were written here together: exchanged with another tile's, or altered",)


def _read(header: Header, array: Any, index: tuple[int, ...]) -> np.ndarray | str:
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


def _is_blank(values: np.ndarray, variable: Variable) -> bool:
    blank = np.isnan(values) if variable.fill != variable.fill else values == variable.fill
    return bool(np.all(blank))
