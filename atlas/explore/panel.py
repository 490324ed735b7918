"""Panels of a page: a panel is about one thing at a time, asks for results on it, and shows the answers.

An answer that comes once its panel is about something else is dropped: here, and nowhere else.
"""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, Generic, TypeVar

from atlas.explore.background import BackgroundTasks, Show
from atlas.explore.explorer import Explorer
from atlas.explore.jobs import Computation, ComputationJob

A = TypeVar("A")


class Panel(Generic[A]):
    """What ``turn`` says it is ``about``, None for nothing; the panels have ``begin``, ``clear`` and ``refuse``."""

    def __init__(self, explorer: Explorer, background: BackgroundTasks) -> None:
        self._explorer, self._subject, self._background = explorer, explorer.subject, background
        self.topic: A | None = None
        self._turns = 0

    def start(self, about: A) -> None:
        """Show that nothing is known of a thing yet, and ask."""
        raise NotImplementedError

    def clear(self) -> None:
        """Show nothing."""

    def show_error(self, reason: str) -> None:
        """Say why something is not found."""
        self._background.refuse(reason)

    def set_topic(self, about: A | None) -> None:
        """Turn to another thing: earlier questions are dropped. Does nothing if it is the same."""
        if about == self.topic:
            return
        self.topic = about
        self._turns += 1
        self._explorer.patches.request(self, ())
        if about is None:
            self.clear()
        else:
            self.start(about)

    def close(self) -> None:
        """Want nothing more."""
        self._explorer.patches.request(self, ())

    def submit(
        self,
        questions: Iterable[Computation[Any]],
        on_result: Callable[[Any], None],
        on_error: Callable[[str], None] | None = None,
    ) -> None:
        """Ask the crew, before earlier questions: ``on_result`` shows an answer, ``on_error`` why there is none."""
        answers = [
            self._background.deferred_call(self._current(act)) for act in (on_result, on_error or self.show_error)
        ]
        self._explorer.patches.request(
            self, [ComputationJob(question, *answers) for question in questions], keep_earlier=True
        )

    def run_in_background(self, work: Callable[[], Show]) -> None:
        """Have something found in a thread of the page, and shown by what ``work`` returns."""
        turns, shown = self._turns, self._current(_do)

        def whole() -> Show:
            return partial(shown, work()) if turns == self._turns else lambda: None

        self._background.run(whole, self._current(self.show_error))

    def progress_callback(self) -> Callable[[Show], None]:
        """A function that shows something during ``work``, in its thread; to be made before that begins."""
        return self._background.deferred_call(self._current(_do))

    def _current(self, callback: Callable[..., None]) -> Callable[..., None]:
        """An act for the document's thread that does nothing once the panel is about something else."""
        turns = self._turns
        return lambda *given: callback(*given) if turns == self._turns else None


def _do(show: Show) -> None:
    show()
