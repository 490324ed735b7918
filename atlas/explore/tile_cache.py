"""The known cells of a subject, tile by tile: solved tiles in memory, and cells of the atlas."""

import threading
import time
from collections import OrderedDict
from contextlib import suppress
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from atlas.errors import RunError
from atlas.explore.compose import atlas_cells, atlas_covers
from atlas.explore.subject import Arrays, PlaneParameters, Subject
from atlas.explore.viewport import TILE_CELLS, TileKey, Viewport
from atlas.store.store import done_tiles
from workers.results import INVALID, OUT_OF_RANGE, PENDING, REASON, REGIME

MAX_BYTES = 384 * 2**20
"""Maximum size, in bytes, of all tiles in memory together."""
RELIST_SECONDS = 5.0
"""Time, in seconds, after which the finished tiles of the atlas are listed anew, since a run may have written some."""
MAX_REMEMBERED_ROWS = 4096
"""Maximum number of rows and columns of tiles for which it is cached whether one of their cells is in range."""


class MemoryTileCache:
    """The most recently viewed tiles of several owners, up to a total size; other tiles are evicted.

    ``owner`` is the object whose tiles they are, ``plane`` the fixed parameters, and ``key`` the zoom level and index
    of a tile.
    """

    def __init__(self, most_bytes: int = MAX_BYTES) -> None:
        self.most, self.bytes, self._lock = most_bytes, 0, threading.Lock()
        self._tiles: OrderedDict[tuple[object, PlaneParameters, TileKey], Arrays] = OrderedDict()

    def put(self, owner: object, plane: PlaneParameters, key: TileKey, arrays: Arrays) -> None:
        """Add a tile's result arrays, and evict the least recently viewed tiles if there is no room."""
        at = owner, plane, key
        with self._lock:
            self.bytes += _size(arrays) - _size(self._tiles.pop(at, {}))
            self._tiles[at] = arrays
            while self.bytes > self.most and len(self._tiles) > 1:
                self.bytes -= _size(self._tiles.popitem(last=False)[1])

    def get(self, owner: object, plane: PlaneParameters, key: TileKey) -> Arrays | None:
        """Return the result arrays of a tile and mark it as viewed; None if the tile is not in memory."""
        at = owner, plane, key
        with self._lock:
            if at not in self._tiles:
                return None
            self._tiles.move_to_end(at)
            return self._tiles[at]

    def tiles_of_plane(self, owner: object, plane: PlaneParameters) -> list[tuple[TileKey, Arrays]]:
        """Return the tiles in memory that an owner has of a plane, as pairs of a key and arrays."""
        with self._lock:
            tiles = self._tiles.items()
            return [(key, arrays) for (who, of, key), arrays in tiles if who is owner and of == plane]

    def drop(self, owner: object) -> None:
        """Remove the tiles of an owner."""
        with self._lock:
            for at in [key for key in self._tiles if key[0] is owner]:
                self.bytes -= _size(self._tiles.pop(at))


