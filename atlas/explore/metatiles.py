"""The metatiles of a store's zoom levels: which metatile contains which tile, and reading their tiles.

A metatile is a store of its own within the store: a block of one zoom level of a plane.
"""

import threading
import time
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from atlas.errors import InputError, RunError
from atlas.explore.subject import Arrays, PlaneParameters, Subject
from atlas.explore.viewport import TILE_CELLS, CellRange, TileKey
from atlas.store.create import create_store, remove_half_made
from atlas.store.object_backend import StoreBackend
from atlas.store.store import AtlasStore, chunk_key, done_tiles, open_store
from atlas.store.tiles import is_blank
from atlas.store.zoom import drop_metatile, make_plane, metatile_backend

METATILE_TILES = 16
"""Number of tiles of a metatile along each axis."""
MAX_OPEN = 64
"""Maximum number of metatiles that are open at a time."""
MAX_ABSENT = 4096
"""Maximum number of metatiles remembered as absent."""
MAX_PLANES = 256
"""Maximum number of planes whose digests are cached."""
RELIST_SECONDS = 5.0
"""Time, in seconds, after which tiles are listed anew, since other explorers and runs may have written some."""

Span = tuple[range, range]


class MetatileKey(NamedTuple):
    """A metatile of a plane: its levels and its indices along x and along y."""

    level_x: int
    level_y: int
    x: int
    y: int

    @classmethod
    def from_tile(cls, key: TileKey) -> "MetatileKey":
        """Return the key of the metatile that contains a tile."""
        return cls(key.level_x, key.level_y, key.x // METATILE_TILES, key.y // METATILE_TILES)

    @property
    def name(self) -> str:
        """The name of the metatile's folder."""
        return f"x{self.level_x}_y{self.level_y}_{self.x}_{self.y}"


@dataclass
class Metatile:
    """An open metatile.

    handle       handle of the metatile's store
    first_tile   row and column of its first tile in the level
    arrays       arrays of the store, by name
    done         indices of its finished tiles
    damaged      indices of its damaged tiles
    listed_at    time at which its tiles were listed, in seconds of ``time.monotonic``
    refused_at   time at which the disk last refused to read the metatile
    """

    handle: AtlasStore
    first_tile: tuple[int, int]
    arrays: dict[str, Any]
    done: set[tuple[int, ...]]
    damaged: set[tuple[int, ...]] = field(default_factory=set)
    listed_at: float = 0.0
    refused_at: float = float("-inf")

    def index(self, key: TileKey) -> tuple[int, int]:
        """Return the index of a tile in the metatile."""
        return key.y - self.first_tile[0], key.x - self.first_tile[1]


class MetatileCatalog:
    """The metatiles of a subject in its store.

    ``seen`` has the time at which each metatile was last viewed, until that time is written to the store.
    """

    def __init__(self, subject: Subject, handle: AtlasStore) -> None:
        self._subject, self._handle, self._lock = subject, handle, threading.RLock()
        self._open: OrderedDict[tuple[PlaneParameters, MetatileKey], Metatile] = OrderedDict()
        self._absent: OrderedDict[tuple[PlaneParameters, MetatileKey], float] = OrderedDict()
        self.seen: dict[tuple[str, str], float] = {}
        self._refusal = float("-inf"), ""
        self.digest = lru_cache(MAX_PLANES)(lambda plane: subject.digest(plane)[:16])

    @property
    def counts(self) -> dict[str, int]:
        """Number of open metatiles, and of metatiles remembered as absent."""
        with self._lock:
            return {"open": len(self._open), "absent": len(self._absent)}

    @property
    def trouble(self) -> str:
        """Why saved tiles could not be read a moment ago; empty if nothing was wrong."""
        when, said = self._refusal
        return said if time.monotonic() - when < 2.0 * RELIST_SECONDS else ""

    def find(self, plane: PlaneParameters, key: MetatileKey) -> Metatile | None:
        """Return an open metatile, None if it does not exist yet. Tiles that other processes write are listed now and
        then.
        """
        at, now = (plane, key), time.monotonic()
        with self._lock:
            if at in self._open:
                self._open.move_to_end(at)
                sheet = self._open[at]
                if now - sheet.listed_at > RELIST_SECONDS:
                    sheet.listed_at = now
                    try:
                        sheet.done = done_tiles(sheet.handle) - sheet.damaged
                    except (OSError, RunError) as error:
                        self._was_refused(error)
                return sheet
            if now - self._absent.get(at, -RELIST_SECONDS) < RELIST_SECONDS:
                return None
            span = self.span(key)
            if span is not None:
                try:
                    return self._opened(at, self._place(plane, key), span)
                except Exception as error:  # as in ``_read``; a damaged metatile is created anew
                    self._was_refused(error)
            self._absent[at] = now
            self._absent.move_to_end(at)
            while len(self._absent) > MAX_ABSENT:
                self._absent.popitem(last=False)
            return None

    def create(self, handle: AtlasStore, plane: PlaneParameters, key: MetatileKey, span: Span) -> Metatile:
        """Create a metatile and return it open.

        handle   handle of the store that writes behind the fence of the lease
        plane    plane of the metatile
        key      key of the metatile
        span     rows and columns of its tiles

        If another explorer has created the metatile meanwhile, return that one. A damaged metatile, which cannot be
        opened, is created anew. Raise OSError if the disk refuses.
        """
        at, place = (plane, key), metatile_backend(handle, self.digest(plane), key.name)
        try:
            with self._lock:
                return self._opened(at, place.with_fence(None), span)
        except Exception as error:
            if _refused(error):
                raise
        drop_metatile(handle, self.digest(plane), key.name)
        subject, digest, (rows, columns) = self._subject, self.digest(plane), span
        x = CellRange(key.level_x, columns.start * TILE_CELLS, len(columns) * TILE_CELLS)
        y = CellRange(key.level_y, rows.start * TILE_CELLS, len(rows) * TILE_CELLS)
        described = {
            "long_name": "a plane as it was looked at",
            "parameters": dict(plane.parameters),
            "solve": dict(vars(subject.settings)),
            "digest": subject.digest(plane),
        }
        make_plane(handle, digest, described)
        if place.local is not None:
            remove_half_made(place.local)
        create_store(place, subject.spec_of(plane, *subject.points(x, y)), (TILE_CELLS, TILE_CELLS))
        with self._lock:
            return self._opened(at, place.with_fence(None), span)

    def close(self, digest: str, name: str) -> None:
        """Forget a deleted metatile, by the names of its plane and of its folder."""
        with self._lock:
            for plane, key in [at for at in self._open if (self.digest(at[0]), at[1].name) == (digest, name)]:
                del self._open[plane, key]

    def has(self, plane: PlaneParameters, key: TileKey) -> bool:
        """Return True if a tile is saved and the disk has not just refused to read its metatile."""
        with self._lock:
            sheet = self.find(plane, MetatileKey.from_tile(key))
            return (
                sheet is not None
                and sheet.index(key) in sheet.done
                and time.monotonic() - sheet.refused_at > RELIST_SECONDS
            )

    def load(self, plane: PlaneParameters, keys: Sequence[TileKey], names: Sequence[str]) -> dict[TileKey, Arrays]:
        """Return the variables ``names`` of the saved tiles that can be read."""
        wanted, read = dict[MetatileKey, list[TileKey]](), dict[TileKey, Arrays]()
        for key in keys:
            if self.has(plane, key):
                wanted.setdefault(MetatileKey.from_tile(key), []).append(key)
        for of, tiles in wanted.items():
            sheet = self.find(plane, of)
            if sheet is not None:
                read |= self._read(sheet, tiles, names)
                self.mark_viewed(plane, of)
        return read

    def mark_viewed(self, plane: PlaneParameters, key: MetatileKey) -> None:
        """Record that a metatile is viewed now."""
        with self._lock:
            self.seen[self.digest(plane), key.name] = time.time()

    def pop_view_times(self) -> dict[tuple[str, str], float]:
        """Return and clear the times at which metatiles were last viewed, to be written to the store."""
        with self._lock:
            seen, self.seen = self.seen, {}
            return seen

    def mark_written(self, sheet: Metatile, index: tuple[int, int]) -> None:
        """Record that a tile is written."""
        with self._lock:
            sheet.damaged.discard(index)
            sheet.done.add(index)

    def _read(self, sheet: Metatile, tiles: Sequence[TileKey], names: Sequence[str]) -> dict[TileKey, Arrays]:
        """Return the variables ``names`` of tiles of a metatile; empty if the metatile cannot be read.

        Damaged tiles will be solved again. A metatile that the disk refuses to read stays in the catalog, and is read
        again after RELIST_SECONDS.
        """
        places = np.array([sheet.index(key) for key in tiles]) * TILE_CELLS
        low, high = places.min(axis=0), places.max(axis=0) + TILE_CELLS
        box = tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
        tiles_read, bad = dict[TileKey, Arrays](), set[tuple[int, int]]()
        try:
            blocks = {name: np.asarray(sheet.arrays[name][box]) for name in names if name in sheet.arrays}
            for key, place in zip(tiles, places - low, strict=True):
                part = tuple(slice(int(a), int(a) + TILE_CELLS) for a in place)
                arrays = {name: block[part].copy() for name, block in blocks.items()}
                if self._is_lost(sheet, sheet.index(key), arrays):
                    bad.add(sheet.index(key))
                else:
                    tiles_read[key] = arrays
        except Exception as error:  # a codec may raise anything for damaged bytes
            with self._lock:
                if self._was_refused(error):
                    sheet.refused_at = time.monotonic()
                    return {}
            tiles_read, bad = {}, {sheet.index(key) for key in tiles}
        with self._lock:
            sheet.damaged |= bad
            sheet.done -= bad
        return tiles_read

    def _is_lost(self, sheet: Metatile, index: tuple[int, int], arrays: Arrays) -> bool:
        """Return True if a chunk of a tile is missing, which Zarr reads as fill values."""
        return any(
            not variable.sparse
            and is_blank(arrays[name], variable)
            and not sheet.handle.backend.exists(chunk_key(variable, index))
            for name, variable in self._subject.variables.items()
            if name in arrays
        )

    def span(self, key: MetatileKey) -> Span | None:
        """Return the rows and columns of a metatile's tiles whose cells all lie in the valid ranges; None if there are
        none.
        """
        spans = []
        for along, level, number in ((1, key.level_y, key.y), (0, key.level_x, key.x)):
            first = number * METATILE_TILES
            whole = np.flatnonzero(self._subject.valid_mask(along, level, first, METATILE_TILES).all(axis=1))
            if not whole.size:
                return None
            spans.append(range(first + int(whole[0]), first + int(whole[-1]) + 1))
        return spans[0], spans[1]

    def span_with(self, key: TileKey) -> Span | None:
        """Return the span of the metatile that contains a tile; None if a cell of the tile is out of range.

        Cells out of range cannot be saved, since no spec may contain them.
        """
        span = self.span(MetatileKey.from_tile(key))
        return span if span is not None and key.y in span[0] and key.x in span[1] else None

    def _was_refused(self, error: Exception) -> bool:
        """Return True if the disk refused an access, and record the reason for ``trouble``."""
        refused = _refused(error)
        if refused:
            self._refusal = time.monotonic(), f"saved cells cannot be read: {error}"
        return refused

    def _place(self, plane: PlaneParameters, key: MetatileKey) -> StoreBackend:
        return metatile_backend(self._handle, self.digest(plane), key.name)

    def _opened(self, at: tuple[PlaneParameters, MetatileKey], place: StoreBackend, span: Span) -> Metatile:
        """Open a metatile and keep it open. Beyond MAX_OPEN the least recently used metatiles are closed."""
        handle, first = open_store(place), (span[0].start, span[1].start)
        self._open[at] = sheet = Metatile(
            handle, first, dict(handle.arrays), done_tiles(handle), listed_at=time.monotonic()
        )
        self._absent.pop(at, None)
        while len(self._open) > MAX_OPEN:
            self._open.popitem(last=False)
        return sheet


def _refused(error: BaseException) -> bool:
    """Return True if a disk or a server refused to read, which leaves open whether the file is damaged."""
    cause = error.__cause__ if isinstance(error, InputError | RunError) else error
    return isinstance(cause, OSError) and not isinstance(cause, FileNotFoundError)


def depth(name: str) -> int:
    """Return the depth of a metatile of this name: the sum of its two levels."""
    x, y, *_ = name.split("_")
    return int(x[1:]) + int(y[1:])
