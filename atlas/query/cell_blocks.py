"""Iteration over the cells of an atlas in blocks, without reading tiles that hold no cell of interest.

The tile records, counts of the cells of each tile by regime, tell what a tile holds.
"""

import itertools
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.query.read_counter import count_reads
from atlas.query.store_block import StoreBlock, find_part
from atlas.spec.spec import Slices
from atlas.store.record_format import CELLS
from workers.results import PENDING, REGIME, REGIMES

if TYPE_CHECKING:
    import xarray as xr

_MIXED = REGIMES[-1].code + 1
_NOTHING = _MIXED + 1
"""Codes of tiles beyond those of regimes: _MIXED has several or unknown regimes, _NOTHING no requested cell."""


@dataclass(frozen=True)
class CellBlock:
    """A rectangular block of cells of a dataset.

    cells   slices of the block along the dimensions of the dataset
    regime  codes of the regimes of the cells
    values  requested variables of the cells, by name; empty for a block that is not solved yet (pending)
    """

    cells: Slices
    regime: NDArray[np.int8]
    values: dict[str, NDArray[Any]]


def iter_cell_blocks(ds: "xr.Dataset", names: Iterable[str], codes: Collection[int]) -> Iterator[CellBlock]:
    """Yield blocks of cells that together contain every cell with one of the regimes ``codes``.

    ds      the dataset
    names   names of the variables that the blocks have
    codes   codes of the regimes

    Blocks may contain other cells, too. In a store a block is a row of consecutive tiles along the last dimension.
    Tiles without a requested cell, by their tile records, are not read. Of a tile with a single regime the regimes are
    not read, and of a pending tile nothing is. A dataset that does not show a store is one block.
    """
    requested = list(dict.fromkeys(names))
    part = find_part(ds, [REGIME.name, *requested])
    if part is None:
        dims = ds[REGIME.name].dims
        arrays = {name: ds[name].transpose(*dims).values for name in (REGIME.name, *requested)}
        codes_of_cells = arrays.pop(REGIME.name)
        yield CellBlock(tuple(slice(0, n) for n in codes_of_cells.shape), codes_of_cells, arrays)
        return
    try:
        yield from _walk_part(part, requested, codes)
    finally:
        count_reads(part.chunks_read)


def _walk_part(part: StoreBlock, names: list[str], codes: Collection[int]) -> Iterator[CellBlock]:
    states, levels = _states(part, codes), part.pyramid.levels
    tiles = levels.tiles_below(0, part.cells)
    for row in itertools.product(*(range(s.start, s.stop) for s in tiles[:-1])):
        along = range(tiles[-1].start, tiles[-1].stop)
        for state, run in itertools.groupby(along, key=lambda k, row=row: int(states[(*row, k)])):  # type: ignore[misc]
            columns = list(run)
            if state == _NOTHING:
                continue
            index = (*(slice(i, i + 1) for i in row), slice(columns[0], columns[-1] + 1))
            ends = zip(levels.cells_of(index), part.cells, strict=True)
            piece = tuple(slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in ends)
            cells = tuple(slice(p.start - c.start, p.stop - c.start) for p, c in zip(piece, part.cells, strict=True))
            values = {} if state == PENDING else {name: part.pyramid.read(0, name, piece) for name in names}
            values = {name: part.as_given(stored) for name, stored in values.items()}
            if state == _MIXED:
                regime = part.pyramid.read(0, REGIME.name, piece)
            else:
                regime = np.full(tuple(p.stop - p.start for p in piece), state, np.int8)
            yield CellBlock(cells[1:] if part.drops_stack_dim else cells, part.as_given(regime), values)


def _states(part: StoreBlock, codes: Collection[int]) -> NDArray[np.int64]:
    """Return for every tile of a store what must be read of it, as a code.

    The code is that of the tile's only regime, _MIXED for several or unknown regimes, or _NOTHING if no cell has one of
    the regimes ``codes``.
    """
    known = part.records.known_mask
    counts = part.records.columns(CELLS)
    states = np.where(
        np.count_nonzero(counts, axis=-1) == 1, np.array([r.code for r in REGIMES])[counts.argmax(axis=-1)], _MIXED
    )
    states[~known] = _MIXED
    states[part.records.tiles_without(codes)] = _NOTHING
    states[~part.finished_mask] = PENDING if PENDING in codes else _NOTHING
    return states
