"""The records of the finished tiles of a store: one table, ``tiles/records``, which the coordinator of a run writes.

A worker returns the record of a tile once it has written ``regime``, which makes the tile finished. The coordinator
keeps all records in memory. It writes the changed chunks of the table now and then, and the rest at the end of the run.
No kill leaves a wrong record of a finished tile:

- A record without a ``regime`` belongs to an unfinished tile, and is not read.
- After a kill the records of the last tiles are missing. Such a tile is counted from its chunks, and the next run
  writes its record again.
- Before a damaged tile is dropped its record is removed from the table; likewise all records before the tiles of basins
  get their final labels.
- If the table has records of all tiles, all tiles are finished.

A tile whose record is missing, damaged or does not add up to its cells is counted from its chunks.
"""

import itertools
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import ChunkError, message_of
from atlas.store.record_format import (
    BY_REASON,
    CELLS,
    DIGEST,
    RECORDS,
    WIDTH,
    Index,
    Rows,
    add_up,
    count_row,
    record_block,
)
from atlas.store.store import READERS, AtlasStore, array_by, chunk_key, done_mask, is_done
from atlas.store.tiles import encode_chunks, read_tile, record_of
from workers.results import NO_REASON, REASON, REASONS, REGIME, REGIMES

SAVE_SECONDS = 30.0
"""Minimum seconds between writes of the table during a run; a run that is killed loses at most the records since the
last.
"""
SAVE_SHARE = 100
"""Minimum ratio of the pause after a write of the table of records to the duration of the write."""
Block = tuple[slice, ...]


