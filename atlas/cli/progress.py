"""Display of the progress of a run: a bar on a terminal, or lines in a log."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import replace
from types import TracebackType
from typing import IO

import click

from atlas.cli.options import INTERRUPTED, interruptible, print_status
from atlas.service.options import RunOptions
from atlas.service.progress import Progress, prepare_kernels
from atlas.task.compile import kernels_for
from workers import Settings
from workers.model.system import System

LOG_INTERVAL = 5.0
"""Length, in seconds, of the interval between two lines in a log."""

Report = Callable[[Progress], None]


def reporter(stream: IO[str]) -> "TerminalReporter | LogReporter":
    """Return an object that shows progress: a bar if the stream is a terminal, else a plain line every few seconds."""
    return TerminalReporter(stream) if stream.isatty() else LogReporter(stream)


@contextmanager
def resumable(
    ctx: click.Context, options: RunOptions, of: Callable[[Report], Report] = lambda show: show
) -> Iterator[RunOptions]:
    """Yield the options of a command that can be resumed, with a display of its progress.

    After Ctrl-C end the command with the advice to run it again. ``of`` may wrap the function that shows the progress.
    """
    try:
        with interruptible(), reporter(sys.stderr) as show:
            yield replace(options, on_progress=of(show))
    except KeyboardInterrupt:
        print_status("interrupted: finished work is kept; rerun the same command to resume")
        ctx.exit(INTERRUPTED)


@contextmanager
def show_solving(system: System, *kernels: str, settings: Settings | None = None) -> Iterator[None]:
    """Show on stderr, during the block, that one cell is being solved.

    Before, the kernels that its system needs, and ``kernels``, are compiled unless they are in the cache.
    """
    with reporter(sys.stderr) as show:
        prepare_kernels(show, *kernels_for(system, *kernels, settings=settings))
        show(Progress("solving"))
        yield


class LogReporter(AbstractContextManager["LogReporter"]):
    """Prints progress as plain lines: every new stage at once, then a line every few seconds if it has changed."""

    def __init__(self, stream: IO[str], interval: float = LOG_INTERVAL) -> None:
        self._stream, self._interval = stream, interval
        self._stage, self._line, self._planned, self._last = "", "", False, 0.0

    def __call__(self, progress: Progress) -> None:
        """Print a line for the progress if its stage is new or the last line is old enough."""
        if progress.plan and not self._planned:
            self._planned = True
            self._print(str(progress.plan))
        if progress.stage != self._stage:
            self._stage = self._line = progress.stage
            self._last = time.monotonic()
            self._print(progress.stage)
        elif time.monotonic() - self._last >= self._interval:
            self._last = time.monotonic()
            if str(progress) != self._line:
                self._line = str(progress)
                self._print(self._line)
        if progress.note:
            self._print(progress.note)

    def _print(self, text: str) -> None:
        with suppress(BrokenPipeError):  # the reader has gone; the run continues
            print(text, file=self._stream, flush=True)

    def __exit__(self, *error: object) -> None:
        """Do nothing: lines of a log remain."""


class TerminalReporter(AbstractContextManager["TerminalReporter"]):
    """Shows a progress bar that keeps moving between tiles: cells per second and time left, and below it the
    regimes.
    """

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
        """Update the bar from a Progress."""
        plan = progress.plan
        if plan and not self._planned:
            self._planned = True
            self._live.console.print(str(plan), highlight=False)
        if progress.note:
            self._live.console.print(progress.note, highlight=False)
        self._bar.update(
            self._task,
            description=progress.stage,
            total=progress.cells if progress.cells_done else None,
            completed=progress.cells_done,
            speed=progress.format_speed,
        )
        self._regimes.plain = progress.outcome

    def __enter__(self) -> "TerminalReporter":
        """Show the bar."""
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove the bar, since a summary or an error follows."""
        self._live.transient = True
        self._live.stop()
