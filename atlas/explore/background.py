"""Slow work of a page in threads of its own; the results are shown in the thread of the server."""

import logging
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from tornado.ioloop import IOLoop

from atlas.errors import InputError, RunError
from atlas.explore.threads import why

THREADS = 2
"""Number of threads of a page: with two, the clicked cell is looked up even while portraits are computed."""

Show = Callable[[], None]


class BackgroundTasks:
    """The worker threads of a page. The object must be created in the server's thread.

    on_error   called in the server's thread with the reason why some work failed
    """

    def __init__(self, on_error: Callable[[str], None]) -> None:
        self.refuse, self._loop = on_error, IOLoop.current()
        self._lock, self.closed = threading.Lock(), False
        self._threads = ThreadPoolExecutor(THREADS, thread_name_prefix="atlas-page")

    def deferred_call(self, callback: Callable[..., None]) -> Callable[..., None]:
        """Return a function for other threads that calls ``callback`` with its arguments in the server's thread.

        The callback is not called once the page is closed.
        """
        return lambda *arguments: self._loop.add_callback(self._show, partial(callback, *arguments))

    def _show(self, callback: Show) -> None:
        if not self.closed:
            callback()

    def run(self, work: Callable[[], Show], on_error: Callable[[str], None] | None = None) -> None:
        """Call ``work`` in a thread of the page; then call the function that it returns in the server's thread.

        If ``work`` fails, ``on_error`` is called there instead, with the reason. Its default is the handler of all the
        work.
        """
        refused = on_error or self.refuse

        def run_work() -> None:
            try:
                act = work()
            except (InputError, RunError, OSError) as error:
                act = partial(refused, str(error))
            except BaseException as error:  # a defect must not leave the page without a message
                logging.getLogger(__name__).exception("the page could not do something")
                act = partial(refused, f"this could not be done: {why(error)}")
            self.deferred_call(act)()

        with self._lock:
            if not self.closed:
                self._threads.submit(run_work)

    def close(self) -> None:
        """Discard the results of work in progress, and start no further work."""
        with self._lock:
            self.closed = True
        self._threads.shutdown(wait=False, cancel_futures=True)

    def wait(self) -> None:
        """Wait until the work in progress has ended."""
        self._threads.shutdown(wait=True)
