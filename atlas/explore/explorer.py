"""The explorer of one plane, shared by any number of pages: it finds and solves cells, and notifies the pages."""

import math
import threading
import time
from collections.abc import Callable, Hashable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from atlas.explore.cell_lookup import CellLookup
from atlas.explore.grid_patch import solve_patch
from atlas.explore.jobs import JobService, ServiceJob, Take, Task
from atlas.explore.subject import Arrays, PlaneParameters, Subject
from atlas.explore.tile_cache import MemoryTileCache, TileCache
from atlas.explore.viewport import TILE_CELLS, TileKey, Viewport
from atlas.service.timing import TIMING, Timing

if TYPE_CHECKING:
    from distributed import Client

RETRY_SECONDS = 60.0
"""Time, in seconds, after which a tile that was given up may be requested again."""
MAX_OTHER_EXPLORERS = 4
"""Maximum number of remembered explorers of other axes and layers. Beyond it, explorers that no page shows are dropped.
"""
MAX_FAILURES = 4096
"""Maximum number of failed tiles that are remembered."""


class Explorer:
    """Finds and solves the cells of one subject, the plane that is explored, for its pages.

    subject      the subject
    connect      opens the Dask client; or the explorer whose cluster and memory are shared
    timing       time limits of the jobs on the cluster

    patches      the service that runs jobs on the cluster
    tiles        the solved tiles of the subject
    known        looks up known cells, in the tiles and in the atlas
    failures     time at which a tile failed, in seconds of ``time.monotonic``, by plane and key
    """

    def __init__(
        self,
        subject: Subject,
        connect: "Callable[[], AbstractContextManager[Client]] | Explorer",
        timing: Timing = TIMING,
    ) -> None:
        self.subject, self.failures = subject, dict[tuple[PlaneParameters, TileKey], float]()
        self._listeners: dict[Hashable, Callable[[PlaneParameters, TileKey], None]] = {}
        self._lock = threading.Lock()
        self._others: dict[tuple[tuple[str, str], float | None], Explorer] = {}
        self.patches: JobService
        memory: MemoryTileCache
        if isinstance(connect, Explorer):
            self.patches, memory = connect.patches, connect.tiles.memory
        else:
            self.patches, memory = JobService(connect, timing), MemoryTileCache()
        self.tiles: TileCache = TileCache(subject, memory)
        self.known = CellLookup(self.tiles)

    def stop(self) -> None:
        """Stop the jobs on the cluster."""
        self.patches.stop()

    def explorer_for_axes(self, axes: tuple[str, str], layer: float | None = None) -> "Explorer":
        """Return the explorer of the same system over other axes, or of another layer of a stack, on the same cluster.

        axes    names of the two parameters across and up
        layer   value of the stack axis; None for the present layer

        Raise InputError if the axes are not two different parameters, or if the stack does not have the layer.
        """
        if axes == self.subject.axes and layer in (None, self.subject.layer_value):
            return self
        subject, layer = self.subject.with_axes(axes, layer), self.subject.layer_value if layer is None else layer
        with self._lock:
            explorer = self._others.pop((axes, layer), None) or Explorer(subject, self)
            self._others[axes, layer] = explorer  # in order of their last use
            idle = [key for key, other in self._others.items() if not other.listeners and key != (axes, layer)]
            for key in idle[: max(0, len(self._others) - MAX_OTHER_EXPLORERS)]:
                self._others.pop(key).tiles.drop()
            return explorer

    def subscribe(self, consumer: Hashable, callback: Callable[[PlaneParameters, TileKey], None] | None) -> None:
        """Call ``callback``, in another thread, with the fixed parameters and the key of each tile solved from now on.

        ``consumer`` identifies the caller. With None its callback is removed, and its jobs are cancelled.
        """
        with self._lock:
            if callback is None:
                self._listeners.pop(consumer, None)
            else:
                self._listeners[consumer] = callback
        if callback is None:
            self.patches.request(consumer, ())

    @property
    def listeners(self) -> list[Hashable]:
        """The consumers, such as the renderers of pages, that are notified of solved tiles."""
        with self._lock:
            return list(self._listeners)

    def request_tiles(self, consumer: Hashable, plane: PlaneParameters, viewport: Viewport, stages: range) -> int:
        """Request the unknown tiles of a viewport for a page, and return their number.

        consumer   identifies the page; its earlier requests are replaced
        plane      the fixed parameters
        viewport   the ranges of visible cells along both axes
        stages     numbers of halvings of the full density at which tiles are requested, in this order

        A tile that failed is requested again only if RETRY_SECONDS have passed since.
        """
        since = time.monotonic() - RETRY_SECONDS
        jobs = [
            TileJob(self, plane, key)
            for stage in stages
            for key in viewport.tiles(stage)
            if self.failures.get((plane, key), -math.inf) <= since and not self.tiles.has(plane, key)
        ]
        self.patches.request(consumer, jobs)
        return len(jobs)

    def record_failure(self, plane: PlaneParameters, key: TileKey) -> None:
        """Record that a tile could not be solved. Beyond MAX_FAILURES the oldest records are dropped."""
        with self._lock:
            self.failures.pop((plane, key), None)
            self.failures[plane, key] = time.monotonic()
            while len(self.failures) > MAX_FAILURES:
                self.failures.pop(next(iter(self.failures)))

    def add_tile(self, plane: PlaneParameters, key: TileKey, arrays: Arrays) -> None:
        """Store a solved tile, and notify the pages."""
        self.tiles.put(plane, key, arrays)
        self.failures.pop((plane, key), None)
        with self._lock:
            listeners = list(self._listeners.values())
        for hear in listeners:
            hear(plane, key)


@dataclass(frozen=True)
class TileJob(ServiceJob):
    """The job of solving one tile, a square of cells of one zoom level, for an explorer."""

    explorer: Explorer
    plane: PlaneParameters
    key: TileKey

    def build_task(self) -> tuple[Task, Take] | None:
        """Return the task that solves the tile's cells, and the function that stores the tile from the result.

        Every fourth cell is also a cell of the coarser parent tile, and is not solved again if that tile is known.
        Return None if the whole tile has become known meanwhile.
        """
        tiles, subject = self.explorer.tiles, self.explorer.subject
        if tiles.full_tile(self.plane, self.key) is not None:
            return None
        parent = tiles.parent(self.plane, self.key)
        missing = np.ones((TILE_CELLS, TILE_CELLS), dtype=bool)
        missing[::2, ::2] = parent is None

        def take(results: Arrays) -> int:
            arrays = subject.without_results(subject.variables, (TILE_CELLS, TILE_CELLS))
            for name, array in arrays.items():
                array[missing] = results[name]
                if parent is not None:
                    array[::2, ::2] = parent[name]
            self.explorer.add_tile(self.plane, self.key, arrays)
            return int(missing.sum())

        return (solve_patch, subject.patch(self.plane, self.key, missing)), take

    def on_failed(self, reason: str) -> None:
        """Record that the tile could not be solved."""
        self.explorer.record_failure(self.plane, self.key)
