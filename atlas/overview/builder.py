"""The overviews of a store during a run: chunks over lost tiles are dropped, missing chunks are built at the end.

Overviews are coarser copies of the atlas. The store shows which chunks are missing and can be built, so a kill needs no
record.
"""

from collections.abc import Callable

import numpy as np

from atlas.errors import ChunkError, RunError
from atlas.overview.levels import MIN_SIDE, SIDE, Index
from atlas.overview.pyramid import Pyramid
from atlas.store.store import AtlasStore, done_mask, done_tiles
from workers.results import REGIME


class OverviewBuilder:
    """Builds the missing chunks of the overviews, coarser copies of the atlas, during a run that writes the store.

    At the start it creates the groups of all levels and drops chunks over tiles that are no longer finished. ``side``
    and ``minimum`` are ``chunk_side`` and ``min_side`` of ``OverviewLevels``; a store with overviews keeps its own.
    """

    def __init__(
        self,
        handle: AtlasStore,
        *,
        side: int = SIDE,
        minimum: int = MIN_SIDE,
    ) -> None:
        self._handle = handle
        self._pyramid = Pyramid(handle, side, minimum)
        self.levels = range(1, self._pyramid.levels.count + 1)
        if not self.levels:
            return
        handle.backend.confirm_lease()
        self._pyramid.create()
        self._pyramid.drop(map(tuple, np.argwhere(~done_mask(handle)).tolist()))

    def __bool__(self) -> bool:
        """Return True if a missing chunk can be built: all tiles or chunks below it are finished."""
        return any(map(self.missing_chunks, self.levels))

    def missing_chunks(self, level: int) -> list[Index]:
        """Return the indices of a level's missing chunks that can be built: all tiles or chunks below them are
        finished.
        """
        levels, stored = self._pyramid.levels, self._pyramid.stored(level, REGIME)
        below = done_tiles(self._handle) if level == 1 else self._pyramid.stored(level - 1, REGIME)
        missing = (index for index in levels.chunks(level) if index not in stored)
        return [index for index in missing if below.issuperset(levels.children(level, index))]

    def finish(self, report: Callable[[int, int], None] = lambda _done, _all: None) -> int:
        """Build all missing chunks that can be built, level by level, and return their number.

        ``report`` is called before each chunk with the number of chunks of its level built, and the number to build.
        Raise RunError if a write fails.
        """
        self._handle.backend.confirm_lease()
        n_built = 0
        for level in self.levels:
            missing = self.missing_chunks(level)
            for n_finished, index in enumerate(missing):
                report(n_finished, len(missing))
                try:
                    self._pyramid.build_chunk(level, index)
                except (RunError, ChunkError):
                    raise
                except (OSError, ValueError) as error:
                    raise RunError(
                        f"{self._handle.backend}: finished tiles are kept, but the overviews could not be written "
                        f"({error}); rerun the same command to build them"
                    ) from error
            n_built += len(missing)
        return n_built
