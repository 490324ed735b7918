"""What a run did: receipts added up while it goes on, and their sum at its end."""

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from atlas.job import Receipt
from atlas.plan import Plan, duration, plural
from atlas.progress import Progress, shares


@dataclass(frozen=True)
class TileFailure:
    """A tile that ended with an exception: its index and what was raised."""

    index: tuple[int, ...]
    message: str


@dataclass(frozen=True)
class Summary:
    """What a run did.

    tiles, tiles_done            in all; in the store now
    tiles_solved, cells_solved   by this run
    counts, reasons              cells solved by regime; failed cells by reason
    seconds, busy_seconds        from the first tile to the last; the workers' own, summed
    periods                      forcing periods simulated
    """

    store: str
    tiles: int
    tiles_done: int
    tiles_solved: int
    cells_solved: int
    counts: Mapping[str, int]
    reasons: Mapping[str, int]
    seconds: float
    busy_seconds: float
    periods: int
    workers: int
    failures: tuple[TileFailure, ...]

    @property
    def cells_per_second(self) -> float:
        """Cells solved a second."""
        return self.cells_solved / self.seconds if self.seconds else 0.0

    @property
    def periods_per_second(self) -> float:
        """Forcing periods simulated a second, by all workers together."""
        return self.periods / self.seconds if self.seconds else 0.0

    @property
    def efficiency(self) -> float:
        """Share of the workers' time that went into tiles: the rest is start, queues and waiting for the last."""
        return self.busy_seconds / (self.seconds * self.workers) if self.seconds else 0.0

    def __str__(self) -> str:
        done = f"{self.store}: {self.tiles_done} of {plural(self.tiles, 'tile')} done"
        if not self.tiles_solved:
            return done
        lines = [
            done,
            f"{plural(self.cells_solved, 'cell')} in {duration(self.seconds)}: "
            f"{self.cells_per_second:.3g} cells/s, {self.periods_per_second:.3g} forcing periods/s, "
            f"{plural(self.workers, 'worker')} busy {100 * self.efficiency:.0f} % of the time",
            shares(self.counts),
        ]
        lines += [f"{plural(count, 'cell')} failed: {reason}" for reason, count in self.reasons.items()]
        return "\n".join(lines)


class Tally:
    """Receipts added up: the state of a run between its snapshots."""

    def __init__(self, plan: Plan, done: set[tuple[int, ...]]) -> None:
        self.plan = plan
        self.workers = plan.workers
        self.tiles_done, self.cells_done = len(done), sum(map(plan.size, done))
        self.tiles_solved = self.cells_solved = self.periods = 0
        self.counts: Counter[str] = Counter()
        self.reasons: Counter[str] = Counter()
        self.failures: list[TileFailure] = []
        self.busy_seconds = 0.0
        self.seconds = 0.0
        self.start()

    def start(self) -> None:
        """Let the clock begin."""
        self.begin = time.perf_counter()

    def add(self, outcome: Receipt | TileFailure) -> None:
        """Count one tile's outcome."""
        self.seconds = time.perf_counter() - self.begin
        if isinstance(outcome, TileFailure):
            self.failures.append(outcome)
            return
        cells = self.plan.size(outcome.index)
        self.tiles_done, self.cells_done = self.tiles_done + 1, self.cells_done + cells
        self.tiles_solved, self.cells_solved = self.tiles_solved + 1, self.cells_solved + outcome.cells
        self.counts.update(outcome.counts)
        self.reasons.update(outcome.reasons)
        self.busy_seconds += outcome.seconds
        self.periods += outcome.periods

    def progress(self, stage: str) -> Progress:
        """The snapshot of now."""
        return Progress(
            stage=stage,
            plan=self.plan,
            tiles_done=self.tiles_done,
            cells_done=self.cells_done,
            cells_solved=self.cells_solved,
            seconds=self.seconds,
            counts=dict(self.counts),
            failures=len(self.failures),
        )

    def summary(self, store: str) -> Summary:
        """The sum, for a store at that path or URL."""
        return Summary(
            store=store,
            tiles=self.plan.tile_count,
            tiles_done=self.tiles_done,
            tiles_solved=self.tiles_solved,
            cells_solved=self.cells_solved,
            counts=dict(self.counts),
            reasons=dict(self.reasons),
            seconds=self.seconds,
            busy_seconds=self.busy_seconds,
            periods=self.periods,
            workers=self.workers,
            failures=tuple(self.failures),
        )
