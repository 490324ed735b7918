"""The tiles that are in memory: those seen last, up to so many bytes."""

import threading
from collections import OrderedDict
from typing import Any

from numpy.typing import NDArray

from atlas.explore.subject import Plane
from atlas.explore.view import Sight, TileKey

MOST_BYTES = 384 * 2**20

Arrays = dict[str, NDArray[Any]]


class Tiles:
    """Arrays (TILE, TILE, ...) by plane, tile and name. A tile may have been read with some of its variables only."""

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self._most, self._bytes, self._lock = most_bytes, 0, threading.Lock()
        self._tiles: OrderedDict[tuple[Plane, TileKey], Arrays] = OrderedDict()
        self._only_here: set[tuple[Plane, TileKey]] = set()

    @property
    def bytes(self) -> int:
        """Bytes of all arrays."""
        return self._bytes

    def put(self, plane: Plane, key: TileKey, arrays: Arrays, only_here: bool = False) -> None:
        """Keep arrays of a tile, beside those that it has.

        The tiles not seen for longest go where there is no room; those that are ``only_here`` after all others.
        """
        with self._lock:
            if only_here:
                self._only_here.add((plane, key))
            known = self._tiles.pop((plane, key), {})
            self._bytes -= _size(known)
            self._tiles[plane, key] = made = known | arrays
            self._bytes += _size(made)
            while self._bytes > self._most and len(self._tiles) > 1:
                others = (each for each in self._tiles if each not in self._only_here and each != (plane, key))
                at = next(others, next(iter(self._tiles)))
                self._only_here.discard(at)
                self._bytes -= _size(self._tiles.pop(at))

    def get(self, plane: Plane, key: TileKey) -> Arrays | None:
        """The arrays of a tile, which now counts as seen; None where it is not in memory."""
        with self._lock:
            if (plane, key) not in self._tiles:
                return None
            self._tiles.move_to_end((plane, key))
            return self._tiles[plane, key]

    def has(self, plane: Plane, key: TileKey, names: set[str]) -> bool:
        """Whether a tile is in memory with these variables."""
        with self._lock:
            return names <= self._tiles.get((plane, key), {}).keys()

    def of(self, plane: Plane) -> list[tuple[TileKey, Arrays]]:
        """The tiles of a plane."""
        with self._lock:
            return [(key, arrays) for (mine, key), arrays in self._tiles.items() if mine == plane]

    def shown(self, plane: Plane, sight: Sight) -> list[tuple[TileKey, Arrays]]:
        """The tiles of a plane in view that are as dense as the view or less, coarse ones first."""
        found = [(key, arrays) for key, arrays in self.of(plane) if sight.shows(key)]
        return sorted(found, key=lambda pair: (pair[0].level_x + pair[0].level_y, min(pair[0][:2])))


def _size(arrays: Arrays) -> int:
    return sum(array.nbytes for array in arrays.values())
