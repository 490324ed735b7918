"""Long work away from the thread of a page's document; its results are shown in that thread."""

import logging
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from bokeh.document import Document
from tornado.ioloop import IOLoop

from atlas.errors import InputError, RunError
from atlas.explore.threads import why

THREADS = 2
"""Threads of a page: beside a portrait the cell under the pointer is still looked up."""

Show = Callable[[], None]


class BackgroundTasks:
    """Threads of a page's own, made in the document's thread, in which ``refuse`` hears why something is not done."""

    def __init__(self, document: Document, on_error: Callable[[str], None]) -> None:
        self._document, self.refuse, self._loop = document, on_error, IOLoop.current()
        self._lock, self.closed = threading.Lock(), False
        self._threads = ThreadPoolExecutor(THREADS, thread_name_prefix="atlas-page")

    def call_in_document(self, callback: Show) -> None:
        """Have something done in the thread of the document, for as long as there is one."""
        self._loop.add_callback(self._show, callback)

    def deferred_call(self, callback: Callable[..., None]) -> Callable[..., None]:
        """A function for other threads that has something done in that of the document, with its arguments."""
        return lambda *given: self.call_in_document(partial(callback, *given))

    def _show(self, callback: Show) -> None:
        # Bokeh empties a document some time before it says that its session has ended, both in this thread.
        if not self.closed and self._document.session_context is not None:
            self._document.add_next_tick_callback(callback)

    def run(self, work: Callable[[], Show], on_error: Callable[[str], None] | None = None) -> None:
        """Do work in a thread of the page, then call its result, or ``on_error``, in the thread of the document."""
        refused = on_error or self.refuse

        def whole() -> None:
            try:
                act = work()
            except (InputError, RunError, OSError) as error:
                act = partial(refused, str(error))
            except BaseException as error:  # a mistake of ours must not leave the page without a word for good
                logging.getLogger(__name__).exception("the page could not do something")
                act = partial(refused, f"this could not be done: {why(error)}")
            self.call_in_document(act)

        with self._lock:
            if not self.closed:
                self._threads.submit(whole)

    def close(self) -> None:
        """Show nothing more, and begin nothing more."""
        with self._lock:
            self.closed = True
        self._threads.shutdown(wait=False, cancel_futures=True)

    def wait(self) -> None:
        """Wait until the work under way has ended."""
        self._threads.shutdown(wait=True)
