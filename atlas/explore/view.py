"""What is in view: at which levels, in which tiles, and in which order they are wanted. Nothing here is computed."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from atlas.explore.lattice import Lattice

TILE = 32
"""Cells of a tile along each axis."""
STAGES = 3
"""So many coarser levels come first: an eighth, a quarter, a half of the full density."""
MOST_TILES = 4096
"""Tiles of a level that are looked at at once, more than any screen takes."""


class TileKey(NamedTuple):
    """A tile of a level: the level and the tile's number along x and along y. Numbers may be negative."""

    level_x: int
    level_y: int
    x: int
    y: int

    @property
    def above(self) -> "TileKey":
        """The tile of the next coarser level that has every fourth cell of this one."""
        return TileKey(self.level_x - 1, self.level_y - 1, self.x // 2, self.y // 2)

    @property
    def quarter(self) -> tuple[slice, slice]:
        """Where in ``above`` these cells lie, (y, x)."""
        half = TILE // 2
        return tuple(slice(half * (n % 2), half * (n % 2) + half) for n in (self.y, self.x))  # type: ignore[return-value]

    def index_x(self) -> NDArray[np.int64]:
        """The cells' numbers along x."""
        return np.arange(self.x * TILE, (self.x + 1) * TILE, dtype=np.int64)

    def index_y(self) -> NDArray[np.int64]:
        """The cells' numbers along y."""
        return np.arange(self.y * TILE, (self.y + 1) * TILE, dtype=np.int64)


@dataclass(frozen=True)
class View:
    """A window of the plane, x and y from low to high, on so many pixels."""

    x: tuple[float, float]
    y: tuple[float, float]
    width: int
    height: int


@dataclass(frozen=True)
class Sight:
    """A view on two lattices: the levels of the full density, and the cells of that level in view, ends included."""

    level_x: int
    level_y: int
    first_x: int
    last_x: int
    first_y: int
    last_y: int

    @classmethod
    def of(cls, view: View, x: Lattice, y: Lattice) -> "Sight":
        """The cells of the deepest levels whose cells are not finer than pixels."""
        level_x, level_y = x.level(*view.x, view.width), y.level(*view.y, view.height)
        ends_x = [x.nearest(level_x, end) for end in view.x]
        ends_y = [y.nearest(level_y, end) for end in view.y]
        return cls(level_x, level_y, *ends_x, *ends_y)

    @property
    def index_x(self) -> NDArray[np.int64]:
        """The cells' numbers along x."""
        return np.arange(self.first_x, self.last_x + 1, dtype=np.int64)

    @property
    def index_y(self) -> NDArray[np.int64]:
        """The cells' numbers along y."""
        return np.arange(self.first_y, self.last_y + 1, dtype=np.int64)

    def tiles(self, stage: int) -> list[TileKey]:
        """The tiles in view, so many times halved in density, from the centre out.

        The distance from the centre is measured in views, so that a wide view does not begin with a column.
        """
        half = (1 << stage) // 2
        across = [(n + half) >> stage for n in (self.first_x, self.last_x)]
        up = [(n + half) >> stage for n in (self.first_y, self.last_y)]
        keys = [
            TileKey(self.level_x - stage, self.level_y - stage, tx, ty)
            for ty in range(up[0] // TILE, up[1] // TILE + 1)
            for tx in range(across[0] // TILE, across[1] // TILE + 1)
        ]
        return sorted(keys, key=lambda key: self._distance(key, stage))[:MOST_TILES]

    def shows(self, key: TileKey) -> bool:
        """Whether a tile, of this density or a coarser one, has a cell in view."""
        rows, columns = self.place(key)
        return rows.start < rows.stop and columns.start < columns.stop

    def place(self, key: TileKey) -> tuple[slice, slice]:
        """Rows and columns of the view that a tile of this density or a coarser one covers, perhaps none."""
        found = []
        for first, last, level, own, number in (
            (self.first_y, self.last_y, self.level_y, key.level_y, key.y),
            (self.first_x, self.last_x, self.level_x, key.level_x, key.x),
        ):
            step, half = 1 << (level - own), (1 << (level - own)) // 2
            begin, end = number * TILE * step - half, (number + 1) * TILE * step - half
            found.append(slice(max(begin - first, 0), max(0, min(end, last + 1) - first)))
        return found[0], found[1]

    def _distance(self, key: TileKey, stage: int) -> float:
        width, height = self.last_x - self.first_x + 1, self.last_y - self.first_y + 1
        step = float(1 << stage)
        x = (key.x + 0.5) * TILE * step - 0.5 * (self.first_x + self.last_x)
        y = (key.y + 0.5) * TILE * step - 0.5 * (self.first_y + self.last_y)
        return (x / width) ** 2 + (y / height) ** 2


def cells_of(tile: TileKey, level: int, index: NDArray[np.int64], along_x: bool) -> NDArray[np.int64]:
    """Which cell of a tile each cell of a level, as fine or finer, lies in, along one axis: 0 to TILE - 1."""
    own, number = (tile.level_x, tile.x) if along_x else (tile.level_y, tile.y)
    shift = level - own
    half = (1 << shift) // 2
    return np.asarray(((index + half) >> shift) - number * TILE)