class TileRecords:
    """The tile records of a store at one moment, read at their first use.

    finished_mask   mask (grid) of the finished tiles: ``finished``, by default found in the store
    known_mask      mask (grid) of the finished tiles with a valid record
    damaged         faults of chunks of the table, by key
    lost            tiles that are finished according to the table, but not by their chunks

    Reading records sets ``damaged`` and ``lost``.
    """

    def __init__(self, handle: AtlasStore, finished: NDArray[np.bool_] | None = None) -> None:
        self.handle, self.damaged, self.lost = handle, dict[str, str](), list[Index]()
        self._columns: dict[tuple[int, int], Rows] = {}
        self._sizes, self._given = handle.tiling.sizes(), finished

    @cached_property
    def _listed(self) -> NDArray[np.bool_]:
        """Mask (grid) of the finished tiles, and of empty files in their place, from a listing of their chunks.

        At a URL, a table with valid records of all tiles makes the listing unnecessary.
        """
        if self.handle.backend.local is None:
            checks = (add_up(rows, self._sizes[block]).all() for block, rows in self._blocks())
            if all(checks):
                return np.ones(self.handle.tiling.grid, dtype=bool)
        return done_mask(self.handle, sized=False)

    @cached_property
    def _masks(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        deque(self.valid_blocks(), maxlen=0)
        return self._masks  # which the end of the blocks has set

    @property
    def finished_mask(self) -> NDArray[np.bool_]:
        """Mask (grid) of the finished tiles."""
        return self._masks[0]

    @property
    def known_mask(self) -> NDArray[np.bool_]:
        """Mask (grid) of the finished tiles that have a valid record."""
        return self._masks[1]

    def valid_blocks(self) -> Iterator[tuple[Block, Rows, NDArray[np.bool_]]]:
        """Yield (tiles, rows, finished) for each chunk of the table of records.

        tiles     slices of the tiles whose records are in the chunk
        rows      (..., WIDTH) the records; zeros for a tile without a valid record
        finished  (...) mask of the finished tiles

        Memory does not grow with the atlas.
        """
        finished = (self._listed if self._given is None else self._given).copy()
        known, self.lost = np.zeros_like(finished), []
        for block, rows in self._blocks():
            valid = add_up(rows, self._sizes[block])
            if self._given is None:  # no empty file has a record: a tile is flushed before its record is written
                keys = {chunk_key(self.handle.regime, tile): tile for tile in _tiles(finished[block] & ~valid, block)}
                for key in keys.keys() - self.handle.backend.whole_keys(keys):
                    finished[keys[key]] = False
            self.lost += _tiles(valid & ~finished[block], block)
            known[block] = valid & finished[block]
            rows[~known[block]] = 0.0
            yield block, rows, finished[block]
        self._masks = finished, known

    def columns(self, part: slice = slice(0, WIDTH)) -> Rows:
        """Return columns of the records of all tiles, (grid..., columns); by default all columns.

        A tile without a valid record has zeros.
        """
        values = self._columns.get((part.start, part.stop))
        if values is None:
            values = np.zeros((*self.handle.tiling.grid, part.stop - part.start))
            for block, rows, _ in self.valid_blocks():
                values[block] = rows[..., part]
            self._columns[part.start, part.stop] = values
        return values

    def tiles_without(self, codes: Iterable[int]) -> NDArray[np.bool_]:
        """Return the mask (grid) of the tiles that have, by their records, no cell of the regimes with these codes."""
        code_mask = np.isin([regime.code for regime in REGIMES], list(codes))
        return self.known_mask & (self.columns(CELLS)[..., code_mask].sum(axis=-1) == 0)

    def _blocks(self) -> Iterator[tuple[Block, Rows]]:
        """Yield the content of each chunk of the table of records: the slices of its tiles, and their records (...,
        WIDTH).
        """
        table, grid = _table(self.handle), self.handle.tiling.grid
        for block in _blocks_of(grid):
            try:
                yield block, np.asarray(table[block], dtype=np.float64)
            except OSError:
                raise
            except Exception as error:  # a codec that reads damaged bytes may raise anything
                self.damaged[_chunk_key(block, grid)] = f"is damaged ({message_of(error)})"
                yield block, np.zeros((*(part.stop - part.start for part in block), WIDTH))


class RunTileRecords:
    """The tile records of a store during a run, in the memory of the coordinator.

    They begin as ``records``, those in the store; each report of a finished tile adds one.
    """

    def __init__(self, handle: AtlasStore, records: TileRecords) -> None:
        self._handle, self._rows, self._done = handle, records.columns().copy(), records.finished_mask.copy()
        grid, self._next = handle.tiling.grid, time.monotonic() + SAVE_SECONDS
        self._changed = {_block_index(index, grid) for index in records.lost}  # solved again, they may differ in bits
        self._total = self._rows.reshape(-1, WIDTH).sum(axis=0)

    def add(self, index: Index, row: Sequence[float]) -> None:
        """Add the record of a finished tile."""
        new = np.array(row)
        self._total += new - self._rows[index]
        self._rows[index], self._done[index] = new, True
        self._changed.add(_block_index(index, self._handle.tiling.grid))

    @property
    def counts(self) -> dict[str, Any] | None:
        """Contents of the store by its records: finished tiles, cells by regime and by reason.

        None if a finished tile has no record.
        """
        if self._uncounted.any():
            return None
        regimes, reasons = counts_by_name(self._total)
        return {"tiles": int(self._done.sum()), "regimes": regimes, "reasons": reasons}

    @property
    def _uncounted(self) -> NDArray[np.bool_]:
        return self._done & ~self._rows.any(axis=-1)

    def save(self) -> None:
        """Write the changed chunks of the table of records, if the last write was long enough ago."""
        begin = time.monotonic()
        if begin >= self._next and self._changed:
            self.write()
            end = time.monotonic()
            self._next = end + max(SAVE_SECONDS, SAVE_SHARE * (end - begin))

    def clear_table(self) -> None:
        """Remove all records from the table in the store, but not from memory, since tiles are about to change."""
        self._handle.backend.confirm_lease()
        keys = [_chunk_key(block, self._handle.tiling.grid) for block in _blocks_of(self._handle.tiling.grid)]
        self._handle.backend.remove_all(keys)
        self._changed.update(itertools.product(*map(range, _table_grid(self._handle.tiling.grid))))

    def finish(self, on_wait: Callable[[int], None] = lambda _tiles: None) -> None:
        """Complete the table of records and write it. Missing records are made by reading their tiles.

        ``on_wait`` is called with the number of tiles that have to be read.
        """
        uncounted = [tuple(index) for index in np.argwhere(self._uncounted).tolist()]
        if uncounted:
            on_wait(len(uncounted))
        for index in uncounted:
            try:
                self.add(index, record_of(self._handle, index, read_tile(self._handle, index)).tolist())
            except ChunkError:
                continue  # a verification reports it
        self.write()

    def write(self) -> None:
        """Write the changed chunks of the table of records."""
        if self._changed:
            write_records(self._handle, self._rows, self._changed)
            self._changed.clear()


def complete_records(handle: AtlasStore) -> None:
    """Make and write the records that the table of a store lacks. No run may write the store meanwhile."""
    RunTileRecords(handle, TileRecords(handle, done_mask(handle))).finish()


def write_records(handle: AtlasStore, rows: Rows, chunks: Iterable[Index] | None = None) -> None:
    """Write chunks of the table of records from ``rows`` (grid..., WIDTH), the records of all tiles.

    ``chunks`` are the indices of the chunks, by default all. Chunks without a record are removed.
    """
    table, grid = _table(handle), handle.tiling.grid
    handle.backend.confirm_lease()
    for block in _blocks_of(grid):
        if chunks is None or _block_index(tuple(part.start for part in block), grid) in chunks:
            if rows[block].any():
                handle.backend.put_all(encode_chunks(table, (*block, slice(0, WIDTH)), rows[block]))
            else:
                handle.backend.remove(_chunk_key(block, grid))


def forget_records(handle: AtlasStore, tiles: Iterable[Index]) -> None:
    """Remove the records of these tiles from the table, which must happen before the tiles themselves are dropped."""
    rows = TileRecords(handle).columns()
    for index in tiles:
        rows[index] = 0.0
    write_records(handle, rows)


EXCHANGED = "its digest does not match: its chunks were swapped with another tile's, or altered"


def is_exchanged(records: TileRecords, index: Index, row: Rows) -> bool:
    """Return True if the digest in a tile's stored record differs from that of ``row``, computed from the tile's cells.

    The tile's chunks were then swapped with another tile's, or altered.
    """
    digest = records.columns(DIGEST)[index]
    return bool(digest.any()) and not np.array_equal(digest, row[DIGEST])


def count_tiles(handle: AtlasStore, tiles: Sequence[Index]) -> Iterator[Rows | ChunkError]:
    """Count the cells of tiles by regime and reason, from their chunks. Yield one item for each tile, in order.

    An item is the tile's record (WIDTH,) with the digest left at zero, or the error that names a damaged chunk. A tile
    that is not finished has a record of zeros.
    """

    def count_one(index: Index) -> Rows | ChunkError:
        try:
            classes = read_tile(handle, index, (REGIME.name, REASON.name))
        except ChunkError as error:
            return error if is_done(handle, index) else np.zeros(WIDTH)
        return count_row(handle.spec, handle.tiling.at(index).slices, handle.dominant_arrays(classes))

    with ThreadPoolExecutor(READERS) as readers:
        yield from readers.map(count_one, tiles)


def counts_by_name(total: Rows) -> tuple[dict[str, int], dict[str, int]]:
    """Return the numbers of cells by name of the regime and by text of the reason, from a sum of records (WIDTH,).

    Zeros are left out.
    """
    cells, reasons = total[CELLS].astype(int).tolist(), total[BY_REASON].astype(int).tolist()
    regimes = {regime.name: count for regime, count in zip(REGIMES, cells, strict=True) if count}
    named = {r.text: count for r, count in zip(REASONS, reasons, strict=True) if count and r.code != NO_REASON}
    return regimes, named


def _tiles(mask: NDArray[np.bool_], block: Block) -> list[Index]:
    """Return the indices of the tiles that are True in ``mask``, a mask over the tiles with slices ``block``."""
    return [tuple(index) for index in (np.argwhere(mask) + [part.start for part in block]).tolist()]


def _table(handle: AtlasStore) -> Any:
    return array_by(handle.backend, RECORDS, handle.nodes[RECORDS])


def _table_grid(grid: Index) -> Index:
    """Return the number of chunks of the table of records along each dimension, for a ``grid`` of tiles."""
    return tuple(-(-n // side) for n, side in zip(grid, record_block(grid), strict=True))


def _blocks_of(grid: Index) -> Iterator[Block]:
    """Yield, for each chunk of the table of records, the slices of its tiles along each dimension."""
    ends = record_block(grid)
    for index in itertools.product(*map(range, _table_grid(grid))):
        yield tuple(slice(i * side, min((i + 1) * side, n)) for i, side, n in zip(index, ends, grid, strict=True))


def _block_index(index: Index, grid: Index) -> Index:
    """Return the index of the chunk of the table of records that has the record of a tile."""
    return tuple(i // side for i, side in zip(index, record_block(grid), strict=True))


def _chunk_key(block: Block, grid: Index) -> str:
    index = _block_index(tuple(part.start for part in block), grid)
    return f"{RECORDS}/{'.'.join(['c', *map(str, index), '0'])}"
