"""A plane cut into tiles."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from atlas.spec.spec import Slices

Index = tuple[int, ...]

PART = 64
"""Cells along each side of what is solved, and read, at once of a larger tile."""


def part_side(tile: int) -> int:
    """The side of the parts that a side of a tile is stored in: its largest divisor from PART / 2 to PART, or all."""
    return next((side for side in range(PART, PART // 2 - 1, -1) if tile % side == 0), tile)


@dataclass(frozen=True)
class Tile:
    """A block of cells: its index along each dimension, and the cells it covers."""

    index: Index
    slices: Slices

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along each dimension."""
        return tuple(part.stop - part.start for part in self.slices)

    @property
    def size(self) -> int:
        """Cells in all."""
        return math.prod(self.shape)


@dataclass(frozen=True)
class Tiling:
    """Cells of a ``shape`` in tiles of another, ``tile``, slowest dimension first; the last tiles may hold fewer."""

    shape: tuple[int, ...]
    tile: tuple[int, ...]

    @property
    def cells(self) -> int:
        """Cells in all."""
        return math.prod(self.shape)

    @property
    def grid(self) -> tuple[int, ...]:
        """Tiles along each dimension."""
        return tuple(-(-n // t) for n, t in zip(self.shape, self.tile, strict=True))

    @property
    def count(self) -> int:
        """Tiles in all."""
        return math.prod(self.grid)

    def tiles(self) -> Iterator[Tile]:
        """All tiles, row by row."""
        for index in itertools.product(*map(range, self.grid)):
            yield self.at(index)

    def at(self, index: Index) -> Tile:
        """The tile of that index."""
        parts = zip(index, self.tile, self.shape, strict=True)
        return Tile(index, tuple(slice(i * t, min((i + 1) * t, n)) for i, t, n in parts))

    def sizes(self) -> NDArray[np.int64]:
        """Cells of every tile, as an array over the tiles."""
        along = (
            np.minimum(np.arange(1, count + 1) * tile, cells) - np.arange(count) * tile
            for count, tile, cells in zip(self.grid, self.tile, self.shape, strict=True)
        )
        return np.asarray(reduce(np.multiply.outer, along))


def chunk_index(name: str, grid: tuple[int, ...]) -> Index | None:
    """The index that a chunk's name, ``3/14``, stands for; None for one that a grid does not have, such as ``03/14``.

    Such names are what a killed write left behind, or nothing of ours.
    """
    parts = name.split("/")
    if len(parts) != len(grid) or not all(part.isascii() and part.isdigit() for part in parts):
        return None
    index = tuple(map(int, parts))
    canonical = list(map(str, index)) == parts
    return index if canonical and all(i < n for i, n in zip(index, grid, strict=True)) else None
