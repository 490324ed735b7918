"""Looking up the known cells of the explorer, from the atlas or from tiles that were solved for a page."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from atlas.errors import InputError, RunError
from atlas.explore.compose import VisibleCells, compose_view, seen_atlas
from atlas.explore.grid_patch import solve_patch
from atlas.explore.subject import Arrays, PlaneParameters
from atlas.explore.tile_cache import TileCache
from atlas.explore.viewport import STAGES, TILE_CELLS, CellRange, TileKey, Viewport
from atlas.query.queries import nearest_cell
from atlas.query.window import nearest
from workers.results import PENDING, REASON, REGIME, in_words

MOST_VIEWS = 4
"""Maximum number of viewports whose cells, as read from the atlas, are cached.

A page draws the cells of its viewport again with each solved tile. The cache is refilled when the finished tiles of the
atlas are listed anew.
"""


@dataclass(frozen=True)
class CellResult:
    """The results of a cell that was looked up.

    parameters   value of each parameter, by name
    results      results by name, in the form that the dataset accessor ``at`` returns
    of_atlas     True for a cell of the atlas, False for a cell that the explorer solved
    """

    parameters: dict[str, float]
    results: dict[str, Any]
    of_atlas: bool


class CellLookup:
    """Looks up the known cells of a subject, in tiles in memory and in the atlas."""

    def __init__(self, tiles: TileCache) -> None:
        self.tiles, self.subject = tiles, tiles.subject
        self._base = lru_cache(MOST_VIEWS)(lambda sight, names, listed_at: seen_atlas(self.subject, sight, names))

    def visible_cells(self, plane: PlaneParameters, viewport: Viewport, names: Iterable[str]) -> VisibleCells:
        """Return the visible cells of a viewport as a dataset with the variables ``names``.

        Cells that are not known are pending.
        """
        variable_names = list(names)
        base = (
            self._base(viewport, tuple(variable_names), self.tiles.listed_at) if plane == self.subject.plane else None
        )
        return compose_view(
            self.subject, plane, viewport, self.tiles.visible_tiles(plane, viewport), variable_names, base
        )

    def cell(self, plane: PlaneParameters, viewport: Viewport, x: float, y: float) -> CellResult | None:
        """Return the known cell at a point (x, y), from the finest known level; None if no cell is known there.

        plane      the fixed parameters
        viewport   the ranges of visible cells, whose levels are the finest that are searched
        x, y       values of the axes
        """
        for stage in range(max(STAGES, viewport.x.level, viewport.y.level) + 1):
            level_x, level_y = viewport.x.level - stage, viewport.y.level - stage
            if min(level_x, level_y) < 0:
                atlas_cell = self._atlas_cell(plane, x, y)
                if atlas_cell is not None:
                    return atlas_cell
            j, i = self.subject.x.nearest(level_x, x), self.subject.y.nearest(level_y, y)
            key = TileKey(level_x, level_y, j // TILE_CELLS, i // TILE_CELLS)
            arrays = self.tiles.full_tile(plane, key)
            if arrays is not None:
                return self._cell_of(
                    plane, arrays, (i % TILE_CELLS, j % TILE_CELLS), self._at(level_x, level_y, j, i), (x, y)
                )
        return self._atlas_cell(plane, x, y)

    def point(self, plane: PlaneParameters, viewport: Viewport, x: float, y: float) -> tuple[float, float]:
        """Return the point of the cell nearest to (x, y).

        The cell is one of the viewport, or one of the atlas if the atlas has denser cells.
        """
        if min(viewport.x.level, viewport.y.level) < 0:
            atlas_cell = self._atlas_cell(plane, x, y)
            if atlas_cell is not None:
                return self.subject.point(atlas_cell.parameters)[1:]
        j, i = self.subject.x.nearest(viewport.x.level, x), self.subject.y.nearest(viewport.y.level, y)
        return self._at(viewport.x.level, viewport.y.level, j, i)

    def solve_cell(self, plane: PlaneParameters, x: float, y: float) -> CellResult:
        """Solve the cell at exactly the point (x, y), in the calling thread, and return it."""
        results = solve_patch(self.subject.grid(plane, (x,), (y,)))
        return self._cell_of(plane, results, (0,), (x, y), (x, y))

    def _at(self, level_x: int, level_y: int, j: int, i: int) -> tuple[float, float]:
        """Return the values of the axes at column ``j`` of zoom level ``level_x`` and row ``i`` of ``level_y``."""
        across, up = self.subject.points(CellRange(level_x, j, 1), CellRange(level_y, i, 1))
        return float(across[0]), float(up[0])

    def _atlas_cell(self, plane: PlaneParameters, x: float, y: float) -> CellResult | None:
        subject = self.subject
        if subject.ds is None or plane != subject.plane:
            return None
        point = dict(zip(subject.axes, (x, y), strict=True))
        try:
            places = {name: nearest(subject.ds, name, value) for name, value in point.items()}
            around = {name: slice(max(0, index - 1), index + 2) for name, index in places.items()}
            results = nearest_cell(subject.part(around), point)
        except (InputError, RunError):  # outside the atlas, or a damaged chunk
            return None
        if results[REGIME.name] == REGIME.meaning(PENDING).name:
            return None
        return CellResult(subject.values(plane, *(results[name] for name in subject.axes)), results, of_atlas=True)

    def _cell_of(
        self,
        plane: PlaneParameters,
        arrays: Arrays,
        index: tuple[int, ...],
        at: tuple[float, float],
        point: tuple[float, float],
    ) -> CellResult:
        """Return one cell of result arrays as a ``CellResult``.

        plane    the fixed parameters
        arrays   results of many cells, by name
        index    index of the cell in the arrays
        at       the cell's values of both axes
        point    the point that was looked up; the results contain its distance from the cell
        """
        subject, (x, y) = self.subject, at
        results: dict[str, Any] = dict(zip(subject.axes, at, strict=True))
        results["distance"] = dict(zip(subject.axes, (abs(x - point[0]), abs(y - point[1])), strict=True))
        results |= in_words({variable.name: arrays[variable.name][index] for variable in (REGIME, REASON)})
        results |= {name: arrays[name][index].item() for name in subject.numbers}
        return CellResult(subject.values(plane, x, y), results, of_atlas=False)
