"""The record of a tile: a digest of its place and contents, and the counts of its cells by regime and by reason.

It is a row of numbers, the chunk of its tile in the array ``tiles/record``. Digests reveal swapped tiles; the
counts say what an atlas holds without reading its cells. Columns have fixed places, with room for regimes and reasons
of later versions: this version finds that such a row does not add up to its tile, and counts the tile from its chunks.
"""

import hashlib
from collections.abc import Iterable, Mapping
from functools import reduce
from typing import Any

import google_crc32c
import numpy as np
from numpy.typing import NDArray

from atlas.spec.cells import widths_along
from atlas.spec.spec import Spec
from atlas.store.tiling import chunk_index
from workers.results import PENDING, REASON, REASONS, REGIME, REGIMES, Variable

TILES = "tiles"
RECORD, RECORDS = f"{TILES}/record", f"{TILES}/records"
COVERED = "variables"
"""The attribute with the names of the variables in a digest, in their order."""
_ROOM = {"cells": 16, "area": 16, "reason": 64}
DIGEST = slice(0, 2)
CELLS = slice(2, 2 + len(REGIMES))
AREAS = slice(18, 18 + len(REGIMES))
BY_REASON = slice(34, 34 + len(REASONS))
"""The columns of the digest in two halves, of cells by regime, of their areas, and of cells by reason."""
WIDTH = 2 + sum(_ROOM.values())

Index = tuple[int, ...]
Rows = NDArray[np.float64]


def digest_of(index: Index, variables: Iterable[Variable], arrays: Mapping[str, Any]) -> int:
    """The digest of a tile, 64 bits, of these variables."""
    digest = hashlib.blake2b(repr(tuple(map(int, index))).encode(), digest_size=8)
    for variable in variables:
        dtype = np.dtype(variable.dtype).newbyteorder("<")
        digest.update(variable.name.encode())
        digest.update(np.asarray(arrays[variable.name], dtype=dtype).tobytes())
    return int.from_bytes(digest.digest(), "little")


def halves(digest: int) -> tuple[int, int]:
    """The two columns of a digest in a row."""
    return divmod(digest, 2**32)


def counted_row(spec: Spec, slices: tuple[slice, ...], arrays: Mapping[str, NDArray[Any]]) -> Rows:
    """The row of a tile without its digest, from arrays of regimes and, if there are any, of reasons, one a cell.

    Areas are in units of the axes.
    """
    codes = arrays[REGIME.name]
    area = reduce(np.multiply.outer, (width[part] for width, part in zip(widths_along(spec), slices, strict=True)))
    known = (codes >= PENDING) & (codes < PENDING + len(REGIMES))  # with other codes the counts add up to no tile
    places = codes[known] - PENDING
    row = np.zeros(WIDTH)
    row[CELLS] = np.bincount(places, minlength=len(REGIMES))
    row[AREAS] = np.bincount(places, weights=area[known], minlength=len(REGIMES))
    reasons = arrays.get(REASON.name, np.zeros(codes.shape, REASON.dtype))
    row[BY_REASON] = [np.count_nonzero(reasons == reason.code) for reason in REASONS]
    return row


def add_up(rows: Rows, sizes: NDArray[np.int64]) -> NDArray[np.bool_]:
    """A mask of the rows, along the last dimension, whose counts add up to the cells of their tiles."""
    by_regime, by_reason = rows[..., CELLS].sum(axis=-1), rows[..., BY_REASON].sum(axis=-1)
    return np.asarray((by_regime == sizes) & (by_reason == sizes))


def packed(row: Rows) -> bytes:
    """A row as the chunk of its tile, in the form that ``create_arrays`` declares."""
    data = row.astype("<f8").tobytes()
    return data + google_crc32c.value(data).to_bytes(4, "little")


def unpacked(data: bytes) -> Rows | None:
    """The inverse; None for bytes of any other kind."""
    inner, checksum = data[:-4], data[-4:]
    if len(inner) != 8 * WIDTH or google_crc32c.value(inner) != int.from_bytes(checksum, "little"):
        return None
    return np.frombuffer(inner, dtype="<f8").astype(np.float64)


def record_key(index: Index) -> str:
    """The key of a tile's record. All are in one folder, so that removing them leaves no empty folders."""
    return f"{RECORD}/{'.'.join(['c', *map(str, index), '0'])}"


def record_index(key: str, grid: Index) -> Index | None:
    """The tile whose record has this key; None for any other key."""
    begin = f"{RECORD}/c."
    index = chunk_index(key.removeprefix(begin).replace(".", "/"), (*grid, 1)) if key.startswith(begin) else None
    return None if index is None else index[:-1]


def create_arrays(
    root: Any, variables: Iterable[Variable], dims: tuple[str, ...], grid: Index, codecs: list[Any]
) -> None:
    """Make the arrays of a store's records: one with a chunk for each tile, and one with a single chunk."""
    from zarr.codecs import Crc32cCodec

    columns = [""] * WIDTH
    columns[DIGEST] = "digest, upper half", "digest, lower half"
    columns[CELLS] = [f"cells {regime.name}" for regime in REGIMES]
    columns[AREAS] = [f"area {regime.name}" for regime in REGIMES]
    columns[BY_REASON] = [f"reason {reason.name}" for reason in REASONS]
    described: dict[str, Any] = {"units": "1", "columns": columns, COVERED: [variable.name for variable in variables]}
    group = root.require_group(TILES)
    for name, chunk, packing, meant in (
        ("record", (1,) * len(grid), [Crc32cCodec()], "digest and counts of a tile, as its worker wrote them"),
        ("records", grid, codecs, "digests and counts of all tiles, as the last run put them together"),
    ):
        group.create_array(
            name,
            shape=(*grid, WIDTH),
            chunks=(*chunk, WIDTH),
            dtype="float64",
            fill_value=0.0,
            dimension_names=(*(f"tile_{dim}" for dim in dims), "column"),
            chunk_key_encoding={"name": "default", "separator": "."},
            compressors=packing,
            attributes={"long_name": meant, **described},
            overwrite=True,
        )
