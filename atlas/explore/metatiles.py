"""The sheets of a store's zoom levels that tiles lie in: which sheet has which tile, and reading them.

A sheet is a store of its own within the store, a block of a level of a plane.
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
from atlas.store.store import AtlasStore, chunk_key, done_tiles, open_arrays, open_store
from atlas.store.tiles import is_blank
from atlas.store.zoom import drop_metatile, make_plane, metatile_backend

METATILE_TILES = 16
"""Tiles of a sheet along each axis."""
MAX_OPEN = 64
"""Sheets that are held open."""
MAX_ABSENT = 4096
"""Sheets of which it is remembered that there are none."""
MAX_PLANES = 256
"""Planes whose digests are remembered."""
RELIST_SECONDS = 5.0
"""Seconds after which it is looked for what other explorers have written, or a run to the atlas itself."""

Span = tuple[range, range]


class MetatileKey(NamedTuple):
    """A sheet of a plane: its levels and its number along x and along y."""

    level_x: int
    level_y: int
    x: int
    y: int

    @classmethod
    def from_tile(cls, key: TileKey) -> "MetatileKey":
        """The sheet that a tile lies in."""
        return cls(key.level_x, key.level_y, key.x // METATILE_TILES, key.y // METATILE_TILES)

    @property
    def name(self) -> str:
        """The name of its folder."""
        return f"x{self.level_x}_y{self.level_y}_{self.x}_{self.y}"


@dataclass
class Metatile:
    """A sheet that is open: where its first tile lies, which of its tiles are done, and which of those are damaged.

    looked, refused   when its tiles were listed, and when the disk last refused to read them
    """

    handle: AtlasStore
    first_tile: tuple[int, int]
    arrays: dict[str, Any]
    done: set[tuple[int, ...]]
    damaged: set[tuple[int, ...]] = field(default_factory=set)
    listed_at: float = 0.0
    refused_at: float = float("-inf")

    def index(self, key: TileKey) -> tuple[int, int]:
        """The tile's index in the sheet."""
        return key.y - self.first_tile[0], key.x - self.first_tile[1]


