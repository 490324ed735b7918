"""Tiles kept in the store: looked up in its zoom levels, written there in the background, dropped where they are many.

One thread writes newly solved tiles under the store's claim, so that explorers and runs take turns.
Tiles that cannot be written wait, and are tried again.
"""

import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from contextlib import suppress

from atlas.errors import InputError, RunError
from atlas.explore.metatiles import MetatileCatalog, MetatileKey, depth
from atlas.explore.subject import Arrays, PlaneParameters, Subject
from atlas.explore.threads import restarting_thread, why
from atlas.explore.viewport import TileKey
from atlas.formatting import plural
from atlas.service.lease import hold_lease
from atlas.store.sidecar import LEASE_NAME, sidecar_of
from atlas.store.store import ROOT, AtlasStore, done_tiles
from atlas.store.tiles import write_tile
from atlas.store.zoom import drop_metatile, list_metatiles, metatile_bytes, read_view_times, write_view_times

MAX_BYTES = 250_000_000
"""Bytes that the zoom levels of a store may take on its disk. A file takes a whole block, a tile about twenty files: so
these are 61,000 files at most, a few screens full of cells.
"""
TILES_PER_BATCH = 64
"""Tiles written in one turn, so that others get theirs."""
BATCH_PAUSE = 1.0
"""Seconds between two turns."""
MAX_BATCH_PAUSE = 60.0
"""Seconds between two turns at most: the pause doubles while nothing can be written."""
MAX_QUEUED = 512
"""Tiles that wait for their turn. While nothing can be written, the oldest of more than these are not kept."""
RECENT_SECONDS = 60.0