class TileCache:
    """The known tiles of a subject, as result arrays (TILE_CELLS, TILE_CELLS, ...) by name.

    subject   the subject, that is, the plane that is explored
    memory    the cache in memory, which other subjects may share
    """

    def __init__(self, subject: Subject, memory: MemoryTileCache | None = None) -> None:
        self.subject, self.memory = subject, memory or MemoryTileCache()
        self._invalid = subject.without_results(subject.variables, (TILE_CELLS, TILE_CELLS))
        self._invalid[REGIME.name][...], self._invalid[REASON.name][...] = INVALID, OUT_OF_RANGE
        self._admits = lru_cache(MAX_REMEMBERED_ROWS)(
            lambda along, level, number: bool(subject.valid_mask(along, level, number, 1).any())
        )
        self._done: NDArray[np.bool_] | None = None
        self._listed_at, self._complete = float("-inf"), False

    def has(self, plane: PlaneParameters, key: TileKey) -> bool:
        """Return True if a tile need not be solved: it is known, or outside the valid ranges of the axes."""
        known = self.full_tile(plane, key) is not None
        return known or atlas_covers(self.subject, self.atlas_done(), plane, key)

    def put(self, plane: PlaneParameters, key: TileKey, arrays: Arrays) -> None:
        """Put a solved tile, with all variables, into memory."""
        self.memory.put(self, plane, key, arrays)

    def drop(self) -> None:
        """Remove all tiles of this subject from memory."""
        self.memory.drop(self)

    def tiles_of_plane(self, plane: PlaneParameters) -> list[tuple[TileKey, Arrays]]:
        """Return the tiles of a plane that are in memory, as pairs of a key and arrays."""
        return self.memory.tiles_of_plane(self, plane)

    def visible_tiles(self, plane: PlaneParameters, viewport: Viewport) -> list[tuple[TileKey, Arrays]]:
        """Return the known tiles that are visible and not denser than the viewport, and mark them as viewed.

        The coarsest tiles come first. Tiles outside the valid ranges of the axes come last; all their cells are
        invalid.
        """
        tiles = [(key, arrays) for key, arrays in self.tiles_of_plane(plane) if viewport.contains(key)]
        tiles.sort(key=lambda pair: (pair[0].level_x + pair[0].level_y, min(pair[0][:2])))
        for key, _ in tiles:
            self.memory.get(self, plane, key)
        return tiles + [(key, self._invalid) for key in viewport.tiles(0) if self.is_out_of_range(key)]

    def full_tile(self, plane: PlaneParameters, key: TileKey) -> Arrays | None:
        """Return the arrays of all variables of a tile; None if the tile is not known."""
        return self._invalid if self.is_out_of_range(key) else self.memory.get(self, plane, key)

    def parent(self, plane: PlaneParameters, key: TileKey) -> Arrays | None:
        """Return the arrays of every fourth cell of a tile, which are also cells of its coarser parent tile.

        They are taken from the parent tile, or from the atlas if it has the settings of explored cells. Return None if
        they are not known.
        """
        above = key.parent
        parent_tile = self.full_tile(plane, above)
        if parent_tile is not None:
            return {name: array[key.quarter] for name, array in parent_tile.items()}
        subject, names = self.subject, self.subject.variables.keys()
        if subject.ds is None or not subject.has_same_settings:
            return None
        if not atlas_covers(subject, self.atlas_done(), plane, above):
            return None
        rows, columns = (cells[part] for cells, part in zip(above.of_atlas, key.quarter, strict=True))
        with suppress(OSError, RunError):
            return atlas_cells(subject, names, rows, columns)
        return None

    def is_out_of_range(self, key: TileKey) -> bool:
        """Return True if no cell of a tile lies in the valid ranges of the axes, so that there is nothing to solve."""
        return not (self._admits(0, key.level_x, key.x) and self._admits(1, key.level_y, key.y))

    @property
    def listed_at(self) -> float:
        """Time, by ``time.monotonic``, at which the finished tiles of the atlas were last listed.

        It stays constant once all tiles are finished.
        """
        self.atlas_done()
        return self._listed_at

    def atlas_done(self) -> NDArray[np.bool_] | None:
        """Return the mask (y, x) of the solved cells of the atlas; None if there is no atlas.

        In an atlas of all attractors a cell counts as solved if it has the attractor that its own initial state
        reaches.
        """
        subject = self.subject
        if subject.ds is None or subject.store is None:
            return None
        if time.monotonic() - self._listed_at > RELIST_SECONDS and not self._complete:
            self._listed_at = time.monotonic()
            tiling = subject.store.tiling
            solved = np.zeros(tiling.shape, dtype=bool)
            for index in done_tiles(subject.store):
                solved[tiling.at(index).slices] = True
            solved = solved[subject.layer] if solved.ndim > 2 else solved
            self._complete = bool(solved.all())
            self._done = (
                solved if subject.all_attractors is None else solved & (subject.part({})[REGIME.name].values != PENDING)
            )
        return self._done


def _size(arrays: Arrays) -> int:
    return sum(array.nbytes for array in arrays.values())
