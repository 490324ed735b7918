"""The status of a store: its progress, found from its contents and from the lease of the run that writes it."""

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from atlas.errors import ChunkError
from atlas.formatting import PrintableResult, duration
from atlas.service.lease import LeaseObservation, LeaseObserver, LeaseRecord
from atlas.service.progress import Progress, reason_lines
from atlas.service.timing import TIMING, Timing
from atlas.store.record_format import WIDTH
from atlas.store.sidecar import sidecar_of
from atlas.store.store import AtlasStore
from atlas.store.tile_records import TileRecords, count_tiles, counts_by_name
from workers.results import REASONS, REGIMES


@dataclass(frozen=True, repr=False)
class StoreStatus(PrintableResult):
    """The finished tiles and cells of a store, the regimes of these cells, and the run that writes the store.

    handle      handle of the store
    tiles_done  number of finished tiles
    cells_done  number of finished cells
    regimes     numbers of cells by regime
    reasons     numbers of cells without a certain result, by the reason as text
    run         lease of the run that writes the store, or None
    trouble     reason to doubt the lease (holder dead or silent, file damaged), or why the run makes no progress

    ``trouble`` is empty if all is well.
    """

    handle: AtlasStore
    tiles_done: int
    cells_done: int
    regimes: dict[str, int]
    reasons: dict[str, int]
    run: LeaseRecord | None
    trouble: str

    @property
    def fraction(self) -> float:
        """Fraction of the cells that are finished."""
        return self.cells_done / self.handle.tiling.cells

    @property
    def progress(self) -> Progress:
        """The status as the Progress of a run, with the speed and the remaining time that the run reports."""
        working = f"{self.run} is at work" if self.run else "no run is at work"
        return Progress(
            stage=self.trouble or working,
            tiles=self.handle.tiling.count,
            cells=self.handle.tiling.cells,
            tiles_done=self.tiles_done,
            cells_done=self.cells_done,
            cells_solved=int(self._reported("cells_solved")),
            seconds=0.0 if self.trouble else self._reported("seconds"),
            counts=self.regimes,
        )

    @property
    def seconds_left(self) -> float | None:
        """Seconds until the run is finished, at its present speed; None if no run is known to make progress."""
        rate = self.progress.rate
        return (self._reported("cells") - self._reported("cells_done")) / rate if rate else None

    def _reported(self, name: str) -> float:
        return self.run.number(name) if self.run else 0

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """Rows of text: the facts about the store by name; then regimes, with their cells and shares of the finished
        cells; then reasons.
        """
        total = max(1, self.cells_done)
        return [
            ("axes", " x ".join(self.handle.spec.axis_descriptions)),
            ("tiles", f"{self.tiles_done} of {self.handle.tiling.count} done"),
            ("cells", f"{self.cells_done} of {self.handle.tiling.cells} done ({100 * self.fraction:.1f} %)"),
            ("solver", f"version {self.handle.solver_version}"),
            ("run", self._run()),
            *((name, str(count), f"{100 * count / total:.2f} %") for name, count in self.regimes.items()),
            *((f"  {line}",) for line in reason_lines(self.reasons)),
        ]

    def _run(self) -> str:
        if self.run is None:
            trouble = f"; {self.trouble}" if self.trouble else ""
            return "complete" if self.fraction == 1 and not trouble else f"none at work{trouble}"
        if self.trouble:
            return f"{self.run}: {self.trouble}" if self.trouble == self.run.trouble else self.trouble
        workers = int(self._reported("workers"))
        speed = "" if self.seconds_left is None else f", {self.progress.rate:.3g} cells/s"
        left = "" if self.seconds_left is None else f", {duration(self.seconds_left)} left"
        stop_note = ", asked to stop" if self.run.cancelled else ""
        return f"{self.run}, {workers} workers{speed}{left}{stop_note}"

    def as_dict(self) -> dict[str, Any]:
        """Return the dict that ``atlas status --json`` prints."""
        spec = self.handle.spec
        return {
            "store": str(self.handle.backend),
            "system": spec.system,
            "axes": [
                {"name": a.name, "start": a.start, "stop": a.stop, "num": len(a), "scale": a.scale} for a in spec.axes
            ],
            "parameters": spec.parameters,
            "columns": list(spec.points),
            "solve": asdict(spec.settings),
            "tile": self.handle.tile,
            "tiles": self.handle.tiling.count,
            "tiles_done": self.tiles_done,
            "tiles_pending": self.handle.tiling.count - self.tiles_done,
            "cells": self.handle.tiling.cells,
            "cells_done": self.cells_done,
            "cells_pending": self.handle.tiling.cells - self.cells_done,
            "cells_failed": self.regimes.get("failed", 0),
            "fraction": self.fraction,
            "regimes": self.regimes,
            "reasons": self.reasons,
            "run": self.run and str(self.run),
            "trouble": self.trouble or None,
            "workers": int(self._reported("workers")),
            "cells_per_second": self.progress.rate,
            "seconds_left": self.seconds_left,
            "solver_version": self.handle.solver_version,
            "run_id": self.handle.run_id,
            "digest": self.handle.digest,
        }


