"""The known cells of a subject: of the atlas itself, of tiles in memory, of kept tiles; one cell is solved if asked."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from atlas.errors import InputError, RunError
from atlas.explore.compose import VisibleCells, compose_view, seen_atlas
from atlas.explore.grid_patch import solve_patch
from atlas.explore.subject import Arrays, PlaneParameters
from atlas.explore.tile_cache import TileCache
from atlas.explore.viewport import STAGES, TILE_CELLS, CellRange, TileKey, Viewport
from atlas.query.queries import at
from atlas.query.window import nearest
from workers.results import PENDING, REASON, REGIME, in_words

DEPTH = 12
"""Coarser levels that are looked through for kept tiles."""
MOST_VIEWS = 4
"""Views of which the atlas's own cells are held, as they were when it was last looked at: a page draws them again with
each tile that is solved.
"""


@dataclass(frozen=True)
class CellResult:
    """A cell that was asked for: its parameters, its results as ``at`` has them, and whether it is the atlas's own."""

    parameters: dict[str, float]
    results: dict[str, Any]
    of_atlas: bool


class CellLookup:
    """The cells of a subject that are known, by its tiles and its atlas."""

    def __init__(self, tiles: TileCache) -> None:
        self.tiles, self.subject = tiles, tiles.subject
        self._base = lru_cache(MOST_VIEWS)(lambda sight, names, looked: seen_atlas(self.subject, sight, names))

    def load_visible(self, plane: PlaneParameters, viewport: Viewport, names: Collection[str]) -> None:
        """Read the kept tiles in view: the finest first, and coarser ones only where these leave gaps."""
        hidden: set[TileKey] = set()
        for stage in range(max(STAGES, min(DEPTH, max(viewport.x.level, viewport.y.level))) + 1):
            tiles = viewport.tiles(stage)
            shown = hidden | self.tiles.get(plane, [key for key in tiles if key not in hidden], names).keys()
            hidden = {above for above in {key.parent for key in tiles} if all(b in shown for b in child_tiles(above))}

    def visible_cells(self, plane: PlaneParameters, viewport: Viewport, names: Iterable[str]) -> VisibleCells:
        """The cells in view as far as they are known."""
        wanted = list(names)
        base = self._base(viewport, tuple(wanted), self.tiles.looked) if plane == self.subject.plane else None
        return compose_view(self.subject, plane, viewport, self.tiles.visible_tiles(plane, viewport), wanted, base)

    def cell(self, plane: PlaneParameters, viewport: Viewport, x: float, y: float) -> CellResult | None:
        """The finest cell that is known at a point in view; None where none is."""
        for stage in range(max(STAGES, viewport.x.level, viewport.y.level) + 1):
            level_x, level_y = viewport.x.level - stage, viewport.y.level - stage
            if min(level_x, level_y) < 0:
                own = self._atlas_cell(plane, x, y)
                if own is not None:
                    return own
            j, i = self.subject.x.nearest(level_x, x), self.subject.y.nearest(level_y, y)
            key = TileKey(level_x, level_y, j // TILE_CELLS, i // TILE_CELLS)
            arrays = self.tiles.full_tile(plane, key)
            if arrays is not None:
                return self._cell_of(
                    plane, arrays, (i % TILE_CELLS, j % TILE_CELLS), self._at(level_x, level_y, j, i), (x, y)
                )
        return self._atlas_cell(plane, x, y)

    def point(self, plane: PlaneParameters, viewport: Viewport, x: float, y: float) -> tuple[float, float]:
        """The cell of a view nearest to a point: one of the atlas itself where its cells lie closer than the view's."""
        if min(viewport.x.level, viewport.y.level) < 0:
            own = self._atlas_cell(plane, x, y)
            if own is not None:
                return self.subject.point(own.parameters)[1:]
        j, i = self.subject.x.nearest(viewport.x.level, x), self.subject.y.nearest(viewport.y.level, y)
        return self._at(viewport.x.level, viewport.y.level, j, i)

    def solve_cell(self, plane: PlaneParameters, x: float, y: float) -> CellResult:
        """The cell at exactly this point, solved here and now."""
        results = solve_patch(self.subject.grid(plane, (x,), (y,)))
        return self._cell_of(plane, results, (0,), (x, y), (x, y))

    def _at(self, level_x: int, level_y: int, j: int, i: int) -> tuple[float, float]:
        """The parameters of a column and a row of a level."""
        across, up = self.subject.points(CellRange(level_x, j, 1), CellRange(level_y, i, 1))
        return float(across[0]), float(up[0])

    def _atlas_cell(self, plane: PlaneParameters, x: float, y: float) -> CellResult | None:
        subject = self.subject
        if subject.ds is None or plane != subject.plane:
            return None
        point = dict(zip(subject.axes, (x, y), strict=True))
        try:
            places = {name: nearest(subject.ds, name, value) for name, value in point.items()}
            around = {name: slice(max(0, place - 1), place + 2) for name, place in places.items()}
            results = at(subject.part(around), point)
        except (InputError, RunError):  # outside the atlas, or a damaged chunk
            return None
        if results[REGIME.name] == REGIME.meaning(PENDING).name:
            return None
        return CellResult(subject.values(plane, *(results[name] for name in subject.axes)), results, of_atlas=True)

    def _cell_of(
        self,
        plane: PlaneParameters,
        arrays: Arrays,
        place: tuple[int, ...],
        at: tuple[float, float],
        point: tuple[float, float],
    ) -> CellResult:
        """The cell at a place of arrays, which lies at ``at``, as the one nearest to a point."""
        subject, (x, y) = self.subject, at
        results: dict[str, Any] = dict(zip(subject.axes, at, strict=True))
        results["distance"] = dict(zip(subject.axes, (abs(x - point[0]), abs(y - point[1])), strict=True))
        results |= in_words({variable.name: arrays[variable.name][place] for variable in (REGIME, REASON)})
        results |= {name: arrays[name][place].item() for name in subject.numbers}
        return CellResult(subject.values(plane, x, y), results, of_atlas=False)


def child_tiles(key: TileKey) -> list[TileKey]:
    """The four tiles of the next finer level that have the cells of a tile, and those between."""
    x, y = 2 * key.x, 2 * key.y
    return [TileKey(key.level_x + 1, key.level_y + 1, x + i, y + j) for j in (0, 1) for i in (0, 1)]
