"""Exact totals over a block of an atlas's cells: the area of each regime, and the number of cells by reason."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
from numpy.typing import NDArray

from atlas.overview.coarsen import CODES, SHARE
from atlas.query.store_block import PENDING_SHARE, StoreBlock, relative_slices
from atlas.spec.cells import widths_along
from atlas.spec.spec import Slices
from atlas.store.record_format import AREAS, BY_REASON, Rows
from atlas.store.store import AtlasStore
from workers.results import NO_REASON, REASON, REASONS, REGIME


@dataclass(frozen=True)
class StoreTotals:
    """The exact totals of a block of cells of a store, from as few chunks as possible.

    The inside of the block is read at the coarsest level of the overviews that fits, its border at ever finer levels.
    Without overviews, whole tiles are taken from their tile records, which hold counts and areas by regime.
    """

    part: StoreBlock

    def areas(self) -> dict[int, float]:
        """Return the area of the block's cells of each regime, by code; cells count with their widths."""
        total = sum((self._areas(level, piece) for level, piece in self._pieces()), np.zeros(CODES.size))
        return dict(zip(CODES.tolist(), total.tolist(), strict=True))

    def reasons(self) -> NDArray[np.int64]:
        """Return the number of the block's cells for each reason of a missing or uncertain result.

        Their order is that of REASONS. Reasons are read only from tiles that are cut by the border of the block or lack
        a tile record. Tiles whose record counts no reason are not read either.
        """
        levels, cells = self.part.pyramid.levels, self.part.cells
        within, below = np.zeros((2, *self.part.handle.tiling.grid), dtype=bool)
        within[levels.tiles_within(0, cells)] = below[levels.tiles_below(0, cells)] = True
        total, unread = np.zeros(len(REASONS), dtype=np.int64), np.zeros_like(below)
        for tiles, rows, finished in self.part.records.valid_blocks():
            by_reason = rows[..., BY_REASON]
            counted = by_reason.sum(axis=-1)
            complete, blank = within[tiles] & (counted > 0), (counted > 0) & (by_reason[..., NO_REASON] == counted)
            total += by_reason[complete].sum(axis=0).astype(np.int64)
            unread[tiles] = below[tiles] & finished & ~complete & ~blank
        for index in np.argwhere(unread).tolist():
            ends = zip(levels.cells_of(_one(index)), cells, strict=True)
            piece = tuple(slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in ends)
            codes = self.part.pyramid.read(0, REASON.name, piece)
            total += [np.count_nonzero(codes == reason.code) for reason in REASONS]
        return total

    @cached_property
    def _recorded(self) -> tuple[Rows, NDArray[np.bool_]]:
        """The area of each regime in every tile, by the records of the tiles, and the mask of tiles with known areas.

        Unfinished tiles count as pending as a whole.
        """
        areas, pending = self.part.records.columns(AREAS).copy(), ~self.part.finished_mask
        areas[pending, PENDING_SHARE] = _tile_areas(self.part.handle)[pending]
        return areas, self.part.records.known_mask | pending

    def _pieces(self) -> Iterator[tuple[int, Slices]]:
        """Yield the parts of the block to be read, as pairs of an overview level and slices of cells of this level.

        The level is as coarse as possible. Level 0 are the cells; each further level has half as many along every
        dimension. All parts together are the block.
        """
        levels = self.part.pyramid.levels
        inner: Slices | None = None
        for level in range(levels.count, -1, -1):
            ends = zip(self.part.cells, levels.shape_of(level), levels.shape, levels.halvings(level), strict=True)
            outer = tuple(slice(-(-s.start >> k), n if s.stop == all_ else s.stop >> k) for s, n, all_, k in ends)
            if all(s.start < s.stop for s in outer):
                yield from ((level, piece) for piece in _around(outer, inner))
                inner = levels.finer(level, outer) if level else None

    def _areas(self, level: int, piece: Slices) -> NDArray[np.float64]:
        """Return the area of each regime in the cells ``piece`` of an overview level, in the order of CODES.

        Missing parts of an overview are taken from tile records (counts and areas of each tile by regime), or from the
        level below, down to the cells.
        """
        if level == 0:
            return self._areas_of_cells(piece)
        levels = self.part.pyramid.levels
        arrays, missing = self.part.read_stored(level, piece, [REGIME.name, SHARE.name])
        for block in missing:
            arrays[SHARE.name][relative_slices(piece, block)] = 0.0
        total = self._weighed(level, piece, arrays[SHARE.name])
        for block in missing:
            tiles = levels.tiles_below(level, block)
            is_complete = tiles == levels.tiles_within(level, block) and self._recorded[1][tiles].all()
            total = total + (self._added(tiles) if is_complete else self._areas(level - 1, levels.finer(level, block)))
        return total

    def _areas_of_cells(self, piece: Slices) -> NDArray[np.float64]:
        """Return the area of each regime in the stored cells ``piece``, in the order of CODES.

        Whole tiles are taken from their tile records, which hold areas by regime, if they have one.
        """
        levels = self.part.pyramid.levels
        tiles = levels.tiles_within(0, piece)
        if any(s.start >= s.stop for s in tiles) or not self._recorded[1][tiles].any():
            return self._read_areas(piece)
        known = self._recorded[1]
        total = self._added(tiles)
        for side in _around(piece, levels.cells_of(tiles)):
            total = total + self._read_areas(side)
        for index in np.argwhere(~known[tiles]) + [s.start for s in tiles]:
            total = total + self._read_areas(levels.cells_of(_one(index.tolist())))
        return total

    def _added(self, tiles: Slices) -> NDArray[np.float64]:
        """Return the area of each regime, in the order of CODES, summed over the ``tiles`` with a tile record."""
        areas, known = self._recorded
        return np.asarray(areas[tiles][known[tiles]].sum(axis=0))

    def _read_areas(self, piece: Slices) -> NDArray[np.float64]:
        return self._weighed(0, piece, self.part.read(0, piece, [REGIME.name, SHARE.name])[SHARE.name])

    def _weighed(self, level: int, piece: Slices, share: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the area of each regime in the cells ``piece`` of an overview level, in the order of CODES.

        ``share`` is the share of each regime in each cell.
        """
        for width, p in zip(self.part.pyramid.widths[level], piece, strict=True):
            share = np.tensordot(width[p], share, axes=1)
        return np.asarray(share)


def _one(index: list[int]) -> Slices:
    """Return the index of a single tile as slices over the tiles of a store."""
    return tuple(slice(i, i + 1) for i in index)


def _around(outer: Slices, inner: Slices | None) -> Iterator[Slices]:
    """Yield boxes that together cover the box ``outer`` without the box ``inner``, as slices along all dimensions."""
    if inner is None:
        yield outer
        return
    for dim, (out, within) in enumerate(zip(outer, inner, strict=True)):
        for side in (slice(out.start, within.start), slice(within.stop, out.stop)):
            if side.start < side.stop:
                yield (*inner[:dim], side, *outer[dim + 1 :])


def _tile_areas(handle: AtlasStore) -> NDArray[np.float64]:
    """Return the area of every tile in the units that tile records use, as an array over the tiles."""
    widths = zip(widths_along(handle.spec), handle.tile, strict=True)
    along = (np.add.reduceat(width, np.arange(0, width.size, tile)) for width, tile in widths)
    return np.asarray(reduce(np.multiply.outer, along))
