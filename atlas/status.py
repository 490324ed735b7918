"""How far a store is, from the store alone: what is in it, and what the run at work on it says beside it."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from atlas.beside import notes_of
from atlas.chunks import ChunkError
from atlas.claim import PATIENCE_SECONDS, Record, holder, last_word
from atlas.plan import Plan, duration
from atlas.progress import Progress, reasons_told
from atlas.store import Header, open_group
from atlas.tally import BY_REASON, CELLS, COLUMNS, count_tiles, done_mask, plan_of, read_tally, tile_sizes
from workers.results import NO_REASON, REASONS, REGIMES


@dataclass(frozen=True)
class Status:
    """Tiles and cells done of a store, the regimes of the cells done (those that occur), and the run at work on it.

    ``reasons`` has the cells without a result, by the reason in words; none of a store too old to keep them.
    ``ended`` is how the last submitted run ended, empty where it ended well.
    """

    header: Header
    plan: Plan
    tiles_done: int
    cells_done: int
    regimes: dict[str, int]
    reasons: dict[str, int]
    run: Record | None
    ended: str

    @property
    def fraction(self) -> float:
        """Share of the cells that is done."""
        return self.cells_done / self.plan.cells

    @property
    def progress(self) -> Progress:
        """As the run at work would tell it; speed and time left are its own."""
        told = self.run.progress if self.run else {}
        return Progress(
            stage=f"{self.run} is at work" if self.run else "no run is at work",
            plan=self.plan,
            tiles=self.plan.tile_count,
            cells=self.plan.cells,
            tiles_done=self.tiles_done,
            cells_done=self.cells_done,
            cells_solved=told.get("cells_solved", 0),
            seconds=told.get("seconds", 0.0),
            counts=self.regimes,
        )

    @property
    def seconds_left(self) -> float | None:
        """Seconds until the run at work has done what it set out to, or None."""
        told = self.run.progress if self.run else {}
        rate = self.progress.rate
        return (told["cells"] - told["cells_done"]) / rate if rate else None

    def __str__(self) -> str:
        axes = " x ".join(map(str, self.header.spec.axes))
        lines = [
            f"axes     {axes}",
            f"tiles    {self.tiles_done} of {self.plan.tile_count} done",
            f"cells    {self.cells_done} of {self.plan.cells} done ({100 * self.fraction:.1f} %)",
            f"solver   version {self.header.solver_version}",
            f"run      {self._run()}",
        ]
        total = max(1, self.cells_done)
        lines += [f"  {name:<15}{count:>10}  {100 * count / total:6.2f} %" for name, count in self.regimes.items()]
        lines += [f"  {line}" for line in reasons_told(self.reasons)]
        return "\n".join(lines)

    def _run(self) -> str:
        if self.run is None:
            ended = f"; the last one submitted ended: {self.ended}" if self.ended else ""
            return "complete" if self.fraction == 1 and not ended else f"none at work{ended}"
        workers = self.run.progress.get("workers", 0)
        speed = "" if self.seconds_left is None else f", {self.progress.rate:.3g} cells/s"
        left = "" if self.seconds_left is None else f", {duration(self.seconds_left)} left"
        return f"{self.run}, {workers} workers{speed}{left}{', asked to stop' if self.run.cancelled else ''}"

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
            "solve": spec.resolved()["solve"],
            "tile": self.plan.tile,
            "tiles": self.plan.tile_count,
            "tiles_done": self.tiles_done,
            "tiles_pending": self.plan.tile_count - self.tiles_done,
            "cells": self.plan.cells,
            "cells_done": self.cells_done,
            "cells_pending": self.plan.cells - self.cells_done,
            "cells_failed": self.regimes.get("failed", 0),
            "fraction": self.fraction,
            "regimes": self.regimes,
            "reasons": self.reasons,
            "run": self.run and str(self.run),
            "ended": self.ended or None,
            "workers": self.run.progress.get("workers", 0) if self.run else 0,
            "cells_per_second": self.progress.rate,
            "seconds_left": self.seconds_left,
            "solver_version": self.header.solver_version,
            "run_id": self.header.run_id,
            "digest": self.header.digest,
        }


class Census:
    """Counts a store's cells by its tally; where a finished tile has no entry there, by its chunks, once."""

    def __init__(self, header: Header) -> None:
        self.header, self.plan = header, plan_of(header)
        self.counted = np.zeros(self.plan.grid, dtype=bool)
        self.total = np.zeros(len(COLUMNS))

    def take(self) -> Status:
        """The status of now."""
        new = done_mask(self.header, self.plan) & ~self.counted
        if new.any():
            with self.header.place.told():
                entries, known = read_tally(open_group(self.header.place, "r"), self.plan)
            self.total += entries[new & known].sum(axis=0)
            for entry in count_tiles(self.header, [tuple(index) for index in np.argwhere(new & ~known).tolist()]):
                if isinstance(entry, ChunkError):
                    raise entry
                self.total += entry
            self.counted |= new
        cells = self.total[CELLS].astype(int).tolist()
        regimes = {regime.name: count for regime, count in zip(REGIMES, cells, strict=True) if count}
        found = zip(REASONS, self.total[BY_REASON].astype(int).tolist(), strict=True)
        reasons = {reason.text: count for reason, count in found if count and reason.code != NO_REASON}
        tiles, done = int(self.counted.sum()), int(tile_sizes(self.plan)[self.counted].sum())
        notes = notes_of(self.header.place)
        run, ended = holder(notes), last_word(notes)
        return Status(self.header, self.plan, tiles, done, regimes, reasons, run, ended)


def read_status(header: Header) -> Status:
    """The status of a store, from one listing and its tally; reads the chunks of no tile that has an entry there."""
    return Census(header).take()


def watch(header: Header, seconds: float, sleep: Callable[[float], None] = time.sleep) -> Iterator[Status]:
    """Statuses, one every so many seconds, until the atlas is complete or no run has been at work for a while."""
    census, idle, beat = Census(header), 0.0, -1
    while True:
        status = census.take()
        yield status
        moved = status.run is not None and status.run.beat != beat  # a claim that stands still is nobody's
        idle, beat = 0.0 if moved else idle + seconds, status.run.beat if status.run else -1
        if (status.fraction == 1 and not status.run) or idle > PATIENCE_SECONDS:
            return
        sleep(seconds)
