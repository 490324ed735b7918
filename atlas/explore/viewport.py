"""The viewport of a page: the visible cells, their zoom levels, and the tiles that contain them.

A tile is a square of TILE_CELLS x TILE_CELLS cells that is requested and solved as a whole.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from atlas.explore.lattice import Lattice

TILE_CELLS = 32
"""Number of cells of a tile along each axis."""
STAGES = 3
"""Number of coarser levels that are solved first, at an eighth, a quarter and a half of the full density of cells."""
MAX_TILES = 4096
"""Maximum number of tiles of a level in a viewport, more than any screen shows."""


@dataclass(frozen=True)
class CellRange:
    """A range of consecutive cells of one zoom level along one axis.

    level   the level; each level halves the width of cells, and level 0 has the cells of the atlas
    first   index of the first cell; may be negative
    count   number of cells
    """

    level: int
    first: int
    count: int

    @classmethod
    def from_window(cls, lattice: Lattice, low: float, high: float, pixels: int) -> "CellRange":
        """Return the cells of a window along an axis, at the deepest zoom level whose cells are not finer than pixels.

        lattice     the points of the axis at all levels
        low, high   limits of the window
        pixels      width of the window, in pixels
        """
        level = lattice.level(low, high, pixels)
        first = lattice.nearest(level, low)
        return cls(level, first, lattice.nearest(level, high) - first + 1)

    @property
    def last(self) -> int:
        """The index of the last cell."""
        return self.first + self.count - 1

    @property
    def index(self) -> NDArray[np.int64]:
        """The indices of the cells."""
        return np.arange(self.first, self.first + self.count, dtype=np.int64)

    def tiles(self, stage: int) -> range:
        """Return the indices of the tiles that contain the cells, at a zoom level that is ``stage`` levels coarser."""
        half = (1 << stage) // 2
        first, last = (((end + half) >> stage) // TILE_CELLS for end in (self.first, self.last))
        return range(first, last + 1)

    def slice_of(self, other: "CellRange") -> slice:
        """Return the slice of this range's cells that the range ``other`` covers; may be empty.

        ``other`` is a range of the same zoom level or a coarser one.
        """
        step = 1 << (self.level - other.level)
        begin, end = (step * number - step // 2 - self.first for number in (other.first, other.first + other.count))
        return slice(max(begin, 0), max(0, min(end, self.count)))

    def position_of(self, level: int, index: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the positions in this range, counted from 0, of the cells that contain the cells ``index`` of a level.

        ``level`` is the zoom level of this range or a finer one.
        """
        shift = level - self.level
        return np.asarray(((index + (1 << shift) // 2) >> shift) - self.first)

    def away(self, other: "CellRange") -> float:
        """Return the distance from this range's middle to that of ``other``, in lengths of this range.

        ``other`` is a range of the same zoom level or a coarser one.
        """
        middle = (other.first + 0.5 * other.count) * (1 << (self.level - other.level))
        return (middle - 0.5 * (self.first + self.last)) / self.count


class TileKey(NamedTuple):
    """What identifies a tile: its zoom levels along x and y, and its indices along x and y, which may be negative."""

    level_x: int
    level_y: int
    x: int
    y: int

    @property
    def parent(self) -> "TileKey":
        """The key of the tile one zoom level coarser along both axes that contains every fourth cell of this tile."""
        return TileKey(self.level_x - 1, self.level_y - 1, self.x // 2, self.y // 2)

    @property
    def quarter(self) -> tuple[slice, slice]:
        """The slices (y, x) of the parent tile's cells that are also cells of this tile; a quarter of them."""
        half = TILE_CELLS // 2
        return tuple(slice(half * (n % 2), half * (n % 2) + half) for n in (self.y, self.x))  # type: ignore[return-value]

    @property
    def of_atlas(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The rows and columns of the atlas whose cells are those of the tile, for a tile not finer than the atlas."""
        return self.rows.index << -self.level_y, self.columns.index << -self.level_x

    @property
    def columns(self) -> CellRange:
        """The cells of the tile along x."""
        return CellRange(self.level_x, self.x * TILE_CELLS, TILE_CELLS)

    @property
    def rows(self) -> CellRange:
        """The cells of the tile along y."""
        return CellRange(self.level_y, self.y * TILE_CELLS, TILE_CELLS)


class Viewport(NamedTuple):
    """The ranges of visible cells along both axes, at the zoom levels of full density: about one cell per pixel."""

    x: CellRange
    y: CellRange

    @property
    def shape(self) -> tuple[int, int]:
        """Number of visible cells along y and along x."""
        return self.y.count, self.x.count

    def tiles(self, stage: int) -> list[TileKey]:
        """Return the keys of the visible tiles at zoom levels that are ``stage`` levels coarser, from the centre out.

        Distances from the centre are measured in lengths of the viewport, so that a wide viewport does not begin with a
        column.
        """
        levels = self.x.level - stage, self.y.level - stage
        keys = [TileKey(*levels, x, y) for y in self.y.tiles(stage) for x in self.x.tiles(stage)]
        return sorted(keys, key=lambda key: self.x.away(key.columns) ** 2 + self.y.away(key.rows) ** 2)[:MAX_TILES]

    def stage(self, key: TileKey) -> int:
        """Return by how many zoom levels a tile is coarser than the viewport, along the axis with more of them."""
        return max(self.x.level - key.level_x, self.y.level - key.level_y)

    def contains(self, key: TileKey) -> bool:
        """Return True if a tile contains a visible cell and is not finer than the viewport along either axis."""
        if key.level_x > self.x.level or key.level_y > self.y.level:
            return False
        return all(part.start < part.stop for part in self.slices_of(key))

    def slices_of(self, key: TileKey) -> tuple[slice, slice]:
        """Return the rows and columns of the viewport that a tile covers, as slices; may be empty.

        The tile must not be finer than the viewport.
        """
        return self.y.slice_of(key.rows), self.x.slice_of(key.columns)
