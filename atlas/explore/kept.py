"""Tiles kept in the store: looked up in its zoom levels, written there in the background, dropped where they are many.

One thread writes what was solved since it last did, under the store's claim, so that explorers and runs take turns.
"""

import threading
import time
from collections import OrderedDict
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from atlas.errors import InputError, RunError
from atlas.explore.lattice import Lattice
from atlas.explore.subject import Plane, Subject
from atlas.explore.tiles import Arrays
from atlas.explore.view import TILE, TileKey
from atlas.service.lease import CLAIM, claimed, remove_half_made
from atlas.store.sidecar import notes_of
from atlas.store.store import Header, create, done_tiles, open_arrays, read_header
from atlas.store.tiles import write_tile
from atlas.store.zoom import drop_sheet, make_plane, note_seen, seen_sheets, sheet_bytes, sheet_place, sheets
from workers.model.parameter import Parameter

SHEET = 16
"""Tiles of a sheet along each axis: a store of its own within the store."""
MOST_BYTES = 2 * 2**30
"""Bytes that the zoom levels of a store may take on its disk."""
TOGETHER = 64
"""Tiles written in one turn, so that others get theirs."""
PAUSE = 1.0
"""Seconds between two turns."""
MOST_WAITING = 4096
"""Tiles that wait for their turn; of more the oldest are not kept."""
OPEN_SHEETS = 64
RECENT = 60.0
LOOK = 5.0
"""Seconds after which it is looked for what other explorers have written."""


