"""The division of a block of cells into tiles, and of large tiles into chunks."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from atlas.spec.spec import Slices

Index = tuple[int, ...]

INNER_CHUNK = 64
"""Maximum side, in cells, of the chunks in which a larger tile is solved and read."""


def part_side(tile: int) -> int:
    """Return the side of a tile's chunks: the largest divisor of its side from INNER_CHUNK / 2 to INNER_CHUNK.

    Without such a divisor the chunk is the tile.
    """
    return next((side for side in range(INNER_CHUNK, INNER_CHUNK // 2 - 1, -1) if tile % side == 0), tile)


@dataclass(frozen=True)
class Tile:
    """A block of cells that is solved and written as one: its index along each dimension, and the cells it covers."""

    index: Index
    slices: Slices

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along each dimension."""
        return tuple(part.stop - part.start for part in self.slices)

    @property
    def size(self) -> int:
        """Number of cells."""
        return math.prod(self.shape)


@dataclass(frozen=True)
class Tiling:
    """A block of cells of shape ``shape``, divided into tiles of shape ``tile``; the slowest dimension comes first.

    The last tiles may have fewer cells.
    """

    shape: tuple[int, ...]
    tile: tuple[int, ...]

    @property
    def cells(self) -> int:
        """Number of cells."""
        return math.prod(self.shape)

    @property
    def grid(self) -> tuple[int, ...]:
        """Tiles along each dimension."""
        return tuple(-(-n // t) for n, t in zip(self.shape, self.tile, strict=True))

    @property
    def count(self) -> int:
        """Number of tiles."""
        return math.prod(self.grid)

    def tiles(self) -> Iterator[Tile]:
        """Yield all tiles, row by row."""
        for index in itertools.product(*map(range, self.grid)):
            yield self.at(index)

    def at(self, index: Index) -> Tile:
        """Return the tile with this index."""
        parts = zip(index, self.tile, self.shape, strict=True)
        return Tile(index, tuple(slice(i * t, min((i + 1) * t, n)) for i, t, n in parts))

    def sizes(self) -> NDArray[np.int64]:
        """Return the number of cells of every tile, as an array over the tiles."""
        along = (
            np.minimum(np.arange(1, count + 1) * tile, cells) - np.arange(count) * tile
            for count, tile, cells in zip(self.grid, self.tile, self.shape, strict=True)
        )
        return np.asarray(reduce(np.multiply.outer, along))


def chunk_index(name: str, grid: tuple[int, ...]) -> Index | None:
    """Return the index in the name of a chunk, such as ``3/14``; None for a name that no chunk has, such as ``03/14``.

    A killed write or another program may leave such names.
    """
    parts = name.split("/")
    if len(parts) != len(grid) or not all(part.isascii() and part.isdigit() for part in parts):
        return None
    index = tuple(map(int, parts))
    canonical = list(map(str, index)) == parts
    return index if canonical and all(i < n for i, n in zip(index, grid, strict=True)) else None
