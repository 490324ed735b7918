"""The overviews of a store during a run: chunks over a lost tile are dropped, missing ones made at the end.

The store itself says which chunks are missing and can be made, so that a kill leaves nothing to be remembered.
"""

from collections.abc import Callable

import numpy as np

from atlas.errors import ChunkError, RunError
from atlas.overview.levels import LEAST, SIDE, Index
from atlas.overview.pyramid import Pyramid
from atlas.store.store import Atlas, done_tiles
from workers.results import REGIME


class Overviews:
    """The overviews of a store that a run writes.

    At the beginning it makes the groups of all levels, and drops what lies over tiles that are no longer finished.
    ``side`` and ``least`` are those of ``Levels``; a store that has overviews keeps its own.
    """

    def __init__(
        self,
        handle: Atlas,
        *,
        side: int = SIDE,
        least: int = LEAST,
    ) -> None:
        self._handle = handle
        self._pyramid = Pyramid(handle, side, least)
        self.levels = range(1, self._pyramid.levels.count + 1)
        if not self.levels:
            return
        self._pyramid.create()
        stale = np.ones(handle.tiling.grid, dtype=bool)
        for tile in done_tiles(handle):
            stale[tile] = False
        self._pyramid.drop(tuple(tile) for tile in np.argwhere(stale).tolist())

    def __bool__(self) -> bool:
        """Whether a chunk can be made."""
        return any(map(self.missing, self.levels))

    def missing(self, level: int) -> list[Index]:
        """The chunks of a level that are missing, but computable: everything below them exists."""
        levels, there = self._pyramid.levels, self._pyramid.stored(level, REGIME)
        below = done_tiles(self._handle) if level == 1 else self._pyramid.stored(level - 1, REGIME)
        wanted = (index for index in levels.chunks(level) if index not in there)
        return [index for index in wanted if below.issuperset(levels.children(level, index))]

    def finish(self, report: Callable[[int, int], None] = lambda _done, _all: None) -> int:
        """Make all that can be made, level by level, and return the number of chunks made.

        ``report`` is called before each chunk, with the number made of its level and of all there. RunError if a write
        fails.
        """
        made = 0
        for level in self.levels:
            missing = self.missing(level)
            for done, index in enumerate(missing):
                report(done, len(missing))
                try:
                    self._pyramid.make(level, index)
                except (RunError, ChunkError):
                    raise
                except (OSError, ValueError) as error:
                    raise RunError(
                        f"{self._handle.place}: the tiles done are kept, but the overviews could not be written "
                        f"({error}); run again to make them"
                    ) from error
            made += len(missing)
        return made