class SheetKey(NamedTuple):
    """A sheet of a plane: its levels and its number along x and along y."""

    level_x: int
    level_y: int
    x: int
    y: int

    @classmethod
    def of(cls, key: TileKey) -> "SheetKey":
        """The sheet that a tile lies in."""
        return cls(key.level_x, key.level_y, key.x // SHEET, key.y // SHEET)

    @property
    def name(self) -> str:
        """The name of its folder."""
        return f"x{self.level_x}_y{self.level_y}_{self.x}_{self.y}"


@dataclass
class _Sheet:
    """A sheet that is open: where its first tile lies, and which of its tiles are done."""

    header: Header
    first: tuple[int, int]
    arrays: dict[str, Any]
    done: set[tuple[int, ...]]
    bad: set[tuple[int, ...]] = field(default_factory=set)
    looked: float = 0.0

    def index(self, key: TileKey) -> tuple[int, int]:
        """The tile's index in the sheet."""
        return key.y - self.first[0], key.x - self.first[1]


class Keeper:
    """The kept tiles of a subject. ``trouble`` says why tiles are not kept at this moment, "" while they are.

    What was looked at in the last ``recent`` seconds is not dropped, however much it is.
    """

    def __init__(
        self, subject: Subject, most_bytes: int = MOST_BYTES, wanted: bool = True, recent: float = RECENT
    ) -> None:
        self._subject, self._most, self._recent = subject, most_bytes, recent
        self._lock, self._stopped = threading.RLock(), threading.Event()
        self._waiting: OrderedDict[tuple[Plane, TileKey], Arrays] = OrderedDict()
        self._open: OrderedDict[tuple[Plane, SheetKey], _Sheet] = OrderedDict()
        self._absent: dict[tuple[Plane, SheetKey], float] = {}
        self._digests: dict[Plane, str] = {}
        self._seen: dict[tuple[str, str], float] = {}
        self._sizes: dict[tuple[str, str], int] | None = None
        self.header = subject.header if wanted else None
        self.trouble = "" if self.header is not None else "nothing is kept"
        if self.header is not None and self.header.place.local is None and "://" not in str(self.header.place):
            self.header, self.trouble = None, "nothing is kept: a packed atlas is read only"
        self._thread = threading.Thread(target=self._write_on, name="atlas-keeper", daemon=True)
        self._thread.start()

    def offer(self, plane: Plane, key: TileKey, arrays: Arrays) -> None:
        """Keep a tile, soon."""
        with self._lock:
            if self.header is None:
                return
            self._waiting[plane, key] = arrays
            while len(self._waiting) > MOST_WAITING:
                self._waiting.popitem(last=False)

    def has(self, plane: Plane, key: TileKey) -> bool:
        """Whether a tile is kept."""
        if self.header is None:
            return False
        with self._lock:
            sheet = self._sheet(plane, SheetKey.of(key))
            return sheet is not None and sheet.index(key) in sheet.done

    def load(self, plane: Plane, keys: Iterable[TileKey], names: Iterable[str]) -> dict[TileKey, Arrays]:
        """These variables of those of the tiles that are kept and can be read."""
        wanted: dict[SheetKey, list[TileKey]] = {}
        for key in keys:
            if self.has(plane, key):
                wanted.setdefault(SheetKey.of(key), []).append(key)
        found: dict[TileKey, Arrays] = {}
        for of, tiles in wanted.items():
            with self._lock:
                sheet = self._sheet(plane, of)
            if sheet is not None:
                found |= self._read(sheet, tiles, list(names))
                self._seen[self._digest(plane), of.name] = time.time()
        return found

    def stop(self) -> None:
        """Write what waits, and end."""
        self._stopped.set()
        self._thread.join()

    def _read(self, sheet: _Sheet, tiles: list[TileKey], names: list[str]) -> dict[TileKey, Arrays]:
        places = np.array([sheet.index(key) for key in tiles]) * TILE
        low, high = places.min(axis=0), places.max(axis=0) + TILE
        box = tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
        try:
            blocks = {name: np.asarray(sheet.arrays[name][box]) for name in names if name in sheet.arrays}
        except Exception:  # a codec that meets bytes it never wrote may raise anything: these are solved again
            with self._lock:
                bad = {sheet.index(key) for key in tiles}
                sheet.bad |= bad
                sheet.done -= bad
            return {}
        found = {}
        for key, place in zip(tiles, places - low, strict=True):
            part = tuple(slice(int(a), int(a) + TILE) for a in place)
            found[key] = {name: block[part].copy() for name, block in blocks.items()}
        return found

    def _digest(self, plane: Plane) -> str:
        if plane not in self._digests:
            self._digests[plane] = self._subject.digest(plane)[:16]
        return self._digests[plane]

    def _sheet(self, plane: Plane, key: SheetKey) -> _Sheet | None:
        """A sheet, open; None where there is none yet. Tiles that others write are looked for now and then."""
        assert self.header is not None
        at, now = (plane, key), time.monotonic()
        if at in self._open:
            self._open.move_to_end(at)
            sheet = self._open[at]
            if now - sheet.looked > LOOK:
                sheet.looked = now
                with suppress(OSError):
                    sheet.done = done_tiles(sheet.header) - sheet.bad
            return sheet
        if now - self._absent.get(at, -LOOK) < LOOK:
            return None
        span = self._span(key)
        if span is not None:
            with suppress(InputError, OSError):
                header = read_header(sheet_place(self.header, self._digest(plane), key.name))
                return self._opened(at, header, span[0])
        self._absent[at] = now
        return None

    def _opened(self, at: tuple[Plane, SheetKey], header: Header, first: tuple[int, int]) -> _Sheet:
        """Keep a sheet open; those not used for longest are closed."""
        self._open[at] = sheet = _Sheet(header, first, open_arrays(header), done_tiles(header), looked=time.monotonic())
        self._absent.pop(at, None)
        while len(self._open) > OPEN_SHEETS:
            self._open.popitem(last=False)
        return sheet

    def _span(self, key: SheetKey) -> tuple[tuple[int, int], tuple[int, int]] | None:
        """The first and the last tile (y, x) of a sheet whose cells all lie in the valid ranges; None without any."""
        subject, ends = self._subject, []
        for lattice, level, number in ((subject.y, key.level_y, key.y), (subject.x, key.level_x, key.x)):
            parameter = subject.system.parameter(lattice.axis.name)
            ends.append(_admitted_tiles(lattice, parameter, level, number))
        (low_y, high_y), (low_x, high_x) = ends
        return ((low_y, low_x), (high_y, high_x)) if low_y <= high_y and low_x <= high_x else None

    def _write_on(self) -> None:
        noted = time.monotonic()
        while True:
            ending = self._stopped.wait(PAUSE)
            with self._lock:
                batch = [(key, self._waiting[key]) for key in list(self._waiting)[:TOGETHER]]
            if self.header is not None and (batch or (self._seen and time.monotonic() - noted > RECENT)):
                noted = time.monotonic()
                self._turn(self.header, batch)
            with self._lock:
                if ending and (not self._waiting or self.trouble):
                    return

    def _turn(self, header: Header, batch: list[tuple[tuple[Plane, TileKey], Arrays]]) -> None:
        """Write some tiles under the store's claim."""
        notes = notes_of(header.place)
        try:
            with claimed(notes, str(header.place)):
                for (plane, key), arrays in batch:
                    self._write(header, plane, key, arrays)
                    with self._lock:
                        self._waiting.pop((plane, key), None)
                self._trim(header)
                self.trouble = ""
        except (InputError, RunError, OSError) as error:
            busy = False
            with suppress(OSError):
                busy = notes.read(CLAIM) is not None
            if busy:
                self.trouble = "kept later: a run is at work on the store"
                return
            with self._lock:
                self.trouble, self.header = f"nothing is kept: {error}", None
                self._waiting.clear()

    def _write(self, header: Header, plane: Plane, key: TileKey, arrays: Arrays) -> None:
        of = SheetKey.of(key)
        span = self._span(of)
        if span is None or not (span[0][0] <= key.y <= span[1][0] and span[0][1] <= key.x <= span[1][1]):
            return  # some of its cells are out of range: a spec has none such
        with self._lock:
            sheet = self._sheet(plane, of)
        if sheet is None:
            sheet = self._make(header, plane, of, span)
        index = sheet.index(key)
        if index not in done_tiles(sheet.header) or index in sheet.bad:
            write_tile(sheet.header, index, arrays)
        with self._lock:
            sheet.bad.discard(index)
            sheet.done.add(index)
            self._seen[self._digest(plane), of.name] = time.time()
            if self._sizes is not None:
                self._sizes.pop((self._digest(plane), of.name), None)

    def _make(self, header: Header, plane: Plane, of: SheetKey, span: Any) -> _Sheet:
        subject, digest = self._subject, self._digest(plane)
        (low_y, low_x), (high_y, high_x) = span
        x = subject.x.values(of.level_x, np.arange(low_x * TILE, (high_x + 1) * TILE))
        y = subject.y.values(of.level_y, np.arange(low_y * TILE, (high_y + 1) * TILE))
        described = {
            "long_name": "a plane as it was looked at",
            "parameters": dict(plane.parameters),
            "solve": dict(vars(subject.settings)),
            "digest": subject.digest(plane),
        }
        make_plane(header, digest, described)
        place = sheet_place(header, digest, of.name)
        if place.local is not None:
            remove_half_made(place.local)
        made = create(place, subject.spec_of(plane, x, y), (TILE, TILE))
        with self._lock:
            return self._opened((plane, of), made, (low_y, low_x))

    def _trim(self, header: Header) -> None:
        """Drop the sheets seen longest ago, of those the deepest first, until the rest is small enough."""
        all_sheets = sheets(header)
        if self._sizes is None:
            self._sizes = {}
        for each in all_sheets:
            if each not in self._sizes:
                self._sizes[each] = sheet_bytes(header, *each)
        seen = seen_sheets(header) | self._seen
        total = sum(self._sizes[each] for each in all_sheets)
        recent = time.time() - self._recent
        for each in sorted(all_sheets, key=lambda one: (seen.get(one, 0.0), -_depth(one[1]))):
            if total <= self._most or seen.get(each, 0.0) > recent:
                break
            total -= self._sizes.pop(each)
            drop_sheet(header, *each)
            seen.pop(each, None)
            with self._lock:
                for plane, key in [at for at in self._open if (self._digest(at[0]), at[1].name) == each]:
                    del self._open[plane, key]
        note_seen(header, seen)
        with self._lock:
            self._seen.clear()


def _depth(sheet: str) -> int:
    x, y, *_ = sheet.split("_")
    return int(x[1:]) + int(y[1:])


def _admitted_tiles(lattice: Lattice, parameter: Parameter, level: int, number: int) -> tuple[int, int]:
    """The first and the last tile of a sheet, along one axis, whose points all lie in the valid range."""
    first = number * SHEET
    index = np.arange(first * TILE, (first + SHEET) * TILE, dtype=np.int64)
    whole = lattice.admitted(parameter, level, index).reshape(SHEET, TILE).all(axis=1)
    good = np.flatnonzero(whole)
    return (first + int(good[0]), first + int(good[-1])) if good.size else (0, -1)
