"""Tiles kept in the store: looked up in its zoom levels, written there in the background, dropped where they are many.

One thread writes what was solved since it last did, under the store's claim, so that explorers and runs take turns.
"""

import threading
import time
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from contextlib import suppress

from atlas.errors import InputError, RunError
from atlas.explore.sheets import SheetKey, Sheets, depth
from atlas.explore.subject import Plane, Subject
from atlas.explore.tiles import Arrays
from atlas.explore.view import TileKey
from atlas.service.lease import claimed
from atlas.store.archive import ZipPlace
from atlas.store.sidecar import CLAIM, notes_of
from atlas.store.store import Header, done_tiles
from atlas.store.tiles import write_tile
from atlas.store.zoom import drop_sheet, note_seen, seen_sheets, sheet_bytes, sheets

MOST_BYTES = 250_000_000
"""Bytes that the zoom levels of a store may take on its disk. A file takes a whole block, a tile about twenty files: so
these are 61,000 files at most, a few screens full of cells.
"""
TOGETHER = 64
"""Tiles written in one turn, so that others get theirs."""
PAUSE = 1.0
"""Seconds between two turns."""
MOST_WAITING = 1024
"""Tiles that wait for their turn; of more the oldest are not kept, where others may not wait for ``room``."""
RECENT = 60.0


class Keeper:
    """The kept tiles of a subject. ``trouble`` says why tiles are not kept at this moment, "" while they are.

    What was looked at in the last ``recent`` seconds is not dropped, however much it is.
    """

    def __init__(
        self, subject: Subject, most_bytes: int = MOST_BYTES, wanted: bool = True, recent: float = RECENT
    ) -> None:
        self._most, self._recent = most_bytes, recent
        self._lock, self._stopped = threading.RLock(), threading.Event()
        self._room = threading.Condition(self._lock)
        self._waiting: OrderedDict[tuple[Plane, TileKey], Arrays] = OrderedDict()
        self._seen: dict[tuple[str, str], float] = {}
        self._sizes: dict[tuple[str, str], int] = {}
        self.header = subject.header if wanted else None
        self.trouble = "" if self.header is not None else "nothing is kept"
        if self.header is not None and isinstance(self.header.place, ZipPlace):
            self.header, self.trouble = None, "nothing is kept: a packed atlas is read only"
        self.sheets = None if self.header is None else Sheets(subject, self.header)
        self._thread = threading.Thread(target=self._write_on, name="atlas-keeper", daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Tiles that wait to be written."""
        with self._lock:
            return len(self._waiting)

    def room(self) -> None:
        """Wait while as many tiles wait as may, so that cells are solved no faster than they can be written.

        Not while nothing can be written, as during a run: then the oldest are not kept.
        """
        with self._room:
            while len(self._waiting) >= MOST_WAITING and not self.trouble and self._thread.is_alive():
                self._room.wait(PAUSE)

    def offer(self, plane: Plane, key: TileKey, arrays: Arrays) -> None:
        """Keep a tile, soon."""
        with self._lock:
            if self.header is None:
                return
            self._waiting[plane, key] = arrays
            while len(self._waiting) > MOST_WAITING:
                self._waiting.popitem(last=False)

    def has(self, plane: Plane, key: TileKey) -> bool:
        """Whether a tile is kept, or waits to be."""
        with self._lock:
            if (plane, key) in self._waiting:
                return True
        return self.header is not None and self.sheets is not None and self.sheets.has(plane, key)

    def can_keep(self, key: TileKey) -> bool:
        """Whether a tile can be kept at all: not one with cells out of the valid ranges."""
        return self.sheets is not None and self.sheets.span_with(key) is not None

    def load(self, plane: Plane, keys: Sequence[TileKey], names: Iterable[str]) -> dict[TileKey, Arrays]:
        """These variables of those of the tiles that are kept and can be read; all variables of those that wait."""
        if self.sheets is None:
            return {}
        wanted: dict[SheetKey, list[TileKey]] = {}
        with self._lock:
            found = {key: self._waiting[plane, key] for key in keys if (plane, key) in self._waiting}
        for key in keys:
            if key not in found and self.has(plane, key):
                wanted.setdefault(SheetKey.of(key), []).append(key)
        for of, tiles in wanted.items():
            sheet = self.sheets.find(plane, of)
            if sheet is not None:
                found |= self.sheets.read(sheet, tiles, list(names))
                self._see(plane, of)
        return found

    def end(self) -> None:
        """Write what waits, and end, without waiting for that."""
        self._stopped.set()

    def stop(self) -> None:
        """Write what waits, and end."""
        self.end()
        self._thread.join()

    def _see(self, plane: Plane, of: SheetKey) -> None:
        """Note that a sheet was looked at."""
        assert self.sheets is not None
        with self._lock:
            self._seen[self.sheets.digest(plane), of.name] = time.time()

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
            with claimed(notes, str(header.place)) as claim:
                header = header.at(claim.guard(header.place))
                for (plane, key), arrays in batch:
                    self._write(header, plane, key, arrays)
                    with self._room:
                        self._waiting.pop((plane, key), None)
                        self._room.notify_all()
                self._trim(header)
                self.trouble = ""
        except (InputError, RunError, OSError) as error:
            busy = False
            with suppress(OSError):
                busy = notes.read(CLAIM) is not None
            with self._room:
                self.trouble = "kept later: a run is at work on the store"
                if not busy:
                    self.trouble, self.header = f"nothing is kept: {error}", None
                    self._waiting.clear()
                self._room.notify_all()

    def _write(self, header: Header, plane: Plane, key: TileKey, arrays: Arrays) -> None:
        assert self.sheets is not None
        of = SheetKey.of(key)
        span = self.sheets.span_with(key)
        if span is None:
            return
        sheet = self.sheets.find(plane, of) or self.sheets.made(header, plane, of, span)
        index = sheet.index(key)
        if index not in done_tiles(sheet.header) or index in sheet.bad:
            write_tile(sheet.header.at(sheet.header.place.behind(header.place.fence)), index, arrays)
        self.sheets.note(sheet, index)
        self._see(plane, of)
        self._sizes.pop((self.sheets.digest(plane), of.name), None)

    def _trim(self, header: Header) -> None:
        """Drop the sheets seen longest ago, of those the deepest first, until the rest is small enough."""
        assert self.sheets is not None
        all_sheets = sheets(header)
        for each in all_sheets:
            if each not in self._sizes:
                self._sizes[each] = sheet_bytes(header, *each)
        seen = seen_sheets(header)
        with self._lock:
            seen |= self._seen
            self._seen = {}
        total = sum(self._sizes[each] for each in all_sheets)
        recent = time.time() - self._recent
        for each in sorted(all_sheets, key=lambda one: (seen.get(one, 0.0), -depth(one[1]))):
            if total <= self._most or seen.get(each, 0.0) > recent:
                break
            total -= self._sizes.pop(each)
            drop_sheet(header, *each)
            seen.pop(each, None)
            self.sheets.close(*each)
        note_seen(header, seen)
