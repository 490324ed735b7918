"""How a run reports where it is: one frozen snapshot, and two ways to show it, on a terminal and in a log."""

import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from types import TracebackType
from typing import IO

from atlas.service.plan import Plan
from atlas.task.compile import Compilation, compile_once, warming
from atlas.text import duration, plural, shares
from workers.results import FAILED, REASONS, REGIMES

LOG_INTERVAL = 5.0
"""Seconds between two plain lines."""


@dataclass(frozen=True)
class Progress:
    """A snapshot of a run.

    stage                     what is being done now, in words
    plan                      known from its stage on, else None
    tiles, cells              in all: of the atlas, or in a retry of the tiles to solve again
    tiles_done, cells_done    in the store, including earlier runs
    cells_solved, seconds     of this run, since its first tile was submitted; before it of the stage, where it counts
    counts                    cells solved in this run by regime
    failures                  tiles that ended with an error in this run
    passing                   of interest only while it lasts: not for a log
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
    passing: bool = False

    @property
    def rate(self) -> float:
        """Cells a second in this run; 0 before the first tile."""
        return self.cells_solved / self.seconds if self.seconds > 0 else 0.0

    @property
    def seconds_left(self) -> float | None:
        """Seconds to the end at this rate, or None before the first tile."""
        return (self.cells - self.cells_done) / self.rate if self.rate else None

    def __str__(self) -> str:
        return f"{self.stage}: {status_line(self)}" if self.tiles else self.stage

    def __repr__(self) -> str:
        return f"<Progress {self}>"


def reporter(stream: IO[str]) -> "TerminalReporter | LogReporter":
    """A progress bar where the stream is a terminal, a plain line every few seconds otherwise."""
    return TerminalReporter(stream) if stream.isatty() else LogReporter(stream)


def reason_lines(reasons: Mapping[str, int]) -> list[str]:
    """A line for each reason why results are missing or uncertain: ``3 invalid cells: the initial state lies ...``."""
    regimes = {regime.code: regime.name for regime in REGIMES}
    # How a process died has words of its own.
    meant = {reason.text: regimes[reason.regime] for reason in REASONS}
    return [f"{plural(count, f'{meant.get(text, regimes[FAILED])} cell')}: {text}" for text, count in reasons.items()]


class LogReporter(AbstractContextManager["LogReporter"]):
    """Plain lines: every new stage at once, then one line every few seconds in which something has come."""

    def __init__(self, stream: IO[str], interval: float = LOG_INTERVAL) -> None:
        self._stream, self._interval = stream, interval
        self._stage, self._line, self._planned, self._last = "", "", False, 0.0

    def __call__(self, progress: Progress) -> None:
        """Print the snapshot where it is new enough."""
        if progress.passing:
            return
        if progress.plan and not self._planned:
            self._planned = True
            self._print(str(progress.plan))
        if progress.stage != self._stage:
            self._stage, self._last = progress.stage, time.monotonic()
            self._print(progress.stage)
        elif time.monotonic() - self._last >= self._interval:
            self._last = time.monotonic()
            if status_line(progress) != self._line:
                self._line = status_line(progress)
                self._print(self._line)

    def _print(self, text: str) -> None:
        print(text, file=self._stream, flush=True)

    def __exit__(self, *error: object) -> None:
        """Nothing to clear away."""


class TerminalReporter(AbstractContextManager["TerminalReporter"]):
    """A progress bar that keeps moving between tiles: cells a second and time left, and below it the regimes."""

    def __init__(self, stream: IO[str]) -> None:
        from rich.console import Console, Group
        from rich.live import Live
        from rich.progress import BarColumn, SpinnerColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bar
        from rich.text import Text

        self._bar = Bar(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=16),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[speed]}"),
        )
        self._task = self._bar.add_task("starting", total=None, speed="")
        self._regimes = Text("", overflow="ellipsis", no_wrap=True)
        self._live = Live(Group(self._bar, self._regimes), console=Console(file=stream))
        self._planned = False

    def __call__(self, progress: Progress) -> None:
        """Update the bar."""
        plan = progress.plan
        if plan and not self._planned:
            self._planned = True
            self._live.console.print(str(plan), highlight=False)
        self._bar.update(
            self._task,
            description=progress.stage,
            total=progress.cells if progress.cells_done else None,
            completed=progress.cells_done,
            speed=_speed(progress),
        )
        self._regimes.plain = _outcome(progress)

    def __enter__(self) -> "TerminalReporter":
        """Show the bar."""
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the bar away: what was done is in the summary or in the error that follows."""
        self._live.transient = True
        self._live.stop()


def prepare_kernels(report: Callable[[Progress], None], *more: str) -> None:
    """See to it that the kernels of cells, and ``more``, are compiled on this machine, and report how far that is."""
    stage = warming(*more)

    def told(now: Compilation) -> None:
        what = stage if now.of else "waiting for another process, which compiles the kernels"
        report(Progress(what, cells=now.of, cells_done=now.done, seconds=now.seconds))

    report(Progress(stage))
    compile_once(*more, report=told)


def status_line(progress: Progress) -> str:
    """One line: tiles, cells, speed, time left, regimes; before the first tile how far and how long the stage is."""
    if not progress.tiles:
        share = f"{100 * progress.cells_done / progress.cells:.0f} % after " if progress.cells else ""
        return f"{progress.stage}: {share}{duration(progress.seconds)}" if progress.seconds else progress.stage
    done = f"{progress.tiles_done}/{progress.tiles} tiles, {progress.cells_done}/{progress.cells} cells"
    return ", ".join(part for part in (done, _speed(progress), _outcome(progress)) if part)


def _speed(progress: Progress) -> str:
    left = progress.seconds_left
    return "" if left is None else f"{progress.rate:.3g} cells/s, {duration(left)} left"


def _outcome(progress: Progress) -> str:
    failed = f"{plural(progress.failures, 'tile')} failed" if progress.failures else ""
    return ", ".join(part for part in (shares(progress.counts), failed) if part)