class MetatileCatalog:
    """The sheets of a subject in its store; ``seen`` says when each was last looked at, until that is noted there."""

    def __init__(self, subject: Subject, handle: AtlasStore) -> None:
        self._subject, self._handle, self._lock = subject, handle, threading.RLock()
        self._open: OrderedDict[tuple[PlaneParameters, MetatileKey], Metatile] = OrderedDict()
        self._absent: OrderedDict[tuple[PlaneParameters, MetatileKey], float] = OrderedDict()
        self.seen: dict[tuple[str, str], float] = {}
        self._refusal = float("-inf"), ""
        self.digest = lru_cache(MAX_PLANES)(lambda plane: subject.digest(plane)[:16])

    @property
    def counts(self) -> dict[str, int]:
        """How many sheets are open, and of how many it is known that there are none."""
        with self._lock:
            return {"open": len(self._open), "absent": len(self._absent)}

    @property
    def trouble(self) -> str:
        """Why kept tiles could not be read a moment ago; empty if nothing was wrong."""
        when, said = self._refusal
        return said if time.monotonic() - when < 2.0 * RELIST_SECONDS else ""

    def find(self, plane: PlaneParameters, key: MetatileKey) -> Metatile | None:
        """A sheet, open; None where there is none yet. Tiles that others write are looked for now and then."""
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
                except Exception as error:  # as of ``_read``: a sheet that is damaged is made anew
                    self._was_refused(error)
            self._absent[at] = now
            self._absent.move_to_end(at)
            while len(self._absent) > MAX_ABSENT:
                self._absent.popitem(last=False)
            return None

    def create(self, handle: AtlasStore, plane: PlaneParameters, key: MetatileKey, span: Span) -> Metatile:
        """A sheet that does not exist yet, made and open, by the handle of the store as its claim's holder has it.

        Another explorer may have made it meanwhile. One that cannot be opened is damaged, and is made anew; OSError
        where the disk refuses.
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
        """Forget a sheet that is dropped, by the name of its plane and its own."""
        with self._lock:
            for plane, key in [at for at in self._open if (self.digest(at[0]), at[1].name) == (digest, name)]:
                del self._open[plane, key]

    def has(self, plane: PlaneParameters, key: TileKey) -> bool:
        """Whether a tile is kept, and the disk did not refuse to read its sheet a moment ago."""
        with self._lock:
            sheet = self.find(plane, MetatileKey.from_tile(key))
            return (
                sheet is not None
                and sheet.index(key) in sheet.done
                and time.monotonic() - sheet.refused_at > RELIST_SECONDS
            )

    def load(self, plane: PlaneParameters, keys: Sequence[TileKey], names: Sequence[str]) -> dict[TileKey, Arrays]:
        """These variables of the tiles that are kept and can be read."""
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
        """Note that a sheet is looked at."""
        with self._lock:
            self.seen[self.digest(plane), key.name] = time.time()

    def pop_view_times(self) -> dict[tuple[str, str], float]:
        """When sheets were last looked at, to be noted in the store."""
        with self._lock:
            seen, self.seen = self.seen, {}
            return seen

    def mark_written(self, sheet: Metatile, index: tuple[int, int]) -> None:
        """Note that a tile is written."""
        with self._lock:
            sheet.damaged.discard(index)
            sheet.done.add(index)

    def _read(self, sheet: Metatile, tiles: Sequence[TileKey], names: Sequence[str]) -> dict[TileKey, Arrays]:
        """These variables of tiles of a sheet; nothing where it cannot be read.

        Damaged tiles are solved again. A sheet that a disk refuses to read stays, and is read again after LOOK seconds.
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
        except Exception as error:  # a codec that meets bytes it never wrote may raise anything
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
        """Whether a chunk of a tile is missing, which Zarr reads as fill values."""
        return any(
            not variable.sparse
            and is_blank(arrays[name], variable)
            and not sheet.handle.backend.exists(chunk_key(variable, index))
            for name, variable in self._subject.variables.items()
            if name in arrays
        )

    def span(self, key: MetatileKey) -> Span | None:
        """The rows and columns of a sheet's tiles whose cells all lie in the valid ranges; None without any."""
        spans = []
        for along, level, number in ((1, key.level_y, key.y), (0, key.level_x, key.x)):
            first = number * METATILE_TILES
            whole = np.flatnonzero(self._subject.valid_mask(along, level, first, METATILE_TILES).all(axis=1))
            if not whole.size:
                return None
            spans.append(range(first + int(whole[0]), first + int(whole[-1]) + 1))
        return spans[0], spans[1]

    def span_with(self, key: TileKey) -> Span | None:
        """The span of the sheet that a tile lies in; None where some of its cells are out of range, as in no spec."""
        span = self.span(MetatileKey.from_tile(key))
        return span if span is not None and key.y in span[0] and key.x in span[1] else None

    def _was_refused(self, error: Exception) -> bool:
        """Whether the disk refused; if so, ``trouble`` says it."""
        refused = _refused(error)
        if refused:
            self._refusal = time.monotonic(), f"kept cells cannot be read: {error}"
        return refused

    def _place(self, plane: PlaneParameters, key: MetatileKey) -> StoreBackend:
        return metatile_backend(self._handle, self.digest(plane), key.name)

    def _opened(self, at: tuple[PlaneParameters, MetatileKey], place: StoreBackend, span: Span) -> Metatile:
        """Open a sheet, and keep it open; those not used for longest are closed."""
        handle, first = open_store(place), (span[0].start, span[1].start)
        self._open[at] = sheet = Metatile(
            handle, first, open_arrays(handle), done_tiles(handle), listed_at=time.monotonic()
        )
        self._absent.pop(at, None)
        while len(self._open) > MAX_OPEN:
            self._open.popitem(last=False)
        return sheet


def _refused(error: BaseException) -> bool:
    """Whether a disk or a server refused a read, which leaves open whether the file is damaged."""
    cause = error.__cause__ if isinstance(error, InputError | RunError) else error
    return isinstance(cause, OSError) and not isinstance(cause, FileNotFoundError)


def depth(name: str) -> int:
    """How deep a sheet of this name lies, by both its levels."""
    x, y, *_ = name.split("_")
    return int(x[1:]) + int(y[1:])
