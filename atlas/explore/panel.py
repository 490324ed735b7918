"""Panels of a page: each shows one topic at a time, such as a cell, and submits computations about it to workers.

A result that arrives after its panel has changed the topic is discarded. This is done in the base class only.
"""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

from atlas.explore.background import BackgroundTasks, Show
from atlas.explore.explorer import Explorer
from atlas.explore.jobs import Computation, ComputationJob

A = TypeVar("A")


class Tell(Protocol):
    """A function that tells the page something: what it is, and its fields."""

    def __call__(self, what: str, **fields: Any) -> None:
        """Send a message to the page."""


class Panel(Generic[A]):
    """Base class of panels that show one ``topic`` at a time, None if there is none.

    Subclasses implement ``start``, and where needed ``clear`` and ``show_error``. What a panel shows it tells the page
    by ``tell``.
    """

    def __init__(self, explorer: Explorer, background: BackgroundTasks, tell: Tell) -> None:
        self._explorer, self._subject, self._background = explorer, explorer.subject, background
        self.tell = tell
        self.topic: A | None = None
        self._turns = 0

    def start(self, about: A) -> None:
        """Show that nothing is known of the new topic ``about`` yet, and submit the computations about the topic."""
        raise NotImplementedError

    def clear(self) -> None:
        """Show nothing, since there is no topic."""

    def show_error(self, reason: str) -> None:
        """Show the reason why a computation failed."""
        self._background.refuse(reason)

    def set_topic(self, about: A | None) -> None:
        """Change the topic and cancel the computations about the earlier topic. Do nothing if the topic is the same."""
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
        """Cancel all computations of the panel."""
        self._explorer.patches.request(self, ())

    def submit(self, questions: Iterable[Computation[Any]], on_result: Callable[[Any], None]) -> None:
        """Submit computations to the workers, before the earlier ones of this panel.

        ``on_result`` is called in the server's thread with each post-processed result, ``show_error`` with each error
        message.
        """
        answers = [self._background.deferred_call(self._current(act)) for act in (on_result, self.show_error)]
        self._explorer.patches.request(
            self, [ComputationJob(question, *answers) for question in questions], keep_earlier=True
        )

    def run_in_background(self, work: Callable[[], Show]) -> None:
        """Call ``work`` in a thread of the page; then call the function that it returns in the server's thread."""
        turns, show_result = self._turns, self._current(_do)

        def prepare_result() -> Show:
            return partial(show_result, work()) if turns == self._turns else lambda: None

        self._background.run(prepare_result, self._current(self.show_error))

    def progress_callback(self) -> Callable[[Show], None]:
        """Return a function by which work in another thread shows intermediate results in the server's thread.

        The function must be created in the server's thread before the work begins.
        """
        return self._background.deferred_call(self._current(_do))

    def _current(self, callback: Callable[..., None]) -> Callable[..., None]:
        """Return ``callback`` for the server's thread, without effect once the panel has changed its topic."""
        turns = self._turns
        return lambda *arguments: callback(*arguments) if turns == self._turns else None


def _do(show: Show) -> None:
    show()
