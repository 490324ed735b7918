"""The cells of an atlas block by block; cells that records describe are not read."""

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
"""Tiles without a single regime: of several or unknown ones; without a requested cell."""


@dataclass(frozen=True)
class CellBlock:
    """Some cells of a dataset: where they lie along its dimensions, their regimes, and named variables of them."""

    cells: Slices
    regime: NDArray[np.int8]
    values: dict[str, NDArray[Any]]


def iter_cell_blocks(ds: "xr.Dataset", names: Iterable[str], codes: Collection[int]) -> Iterator[CellBlock]:
    """Blocks that together hold every cell of these regimes, with the named variables; other cells may come along.

    Of a store, a block is a run of tiles along its last dimension. A tile that has no such cell by its record is
    not read, the regimes of one that has a single regime neither, and of a pending tile nothing: its block has no
    values. Data that are not what a store holds come as one block.
    """
    wanted = list(dict.fromkeys(names))
    part = find_part(ds, [REGIME.name, *wanted])
    if part is None:
        dims = ds[REGIME.name].dims
        arrays = {name: ds[name].transpose(*dims).values for name in (REGIME.name, *wanted)}
        codes_of_cells = arrays.pop(REGIME.name)
        yield CellBlock(tuple(slice(0, n) for n in codes_of_cells.shape), codes_of_cells, arrays)
        return
    try:
        yield from _walk_part(part, wanted, codes)
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
    """The records of every tile of a store: the code of its only regime, _MIXED, or _NOTHING to read it for."""
    known = part.records.known_mask
    counts = part.records.rows[..., CELLS]
    states = np.where(
        np.count_nonzero(counts, axis=-1) == 1, np.array([r.code for r in REGIMES])[counts.argmax(axis=-1)], _MIXED
    )
    states[~known] = _MIXED
    states[part.records.tiles_without(codes)] = _NOTHING
    states[~part.done] = PENDING if PENDING in codes else _NOTHING
    return states
