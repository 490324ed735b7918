"""What is known of a subject: cells of the atlas itself, tiles in memory, tiles kept; one cell is solved if asked."""

import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError, RunError
from atlas.explore.compose import atlas_cells, atlas_covers, composed, seen_atlas
from atlas.explore.kept import Keeper
from atlas.explore.patch import solve_patch
from atlas.explore.sheets import LOOK
from atlas.explore.subject import Subject, SubjectPlane
from atlas.explore.tiles import Arrays, Memory, Tiles
from atlas.explore.view import STAGES, TILE, Sight, Stretch, TileKey
from atlas.query.queries import at
from atlas.store.store import done_tiles
from workers.results import (
    INVALID,
    NO_REASON,
    OUT_OF_RANGE,
    PENDING,
    REASON,
    REASONS,
    REGIME,
    REGIMES,
)

if TYPE_CHECKING:
    import xarray as xr

DEPTH = 12
"""So many coarser levels are looked through for what was kept."""
MOST_ROWS = 4096
"""Rows and columns of tiles of which it is remembered whether they have a point in the valid range."""


@dataclass(frozen=True)
class Cell:
    """A cell that was asked for: its parameters, its results as ``at`` has them, and whether it is the atlas's own."""

    parameters: dict[str, float]
    results: dict[str, Any]
    of_atlas: bool


