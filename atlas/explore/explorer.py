"""One subject explored by any number of pages: what is solved, for whom, and who is told."""

import threading
from collections.abc import Callable, Hashable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

import numpy as np

from atlas.explore.attractors import Asked, Attractors, Question
from atlas.explore.kept import MOST_BYTES, Keeper
from atlas.explore.known import Cell, Known
from atlas.explore.patch import Patch
from atlas.explore.patches import Events, Patches
from atlas.explore.subject import Plane, Subject
from atlas.explore.tiles import Arrays
from atlas.explore.view import TILE, Sight, TileKey
from atlas.service.timing import TIMING, Timing
from atlas.store.schema import extra_sizes
from workers.results import empty_results

if TYPE_CHECKING:
    from distributed import Client

Item = tuple[Plane, TileKey]


class Explorer:
    """Looks, solves and keeps for the pages of one subject; ``connect`` leads to the cluster.

    known      what is known of the subject
    failures   tiles that could not be solved, and why
    """

    def __init__(
        self,
        subject: Subject,
        connect: Callable[[], "AbstractContextManager[Client]"],
        keep: bool = True,
        most_bytes: int = MOST_BYTES,
        timing: Timing = TIMING,
    ) -> None:
        self.subject, self.failures = subject, dict[Item, str]()
        self._parents: dict[Item, Arrays] = {}
        self._kept_planes = {subject.plane}
        self._listeners: dict[Hashable, Callable[[Plane, TileKey], None]] = {}
        self._asked = Asked(subject)
        self._lock = threading.Lock()
        self.keeper = Keeper(subject, most_bytes, keep)
        self.known = Known(subject, self.keeper)
        self.patches = Patches(connect, Events(self._make, self._take, self._fail, self._drop), timing)

    def stop(self) -> None:
        """End the work, and keep what waits to be kept."""
        self.patches.stop()
        self.keeper.stop()

    def listen(self, who: Hashable, told: Callable[[Plane, TileKey], None] | None) -> None:
        """Have a page told, in another thread, of every tile that is solved; None for a page that is gone."""
        with self._lock:
            if told is None:
                self._listeners.pop(who, None)
            else:
                self._listeners[who] = told
        if told is None:
            self.patches.want(who, ())

    @property
    def listeners(self) -> list[Hashable]:
        """Who is told of solved tiles."""
        with self._lock:
            return list(self._listeners)

    def keep_plane(self, plane: Plane) -> None:
        """Keep this plane too, with what is known of it."""
        with self._lock:
            self._kept_planes.add(plane)
        for key, arrays in self.known.tiles.of(plane):
            if arrays.keys() >= set(self.known.names):
                self.keeper.offer(plane, key, arrays)

    def want(self, who: Hashable, plane: Plane, sight: Sight, stages: range) -> int:
        """Have what is not known of the view solved, at these stages in this order, and return how many tiles."""
        wanted = [
            (plane, key)
            for stage in stages
            for key in sight.tiles(stage)
            if (plane, key) not in self.failures and not self.known.has(plane, key)
        ]
        self.patches.want(who, wanted)
        return len(wanted)

    def ask(self, who: Hashable, cell: Cell, told: Callable[[Attractors], None]) -> None:
        """Have all attractors of a cell found, and somebody told of them in another thread, and of no other cell's."""
        self.patches.want(who, [self._asked.ask(who, cell, told)])

    def forget(self, who: Hashable) -> None:
        """Find nothing more for somebody who asked for attractors."""
        self._asked.forget(who)
        self.patches.want(who, ())

    def _make(self, item: Hashable) -> Patch | None:
        """The patch of a tile, less the cells that the tile above has; None where it is known meanwhile."""
        if isinstance(item, Question):
            return self._asked.patch(item)
        plane, key = _tile(item)
        if self.known.whole(plane, key) is not None:
            return None
        parent = self.known.parent(plane, key)
        solved = np.zeros((TILE, TILE), dtype=bool)
        if parent is not None:
            solved[::2, ::2] = True
            self._parents[plane, key] = parent
        return self.subject.patch(plane, key, solved)

    def _take(self, item: Hashable, patch: Patch, found: Arrays) -> None:
        """Put a solved tile together, keep it, and tell the pages."""
        if isinstance(item, Question):
            self._asked.answer(item, found)
            return
        plane, key = _tile(item)
        mask, parent = patch.mask, self._parents.pop((plane, key), None)
        arrays = empty_results(
            self.subject.system.variables(self.subject.settings), (TILE, TILE), extra_sizes(self.subject.spec)
        )
        for name, array in arrays.items():
            array[mask] = found[name]
            if parent is not None:
                array[::2, ::2] = parent[name]
        with self._lock:
            wanted, listeners = plane in self._kept_planes, list(self._listeners.values())
        kept = wanted and self.keeper.can_keep(key)
        self.known.tiles.put(plane, key, arrays, only_here=wanted and not kept)
        for told in listeners:
            told(plane, key)
        if kept:
            self.keeper.room()
            self.keeper.offer(plane, key, arrays)

    def _fail(self, item: Hashable, why: str) -> None:
        if isinstance(item, Question):
            self._asked.fail(item, why)
            return
        self._drop(item)
        self.failures[_tile(item)] = why

    def _drop(self, item: Hashable) -> None:
        """Let go of what was kept for a tile that is not solved after all."""
        if not isinstance(item, Question):
            self._parents.pop(_tile(item), None)


def _tile(item: Hashable) -> Item:
    """What is asked of the cluster and is no question: a tile of a plane."""
    assert isinstance(item, tuple)
    plane, key = item
    return plane, key
