"""Threads that no exception ends: what one raises is logged and said, and its work begins again."""

import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress

PAUSE = 0.5
"""Seconds after which the work begins again."""


def restarting_thread(name: str, work: Callable[[], None], notify: Callable[[str], None]) -> threading.Thread:
    """A thread, running, in which ``work`` is done until it returns.

    Whenever it raises instead, the exception is logged, ``notify`` gets it in words, and the work begins again after
    PAUSE seconds. Dask's ``sync`` may raise anything, also a bare BaseException.
    """

    def run() -> None:
        while True:
            try:
                return work()
            except BaseException as error:
                logging.getLogger(__name__).exception("%s: an exception; it begins again", name)
                with suppress(Exception):
                    notify(why(error))
            time.sleep(PAUSE)

    thread = threading.Thread(target=run, name=name, daemon=True)
    thread.start()
    return thread


def why(error: BaseException | None) -> str:
    """The text of an exception, with its type, on one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
