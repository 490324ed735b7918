"""The format of a tile record: digest of the tile's index and contents, and counts of its cells by regime and reason.

A tile is a block of cells that is solved and written as one. Its record is a row of WIDTH float64 numbers in the array
``tiles/records``. The first two hold the digest, 64 bits as two halves of 32 bits, which a float64 holds exactly. The
others are numbers of cells, and areas of cells, by regime and by reason. Digests reveal swapped tiles. The counts tell
what an atlas contains without reading its cells. Columns have fixed positions, with room for regimes and reasons of
later versions. A row with codes of a later version does not add up to its tile in this version, which then counts the
tile from its chunks.
"""

import hashlib
from collections.abc import Iterable, Mapping
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.spec.cells import widths_along
from atlas.spec.spec import Spec
from atlas.store.metadata import array_node
from atlas.store.origin import ALLOWANCES
from workers.results import PENDING, REASON, REASONS, REGIME, REGIMES, Variable

TILES = "tiles"
RECORDS = f"{TILES}/records"
TILES_PER_CHUNK = 4096
"""Maximum number of tiles whose records share a chunk."""
_ROOM = {"cells": 16, "area": 16, "reason": 64}
DIGEST = slice(0, 2)
CELLS = slice(2, 2 + len(REGIMES))
AREAS = slice(18, 18 + len(REGIMES))
BY_REASON = slice(34, 34 + len(REASONS))
"""Columns of a tile record: its digest in two halves, its cells by regime, their areas, and its cells by reason."""
WIDTH = 2 + sum(_ROOM.values())

Index = tuple[int, ...]
Rows = NDArray[np.float64]


def digest_of(index: Index, variables: Iterable[Variable], arrays: Mapping[str, Any]) -> int:
    """Return the digest of a tile, a whole number of 64 bits, from its index and the arrays of these variables."""
    digest = hashlib.blake2b(repr(tuple(map(int, index))).encode(), digest_size=8)
    for variable in variables:
        dtype = np.dtype(variable.dtype).newbyteorder("<")
        digest.update(variable.name.encode())
        digest.update(np.asarray(arrays[variable.name], dtype=dtype).tobytes())
    return int.from_bytes(digest.digest(), "little")


def halves(digest: int) -> tuple[int, int]:
    """Return a digest of 64 bits as two numbers of 32 bits, the upper half first.

    A record is a row of float64 numbers, which hold 32 bits exactly but not 64.
    """
    return divmod(digest, 2**32)


def count_row(spec: Spec, slices: tuple[slice, ...], arrays: Mapping[str, NDArray[Any]]) -> Rows:
    """Return the record of a tile, a row of WIDTH numbers, with the digest left at zero.

    spec     spec of the atlas
    slices   cells of the tile; their areas are in units of the axes
    arrays   regimes and, if there are any, reasons, one per cell
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
    """Return the mask (...) of valid tile records: their counts by regime and by reason add up to the cells of their
    tile.

    rows   (..., WIDTH) tile records
    sizes  (...) number of cells of each tile
    """
    by_regime, by_reason = rows[..., CELLS].sum(axis=-1), rows[..., BY_REASON].sum(axis=-1)
    return np.asarray((by_regime == sizes) & (by_reason == sizes))


def record_node(variables: Iterable[Variable], dims: tuple[str, ...], grid: Index) -> dict[str, Any]:
    """Return the Zarr metadata of the array of the tile records.

    variables  variables of the cells, which the digests cover
    dims       names of the dimensions of the atlas
    grid       number of tiles along each dimension
    """
    columns = [""] * WIDTH
    columns[DIGEST] = "digest, upper half", "digest, lower half"
    columns[CELLS] = [f"cells {regime.name}" for regime in REGIMES]
    columns[AREAS] = [f"area {regime.name}" for regime in REGIMES]
    columns[BY_REASON] = [f"reason {reason.name}" for reason in REASONS]
    described: dict[str, Any] = {
        "long_name": "digests and counts of tiles, as the workers sent them; 0 if unknown",
        "units": "1",
        "columns": columns,
        "variables": [variable.name for variable in (*variables, *ALLOWANCES)],
    }
    dimensions = (*(f"tile_{dim}" for dim in dims), "column")
    block = (*record_block(grid), WIDTH)
    return array_node((*grid, WIDTH), "float64", dimensions, described, block=block, separator=".")


def record_block(grid: Index) -> Index:
    """Return the number of tiles along each dimension whose records share a chunk of the array of records."""
    side = round(TILES_PER_CHUNK ** (1 / len(grid)))
    return tuple(min(n, side) for n in grid)
