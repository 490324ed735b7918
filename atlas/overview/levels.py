"""The geometry of overviews, coarser copies of an atlas: the levels, their shapes, and which chunk covers which tiles.

A cell of level L stands for a block of 2^L cells along each dimension, fewer at the far ends. Leading dimensions are
not coarsened: the planes of a stack, the rows of a table. All levels have chunks of the same shape. Along each
dimension a chunk of level 1 covers whole tiles, and a chunk of a later level covers two chunks of the level before.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

from atlas.spec.spec import Slices

SIDE = 256
"""Approximate side of a chunk of an overview, in cells; a picture of a whole plane reads a few tens of such chunks."""
MIN_SIDE = 128
"""Maximum side, in cells, of a level that is not coarsened again. Smaller pictures would be of no use."""

Index = tuple[int, ...]


@dataclass(frozen=True)
class OverviewLevels:
    """The shapes of all levels of overviews over the cells of an atlas.

    shape           cells of the atlas along each dimension, slowest first
    tile            cells of a tile along each dimension
    chunk_side      approximate side of a chunk, in cells; a chunk has a whole number of tiles
    min_side        a level is not coarsened again if no side exceeds this number of cells
    n_uncoarsened   number of leading dimensions that no level coarsens
    """

    shape: Index
    tile: Index
    chunk_side: int = SIDE
    min_side: int = MIN_SIDE
    n_uncoarsened: int = 0

    @property
    def chunk(self) -> Index:
        """Number of cells of an overview level in a chunk along each dimension; the last chunks may have fewer."""
        return tuple(t if dim < self.n_uncoarsened else self._chunk_side(t) for dim, t in enumerate(self.tile))

    def _chunk_side(self, tile: int) -> int:
        if tile > self.chunk_side and tile % 2 == 0:
            return tile // 2  # a chunk of level 1 covers one such tile
        return tile * max(1, self.chunk_side // tile)

    @property
    def coarsened(self) -> tuple[int, ...]:
        """Indices of the dimensions along which each overview level has half as many cells as the level before."""
        return tuple(range(self.n_uncoarsened, len(self.shape)))

    def halvings(self, level: int) -> tuple[int, ...]:
        """Return, for each dimension, how often the number of cells has been halved in an overview level."""
        return tuple(0 if dim < self.n_uncoarsened else level for dim in range(len(self.shape)))

    @property
    def count(self) -> int:
        """Number of overview levels above the cells themselves; 0 for a small atlas."""
        count = 0
        while max(self.shape_of(count)[self.n_uncoarsened :], default=0) > self.min_side:
            count += 1
        return count

    def shape_of(self, level: int) -> Index:
        """Return the number of cells of an overview level along each dimension; level 0 is the atlas itself."""
        return tuple(-(-n // 2**times) for n, times in zip(self.shape, self.halvings(level), strict=True))

    def grid(self, level: int) -> Index:
        """Return the number of chunks of an overview level along each dimension."""
        return tuple(-(-n // c) for n, c in zip(self.shape_of(level), self.chunk, strict=True))

    def chunks(self, level: int) -> Iterator[Index]:
        """Yield the indices of all chunks of an overview level."""
        return itertools.product(*(range(n) for n in self.grid(level)))

    def block(self, level: int, index: Index) -> Slices:
        """Return the slices of cells of an overview level that one of its chunks contains."""
        shape = self.shape_of(level)
        return tuple(slice(i * c, min((i + 1) * c, n)) for i, c, n in zip(index, self.chunk, shape, strict=True))

    def chunk_over(self, tile: Index) -> Index:
        """Return the index of the chunk of the first overview level that covers a tile."""
        ends = zip(tile, self.tile, self.chunk, self.halvings(1), strict=True)
        return tuple(i * t // (c << times) for i, t, c, times in ends)

    def is_alone_under_chunk(self, tile: Index) -> bool:
        """Return True if the chunk of the first overview level over a tile covers no other tile."""
        return bool(self.count) and list(self.children(1, self.chunk_over(tile))) == [tile]

    def parent_chunk(self, index: Index) -> Index:
        """Return the index of the chunk, in the next coarser overview level, that covers a chunk of a level."""
        return tuple(i >> times for i, times in zip(index, self.halvings(1), strict=True))

    def children(self, level: int, index: Index) -> Iterator[Index]:
        """Yield the indices of what a chunk of an overview level is computed from.

        They are tiles for level 1, and chunks of the next finer level for other levels.
        """
        if level == 1:
            return itertools.product(*(range(s.start, s.stop) for s in self.tiles_below(1, self.block(1, index))))
        ends = zip(index, self.grid(level - 1), self.halvings(1), strict=True)
        return itertools.product(*(range(i << times, min(i + 1 << times, n)) for i, n, times in ends))

    def finer(self, level: int, part: Slices) -> Slices:
        """Return the slices of cells of the next finer level that a block ``part`` of an overview level covers."""
        ends = zip(part, self.shape_of(level - 1), self.halvings(1), strict=True)
        return tuple(slice(s.start << times, min(s.stop << times, n)) for s, n, times in ends)

    def tiles_below(self, level: int, part: Slices) -> Slices:
        """Return the slices of the tiles of which a block ``part`` of an overview level covers at least one cell."""
        ends = zip(part, self.tile, self.shape, self.halvings(level), strict=True)
        return tuple(slice((s.start << k) // t, -(-min(s.stop << k, n) // t)) for s, t, n, k in ends)

    def tiles_within(self, level: int, part: Slices) -> Slices:
        """Return the slices, which may be empty, of the tiles that a block ``part`` of an overview level covers
        entirely.
        """
        ends = zip(part, self.tile, self.shape, self.halvings(level), strict=True)
        return tuple(
            slice(-(-(s.start << k) // t), -(-n // t) if s.stop << k >= n else (s.stop << k) // t)
            for s, t, n, k in ends
        )

    def cells_of(self, tiles: Slices) -> Slices:
        """Return the slices of the atlas's cells in the given slices of tiles."""
        return tuple(
            slice(s.start * t, min(s.stop * t, n)) for s, t, n in zip(tiles, self.tile, self.shape, strict=True)
        )