class KnownTiles:
    """Finds what is known. ``tiles`` are those in memory; ``keeper`` has those of the store."""

    def __init__(self, subject: Subject, keeper: Keeper, memory: Memory | None = None) -> None:
        self.subject, self.tiles, self.keeper = subject, Tiles(memory), keeper
        self._invalid = subject.without_results(subject.variables, (TILE, TILE))
        self._invalid[REGIME.name][...], self._invalid[REASON.name][...] = INVALID, OUT_OF_RANGE
        self._admits = lru_cache(MOST_ROWS)(
            lambda along, level, number: bool(subject.admitted(along, level, number, 1).any())
        )
        self._done: NDArray[np.bool_] | None = None
        self._looked = float("-inf")

    def look(self, plane: SubjectPlane, sight: Sight, names: Iterable[str]) -> None:
        """Read what is kept of the cells in view: finest first, and coarser ones only where these leave gaps."""
        wanted = {*names, REGIME.name}
        hidden: set[TileKey] = set()
        for stage in range(max(STAGES, min(DEPTH, max(sight.x.level, sight.y.level))) + 1):
            tiles = sight.tiles(stage)
            missing = [key for key in tiles if key not in hidden and not self.tiles.has(plane, key, wanted)]
            for key, arrays in self.keeper.load(plane, missing, wanted).items():
                self.tiles.put(plane, key, arrays)
            shown = {key for key in tiles if key in hidden or self.tiles.has(plane, key, wanted)}
            hidden = {above for above in {key.above for key in tiles} if all(b in shown for b in below(above))}

    def has(self, plane: SubjectPlane, key: TileKey) -> bool:
        """Whether a tile need not be solved."""
        known = self.tiles.has(plane, key, {REGIME.name}) or self.outside(key) or self.keeper.has(plane, key)
        return known or atlas_covers(self.subject, self.atlas_done(), plane, key)

    def shares(self, plane: SubjectPlane, sight: Sight) -> tuple[float, ...]:
        """Of each stage, the coarsest first, the share of the view that is known as densely or more so."""
        known, found = np.zeros(sight.shape, dtype=bool), []
        for stage in range(STAGES + 1):
            for key in sight.tiles(stage):
                place = sight.place(key)
                if not known[place].all() and self.has(plane, key):
                    known[place] = True
            if stage >= max(sight.x.level, sight.y.level):
                known |= self._in_atlas(plane, sight)
            found.append(float(known.mean()))
        return tuple(found[::-1])

    def _in_atlas(self, plane: SubjectPlane, sight: Sight) -> NDArray[np.bool_]:
        """Which cells in view lie in a cell of the atlas itself that is solved."""
        done = self.atlas_done() if plane == self.subject.plane else None
        if done is None:
            return np.zeros(sight.shape, dtype=bool)
        places, inside = [], []
        for seen, count in zip((sight.y, sight.x), done.shape, strict=True):
            level = seen.level
            place = seen.index << -level if level < 0 else Stretch(0, 0, count).holding(level, seen.index)
            inside.append((place >= 0) & (place < count))
            places.append(np.clip(place, 0, count - 1))
        return np.asarray(done[np.ix_(*places)] & np.outer(*inside))

    def outside(self, key: TileKey) -> bool:
        """Whether no cell of a tile lies in the valid ranges, so that there is nothing to solve."""
        return not (self._admits(0, key.level_x, key.x) and self._admits(1, key.level_y, key.y))

    def whole(self, plane: SubjectPlane, key: TileKey) -> Arrays | None:
        """All variables of a tile, from memory or from the store; None where it is not known."""
        names = self.subject.variables.keys()
        arrays = self.tiles.get(plane, key)
        if arrays is not None and arrays.keys() >= names:
            return arrays
        if self.outside(key):
            return self._invalid
        kept = self.keeper.load(plane, [key], names).get(key)
        if kept is not None and kept.keys() >= names:
            self.tiles.put(plane, key, kept)
            return kept
        return None

    def parent(self, plane: SubjectPlane, key: TileKey) -> Arrays | None:
        """What is known of every fourth cell of a tile, by the tile above or by the atlas where it is solved alike."""
        above = key.above
        whole = self.whole(plane, above)
        if whole is not None:
            return {name: array[key.quarter] for name, array in whole.items()}
        subject, names = self.subject, self.subject.variables.keys()
        if subject.ds is None or not subject.same_settings:
            return None
        if not atlas_covers(subject, self.atlas_done(), plane, above):
            return None
        rows, columns = (cells[part] for cells, part in zip(above.of_atlas, key.quarter, strict=True))
        with suppress(OSError, RunError):
            return atlas_cells(subject, names, rows, columns)
        return None

    def seen(self, plane: SubjectPlane, sight: Sight, names: Iterable[str]) -> "xr.Dataset":
        """The cells in view as far as they are known."""
        wanted = list(names)
        base = seen_atlas(self.subject, sight, wanted) if plane == self.subject.plane else None
        tiles = self.tiles.shown(plane, sight) + [(key, self._invalid) for key in sight.tiles(0) if self.outside(key)]
        return composed(self.subject, plane, sight, tiles, wanted, base)

    def cell(self, plane: SubjectPlane, sight: Sight, x: float, y: float) -> Cell | None:
        """The finest cell that is known at a point in view; None where none is."""
        for stage in range(max(STAGES, sight.x.level, sight.y.level) + 1):
            level_x, level_y = sight.x.level - stage, sight.y.level - stage
            if min(level_x, level_y) < 0:
                found = self._atlas_cell(plane, x, y)
                if found is not None:
                    return found
            j, i = self.subject.x.nearest(level_x, x), self.subject.y.nearest(level_y, y)
            key = TileKey(level_x, level_y, j // TILE, i // TILE)
            arrays = self.whole(plane, key)
            if arrays is not None:
                return self._cell_of(plane, arrays, (i % TILE, j % TILE), self._at(level_x, level_y, j, i), (x, y))
        return self._atlas_cell(plane, x, y)

    def point(self, plane: SubjectPlane, sight: Sight, x: float, y: float) -> tuple[float, float]:
        """The cell of a view nearest to a point: one of the atlas itself where its cells lie closer than the view's."""
        if min(sight.x.level, sight.y.level) < 0:
            found = self._atlas_cell(plane, x, y)
            if found is not None:
                return self.subject.point(found.parameters)[1:]
        j, i = self.subject.x.nearest(sight.x.level, x), self.subject.y.nearest(sight.y.level, y)
        return self._at(sight.x.level, sight.y.level, j, i)

    def solved(self, plane: SubjectPlane, x: float, y: float) -> Cell:
        """The cell at exactly this point, solved here and now."""
        found = solve_patch(self.subject.grid(plane, (x,), (y,)))
        return self._cell_of(plane, found, (0,), (x, y), (x, y))

    def atlas_done(self) -> NDArray[np.bool_] | None:
        """Which cells (y, x) of the atlas itself are solved; None without an atlas.

        Of an atlas of all attractors those that keep the one that the cell's own initial state reaches.
        """
        ds, subject = self.subject.ds, self.subject
        if ds is None or subject.stored is None:
            return None
        if time.monotonic() - self._looked > LOOK and (self._done is None or not self._done.all()):
            self._looked = time.monotonic()
            tiling = subject.stored.tiling
            done = np.zeros(tiling.shape, dtype=bool)
            for index in done_tiles(subject.stored):
                done[tiling.at(index).slices] = True
            done = done[subject.layer] if done.ndim > 2 else done
            self._done = done if subject.every is None else done & (ds[REGIME.name].values != PENDING)
        return self._done

    def _at(self, level_x: int, level_y: int, j: int, i: int) -> tuple[float, float]:
        """The parameters of a column and a row of a level."""
        across, up = self.subject.points(Stretch(level_x, j, 1), Stretch(level_y, i, 1))
        return float(across[0]), float(up[0])

    def _atlas_cell(self, plane: SubjectPlane, x: float, y: float) -> Cell | None:
        subject = self.subject
        if subject.ds is None or plane != subject.plane:
            return None
        try:
            found = at(subject.ds, dict(zip(subject.axes, (x, y), strict=True)))
        except (InputError, RunError):  # outside the atlas, or a damaged chunk
            return None
        if found[REGIME.name] == REGIMES[0].name:
            return None
        return Cell(subject.values(plane, *(found[name] for name in subject.axes)), found, of_atlas=True)

    def _cell_of(
        self,
        plane: SubjectPlane,
        arrays: Arrays,
        place: tuple[int, ...],
        at: tuple[float, float],
        point: tuple[float, float],
    ) -> Cell:
        """The cell at a place of arrays, which lies at ``at``, as the one nearest to a point."""
        subject, (x, y) = self.subject, at
        found: dict[str, Any] = dict(zip(subject.axes, at, strict=True))
        found["distance"] = dict(zip(subject.axes, (abs(x - point[0]), abs(y - point[1])), strict=True))
        regime, reason = int(arrays[REGIME.name][place]), int(arrays[REASON.name][place])
        found[REGIME.name] = next(each.name for each in REGIMES if each.code == regime)
        if reason != NO_REASON:
            found[REASON.name] = REASONS[reason].text
        found |= {name: arrays[name][place].item() for name in subject.numbers}
        return Cell(subject.values(plane, x, y), found, of_atlas=False)


def below(key: TileKey) -> list[TileKey]:
    """The four tiles of the next finer level that have the cells of a tile, and those between."""
    x, y = 2 * key.x, 2 * key.y
    return [TileKey(key.level_x + 1, key.level_y + 1, x + i, y + j) for j in (0, 1) for i in (0, 1)]
