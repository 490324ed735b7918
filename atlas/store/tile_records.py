"""The records of the finished tiles of a store: one per tile, and one chunk with all of them, the compaction.

A worker writes the record of a tile right before its ``regime``, which makes the tile finished. At its end a run
compacts all records into one chunk and removes the single records, so that a few objects describe a finished atlas. No
kill leaves a wrong record of a finished tile:

- A record without a ``regime`` belongs to an unfinished tile, and is not read.
- Before a damaged tile is dropped, an empty record replaces its record; likewise before a tile of basins gets its final
  labels. The empty record takes precedence over the tile's row in the compaction. After a kill there the tile is
  unchanged, and is counted from its chunks.
- A single record takes precedence over the compaction, so a kill between writing the compaction and removing single
  records does no harm. A record is removed only if no worker of the run may still write its tile. Readers list the
  single records first, and start again if one has been removed meanwhile.
- If a compaction has rows of all tiles, and there is no single record, all tiles are finished.

A tile whose row is missing, damaged or does not add up to its cells is counted from its chunks.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import ChunkError, UnlistedError, message_of
from atlas.store.record_format import (
    BY_REASON,
    CELLS,
    DIGEST,
    RECORD,
    RECORDS,
    WIDTH,
    Index,
    Rows,
    add_up,
    count_row,
    decode_row,
    record_index,
    record_key,
)
from atlas.store.store import READERS, AtlasStore, array_by, done_tiles, is_done
from atlas.store.tiles import encode_chunks, read_tile
from workers.results import NO_REASON, REASON, REASONS, REGIME, REGIMES

_LOOKS = 10


class TileRecords:
    """The tile records of a store at one moment, read at their first use.

    done         mask (grid) of the finished tiles: those of ``listed``, by default from a listing of the store
    rows         rows of all tiles, zeros for a tile without a valid row
    known_mask   mask of the tiles with a valid row
    damaged      faults of records, by key
    lost         tiles that are finished according to the compaction, but not by their chunks
    single       tiles with a record of their own, finished or not

    Reading ``rows`` sets the last three.
    """

    def __init__(self, handle: AtlasStore, listed: Iterable[Index] | None = None) -> None:
        self.handle, self.damaged = handle, dict[str, str]()
        self.lost, self.single = list[Index](), list[Index]()
        self._sizes, self._listed = handle.tiling.sizes(), listed

    @cached_property
    def done(self) -> NDArray[np.bool_]:
        """See the class. Two objects are enough for a finished atlas; otherwise a listing is needed."""
        if self._whole is not None:
            return np.ones(self.handle.tiling.grid, dtype=bool)
        done = np.zeros(self.handle.tiling.grid, dtype=bool)
        for index in done_tiles(self.handle) if self._listed is None else self._listed:
            done[index] = True
        return done

    @cached_property
    def rows(self) -> Rows:
        """See the class."""
        rows = self._read() if self._whole is None else self._whole
        self.lost = _indices(add_up(rows, self._sizes) & ~self.done)
        rows[~(add_up(rows, self._sizes) & self.done)] = 0.0
        return rows

    @cached_property
    def known_mask(self) -> NDArray[np.bool_]:
        """See the class."""
        return np.asarray(self.rows.any(axis=-1))

    def tiles_without(self, codes: Iterable[int]) -> NDArray[np.bool_]:
        """Return the mask of the tiles without a cell of these regimes, according to their records."""
        asked = np.isin([regime.code for regime in REGIMES], list(codes))
        return self.known_mask & (self.rows[..., CELLS][..., asked].sum(axis=-1) == 0)

    @cached_property
    def _whole(self) -> Rows | None:
        """The compaction, if it has all tiles and no record is newer; None on a disk, where listing is cheap."""
        on_disk = self.handle.backend.local is not None
        if on_disk or self._listed is not None or single_records(self.handle):
            return None
        rows = self._compacted()
        return rows if add_up(rows, self._sizes).all() else None

    def _compacted(self) -> Rows:
        none = np.zeros((*self.handle.tiling.grid, WIDTH))
        try:
            rows = np.asarray(_compaction(self.handle)[...], dtype=np.float64)
        except OSError:
            raise
        except Exception as error:  # a codec that reads damaged bytes may raise anything
            self.damaged[RECORDS] = f"is damaged ({message_of(error)})"
            return none
        return rows if rows.shape == none.shape else none

    def _read(self) -> Rows:
        """Return the rows of the compaction, replaced by single records where they exist."""
        done = self.done  # read before the records: every finished tile then has a record
        for _ in range(_LOOKS):
            self.single = single_records(self.handle)
            rows = self._compacted()
            empty, without = not rows.any(), done & ~rows.any(axis=-1)
            for index in self.single:
                rows[index], without[index] = 0.0, False
            wanted = {record_key(index): index for index in self.single if done[index]}
            stored = self.handle.backend.get_all(wanted)
            if stored.keys() == wanted.keys():
                break
        if empty and without.any():
            self.damaged.setdefault(RECORDS, "is missing")
        for key, data in stored.items():
            row = decode_row(data)
            if row is None:
                self.damaged[key] = "is damaged"
            else:
                rows[wanted[key]] = row
        return rows


class RunTileRecords:
    """The tile records of a store during a run, in the memory of the coordinator.

    They are the earlier ``records``, and the records of reports. ``unfinished`` is a mask of the tiles that workers may
    write.
    """

    def __init__(self, handle: AtlasStore, records: TileRecords, unfinished: NDArray[np.bool_]) -> None:
        self._handle, self._rows, self._open = handle, records.rows.copy(), unfinished.copy()
        self._new = bool(records.single)
        self._done = records.done.copy()
        self._total = self._rows.reshape(-1, WIDTH).sum(axis=0)

    def add(self, index: Index, row: Sequence[float]) -> None:
        """Add the record of a finished tile; an empty ``row`` if the record is unknown."""
        new = np.array(row) if len(row) == WIDTH else np.zeros(WIDTH)
        self._total += new - self._rows[index]
        self._rows[index], self._done[index], self._open[index], self._new = new, True, False, True

    @property
    def counts(self) -> dict[str, Any] | None:
        """Contents of the store: finished tiles, cells by regime and by reason; None if some tiles are not counted."""
        if self._uncounted.any():
            return None
        regimes, reasons = counts_by_name(self._total)
        return {"tiles": int(self._done.sum()), "regimes": regimes, "reasons": reasons}

    @property
    def _uncounted(self) -> NDArray[np.bool_]:
        return self._done & ~self._rows.any(axis=-1)

    def compact(self, on_wait: Callable[[int], None] = lambda _tiles: None) -> None:
        """Compact all records into one chunk.

        Tiles without a record are counted from their chunks; ``on_wait`` is called with their number.
        """
        uncounted = _indices(self._uncounted & ~self._open)
        if uncounted:
            on_wait(len(uncounted))
        for index, row in zip(uncounted, count_tiles(self._handle, uncounted), strict=True):
            if not isinstance(row, ChunkError):
                self._rows[index] = row
        if self._new or uncounted:
            write_compaction(self._handle, self._rows, ~self._open)


def compact_records(handle: AtlasStore) -> None:
    """Compact all records of a store that no run writes."""
    none = np.zeros(handle.tiling.grid, dtype=bool)
    RunTileRecords(handle, TileRecords(handle, done_tiles(handle)), none).compact()


def write_compaction(handle: AtlasStore, rows: Rows, settled: NDArray[np.bool_]) -> None:
    """Write all rows as one chunk, then remove the single records of ``settled`` tiles with a row in the chunk."""
    handle.backend.put_all(encode_chunks(_compaction(handle), tuple(map(slice, rows.shape)), rows))
    counts = settled & add_up(rows, handle.tiling.sizes())
    handle.backend.remove_all([record_key(index) for index in single_records(handle) if counts[index]])


EXCHANGED = "its digest does not match: its chunks were swapped with another tile's, or altered"


def is_exchanged(records: TileRecords, index: Index, row: Rows) -> bool:
    """Return True if the record of a finished tile has another digest than ``row``.

    ``row`` is the record computed from the cells of the tile.
    """
    digest = records.rows[index][DIGEST]
    return bool(digest.any()) and not np.array_equal(digest, row[DIGEST])


def read_record(handle: AtlasStore, index: Index) -> Rows | None:
    """Return the single record of a tile; None if it is missing or damaged."""
    data = handle.backend.get(record_key(index))
    return None if data is None else decode_row(data)


def single_records(handle: AtlasStore) -> list[Index]:
    """Return the indices of the tiles with a record of their own, finished or not, from one listing.

    Return an empty list for a server without listings: a finished atlas has no single records, and no other atlas can
    be counted there.
    """
    try:
        indices = [record_index(key, handle.tiling.grid) for key in handle.backend.list_keys(f"{RECORD}/")]
    except UnlistedError:
        return []
    return sorted(index for index in indices if index is not None)


def count_tiles(handle: AtlasStore, tiles: Sequence[Index]) -> Iterator[Rows | ChunkError]:
    """Yield the rows of finished tiles, without digests, from their chunks, and the error of each damaged tile.

    The row of a tile that is no longer finished is zero.
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
    """Return the positive counts in a sum of rows, by name of the regime and by text of the reason."""
    cells, reasons = total[CELLS].astype(int).tolist(), total[BY_REASON].astype(int).tolist()
    regimes = {regime.name: count for regime, count in zip(REGIMES, cells, strict=True) if count}
    named = {r.text: count for r, count in zip(REASONS, reasons, strict=True) if count and r.code != NO_REASON}
    return regimes, named


def _compaction(handle: AtlasStore) -> Any:
    return array_by(handle.backend, RECORDS, handle.nodes[RECORDS])


def _indices(mask: NDArray[np.bool_]) -> list[Index]:
    return [tuple(index) for index in np.argwhere(mask).tolist()]
