"""How far a store is, from the store alone: what is in it, and what the run at work on it says beside it."""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from atlas.beside import notes_of
from atlas.claim import PATIENCE_SECONDS, Observer, Record, last_word
from atlas.plan import Plan, duration, make_plan
from atlas.progress import Progress
from atlas.store import Header, done_tiles, regime_counts


@dataclass(frozen=True)
class Status:
    """Tiles and cells done of a store, the regimes of the cells done (those that occur), and the run at work on it.

    ``trouble`` says why no run may be at work in spite of a claim: its holder is dead or silent, or it is damaged.
    ``ended`` is how the last submitted run ended. Both are empty where all is well.
    """

    header: Header
    plan: Plan
    tiles_done: int
    cells_done: int
    regimes: dict[str, int]
    run: Record | None
    trouble: str
    ended: str

    @property
    def fraction(self) -> float:
        """Share of the cells that is done."""
        return self.cells_done / self.plan.cells

    @property
    def progress(self) -> Progress:
        """As the run at work would tell it; speed and time left are its own."""
        working = f"{self.run} is at work" if self.run else "no run is at work"
        return Progress(
            stage=self.trouble or working,
            plan=self.plan,
            tiles=self.plan.tile_count,
            cells=self.plan.cells,
            tiles_done=self.tiles_done,
            cells_done=self.cells_done,
            cells_solved=int(self._reported("cells_solved")),
            seconds=self._reported("seconds"),
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
            trouble = f"; {self.trouble}" if self.trouble else ""
            return "complete" if self.fraction == 1 and not ended + trouble else f"none at work{ended}{trouble}"
        if self.trouble:
            return self.trouble
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
    """Counts a store's cells; asked again, it reads only the tiles that have come since."""

    def __init__(self, header: Header) -> None:
        self.header, self.plan = header, make_plan(header.spec, workers=1, tile=header.tile)
        self.counted = np.zeros(self.plan.grid, dtype=bool)
        self.cells, self.regimes = 0, Counter[str]()
        self.notes = notes_of(header.place)
        self.observer = Observer(self.notes)

    def take(self, settled: bool = False) -> Status:
        """The status of now; ``settled`` waits until a claim from elsewhere moves, or has long enough not moved."""
        new = [index for index in done_tiles(self.header) if not self.counted[index]]
        self.regimes.update(regime_counts(self.header, new))
        for index in new:
            self.counted[index] = True
        self.cells += sum(map(self.plan.size, new))
        seen = self.observer.settle() if settled else self.observer.look()
        run, trouble = (seen.record if seen.alive is not False else None, seen.trouble) if seen else (None, "")
        tiles, ended = int(self.counted.sum()), last_word(self.notes)
        return Status(self.header, self.plan, tiles, self.cells, dict(self.regimes), run, trouble, ended)


def read_status(header: Header) -> Status:
    """The status of a store; reads the regimes of the finished tiles.

    Takes up to ``claim.SILENT_SECONDS`` where the run at work is not on this machine: that is how long it takes to see
    whether it is alive.
    """
    return Census(header).take(settled=True)


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
