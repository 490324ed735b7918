"""The overviews of a store kept up while a run writes its tiles."""

from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager
from types import TracebackType

import numpy as np

from atlas.errors import RunError
from atlas.overview.levels import LEAST, SIDE, Index
from atlas.overview.pyramid import Pyramid
from atlas.store.store import Header, done_tiles
from workers.results import REGIME

WAIT_SECONDS = 5.0
"""Between two signs of life at the end of a run."""


class Overviews(AbstractContextManager["Overviews"]):
    """The overviews of a store kept up during a run: a thread of the coordinator makes each chunk when it can.

    On entry, what lies over unfinished tiles and over ``pending`` ones, finished but to be written again, is dropped.
    ``add`` is called for each tile that is written; ``finish`` waits until all that can be made is made. On the way
    out what is not yet begun is left. ``held`` is called before each write, and raises where another run has the
    store. ``side`` and ``least`` are those of ``Levels``; a store that has overviews keeps
    theirs.
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
        self._threads = ThreadPoolExecutor(1, thread_name_prefix="overviews")
        self._futures: list[Future[int]] = []
        self._missing: dict[Index, int] = {}
        if not self._levels.count:
            return
        self._pyramid.create()
        waiting = np.ones([-(-n // t) for n, t in zip(self._levels.shape, self._levels.tile, strict=True)], dtype=bool)
        for tile in done_tiles(header):
            waiting[tile] = False
        for tile in pending:
            waiting[tile] = True
        unfinished = [tuple(tile) for tile in np.argwhere(waiting).tolist()]
        self._pyramid.drop(unfinished)
        for tile in unfinished:
            over = self._levels.over(tile)
            self._missing[over] = self._missing.get(over, 0) + 1
        self._current = {n: self._pyramid.stored(n, REGIME) for n in self._numbers}
        # What an earlier run finished and did not come to: it was killed, or knew no overviews.
        self._submit(1, [i for i in self._levels.chunks(1) if i not in self._missing and i not in self._current[1]])
        for level in self._numbers[1:]:
            self._submit(level, [i for i in self._levels.chunks(level) if self._ready(level, i)])

    @property
    def _numbers(self) -> range:
        return range(1, self._levels.count + 1)

    def _ready(self, level: int, index: Index) -> bool:
        """Whether a chunk above level 1 is missing and all that it is made of is there."""
        below = self._current[level - 1]
        return index not in self._current[level] and all(i in below for i in self._levels.children(level, index))

    def add(self, tile: Index) -> None:
        """A tile is written."""
        if not self._levels.count:
            return
        over = self._levels.over(tile)
        left = self._missing.get(over, 0) - 1
        self._missing[over] = max(left, 0)
        if left < 0:  # written once more than was said
            self._futures.append(self._threads.submit(self._again, tile))
        elif left == 0:
            self._submit(1, [over])

    def finish(self, report: Callable[[int, int], None] = lambda _done, _all: None) -> int:
        """Wait until all that can be made is made; the number of chunks made since the beginning.

        ``report`` is called, now and every few seconds, with the parts done and all parts while there is something to
        wait for. Raises RunError where a write failed.
        """
        left = set(self._futures)
        while left and self._failure() is None:
            if any(not future.done() for future in left):
                report(len(self._futures) - len(left), len(self._futures))
            _, left = wait(left, timeout=WAIT_SECONDS, return_when=FIRST_EXCEPTION)
        if (failure := self._failure()) is not None:
            if not isinstance(failure, OSError | ValueError):
                raise failure
            raise RunError(
                f"{self._header.place}: the tiles done are kept, but the overviews could not be written ({failure}); "
                "run again to make them"
            ) from failure
        return sum(future.result() for future in self._futures)

    def _failure(self) -> BaseException | None:
        return next((future.exception() for future in self._futures if future.done() and future.exception()), None)

    def _submit(self, level: int, indices: Iterable[Index]) -> None:
        self._futures += [self._threads.submit(self._make, level, index) for index in indices]

    def _make(self, level: int, index: Index) -> int:
        """Make a chunk, and those above it that it completes; how many."""
        made = 0
        while index not in self._current[level]:
            self._held()
            self._pyramid.make(level, index)
            self._current[level].add(index)
            made += 1
            above = self._levels.above(index)
            if level == self._levels.count or not self._ready(level + 1, above):
                break
            level, index = level + 1, above
        return made

    def _again(self, tile: Index) -> int:
        """Drop what lies over a tile and make it anew as far as its tiles are done."""
        self._held()
        self._pyramid.drop([tile])
        over = index = self._levels.over(tile)
        for level in self._numbers:
            self._current[level].discard(index)
            index = self._levels.above(index)
        return self._make(1, over) if not self._missing[over] else 0

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave what is not begun; a chunk under way is finished."""
        self._threads.shutdown(cancel_futures=True)
