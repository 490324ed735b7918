"""The division of an atlas's cells into tiles, and of large tiles into chunks."""

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from atlas.spec.spec import Slices

Index = tuple[int, ...]

INNER_CHUNK = 64
"""Maximum side, in cells, of the chunks in which a larger tile is solved and read."""


def part_side(tile: int) -> int:
    """Return the side, in cells, of the chunks of a tile whose side is ``tile``.

    It is the largest divisor of that side from INNER_CHUNK / 2 to INNER_CHUNK. Without such a divisor the chunk is the
    tile.
    """
    return next((side for side in range(INNER_CHUNK, INNER_CHUNK // 2 - 1, -1) if tile % side == 0), tile)


@dataclass(frozen=True)
class Tile:
    """A block of cells that is solved and written as one.

    index   its index along each dimension
    slices  the cells that it covers
    """

    index: Index
    slices: Slices

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of cells along each dimension."""
        return tuple(part.stop - part.start for part in self.slices)

    @property
    def size(self) -> int:
        """Number of cells."""
        return math.prod(self.shape)


@dataclass(frozen=True)
class Tiling:
    """A block of cells of shape ``shape``, divided into tiles of shape ``tile``; the slowest dimension comes first.

    The last tiles along a dimension may have fewer cells.
    """

    shape: tuple[int, ...]
    tile: tuple[int, ...]

    @property
    def cells(self) -> int:
        """Number of cells."""
        return math.prod(self.shape)

    @property
    def grid(self) -> tuple[int, ...]:
        """Number of tiles along each dimension."""
        return tuple(-(-n // t) for n, t in zip(self.shape, self.tile, strict=True))

    @property
    def count(self) -> int:
        """Number of tiles."""
        return math.prod(self.grid)

    def tiles(self) -> Iterator[Tile]:
        """Yield all tiles of the block, the last dimension fastest."""
        for index in itertools.product(*map(range, self.grid)):
            yield self.at(index)

    def at(self, index: Index) -> Tile:
        """Return the tile with this index."""
        parts = zip(index, self.tile, self.shape, strict=True)
        return Tile(index, tuple(slice(i * t, min((i + 1) * t, n)) for i, t, n in parts))

    def sizes(self) -> NDArray[np.int64]:
        """Return the number of cells of every tile, as an array (grid) over the tiles."""
        along = (
            np.minimum(np.arange(1, count + 1) * tile, cells) - np.arange(count) * tile
            for count, tile, cells in zip(self.grid, self.tile, self.shape, strict=True)
        )
        return np.asarray(reduce(np.multiply.outer, along))


def chunk_places(keys: Iterable[str], folder: str, grid: Index) -> Iterator[int]:
    """Yield for each key, such as ``regime/c/3/14``, the position of its chunk in the flattened grid of chunks.

    The position is negative if the key belongs to no chunk of the ``folder``, here ``regime/c``: a killed write or
    another program may leave a key such as ``regime/c/03/14``.
    """
    columns, none = {str(i): i for i in range(grid[-1])}, -math.prod(grid)
    above = itertools.product(*map(range, grid[:-1]))
    rows = {"/".join([folder, *map(str, row)]): k * grid[-1] for k, row in enumerate(above)}
    for key in keys:
        row, _, column = key.rpartition("/")
        yield rows.get(row, none) + columns.get(column, none)


def chunk_mask(keys: Iterable[str], folder: str, grid: Index) -> NDArray[np.bool_]:
    """Return the mask (grid) of the chunks that exist in a folder, from the keys of its objects.

    Keys that belong to no chunk are ignored.
    """
    places = np.fromiter(chunk_places(keys, folder, grid), np.int64)
    mask = np.zeros(grid, dtype=bool)
    mask.flat[places[places >= 0]] = True
    return mask
