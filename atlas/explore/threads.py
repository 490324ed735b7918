"""Threads that survive exceptions: an exception is logged and reported, and the work starts again."""

import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress

PAUSE = 0.5
"""Time, in seconds, from an exception until the work of a thread starts again."""


def restarting_thread(name: str, work: Callable[[], None], notify: Callable[[str], None]) -> threading.Thread:
    """Start a thread that does ``work``, again after each exception until it returns, and return the thread.

    name     name of the thread
    work     the work
    notify   called with the text of each exception

    If ``work`` raises, the exception is logged and reported, and the work starts again after PAUSE seconds. Dask's
    ``sync`` may raise anything, even a bare BaseException.
    """

    def run() -> None:
        while True:
            try:
                return work()
            except BaseException as error:
                logging.getLogger(__name__).exception("%s: an exception; the work starts again", name)
                with suppress(Exception):
                    notify(why(error))
            time.sleep(PAUSE)

    thread = threading.Thread(target=run, name=name, daemon=True)
    thread.start()
    return thread


def why(error: BaseException | None) -> str:
    """Return the text of an exception with its type, on one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
