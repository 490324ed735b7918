"""What is in view: at which levels, in which tiles, and in which order they are wanted. Nothing here is computed."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from atlas.explore.lattice import Lattice

TILE_CELLS = 32
"""Cells of a tile along each axis."""
STAGES = 3
"""Coarser levels that come first: an eighth, a quarter, a half of the full density."""
MAX_TILES = 4096
"""Tiles of a level that are looked at at once, more than any screen takes."""


@dataclass(frozen=True)
class CellRange:
    """Neighbouring cells of a level along one axis: the number of the first, which may be negative, and how many."""

    level: int
    first: int
    count: int

    @classmethod
    def from_window(cls, lattice: Lattice, low: float, high: float, pixels: int) -> "CellRange":
        """The cells in a window on this many pixels, at the deepest level whose cells are not finer than pixels."""
        level = lattice.level(low, high, pixels)
        first = lattice.nearest(level, low)
        return cls(level, first, lattice.nearest(level, high) - first + 1)

    @property
    def last(self) -> int:
        """The number of the last."""
        return self.first + self.count - 1

    @property
    def index(self) -> NDArray[np.int64]:
        """The cells' numbers."""
        return np.arange(self.first, self.first + self.count, dtype=np.int64)

    def tiles(self, stage: int) -> range:
        """The numbers of the tiles that it lies in, ``stage`` times halved in density."""
        half = (1 << stage) // 2
        first, last = (((end + half) >> stage) // TILE_CELLS for end in (self.first, self.last))
        return range(first, last + 1)

    def slice_of(self, other: "CellRange") -> slice:
        """Which of its cells another one covers, of its level or a coarser one; perhaps none."""
        step = 1 << (self.level - other.level)
        begin, end = (step * number - step // 2 - self.first for number in (other.first, other.first + other.count))
        return slice(max(begin, 0), max(0, min(end, self.count)))

    def position_of(self, level: int, index: NDArray[np.int64]) -> NDArray[np.int64]:
        """The place, from 0 on, of its cell that contains a cell of a level as fine or finer."""
        shift = level - self.level
        return np.asarray(((index + (1 << shift) // 2) >> shift) - self.first)

    def away(self, other: "CellRange") -> float:
        """How far the middle of another one, of its level or a coarser one, lies from its own, in its own lengths."""
        middle = (other.first + 0.5 * other.count) * (1 << (self.level - other.level))
        return (middle - 0.5 * (self.first + self.last)) / self.count


class TileKey(NamedTuple):
    """A tile of a level: the level and the tile's number along x and along y. Numbers may be negative."""

    level_x: int
    level_y: int
    x: int
    y: int

    @property
    def parent(self) -> "TileKey":
        """The tile of the next coarser level that has every fourth cell of this one."""
        return TileKey(self.level_x - 1, self.level_y - 1, self.x // 2, self.y // 2)

    @property
    def quarter(self) -> tuple[slice, slice]:
        """Where in ``above`` these cells lie, (y, x)."""
        half = TILE_CELLS // 2
        return tuple(slice(half * (n % 2), half * (n % 2) + half) for n in (self.y, self.x))  # type: ignore[return-value]

    @property
    def of_atlas(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Which rows and columns of the atlas itself its cells are, for a tile that is not finer than it."""
        return self.rows.index << -self.level_y, self.columns.index << -self.level_x

    @property
    def columns(self) -> CellRange:
        """The cells along x."""
        return CellRange(self.level_x, self.x * TILE_CELLS, TILE_CELLS)

    @property
    def rows(self) -> CellRange:
        """The cells along y."""
        return CellRange(self.level_y, self.y * TILE_CELLS, TILE_CELLS)


class Viewport(NamedTuple):
    """The cells in view along both axes, at the levels of the full density."""

    x: CellRange
    y: CellRange

    @property
    def shape(self) -> tuple[int, int]:
        """How many they are, (y, x)."""
        return self.y.count, self.x.count

    def tiles(self, stage: int) -> list[TileKey]:
        """The tiles in view, ``stage`` times halved in density, from the centre out.

        The distance from the centre is measured in views, so that a wide view does not begin with a column.
        """
        levels = self.x.level - stage, self.y.level - stage
        keys = [TileKey(*levels, x, y) for y in self.y.tiles(stage) for x in self.x.tiles(stage)]
        return sorted(keys, key=lambda key: self.x.away(key.columns) ** 2 + self.y.away(key.rows) ** 2)[:MAX_TILES]

    def stage(self, key: TileKey) -> int:
        """How often halved in density a tile is, by the axis along which it is coarser."""
        return max(self.x.level - key.level_x, self.y.level - key.level_y)

    def contains(self, key: TileKey) -> bool:
        """Whether a tile is of this density or a coarser one, and has a cell in view."""
        if key.level_x > self.x.level or key.level_y > self.y.level:
            return False
        return all(part.start < part.stop for part in self.slices_of(key))

    def slices_of(self, key: TileKey) -> tuple[slice, slice]:
        """Rows and columns of the view that a tile of this density or a coarser one covers, perhaps none."""
        return self.y.slice_of(key.rows), self.x.slice_of(key.columns)