@dataclass(frozen=True)
class StoreCounts:
    """The numbers of finished tiles and cells in a store.

    tiles    number of finished tiles
    regimes  numbers of cells by regime, without zeros
    reasons  numbers of cells without a certain result, by reason, without zeros
    """

    tiles: int
    regimes: dict[str, int]
    reasons: dict[str, int]

    @classmethod
    def from_lease(cls, seen: LeaseObservation | None) -> "StoreCounts | None":
        """Return the counts that the run which holds the lease has reported with it.

        Return None if no run is alive, or if its report is incomplete.
        """
        if seen is None or seen.record is None or seen.alive is False or seen.trouble:
            return None
        try:
            holding = cls(**seen.record.progress["holds"])
            counts = [holding.tiles, *holding.regimes.values(), *holding.reasons.values()]
            known = holding.regimes.keys() <= {regime.name for regime in REGIMES}
            known &= holding.reasons.keys() <= {reason.text for reason in REASONS}
        except (TypeError, KeyError, AttributeError):
            return None
        return holding if known and all(type(count) is int and count >= 0 for count in counts) else None


class StatusReader:
    """Reads the status of a store, from the report of the run that writes it, else from the records of the tiles.

    A finished tile without a record is counted by reading its chunks; ``tiles_read`` is the number of these tiles.
    """

    def __init__(self, handle: AtlasStore, timing: Timing = TIMING) -> None:
        self.handle, self.timing = handle, timing
        self.tiles_read = 0
        self.notes = sidecar_of(handle.backend)
        self.observer = LeaseObserver(self.notes, timing)

    def read(self, settled: bool = False) -> StoreStatus:
        """Return the present status of the store.

        With ``settled`` wait until it is known whether a run on another host still renews its lease, the right to write
        the store. If a run held the lease before the tiles were counted and has ended since, they are counted again.
        Its last tiles may have come after the count.
        """
        look = self.observer.observe_until_settled if settled else self.observer.observe
        seen = look()
        while (holding := StoreCounts.from_lease(seen)) is None:
            before = _token(seen)
            holding = self._count()
            seen = look()
            if before in ("", _token(seen)):
                break
        run, trouble = (seen.record if seen.alive is not False else None, seen.trouble) if seen else (None, "")
        trouble = trouble or (run.trouble if run else "")
        cells = sum(holding.regimes.values())
        counted = (holding.tiles, cells, holding.regimes, holding.reasons)
        return StoreStatus(self.handle, *counted, run, trouble)

    def _count(self) -> StoreCounts:
        records = TileRecords(self.handle)
        total = np.zeros(WIDTH)
        for _, rows, _ in records.valid_blocks():
            total += rows.reshape(-1, WIDTH).sum(axis=0)
        unknown = [tuple(index) for index in np.argwhere(records.finished_mask & ~records.known_mask).tolist()]
        self.tiles_read += len(unknown)
        for row in count_tiles(self.handle, unknown):
            if isinstance(row, ChunkError):
                raise row
            total += row
        return StoreCounts(int(records.finished_mask.sum()), *counts_by_name(total))


def _token(seen: LeaseObservation | None) -> str:
    return seen.record.token if seen and seen.record else ""


def read_status(handle: AtlasStore, timing: Timing = TIMING) -> StoreStatus:
    """Return the status of a store; see ``StatusReader``.

    If the run is on another host, this takes up to ``timing.warn_after`` seconds: only a renewal of its lease shows
    that the run is alive.
    """
    return StatusReader(handle, timing).read(settled=True)


def watch(census: StatusReader, seconds: float, sleep: Callable[[float], None] = time.sleep) -> Iterator[StoreStatus]:
    """Yield the status of a store every ``seconds``, until the atlas is complete or no run has held its lease for a
    while.
    """
    idle, beat = 0.0, -1
    while True:
        status = census.read()
        yield status
        alive = status.run is not None and status.run.beat != beat  # a lease without heartbeats belongs to no live run
        idle, beat = 0.0 if alive else idle + seconds, status.run.beat if status.run else -1
        if (status.fraction == 1 and not status.run) or idle > census.timing.expire_after:
            return
        sleep(seconds)
