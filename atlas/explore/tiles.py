"""The tiles that are in memory: those seen last, up to so many bytes."""

import threading
from collections import OrderedDict
from mmap import mmap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.explore.subject import Plane
from atlas.explore.view import Sight, TileKey

MOST_BYTES = 384 * 2**20
ALIGNMENT = 64
"""Bytes at whose multiples an array begins."""

Arrays = dict[str, NDArray[Any]]


class Tiles:
    """Arrays (TILE, TILE, ...) by plane, tile and name. A tile may have been read with some of its variables only."""

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self._most, self._bytes, self._lock = most_bytes, 0, threading.Lock()
        self._tiles: OrderedDict[tuple[Plane, TileKey], Arrays] = OrderedDict()

    @property
    def bytes(self) -> int:
        """Bytes of all arrays."""
        return self._bytes

    def put(self, plane: Plane, key: TileKey, arrays: Arrays) -> Arrays:
        """Keep copies of a tile's arrays, beside those that it has, and return all that it now has.

        The tiles not seen for longest go where there is no room.
        """
        with self._lock:
            known = self._tiles.pop((plane, key), {})
            self._bytes -= _size(known)
            self._tiles[plane, key] = made = _packed(known | arrays)
            self._bytes += _size(made)
            while self._bytes > self._most and len(self._tiles) > 1:
                _, dropped = self._tiles.popitem(last=False)
                self._bytes -= _size(dropped)
            return made

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
        found = [
            (key, arrays)
            for key, arrays in self.of(plane)
            if key.level_x <= sight.level_x and key.level_y <= sight.level_y and sight.shows(key)
        ]
        return sorted(found, key=lambda pair: (pair[0].level_x + pair[0].level_y, min(pair[0][:2])))


def _packed(arrays: Arrays) -> Arrays:
    """The arrays in a mapping of their own: on the heap, what stays among much that comes and goes leaves gaps."""
    sizes = [-(-array.nbytes // ALIGNMENT) * ALIGNMENT for array in arrays.values()]
    starts = np.cumsum([0, *sizes]).tolist()
    made: Arrays = {}
    block = np.frombuffer(mmap(-1, max(1, starts[-1])), dtype=np.uint8)
    for (name, array), start in zip(arrays.items(), starts[:-1], strict=True):
        made[name] = block[start : start + array.nbytes].view(array.dtype).reshape(array.shape)
        made[name][...] = array
    return made


def _size(arrays: Arrays) -> int:
    return sum(array.nbytes for array in arrays.values())
