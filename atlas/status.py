"""How far a store is, from the store alone: what is in it, and what the run at work on it says beside it."""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from atlas.beside import notes_of
from atlas.claim import PATIENCE_SECONDS, Record, holder, last_word
from atlas.plan import Plan, duration, make_plan
from atlas.progress import Progress
from atlas.store import Header, done_tiles, regime_counts


@dataclass(frozen=True)
class Status:
    """Tiles and cells done of a store, the regimes of the cells done (those that occur), and the run at work on it.

    ``ended`` is how the last submitted run ended, empty where it ended well.
    """

    header: Header
    plan: Plan
    tiles_done: int
    cells_done: int
    regimes: dict[str, int]
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
    """Counts a store's cells; asked again, it reads only the tiles that have come since."""

    def __init__(self, header: Header) -> None:
        self.header, self.plan = header, make_plan(header.spec, workers=1, tile=header.tile)
        self.counted = np.zeros(self.plan.grid, dtype=bool)
        self.cells, self.regimes = 0, Counter[str]()

    def take(self) -> Status:
        """The status of now."""
        new = [index for index in done_tiles(self.header) if not self.counted[index]]
        self.regimes.update(regime_counts(self.header, new))
        for index in new:
            self.counted[index] = True
        self.cells += sum(map(self.plan.size, new))
        notes = notes_of(self.header.place)
        run, ended = holder(notes), last_word(notes)
        return Status(self.header, self.plan, int(self.counted.sum()), self.cells, dict(self.regimes), run, ended)


def read_status(header: Header) -> Status:
    """The status of a store; reads the regimes of the finished tiles."""
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
