"""The server of the page: on this machine's loopback alone, in a thread of its own."""

import asyncio
import logging
import socket
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

from atlas.errors import InputError

if TYPE_CHECKING:
    from bokeh.document import Document

HOST = "127.0.0.1"
FORGOTTEN = 4000
"""Milliseconds after which a page without a connection is gone for good."""


class PageServer:
    """Serves documents that ``make`` fills, one for each page that is opened, until ``stop``.

    ``port`` 0 is any free one. InputError where the port is taken.
    """

    def __init__(self, make: "Callable[[Document], None]", port: int = 0) -> None:
        self._make, self._asked = make, port
        self._ready, self._error = threading.Event(), ""
        self._stop: Callable[[], None] = lambda: None
        self.port = 0
        self._thread = threading.Thread(target=self._serve, name="atlas-page", daemon=True)
        self._thread.start()
        self._ready.wait()
        if self._error:
            raise InputError(self._error)

    @property
    def url(self) -> str:
        """The page's address."""
        return f"http://{HOST}:{self.port}/"

    def stop(self) -> None:
        """Close all pages and end."""
        if self._thread.is_alive():
            self._stop()
            self._thread.join()

    def _serve(self) -> None:
        from bokeh.application import Application
        from bokeh.application.handlers.function import FunctionHandler
        from bokeh.server.server import Server
        from tornado.ioloop import IOLoop

        for name in ("bokeh", "tornado"):
            logging.getLogger(name).setLevel(logging.ERROR)
        asyncio.set_event_loop(asyncio.new_event_loop())
        loop = IOLoop.current()
        try:
            self.port = _free_port(self._asked)
            server = Server(
                {"/": Application(FunctionHandler(self._make))},
                io_loop=loop,
                address=HOST,
                port=self.port,
                allow_websocket_origin=[f"{HOST}:{self.port}", f"localhost:{self.port}"],
                unused_session_lifetime_milliseconds=FORGOTTEN,
                check_unused_sessions_milliseconds=FORGOTTEN // 4,
                keep_alive_milliseconds=10_000,
            )
        except OSError as error:
            self._error = f"port {self._asked}: cannot be used: {error.strerror or error}"
            self._ready.set()
            return
        server.start()
        self._stop = lambda: loop.add_callback(loop.stop)
        loop.add_callback(self._ready.set)
        loop.start()
        server.stop(wait=False)
        loop.close(all_fds=False)


def _free_port(asked: int) -> int:
    """The port that is asked for, or any free one for 0; OSError where it is taken."""
    with socket.socket() as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        trial.bind((HOST, asked))
        return int(trial.getsockname()[1])
