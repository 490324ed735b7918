"""The summary of a run, from the reports of its tiles."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from atlas.formatting import PrintableResult, duration, plural, shares
from atlas.service.progress import reason_lines
from atlas.spec.laws import LawUse, law_lines, merged
from atlas.task.tile_job import TileReport


@dataclass(frozen=True)
class TileFailure:
    """A tile, or another job of a run, that was given up after failed attempts.

    index      index of the tile or job
    message    its last exception, as text
    worker     address of the worker of the last attempt; empty if unknown
    traceback  traceback on the worker
    """

    index: tuple[int, ...]
    message: str
    worker: str = ""
    traceback: str = field(default="", repr=False)

    def __str__(self) -> str:
        return f"tile {self.index} failed{f' on {self.worker}' if self.worker else ''}: {self.message}"


@dataclass(repr=False)
class RunSummary(PrintableResult):
    """The result of a run, or the numbers so far of a run at work.

    store                         path or URL of the store
    tiles, tiles_done             number of tiles; number of tiles finished by now
    tiles_solved, cells_solved    numbers solved by this run
    counts, reasons               cells solved by regime; cells without a certain result by reason
    seconds                       from the first tile to the last
    solve_seconds, write_seconds  wall time in the solver and in the store, summed over workers
    periods                       forcing periods simulated; natural ones for a machine without a force
    workers                       number of worker threads
    peak_bytes                    largest memory of any worker's process
    failures, refused             tiles that failed; reasons for the exclusion of workers, by address
    retried, changed              True for the store of a retry; number of cells that changed their regime
    processor_seconds             processor time in the solver, summed over workers; other programs do not count
    laws                          use of the laws that are expressions, in the cells solved by this run
    cells, cells_done             number of cells; number of cells finished by now
    """

    store: str
    tiles: int
    tiles_done: int = 0
    tiles_solved: int = 0
    cells_solved: int = 0
    counts: Mapping[str, int] = field(default_factory=dict)
    reasons: Mapping[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    solve_seconds: float = 0.0
    write_seconds: float = 0.0
    periods: int = 0
    workers: int = 0
    peak_bytes: int = 0
    failures: tuple[TileFailure, ...] = ()
    refused: Mapping[str, str] = field(default_factory=dict)
    retried: bool = False
    processor_seconds: float = 0.0
    changed: int = 0
    laws: Mapping[str, LawUse] = field(default_factory=dict)
    cells: int = 0
    cells_done: int = 0

    def add(self, outcome: TileReport | TileFailure) -> None:
        """Add the report or the failure of one tile."""
        if isinstance(outcome, TileFailure):
            self.failures += (outcome,)
            return
        self.tiles_done, self.cells_done = self.tiles_done + 1, self.cells_done + outcome.cells + outcome.reused
        self.tiles_solved, self.cells_solved = self.tiles_solved + 1, self.cells_solved + outcome.cells
        self.counts, self.reasons = _added(self.counts, outcome.counts), _added(self.reasons, outcome.reasons)
        self.laws = merged([self.laws, outcome.laws])
        for name in ("solve_seconds", "processor_seconds", "write_seconds", "periods", "changed"):
            setattr(self, name, getattr(self, name) + getattr(outcome, name))
        self.peak_bytes = max(self.peak_bytes, outcome.peak_bytes)

    @property
    def cells_per_second(self) -> float:
        """Cells solved per second."""
        return self.cells_solved / self.seconds if self.seconds else 0.0

    @property
    def efficiency(self) -> float:
        """Share of the workers' time spent solving; the rest is writing, queues and waiting for the last tile."""
        return self.solve_seconds / (self.seconds * self.workers) if self.seconds else 0.0

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The facts of the run, as sentences."""
        tiles_line = f"{self.store}: {self.tiles_done} of {plural(self.tiles, 'tile')} done"
        if not self.tiles_solved:
            return [(tiles_line,)]
        lines = [
            tiles_line,
            f"{plural(self.cells_solved, 'cell')} in {duration(self.seconds)}: "
            f"{self.cells_per_second:.3g} cells/s, {self.periods / self.seconds:.3g} periods/s, "
            f"{plural(self.workers, 'worker')} solving {100 * self.efficiency:.0f} % of the time "
            f"(writing {100 * self.write_seconds / (self.seconds * self.workers):.1f} %), "
            f"{duration(self.processor_seconds)} of processor time, "
            f"at most {self.peak_bytes / 1e6:.0f} MB each",
            f"shares of these cells: {shares(self.counts)}",
        ]
        if self.retried:
            lines.append(f"{plural(self.changed, 'cell')} changed regime")
        return [(line,) for line in lines + reason_lines(self.reasons) + law_lines(self.laws)]


def _added(total: Mapping[str, int], more: Mapping[str, int]) -> dict[str, int]:
    return {name: total.get(name, 0) + more.get(name, 0) for name in {**total, **more}}
