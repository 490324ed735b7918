"""The display of a run's progress in a notebook: one bar under the cell, updated in place."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from html import escape
from types import TracebackType
from typing import Any

from atlas.argument_checks import validate_type
from atlas.service.progress import Progress

INTERVAL = 0.25
"""Minimum seconds between two updates of the bar; each is a message to the browser."""


@contextmanager
def progress_reporter(on_progress: Callable[[Progress], None] | None) -> Iterator[Callable[[Progress], None] | None]:
    """Yield the function to call with each Progress: the given one, or in a notebook that of a bar; None elsewhere."""
    if on_progress is not None:
        validate_type("on_progress", on_progress, Callable, "a function of a Progress")
    display = None if on_progress is not None else _notebook_display()
    if display is None:
        yield on_progress
        return
    with NotebookReporter(display) as reporter:
        yield reporter


class NotebookReporter(AbstractContextManager["NotebookReporter"]):
    """A progress bar in a notebook, which ``display``, IPython's function, shows once and then updates.

    It shows the last Progress and the notes so far, as HTML or text; its last state remains. The bar needs only
    IPython's own displays: Rich's bar needs ipywidgets, which may not be installed.
    """

    def __init__(self, display: Callable[..., Any], interval: float = INTERVAL) -> None:
        self._display, self._interval = display, interval
        self._handle: Any = None
        self._shown = self._last = Progress("")
        self._due, self._notes = 0.0, list[str]()

    def __call__(self, progress: Progress) -> None:
        """Show a Progress, unless the bar was updated a moment ago; at once if its stage is new or it has a note."""
        new = self._last.stage != progress.stage or bool(progress.note)
        self._notes += [progress.note] if progress.note else []
        self._last = progress
        if new or time.monotonic() >= self._due:
            self._show()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Show the last Progress."""
        if self._last is not self._shown:
            self._show()

    def _show(self) -> None:
        self._shown, self._due = self._last, time.monotonic() + self._interval
        if self._handle is None:
            self._handle = self._display(self, display_id=True)
        else:
            self._handle.update(self)

    def __repr__(self) -> str:
        return "\n".join([*self._notes, str(self._last)])

    def _repr_html_(self) -> str:
        known = f' value="{self._last.cells_done}"' if self._last.cells_done else ""
        bar = f'<progress{known} max="{self._last.cells}"></progress> ' if self._last.cells else ""
        notes = "".join(f"<div>{escape(note)}</div>" for note in self._notes)
        return f"{notes}<div>{bar}<span>{escape(str(self._last))}</span></div>"


def _notebook_display() -> Callable[..., Any] | None:
    """Return IPython's display function in the kernel of a notebook; None elsewhere, as in a terminal."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    if getattr(shell, "kernel", None) is None:
        return None
    from IPython.display import display

    return display
