"""Long work of a page outside the document's thread; its results are shown in the document's thread."""

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
"""Number of threads of a page: while a portrait is drawn, the cell under the pointer is still looked up."""

Show = Callable[[], None]


class BackgroundTasks:
    """The threads of a page. It is created in the document's thread.

    document   the document of the page
    on_error   called in the document's thread with the reason why some work failed
    """

    def __init__(self, document: Document, on_error: Callable[[str], None]) -> None:
        self._document, self.refuse, self._loop = document, on_error, IOLoop.current()
        self._lock, self.closed = threading.Lock(), False
        self._threads = ThreadPoolExecutor(THREADS, thread_name_prefix="atlas-page")

    def call_in_document(self, callback: Show) -> None:
        """Call ``callback`` in the document's thread, as long as the document has a session."""
        self._loop.add_callback(self._show, callback)

    def deferred_call(self, callback: Callable[..., None]) -> Callable[..., None]:
        """Return a function for other threads that calls ``callback`` with its arguments in the document's thread."""
        return lambda *arguments: self.call_in_document(partial(callback, *arguments))

    def _show(self, callback: Show) -> None:
        # Bokeh empties a document some time before it reports the end of its session, both in this thread.
        if not self.closed and self._document.session_context is not None:
            self._document.add_next_tick_callback(callback)

    def run(self, work: Callable[[], Show], on_error: Callable[[str], None] | None = None) -> None:
        """Call ``work`` in a thread of the page, then its result, or ``on_error``, in the document's thread."""
        refused = on_error or self.refuse

        def run_work() -> None:
            try:
                act = work()
            except (InputError, RunError, OSError) as error:
                act = partial(refused, str(error))
            except BaseException as error:  # a defect must not leave the page without a message
                logging.getLogger(__name__).exception("the page could not do something")
                act = partial(refused, f"this could not be done: {why(error)}")
            self.call_in_document(act)

        with self._lock:
            if not self.closed:
                self._threads.submit(run_work)

    def close(self) -> None:
        """Show no further results, and start no further work."""
        with self._lock:
            self.closed = True
        self._threads.shutdown(wait=False, cancel_futures=True)

    def wait(self) -> None:
        """Wait until the work in progress has ended."""
        self._threads.shutdown(wait=True)
