"""One subject explored by any number of pages: what is known of it, what is looked up, and what is solved for whom."""

import threading
import time
from collections.abc import Callable, Hashable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError, RunError
from atlas.explore.compose import atlas_covers, composed, seen_atlas
from atlas.explore.kept import MOST_BYTES, Keeper
from atlas.explore.subject import Plane, Subject
from atlas.explore.tiles import Arrays, Tiles
from atlas.explore.view import STAGES, TILE, Sight, TileKey
from atlas.query.queries import at
from atlas.service.patches import Events, Patches
from atlas.service.timing import TIMING, Timing
from atlas.store.schema import extra_sizes
from atlas.store.store import done_tiles
from atlas.task.patch import Patch
from workers.results import NO_REASON, REASON, REASONS, REGIME, REGIMES, empty_results, result_variables

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

LOOK = 5.0
"""Seconds after which it is looked for tiles that a run has added to the atlas itself."""
DEPTH = 12
"""So many coarser levels are looked through for what was kept."""

Item = tuple[Plane, TileKey]


@dataclass(frozen=True)
class Cell:
    """A cell that was asked for: its parameters, its results as ``at`` has them, and whether it is the atlas's own."""

    parameters: dict[str, float]
    results: dict[str, Any]
    of_atlas: bool


class Explorer:
    """Looks, solves and keeps for the pages of one subject; ``connect`` leads to the cluster.

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
        self.subject, self.tiles = subject, Tiles()
        self.failures: dict[Item, str] = {}
        self._variables = result_variables(subject.settings)
        self._names = [variable.name for variable in self._variables]
        self._parents: dict[Item, Arrays] = {}
        self._kept_planes = {subject.plane}
        self._listeners: dict[Hashable, Callable[[Plane, TileKey], None]] = {}
        self._done: NDArray[np.bool_] | None = None
        self._looked = float("-inf")
        self._lock = threading.Lock()
        self.keeper = Keeper(subject, most_bytes, keep)
        self.patches = Patches(connect, Events(self._make, self._take, self._fail), timing)

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
        for key, arrays in self.tiles.of(plane):
            if arrays.keys() >= set(self._names):
                self.keeper.offer(plane, key, arrays)

    def look(self, plane: Plane, sight: Sight, names: Iterable[str]) -> None:
        """Read what is kept of the cells in view: finest first, and coarser ones only where these leave gaps."""
        wanted = {*names, REGIME.name}
        hidden: set[TileKey] = set()
        for stage in range(max(STAGES, min(DEPTH, max(sight.level_x, sight.level_y))) + 1):
            tiles = sight.tiles(stage)
            missing = [key for key in tiles if key not in hidden and not self.tiles.has(plane, key, wanted)]
            for key, arrays in self.keeper.load(plane, missing, wanted).items():
                self.tiles.put(plane, key, arrays)
            shown = {key for key in tiles if key in hidden or self.tiles.has(plane, key, wanted)}
            hidden = {above for above in {key.above for key in tiles} if all(b in shown for b in below(above))}

    def want(self, who: Hashable, plane: Plane, sight: Sight, stages: range) -> int:
        """Have what is not known of the view solved, at these stages in this order, and return how many tiles."""
        done = self.atlas_done()
        wanted: list[Item] = []
        for stage in stages:
            for key in sight.tiles(stage):
                known = self.tiles.has(plane, key, {REGIME.name}) or self.keeper.has(plane, key)
                if not known and (plane, key) not in self.failures and not atlas_covers(self.subject, done, plane, key):
                    wanted.append((plane, key))
        self.patches.want(who, wanted)
        return len(wanted)

    def seen(self, plane: Plane, sight: Sight, names: Iterable[str]) -> "xr.Dataset":
        """The cells in view as far as they are known."""
        wanted = list(names)
        base = seen_atlas(self.subject, sight, wanted) if plane == self.subject.plane else None
        return composed(self.subject, plane, sight, self.tiles.shown(plane, sight), wanted, base)

    def cell(self, plane: Plane, sight: Sight, x: float, y: float) -> Cell | None:
        """The finest cell that is known at a point in view; None where none is."""
        for stage in range(max(STAGES, sight.level_x, sight.level_y) + 1):
            level_x, level_y = sight.level_x - stage, sight.level_y - stage
            if min(level_x, level_y) < 0:
                found = self._atlas_cell(plane, x, y)
                if found is not None:
                    return found
            j, i = self.subject.x.nearest(level_x, x), self.subject.y.nearest(level_y, y)
            key = TileKey(level_x, level_y, j // TILE, i // TILE)
            arrays = self._whole(plane, key)
            if arrays is not None:
                return self._cell_of(plane, key, arrays, (i % TILE, j % TILE), (x, y))
        return self._atlas_cell(plane, x, y)

    def atlas_done(self) -> NDArray[np.bool_] | None:
        """Which cells (y, x) of the atlas itself are solved; None without an atlas."""
        ds, subject = self.subject.ds, self.subject
        if ds is None or subject.stored is None:
            return None
        if time.monotonic() - self._looked > LOOK and (self._done is None or not self._done.all()):
            self._looked = time.monotonic()
            done = np.zeros(subject.stored.tiling.grid, dtype=bool)
            for index in done_tiles(subject.stored):
                done[index] = True
            for dim, size in enumerate(subject.stored.tile):
                done = np.repeat(done, size, axis=dim)
            done = done[tuple(slice(n) for n in subject.stored.tiling.shape)]
            self._done = done[subject.layer] if done.ndim > 2 else done
        return self._done

    def _atlas_cell(self, plane: Plane, x: float, y: float) -> Cell | None:
        ds, names = self.subject.ds, [axis.name for axis in self.subject.spec.axes]
        if ds is None or plane != self.subject.plane:
            return None
        try:
            found = at(ds, dict(zip(names, (x, y), strict=True)))
        except (InputError, RunError):  # outside the atlas, or a damaged chunk
            return None
        if found[REGIME.name] == REGIMES[0].name:
            return None
        return Cell(dict(plane.parameters) | {name: found[name] for name in names}, found, of_atlas=True)

    def _cell_of(
        self, plane: Plane, key: TileKey, arrays: Arrays, place: tuple[int, int], point: tuple[float, float]
    ) -> Cell:
        subject = self.subject
        x = float(subject.x.values(key.level_x, key.index_x()[place[1] : place[1] + 1])[0])
        y = float(subject.y.values(key.level_y, key.index_y()[place[0] : place[0] + 1])[0])
        names = [axis.name for axis in subject.spec.axes]
        found: dict[str, Any] = dict(zip(names, (x, y), strict=True))
        found["distance"] = dict(zip(names, (abs(x - point[0]), abs(y - point[1])), strict=True))
        regime, reason = int(arrays[REGIME.name][place]), int(arrays[REASON.name][place])
        found[REGIME.name] = next(each.name for each in REGIMES if each.code == regime)
        if reason != NO_REASON:
            found[REASON.name] = REASONS[reason].text
        scalars = [v.name for v in self._variables if not v.extra and v.name not in (REGIME.name, REASON.name)]
        found |= {name: arrays[name][place].item() for name in scalars}
        return Cell(dict(plane.parameters) | dict(zip(names, (x, y), strict=True)), found, of_atlas=False)

    def _whole(self, plane: Plane, key: TileKey) -> Arrays | None:
        """All variables of a tile, from memory or from the store; None where it is not known."""
        arrays = self.tiles.get(plane, key)
        if arrays is not None and arrays.keys() >= set(self._names):
            return arrays
        kept = self.keeper.load(plane, [key], self._names).get(key)
        if kept is not None and kept.keys() >= set(self._names):
            self.tiles.put(plane, key, kept)
            return kept
        return None

    def _make(self, item: Hashable) -> Patch | None:
        """The patch of a tile, less the cells that the tile above has; None where it is known meanwhile."""
        plane, key = cast(Item, item)
        if self._whole(plane, key) is not None:
            return None
        parent = self._parent(plane, key)
        known = np.zeros((TILE, TILE), dtype=bool)
        if parent is not None:
            known[::2, ::2] = True
            self._parents[plane, key] = parent
        return self.subject.patch(plane, key, known)

    def _parent(self, plane: Plane, key: TileKey) -> Arrays | None:
        """What is known of every fourth cell of a tile, by the tile above or by the atlas where it is solved alike."""
        above = key.above
        whole = self._whole(plane, above)
        if whole is not None:
            return {name: array[key.quarter] for name, array in whole.items()}
        subject, names = self.subject, [axis.name for axis in self.subject.spec.axes]
        if subject.ds is None or not subject.same_settings or max(above.level_x, above.level_y) > 0:
            return None
        if not atlas_covers(subject, self.atlas_done(), plane, above):
            return None
        rows = (above.index_y() << -above.level_y)[key.quarter[0]]
        columns = (above.index_x() << -above.level_x)[key.quarter[1]]
        part = subject.ds[[name for name in self._names if name in subject.ds]].isel(
            {names[1]: rows, names[0]: columns}
        )
        if len(part.data_vars) < len(self._names):
            return None  # an older atlas lacks some of its variables
        try:
            return {name: part[name].transpose(names[1], names[0], ...).values for name in self._names}
        except (OSError, RunError):
            return None

    def _take(self, item: Hashable, patch: Patch, found: Arrays) -> None:
        """Put a solved tile together, keep it, and tell the pages."""
        plane, key = cast(Item, item)
        mask, parent = patch.mask, self._parents.pop((plane, key), None)
        arrays = empty_results(self._variables, (TILE, TILE), extra_sizes(self.subject.spec))
        for name, array in arrays.items():
            array[mask] = found[name]
            if parent is not None:
                array[::2, ::2] = parent[name]
        self.tiles.put(plane, key, arrays)
        with self._lock:
            kept, listeners = plane in self._kept_planes, list(self._listeners.values())
        if kept:
            self.keeper.offer(plane, key, arrays)
        for told in listeners:
            told(plane, key)

    def _fail(self, item: Hashable, why: str) -> None:
        plane, key = cast(Item, item)
        self._parents.pop((plane, key), None)
        self.failures[plane, key] = why


def below(key: TileKey) -> list[TileKey]:
    """The four tiles of the next finer level that have the cells of a tile, and those between."""
    x, y = 2 * key.x, 2 * key.y
    return [TileKey(key.level_x + 1, key.level_y + 1, x + i, y + j) for j in (0, 1) for i in (0, 1)]
