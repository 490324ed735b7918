"""How far a store is, from the store alone: what is in it, and what the run at work on it notes next to it."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from atlas.errors import ChunkError
from atlas.service.lease import Observer, Record, Sighting, noted_end
from atlas.service.progress import Progress, reason_lines
from atlas.service.timing import TIMING, Timing
from atlas.store.sidecar import notes_of
from atlas.store.store import Header, open_group
from atlas.store.tally import BY_REASON, CELLS, COLUMNS, count_tiles, done_mask, read_tally
from atlas.text import duration
from workers.results import NO_REASON, REASON, REASONS, REGIMES


@dataclass(frozen=True)
class Status:
    """Tiles and cells done of a store, the regimes of the cells done (those that occur), and the run at work on it.

    ``reasons`` has the cells without a certain result, by the reason in words; none of a store too old to keep them.
    ``trouble`` says why no run may be at work in spite of a claim: its holder is dead or silent, or it is damaged; or
    why the run at work comes to nothing.
    ``ended`` is how the last submitted run ended. Both are empty where all is well.
    """

    header: Header
    tiles_done: int
    cells_done: int
    regimes: dict[str, int]
    reasons: dict[str, int]
    run: Record | None
    trouble: str
    ended: str

    @property
    def fraction(self) -> float:
        """Share of the cells that is done."""
        return self.cells_done / self.header.tiling.cells

    @property
    def progress(self) -> Progress:
        """As a snapshot of the run at work, with the speed and the time left that it reports itself."""
        working = f"{self.run} is at work" if self.run else "no run is at work"
        return Progress(
            stage=self.trouble or working,
            tiles=self.header.tiling.count,
            cells=self.header.tiling.cells,
            tiles_done=self.tiles_done,
            cells_done=self.cells_done,
            cells_solved=int(self._reported("cells_solved")),
            seconds=0.0 if self.trouble else self._reported("seconds"),
            counts=self.regimes,
        )

    @property
    def seconds_left(self) -> float | None:
        """Seconds until the run at work has done what it set out to, or None."""
        rate = self.progress.rate
        return (self._reported("cells") - self._reported("cells_done")) / rate if rate else None

    def _reported(self, name: str) -> float:
        return self.run.number(name) if self.run else 0

    def __str__(self) -> str:
        axes = " x ".join(self.header.spec.described)
        lines = [
            f"axes     {axes}",
            f"tiles    {self.tiles_done} of {self.header.tiling.count} done",
            f"cells    {self.cells_done} of {self.header.tiling.cells} done ({100 * self.fraction:.1f} %)",
            f"solver   version {self.header.solver_version}",
            f"run      {self._run()}",
        ]
        total = max(1, self.cells_done)
        lines += [f"  {name:<15}{count:>10}  {100 * count / total:6.2f} %" for name, count in self.regimes.items()]
        lines += [f"  {line}" for line in reason_lines(self.reasons)]
        return "\n".join(lines)

    def _run(self) -> str:
        if self.run is None:
            ended = f"; the last one submitted ended: {self.ended}" if self.ended else ""
            trouble = f"; {self.trouble}" if self.trouble else ""
            return "complete" if self.fraction == 1 and not ended + trouble else f"none at work{ended}{trouble}"
        if self.trouble:
            return f"{self.run}: {self.trouble}" if self.trouble == self.run.trouble else self.trouble
        workers = int(self._reported("workers"))
        speed = "" if self.seconds_left is None else f", {self.progress.rate:.3g} cells/s"
        left = "" if self.seconds_left is None else f", {duration(self.seconds_left)} left"
        asked = ", asked to stop" if self.run.cancelled else ""
        return f"{self.run}, {workers} workers{speed}{left}{asked}"

    def as_dict(self) -> dict[str, Any]:
        """What ``atlas status --json`` prints."""
        spec = self.header.spec
        return {
            "store": str(self.header.place),
            "system": spec.system,
            "axes": [
                {"name": a.name, "start": a.values[0], "stop": a.values[-1], "num": len(a), "scale": a.scale}
                for a in spec.axes
            ],
            "parameters": spec.parameters,
            "columns": list(spec.points),
            "solve": spec.resolved()["solve"],
            "tile": self.header.tile,
            "tiles": self.header.tiling.count,
            "tiles_done": self.tiles_done,
            "tiles_pending": self.header.tiling.count - self.tiles_done,
            "cells": self.header.tiling.cells,
            "cells_done": self.cells_done,
            "cells_pending": self.header.tiling.cells - self.cells_done,
            "cells_failed": self.regimes.get("failed", 0),
            "fraction": self.fraction,
            "regimes": self.regimes,
            "reasons": self.reasons,
            "run": self.run and str(self.run),
            "trouble": self.trouble or None,
            "ended": self.ended or None,
            "workers": int(self._reported("workers")),
            "cells_per_second": self.progress.rate,
            "seconds_left": self.seconds_left,
            "solver_version": self.header.solver_version,
            "run_id": self.header.run_id,
            "digest": self.header.digest,
        }


class Census:
    """Counts a store's cells by its tally; where a finished tile has no entry there, by its chunks, once.

    ``tiles_read`` is how many tiles were counted by their chunks.
    """

    def __init__(self, header: Header, timing: Timing = TIMING) -> None:
        self.header, self.timing = header, timing
        self.tiles_read = 0
        self.counted = np.zeros(header.tiling.grid, dtype=bool)
        self.total = np.zeros(len(COLUMNS))
        self.notes = notes_of(header.place)
        self.observer = Observer(self.notes, timing)
        self.explained = False

    def take(self, settled: bool = False) -> Status:
        """The status of now; ``settled`` waits until a claim from elsewhere moves, or has long enough not moved.

        Where the run that was at work before the tiles were counted has ended since, they are counted again: its last
        ones may have come between.
        """
        seen = self.observer.look()
        while True:
            before = _token(seen)
            regimes, reasons = self._count()
            seen = self.observer.settle() if settled else self.observer.look()
            if before in ("", _token(seen)):
                break
        tiles, done = int(self.counted.sum()), int(self.header.tiling.sizes()[self.counted].sum())
        run, trouble = (seen.record if seen.alive is not False else None, seen.trouble) if seen else (None, "")
        trouble = trouble or (run.trouble if run else "")
        return Status(self.header, tiles, done, regimes, reasons, run, trouble, noted_end(self.notes))

    def _count(self) -> tuple[dict[str, int], dict[str, int]]:
        """Count the tiles that have been finished since the last time; all cells counted by regime and by reason."""
        new = done_mask(self.header) & ~self.counted
        if new.any():
            root = open_group(self.header.place, "r")
            entries, known = read_tally(root, self.header.tiling)
            self.explained = REASON.name in root
            self.total += entries[new & known].sum(axis=0)
            unknown = [tuple(index) for index in np.argwhere(new & ~known).tolist()]
            self.tiles_read += len(unknown)
            for entry in count_tiles(self.header, unknown):
                if isinstance(entry, ChunkError):
                    raise entry
                self.total += entry
            self.counted |= new
        cells = self.total[CELLS].astype(int).tolist()
        regimes = {regime.name: count for regime, count in zip(REGIMES, cells, strict=True) if count}
        found = zip(REASONS, self.total[BY_REASON].astype(int).tolist(), strict=True)
        named = {reason.text: count for reason, count in found if count and reason.code != NO_REASON}
        return regimes, named if self.explained else {}  # an older store knows those of the newest tiles at best


def _token(seen: Sighting | None) -> str:
    return seen.record.token if seen and seen.record else ""


def read_status(header: Header, timing: Timing = TIMING) -> Status:
    """The status of a store, from one listing and its tally; reads the chunks of no tile that has an entry there.

    Takes up to ``timing.silent`` seconds where the run at work is not on this machine: that is how long it takes to
    see whether it is alive.
    """
    return Census(header, timing).take(settled=True)


def watch(census: Census, seconds: float, sleep: Callable[[float], None] = time.sleep) -> Iterator[Status]:
    """Statuses, one every so many seconds, until the atlas is complete or no run has been at work for a while."""
    idle, beat = 0.0, -1
    while True:
        status = census.take()
        yield status
        moved = status.run is not None and status.run.beat != beat  # a claim that stands still is nobody's
        idle, beat = 0.0 if moved else idle + seconds, status.run.beat if status.run else -1
        if (status.fraction == 1 and not status.run) or idle > census.timing.dead:
            return
        sleep(seconds)