class PersistentTileCache:
    """The kept tiles of a subject.

    Tiles seen in the last ``recent`` seconds are not dropped, however many.
    """

    def __init__(
        self, subject: Subject, most_bytes: int = MAX_BYTES, wanted: bool = True, recent: float = RECENT_SECONDS
    ) -> None:
        self._most, self._recent = most_bytes, recent
        self._lock, self._stopped = threading.RLock(), threading.Event()
        self._waiting: OrderedDict[tuple[PlaneParameters, TileKey], Arrays] = OrderedDict()
        self._sizes: dict[tuple[str, str], int] = {}
        self.handle = subject.handle if wanted else None
        self._trouble, self._lost, self._lately = "" if self.handle is not None else "nothing is kept", 0, ""
        if self.handle is not None and self.handle.backend.read_only_reason:
            self.handle, self._trouble = None, "nothing is kept: a packed atlas is read only"
        self.sheets = None if self.handle is None else MetatileCatalog(subject, self.handle)
        self._thread = restarting_thread("atlas-keeper", self._serve, lambda error: self._say(f"kept later: {error}"))

    @property
    def n_queued(self) -> int:
        """Tiles that wait to be written."""
        with self._lock:
            return len(self._waiting)

    @property
    def trouble(self) -> str:
        """Why tiles are not kept at this moment, and how many could not be kept at all; empty if nothing is wrong."""
        with self._lock:
            lost = f"{plural(self._lost, 'solved tile')} could not be kept: {self._lately}" if self._lost else ""
            return "; ".join(filter(None, (self._trouble, lost, self.sheets.trouble if self.sheets else "")))

    @property
    def is_full(self) -> bool:
        """Whether as many tiles wait as may. Never while nothing can be written, as during a run."""
        with self._lock:
            return len(self._waiting) >= MAX_QUEUED and not self._trouble

    @property
    def has_ended(self) -> bool:
        """Whether it has ended."""
        return not self._thread.is_alive()

    def enqueue(self, plane: PlaneParameters, key: TileKey, arrays: Arrays) -> None:
        """Keep a tile, soon."""
        with self._lock:
            if self.handle is None:
                return
            self._waiting[plane, key] = arrays
            while len(self._waiting) > MAX_QUEUED and self._trouble:
                self._waiting.popitem(last=False)
                self._lose(f"more than {MAX_QUEUED} were waiting")

    def has(self, plane: PlaneParameters, key: TileKey) -> bool:
        """Whether a tile is kept, or waits to be."""
        with self._lock:
            if (plane, key) in self._waiting:
                return True
        return self.sheets is not None and self.sheets.has(plane, key)

    def can_keep(self, key: TileKey) -> bool:
        """Whether a tile can be kept at all: not one with cells out of the valid ranges."""
        return self.sheets is not None and self.sheets.span_with(key) is not None

    def load(self, plane: PlaneParameters, keys: Sequence[TileKey], names: Iterable[str]) -> dict[TileKey, Arrays]:
        """These variables of the tiles that are kept and can be read; all variables of waiting tiles."""
        with self._lock:
            waiting = {key: self._waiting[plane, key] for key in keys if (plane, key) in self._waiting}
        rest = [key for key in keys if key not in waiting]
        return waiting | (self.sheets.load(plane, rest, list(names)) if self.sheets is not None else {})

    def request_stop(self) -> None:
        """Write what waits, and end, without waiting for that."""
        self._stopped.set()

    def stop(self) -> None:
        """Write what waits, and end."""
        self.request_stop()
        self._thread.join()

    def _say(self, trouble: str) -> None:
        with self._lock:
            self._trouble = trouble

    def _lose(self, reason: str) -> None:
        """Count a tile that is not kept."""
        with self._lock:
            self._lost, self._lately = self._lost + 1, reason

    def _serve(self) -> None:
        noted, pause = time.monotonic(), BATCH_PAUSE
        if self._stopped.is_set() and self._trouble:  # it would go wrong again, and somebody waits for the end
            return
        while True:
            ending = self._stopped.wait(pause)
            with self._lock:
                batch = [(key, self._waiting[key]) for key in list(self._waiting)[:TILES_PER_BATCH]]
            due = (
                batch
                or self._trouble
                or (self.sheets and self.sheets.seen and time.monotonic() - noted > RECENT_SECONDS)
            )
            if self.handle is not None and due:  # in trouble too, which is over once a turn has come to its end
                noted = time.monotonic()
                self._turn(self.handle, batch)
                pause = min(2.0 * pause, MAX_BATCH_PAUSE) if self._trouble else BATCH_PAUSE
            with self._lock:
                if ending and (not self._waiting or self._trouble):
                    if self._waiting:
                        left = plural(len(self._waiting), "solved tile")
                        logging.getLogger(__name__).warning("%s not kept: %s", left, self._trouble)
                    return

    def _turn(self, handle: AtlasStore, batch: list[tuple[tuple[PlaneParameters, TileKey], Arrays]]) -> None:
        """Write some tiles under the store's claim; tiles that cannot be written wait for another turn."""
        notes = sidecar_of(handle.backend)
        try:
            if not handle.backend.exists(ROOT):  # to claim it would make a folder of its name
                raise RunError(f"{handle.backend} is gone")
            with hold_lease(notes, str(handle.backend)) as claim:
                handle = handle.with_backend(claim.fence_backend(handle.backend))
                for at, arrays in batch:
                    self._keep(handle, *at, arrays)
                    with self._lock:
                        self._waiting.pop(at, None)
                self._trim(handle)
            self._say("")
        except (InputError, RunError, OSError) as error:
            busy = False
            with suppress(OSError):
                busy = notes.read(LEASE_NAME) is not None
            self._say(f"kept later: {'a run is at work on the store' if busy else error}")

    def _keep(self, handle: AtlasStore, plane: PlaneParameters, key: TileKey, arrays: Arrays) -> None:
        """Write a tile; one that cannot be kept for a reason of its own does not hold up the others."""
        try:
            self._write(handle, plane, key, arrays)
        except (InputError, RunError, OSError):
            raise
        except Exception as error:
            logging.getLogger(__name__).exception("a tile could not be kept")
            self._lose(why(error))

    def _write(self, handle: AtlasStore, plane: PlaneParameters, key: TileKey, arrays: Arrays) -> None:
        assert self.sheets is not None
        of = MetatileKey.from_tile(key)
        span = self.sheets.span_with(key)
        if span is None:
            return
        sheet = self.sheets.find(plane, of) or self.sheets.create(handle, plane, of, span)
        index = sheet.index(key)
        if index not in done_tiles(sheet.handle) or index in sheet.damaged:
            write_tile(sheet.handle.with_backend(sheet.handle.backend.with_fence(handle.backend.fence)), index, arrays)
        self.sheets.mark_written(sheet, index)
        self.sheets.mark_viewed(plane, of)
        self._sizes.pop((self.sheets.digest(plane), of.name), None)

    def _trim(self, handle: AtlasStore) -> None:
        """Drop the sheets seen longest ago, of those the deepest first, until the rest is small enough."""
        assert self.sheets is not None
        all_sheets = list_metatiles(handle)
        for sheet in all_sheets:
            if sheet not in self._sizes:
                self._sizes[sheet] = metatile_bytes(handle, *sheet)
        seen = read_view_times(handle) | self.sheets.pop_view_times()
        total = sum(self._sizes[sheet] for sheet in all_sheets)
        recent = time.time() - self._recent
        for sheet in sorted(all_sheets, key=lambda one: (seen.get(one, 0.0), -depth(one[1]))):
            if total <= self._most or seen.get(sheet, 0.0) > recent:
                break
            total -= self._sizes.pop(sheet)
            drop_metatile(handle, *sheet)
            seen.pop(sheet, None)
            self.sheets.close(*sheet)
        write_view_times(handle, seen)
