"""The tiles that are in memory: those seen last, of all that a server explores together up to so many bytes."""

import threading
from collections import OrderedDict
from typing import Any

from numpy.typing import NDArray

from atlas.explore.subject import SubjectPlane
from atlas.explore.view import Sight, TileKey

MOST_BYTES = 384 * 2**20

Arrays = dict[str, NDArray[Any]]


class Memory:
    """The tiles of several subjects: the least recently used go where there is no room.

    At each tile lie its arrays, and whether they are nowhere else.
    """

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self.most, self.bytes, self.lock = most_bytes, 0, threading.Lock()
        self.tiles: OrderedDict[tuple[Tiles, SubjectPlane, TileKey], tuple[Arrays, bool]] = OrderedDict()


class Tiles:
    """Arrays (TILE, TILE, ...) of a subject by plane, tile and name, in a memory that others may share.

    A tile may have been read with some of its variables only.
    """

    def __init__(self, memory: Memory | None = None) -> None:
        self.memory = memory or Memory()

    def put(self, plane: SubjectPlane, key: TileKey, arrays: Arrays, only_here: bool = False) -> None:
        """Keep arrays of a tile, beside those that it has.

        The tiles not seen for longest go where there is no room; those that are ``only_here`` after all others.
        """
        at, memory = (self, plane, key), self.memory
        with memory.lock:
            known, before = memory.tiles.pop(at, ({}, False))
            memory.tiles[at] = made, _ = known | arrays, only_here or before
            memory.bytes += _size(made) - _size(known)
            while memory.bytes > memory.most and len(memory.tiles) > 1:
                others = (each for each, (_, alone) in memory.tiles.items() if not alone and each != at)
                memory.bytes -= _size(memory.tiles.pop(next(others, next(iter(memory.tiles))))[0])

    def get(self, plane: SubjectPlane, key: TileKey) -> Arrays | None:
        """The arrays of a tile, which now counts as seen; None where it is not in memory."""
        at, memory = (self, plane, key), self.memory
        with memory.lock:
            if at not in memory.tiles:
                return None
            memory.tiles.move_to_end(at)
            return memory.tiles[at][0]

    def has(self, plane: SubjectPlane, key: TileKey, names: set[str]) -> bool:
        """Whether a tile is in memory with these variables."""
        with self.memory.lock:
            return names <= self.memory.tiles.get((self, plane, key), ({}, False))[0].keys()

    def of(self, plane: SubjectPlane) -> list[tuple[TileKey, Arrays]]:
        """The tiles of a plane."""
        with self.memory.lock:
            found = self.memory.tiles.items()
            return [(key, arrays) for (whose, mine, key), (arrays, _) in found if whose is self and mine == plane]

    def clear(self) -> None:
        """Forget all."""
        memory = self.memory
        with memory.lock:
            for at in [each for each in memory.tiles if each[0] is self]:
                memory.bytes -= _size(memory.tiles.pop(at)[0])

    def shown(self, plane: SubjectPlane, sight: Sight) -> list[tuple[TileKey, Arrays]]:
        """The tiles of a plane in view that are as dense as the view or less, coarse ones first."""
        found = [(key, arrays) for key, arrays in self.of(plane) if sight.shows(key)]
        return sorted(found, key=lambda pair: (pair[0].level_x + pair[0].level_y, min(pair[0][:2])))


def _size(arrays: Arrays) -> int:
    return sum(array.nbytes for array in arrays.values())
