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

SIDE = 256
"""Cells along each side of a chunk, about: a picture of a whole plane reads some tens of such chunks."""
LEAST = 128
"""A level is coarsened again while one of its sides is longer: nobody looks at a smaller picture."""

Index = tuple[int, ...]


@dataclass(frozen=True)
class Levels:
    """The levels over a grid of cells.

    shape   cells of the grid along each dimension, slowest first
    tile    cells of a tile, likewise
    side    cells along each side of a chunk, about: a whole number of tiles
    least   the length of a side from which on it is not coarsened again
    """

    shape: Index
    tile: Index
    side: int = SIDE
    least: int = LEAST

    @property
    def chunk(self) -> Index:
        """Cells of a level in one chunk; the last chunks may hold fewer."""
        return tuple(t * max(1, self.side // t) for t in self.tile)

    @property
    def count(self) -> int:
        """Levels above the cells themselves; 0 for a small atlas."""
        count = 0
        while max(self.shape_of(count)) > self.least:
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
        """The chunks of the level before that a chunk of a level from the second on is made of."""
        spans = (range(2 * i, min(2 * i + 2, n)) for i, n in zip(index, self.grid(level - 1), strict=True))
        return itertools.product(*spans)

    def finer(self, level: int, part: Slices) -> Slices:
        """The cells of the level before that make up a part of a level."""
        return tuple(
            slice(2 * s.start, min(2 * s.stop, n)) for s, n in zip(part, self.shape_of(level - 1), strict=True)
        )

    def tiles_below(self, level: int, part: Slices) -> Slices:
        """The tiles that have cells below a part of a level."""
        ends = zip(part, self.tile, self.shape, strict=True)
        return tuple(slice((s.start << level) // t, -(-min(s.stop << level, n) // t)) for s, t, n in ends)

    def tiles_within(self, level: int, part: Slices) -> Slices:
        """The tiles that have all their cells below a part of a level; where there are none, slices without a tile."""
        ends = zip(part, self.tile, self.shape, strict=True)
        return tuple(
            slice(-(-(s.start << level) // t), -(-n // t) if s.stop << level >= n else (s.stop << level) // t)
            for s, t, n in ends
        )

    def cells_of(self, tiles: Slices) -> Slices:
        """The cells of the grid that tiles hold."""
        return tuple(
            slice(s.start * t, min(s.stop * t, n)) for s, t, n in zip(tiles, self.tile, self.shape, strict=True)
        )

    def cell_count(self) -> int:
        """Cells of all levels together."""
        return sum(math.prod(self.shape_of(level)) for level in range(1, self.count + 1))
