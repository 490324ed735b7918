"""The geometry of overviews: how many levels an atlas has, their shapes, and which chunk lies over which tile.

A cell of level L stands for a block of 2^L cells along each dimension (fewer at the far ends). Every level has chunks
of the same shape, a whole number of tiles, so that a chunk of level 1 lies over whole tiles and a chunk of any later
level over two chunks of the one before, along each dimension.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

from atlas.spec.spec import Slices

CHUNK = 256
"""Cells along each side of a chunk, about: a picture of a whole plane reads some tens of such chunks."""
LEAST = 128
"""A level is coarsened again while one of its sides is longer: nobody looks at a smaller picture."""

Index = tuple[int, ...]


@dataclass(frozen=True)
class Levels:
    """The levels over a grid of cells: ``shape`` of the grid, ``tile`` and ``chunk`` shapes, all slowest first."""

    shape: Index
    tile: Index

    @property
    def chunk(self) -> Index:
        """Cells of a level in one chunk; the last chunks may hold fewer."""
        return tuple(t * max(1, CHUNK // t) for t in self.tile)

    @property
    def count(self) -> int:
        """Levels above the cells themselves; 0 for a small atlas."""
        count = 0
        while max(self.shape_of(count)) > LEAST:
            count += 1
        return count

    def shape_of(self, level: int) -> Index:
        """Cells of a level; level 0 is the atlas itself."""
        return tuple(-(-n // 2**level) for n in self.shape)

    def grid(self, level: int) -> Index:
        """Chunks of a level along each dimension."""
        return tuple(-(-n // c) for n, c in zip(self.shape_of(level), self.chunk, strict=True))

    def chunks(self, level: int) -> Iterator[Index]:
        """Indices of all chunks of a level."""
        return itertools.product(*(range(n) for n in self.grid(level)))

    def block(self, level: int, index: Index) -> Slices:
        """The cells of its level that a chunk holds."""
        shape = self.shape_of(level)
        return tuple(slice(i * c, min((i + 1) * c, n)) for i, c, n in zip(index, self.chunk, shape, strict=True))

    def over(self, tile: Index) -> Index:
        """The chunk of level 1 that lies over a tile."""
        return tuple(i * t // (2 * c) for i, t, c in zip(tile, self.tile, self.chunk, strict=True))

    def children(self, level: int, index: Index) -> Iterator[Index]:
        """What a chunk is made of: chunks of the level before, or tiles where that is level 0."""
        grid, step = (self.grid(level - 1), (2,) * len(index)) if level > 1 else (self._tiles(), self._tiles_below())
        spans = (range(i * s, min((i + 1) * s, n)) for i, s, n in zip(index, step, grid, strict=True))
        return itertools.product(*spans)

    def finer(self, level: int, part: Slices) -> Slices:
        """The cells of the level before that make up a part of a level."""
        return tuple(
            slice(2 * s.start, min(2 * s.stop, n)) for s, n in zip(part, self.shape_of(level - 1), strict=True)
        )

    def cells(self) -> int:
        """Cells of all levels together."""
        return sum(math.prod(self.shape_of(level)) for level in range(1, self.count + 1))

    def _tiles(self) -> Index:
        return tuple(-(-n // t) for n, t in zip(self.shape, self.tile, strict=True))

    def _tiles_below(self) -> Index:
        return tuple(2 * c // t for c, t in zip(self.chunk, self.tile, strict=True))
