"""The progress of a run as a value, which displays and logs show."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from atlas.formatting import duration, plural, shares
from atlas.service.plan import Plan
from atlas.task.compile import compile_notice, compile_once
from workers.results import REASONS, REGIME


@dataclass(frozen=True)
class Progress:
    """A snapshot of the progress of a run.

    stage                   present activity, as text
    plan                    plan of the run, from the stage on at which it is known; else None
    tiles, cells            numbers of tiles and cells of the atlas
    tiles_done, cells_done  numbers in the store, including earlier runs
    cells_solved            number of cells that this run has solved
    seconds                 seconds since the first tile of this run was submitted; before, those of the present stage
    counts                  cells solved in this run by regime
    failures                number of tiles that ended with an error in this run
    detail                  how far the stage has come, as text; empty for a stage that counts tiles
    note                    a line that remains on the display; empty for none
    """

    stage: str
    plan: Plan | None = None
    tiles: int = 0
    cells: int = 0
    tiles_done: int = 0
    cells_done: int = 0
    cells_solved: int = 0
    seconds: float = 0.0
    counts: Mapping[str, int] = field(default_factory=dict)
    failures: int = 0
    detail: str = ""
    note: str = ""

    @property
    def rate(self) -> float:
        """Cells per second in this run; 0 before the first tile."""
        return self.cells_solved / self.seconds if self.seconds > 0 else 0.0

    @property
    def seconds_left(self) -> float | None:
        """Seconds to the end at the present rate of solving; None before the first tile."""
        return (self.cells - self.cells_done) / self.rate if self.rate else None

    @property
    def format_speed(self) -> str:
        """Cells per second and time left, as text; for a stage without tiles its ``detail``."""
        left = self.seconds_left
        return self.detail if left is None else f"{self.rate:.3g} cells/s, {duration(left)} left"

    @property
    def outcome(self) -> str:
        """Numbers of cells solved by regime, and of tiles failed, as text; empty before the first tile."""
        failed = f"{plural(self.failures, 'tile')} failed" if self.failures else ""
        return ", ".join(part for part in (shares(self.counts), failed) if part)

    @property
    def format_amount(self) -> str:
        """Tiles, cells, speed, time left and regimes; for a stage without tiles, detail or share, and seconds."""
        if not self.tiles:
            amount = self.detail or (f"{100 * self.cells_done / self.cells:.0f} %" if self.cells else "")
            return " after ".join(part for part in (amount, duration(self.seconds) if self.seconds else "") if part)
        amount = f"{self.tiles_done}/{self.tiles} tiles, {self.cells_done}/{self.cells} cells"
        return ", ".join(part for part in (amount, self.format_speed, self.outcome) if part)

    def __str__(self) -> str:
        return f"{self.stage}: {self.format_amount}" if self.format_amount else self.stage

    def __repr__(self) -> str:
        return f"<Progress {self}>"


def reason_lines(reasons: Mapping[str, int]) -> list[str]:
    """Return a line of text for each reason why results are missing or uncertain, with the number of its cells.

    ``reasons`` has the numbers by reason. An example is ``3 invalid cells: the initial state lies ...``.
    """
    meant = {reason.text: REGIME.meaning(reason.regime).name for reason in REASONS}
    return [f"{plural(count, f'{meant[text]} cell')}: {text}" for text, count in reasons.items()]


def prepare_kernels(report: Callable[[Progress], None], *more: str) -> None:
    """Compile the kernels that solve cells, and the kernels named ``more``, on this host unless they are compiled.

    ``report`` is called with the progress.
    """
    stage = compile_notice(*more)

    def report_compilation(functions: int | None, seconds: float) -> None:
        if functions is None:
            report(Progress("waiting for another process, which compiles the kernels", seconds=seconds))
        else:
            report(Progress(stage, detail=plural(functions, "function"), seconds=seconds))

    report(Progress(stage))
    compile_once(*more, report=report_compilation)
