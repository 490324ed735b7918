"""A persistent cache of explored tiles, in the zoom levels of the store.

One background thread writes newly solved tiles while it holds the store's lease, so that explorers and runs take turns.
Tiles that cannot be written stay in the queue and are retried. The least recently viewed metatiles are deleted when the
cache exceeds its size limit.
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
"""Maximum size, in bytes, of the zoom levels of a store on its disk.

A file takes a whole block, and a tile has about twenty files. The limit thus allows at most 61,000 files, which are a
few screens of cells.
"""
TILES_PER_BATCH = 64
"""Maximum number of tiles that are written under one lease, so that other processes get their turns."""
BATCH_PAUSE = 1.0
"""Time, in seconds, between two batches."""
MAX_BATCH_PAUSE = 60.0
"""Maximum time, in seconds, between two batches. The pause doubles while the store cannot be written."""
MAX_QUEUED = 512
"""Maximum length of the write queue, in tiles. While the store cannot be written, the oldest tiles beyond it are
discarded.
"""
RECENT_SECONDS = 60.0


class PersistentTileCache:
    """The tiles of a subject that are saved in its store, and the queue of tiles that wait to be written.

    subject      the subject
    most_bytes   maximum size, in bytes, of the zoom levels
    wanted       whether tiles are saved at all
    recent       time, in seconds, for which a viewed metatile is never evicted
    """

    def __init__(
        self, subject: Subject, most_bytes: int = MAX_BYTES, wanted: bool = True, recent: float = RECENT_SECONDS
    ) -> None:
        self._most, self._recent = most_bytes, recent
        self._lock, self._stopped = threading.RLock(), threading.Event()
        self._waiting: OrderedDict[tuple[PlaneParameters, TileKey], Arrays] = OrderedDict()
        self._sizes: dict[tuple[str, str], int] = {}
        self.handle = subject.handle if wanted else None
        self._trouble, self._lost, self._lately = (
            "" if self.handle is not None else "explored cells are not saved",
            0,
            "",
        )
        if self.handle is not None and self.handle.backend.read_only_reason:
            self.handle, self._trouble = None, "explored cells are not saved: a packed atlas is read-only"
        self.sheets = None if self.handle is None else MetatileCatalog(subject, self.handle)
        self._thread = restarting_thread(
            "atlas-keeper", self._serve, lambda error: self._say(f"not saved yet: {error}")
        )

    @property
    def n_queued(self) -> int:
        """Number of tiles that wait to be written."""
        with self._lock:
            return len(self._waiting)

    @property
    def trouble(self) -> str:
        """Why tiles are not saved at the moment, and how many could not be saved at all; empty if nothing is wrong."""
        with self._lock:
            lost = f"{plural(self._lost, 'solved tile')} could not be saved: {self._lately}" if self._lost else ""
            return "; ".join(filter(None, (self._trouble, lost, self.sheets.trouble if self.sheets else "")))

    @property
    def is_full(self) -> bool:
        """True if the write queue is full. Always False while the store cannot be written, for example during a run."""
        with self._lock:
            return len(self._waiting) >= MAX_QUEUED and not self._trouble

    @property
    def has_ended(self) -> bool:
        """True if the background thread has ended."""
        return not self._thread.is_alive()

    def enqueue(self, plane: PlaneParameters, key: TileKey, arrays: Arrays) -> None:
        """Queue a solved tile for writing."""
        with self._lock:
            if self.handle is None:
                return
            self._waiting[plane, key] = arrays
            while len(self._waiting) > MAX_QUEUED and self._trouble:
                self._waiting.popitem(last=False)
                self._lose(f"more than {MAX_QUEUED} were waiting")

    def has(self, plane: PlaneParameters, key: TileKey) -> bool:
        """Return True if a tile is saved or waits to be written."""
        with self._lock:
            if (plane, key) in self._waiting:
                return True
        return self.sheets is not None and self.sheets.has(plane, key)

    def can_keep(self, key: TileKey) -> bool:
        """Return True if a tile can be saved at all: all of its cells must lie in the valid ranges."""
        return self.sheets is not None and self.sheets.span_with(key) is not None

    def load(self, plane: PlaneParameters, keys: Sequence[TileKey], names: Iterable[str]) -> dict[TileKey, Arrays]:
        """Return the variables ``names`` of saved tiles that can be read, and all variables of queued tiles."""
        with self._lock:
            waiting = {key: self._waiting[plane, key] for key in keys if (plane, key) in self._waiting}
        rest = [key for key in keys if key not in waiting]
        return waiting | (self.sheets.load(plane, rest, list(names)) if self.sheets is not None else {})

    def request_stop(self) -> None:
        """Have the thread write the queue and end, without waiting."""
        self._stopped.set()

    def stop(self) -> None:
        """Write the queue, end the thread and wait for its end."""
        self.request_stop()
        self._thread.join()

    def _say(self, trouble: str) -> None:
        with self._lock:
            self._trouble = trouble

    def _lose(self, reason: str) -> None:
        """Count a tile that is not saved."""
        with self._lock:
            self._lost, self._lately = self._lost + 1, reason

    def _serve(self) -> None:
        noted, pause = time.monotonic(), BATCH_PAUSE
        if self._stopped.is_set() and self._trouble:  # writing would fail again, and the caller waits for the end
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
            if self.handle is not None and due:  # also while there is trouble, since a successful batch clears it
                noted = time.monotonic()
                self._turn(self.handle, batch)
                pause = min(2.0 * pause, MAX_BATCH_PAUSE) if self._trouble else BATCH_PAUSE
            with self._lock:
                if ending and (not self._waiting or self._trouble):
                    if self._waiting:
                        left = plural(len(self._waiting), "solved tile")
                        logging.getLogger(__name__).warning("%s not saved: %s", left, self._trouble)
                    return

    def _turn(self, handle: AtlasStore, batch: list[tuple[tuple[PlaneParameters, TileKey], Arrays]]) -> None:
        """Write some tiles under the store's lease; tiles that cannot be written stay in the queue."""
        notes = sidecar_of(handle.backend)
        try:
            if not handle.backend.exists(ROOT):  # a lease would create a folder of its name
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
            self._say(f"not saved yet: {'a run holds the lease of the store' if busy else error}")

    def _keep(self, handle: AtlasStore, plane: PlaneParameters, key: TileKey, arrays: Arrays) -> None:
        """Write a tile. A tile that cannot be saved for a reason of its own does not delay other tiles."""
        try:
            self._write(handle, plane, key, arrays)
        except (InputError, RunError, OSError):
            raise
        except Exception as error:
            logging.getLogger(__name__).exception("a tile could not be saved")
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
        """Delete the least recently viewed metatiles, the deepest first, until the cache fits its limit."""
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
