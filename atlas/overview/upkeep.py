"""The overviews of a store kept up while a run writes its tiles: which of their chunks can be made now."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from atlas.errors import ChunkError, RunError
from atlas.overview.levels import LEAST, SIDE, Index
from atlas.overview.pyramid import Pyramid
from atlas.store.store import Header, done_tiles
from workers.results import REGIME

Chunk = tuple[int, Index]
"""A chunk of a level: the level, and its index there."""


class Overviews(Iterator[Chunk]):
    """The chunks of a store's overviews that can be made now, each given once; more come with ``add`` and ``made``.

    At the beginning, what lies over unfinished tiles and over ``pending`` ones, finished but to be written again, is
    dropped; what an earlier run finished and did not come to can be made at once. ``held`` is called before each write,
    and raises where another run has the store. ``side`` and ``least`` are those of ``Levels``; a store that has
    overviews keeps theirs.
    """

    def __init__(
        self,
        header: Header,
        pending: Iterable[Index] = (),
        held: Callable[[], None] = lambda: None,
        *,
        side: int = SIDE,
        least: int = LEAST,
    ) -> None:
        self._header, self._held = header, held
        self._pyramid = Pyramid(header, side, least)
        self._levels = self._pyramid.levels
        self._missing: dict[Index, int] = {}
        self._ready: deque[Chunk] = deque()
        self._given: set[Chunk] = set()
        self.count = 0
        if not self._levels.count:
            return
        held()
        self._pyramid.create()
        waiting = np.ones([-(-n // t) for n, t in zip(self._levels.shape, self._levels.tile, strict=True)], dtype=bool)
        for tile in done_tiles(header):
            waiting[tile] = False
        for tile in pending:
            waiting[tile] = True
        unfinished = [tuple(tile) for tile in np.argwhere(waiting).tolist()]
        held()
        self._pyramid.drop(unfinished)
        for tile in unfinished:
            over = self._levels.over(tile)
            self._missing[over] = self._missing.get(over, 0) + 1
        self._current = {n: self._pyramid.stored(n, REGIME) for n in range(1, self._levels.count + 1)}
        for level in self._current:
            for index in self._levels.chunks(level):
                self._offer(level, index)

    def __bool__(self) -> bool:
        """Whether a chunk can be made now that was not given yet."""
        return bool(self._ready)

    def __next__(self) -> Chunk:
        """The next chunk that can be made; StopIteration where there is none now."""
        if not self._ready:
            raise StopIteration
        return self._ready.popleft()

    def add(self, tile: Index, made: bool = False) -> None:
        """A tile is written; ``made`` with the chunk of level 1 that lies over it alone."""
        if not self._levels.count:
            return
        over = self._levels.over(tile)
        self._missing[over] = max(self._missing.get(over, 0) - 1, 0)
        if made:
            self._given.add((1, over))
            self.made((1, over))
        else:
            self._offer(1, over)

    def made(self, chunk: Chunk) -> None:
        """A chunk is made."""
        level, index = chunk
        self._current[level].add(index)
        self.count += 1
        if level < self._levels.count:
            self._offer(level + 1, self._levels.above(index))

    def finish(self, report: Callable[[int, int], None] = lambda _done, _all: None) -> int:
        """Make all that can be made, here and now; the number of chunks made since the beginning, here or elsewhere.

        ``report`` is called before each with the chunks made and known. Raises RunError where a write failed.
        """
        first = self.count
        for level, index in self:
            report(self.count - first, self.count - first + len(self._ready) + 1)
            try:
                self._pyramid.make(level, index, self._held)
            except (RunError, ChunkError):
                raise
            except (OSError, ValueError) as error:
                raise RunError(
                    f"{self._header.place}: the tiles done are kept, but the overviews could not be written "
                    f"({error}); run again to make them"
                ) from error
            self.made((level, index))
        return self.count

    def again(self, chunk: Chunk) -> None:
        """A chunk that was given is not made, and can be made all the same."""
        self._ready.append(chunk)

    def _offer(self, level: int, index: Index) -> None:
        """Have a chunk made that is missing, if all that it is made of is there."""
        if index in self._current[level] or (level, index) in self._given:
            return
        if level == 1:
            whole = not self._missing.get(index)
        else:
            below = self._current[level - 1]
            whole = all(child in below for child in self._levels.children(level, index))
        if whole:
            self._given.add((level, index))
            self._ready.append((level, index))
