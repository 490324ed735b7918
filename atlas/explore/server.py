"""The HTTP server of the pages, in a thread of its own, for requests with its token.

Every user of this machine can reach its loopback, and others can reach another address or a proxy. Therefore a page is
sent only to requests with the server's token, and a websocket is opened only for sessions that such a page signed.

Any web page that the user has open can send requests to the server. By a host name of its own that resolves to this
machine (DNS rebinding), such a page may even read the answers. Therefore requests on the loopback, without a proxy,
must also name the server's own address as the host. If they name an origin, the origin must be this address, too.
"""

import asyncio
import hmac
import logging
import secrets
import socket
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from atlas.errors import InputError
from atlas.explore.threads import restarting_thread, why

if TYPE_CHECKING:
    from bokeh.document import Document
    from tornado.httputil import HTTPServerRequest


HOST = "127.0.0.1"
EVERY = ("0.0.0.0", "::", "")
"""Addresses that mean all network addresses of a machine."""
FORGOTTEN = 4000
"""Time, in milliseconds, after which a page without a connection is removed."""


class PageServer:
    """Serves documents that ``make`` fills, one for each page that a browser opens, until ``stop``.

    make    function that fills a Bokeh document
    port    port to listen at; 0 is any free port
    host    address to listen at
    token   token with which a proxy forwards requests for any host; by default a new token is made

    Raise InputError if the address cannot be used.
    """

    def __init__(
        self, make: "Callable[[Document], None]", port: int = 0, host: str = HOST, token: str | None = None
    ) -> None:
        self._make, self._asked, self._host = make, port, host
        self._any_host = token is not None or host != HOST
        self.token = token or secrets.token_urlsafe(16)
        self._ready, self._stopped, self._error = threading.Event(), threading.Event(), ""
        self._stop: Callable[[], None] = lambda: None
        self.port = 0
        self._mistake = ""
        self._thread = restarting_thread("atlas-page", self._run, lambda _: None)
        self._ready.wait()
        if self._error:
            raise InputError(self._error)
        if self._mistake:
            raise RuntimeError(f"the server of the page did not start: {self._mistake}")

    @property
    def url(self) -> str:
        """The address of the pages, without the token."""
        name = socket.getfqdn() if self._host in EVERY else self._host
        return f"http://{f'[{name}]' if ':' in name else name}:{self.port}/"

    def stop(self) -> None:
        """Close all pages and stop serving."""
        self._stopped.set()
        if self._thread.is_alive():
            with suppress(RuntimeError):  # the loop has just ended by itself
                self._stop()
            self._thread.join()

    def _run(self) -> None:
        """Serve until ``stop``; this function is the work of the server's thread.

        Once the server has started, ``restarting_thread`` restarts it at the same port after any exception.
        """
        try:
            self._serve()
        except BaseException as error:
            if self._ready.is_set():
                raise
            logging.getLogger(__name__).exception("the server of the page did not start")
            self._mistake = why(error)
        finally:
            self._ready.set()

    def _serve(self) -> None:
        from bokeh.server.server import BaseServer
        from tornado.httpserver import HTTPServer
        from tornado.ioloop import IOLoop

        for name in ("bokeh", "tornado"):
            logging.getLogger(name).setLevel(logging.ERROR)
        asyncio.set_event_loop(asyncio.new_event_loop())
        loop = IOLoop.current()
        try:
            sockets = listening(self.port or self._asked, self._host)
        except InputError as error:
            if self._ready.is_set():
                raise
            self._error = str(error)
            self._ready.set()
            return
        self.port = int(sockets[0].getsockname()[1])
        with ExitStack() as ending:
            ending.callback(loop.close, all_fds=False)
            for bound in sockets:
                ending.callback(bound.close)
            pages = _guarded_pages(self._make, None if self._any_host else own_hosts(self.port), self.token)
            http = HTTPServer(pages)
            http.add_sockets(sockets)
            ending.callback(http.stop)
            server = BaseServer(loop, pages, http)
            server.start()
            ending.callback(server.stop, wait=False)
            self._stop = lambda: loop.add_callback(loop.stop)
            loop.add_callback(self._ready.set)
            if not self._stopped.is_set():
                loop.start()


def listening(port: int, host: str) -> "list[socket.socket]":
    """Return sockets that listen at an address. Raise InputError if the address cannot be used."""
    from tornado.netutil import bind_sockets

    if not 0 <= port <= 65535:
        raise InputError(f"port: found {port}, must be 0 to 65535")
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        socket.create_server((host, port), family=family).close()  # Tornado leaves a socket open if it cannot be bound
        return bind_sockets(port, host)
    except OSError as error:
        raise InputError(f"host {host}, port {port}: cannot be used: {error.strerror or error}") from None


def own_hosts(port: int) -> list[str]:
    """Return the hosts that a request to a port of the loopback may name; browsers leave out port 80."""
    names = (HOST, "localhost")
    return [f"{name}:{port}" for name in names] + [name for name in names if port == 80]


def refusal(request: "HTTPServerRequest", hosts: list[str] | None, token: str) -> int | None:
    """Return the HTTP status with which a request is refused; None if the request is served.

    request   the request
    hosts     hosts that the request may name; None for any host
    token     token that the request must have

    Requests for Bokeh's scripts need no token. Its websocket, by itself, accepts only sessions that a page of this
    server signed.
    """
    origin = request.headers.get("Origin")
    if hosts is not None and (
        request.host.lower() not in hosts or (origin is not None and urlsplit(origin).netloc.lower() not in hosts)
    ):
        return 403
    request_token = request.query_arguments.get("token", [b""])[-1]
    for_all = request.path.startswith("/static/") or request.path in ("/ws", "/favicon.ico")
    if not for_all and not hmac.compare_digest(request_token, token.encode()):
        return 403
    try:
        for value in (argument for values in request.query_arguments.values() for argument in values):
            value.decode()
    except UnicodeDecodeError:
        return 400
    return None


def _guarded_pages(make: "Callable[[Document], None]", hosts: list[str] | None, token: str) -> "Any":
    """Return the Tornado application that serves pages, but only to requests that ``refusal`` accepts."""
    from bokeh.application import Application as Pages
    from bokeh.application.handlers.function import FunctionHandler
    from bokeh.server.tornado import BokehTornado
    from tornado.web import ErrorHandler

    class RestrictedTornado(BokehTornado):
        def find_handler(self, request: "HTTPServerRequest", **kwargs: Any) -> Any:
            status = refusal(request, hosts, token)
            if status is not None:
                return self.get_handler_delegate(request, ErrorHandler, {"status_code": status})
            return super().find_handler(request, **kwargs)

        def resources(self, absolute_url: Any = None) -> Any:
            return super().resources("./")  # relative to the page, since a proxy may serve the page in a folder

    return RestrictedTornado(
        {"/": Pages(FunctionHandler(make))},
        extra_websocket_origins=["*"] if hosts is None else hosts,
        sign_sessions=True,
        secret_key=secrets.token_bytes(32),
        include_headers=[],  # otherwise a page's source has the headers of its request, and a hub's cookies
        include_cookies=[],
        unused_session_lifetime_milliseconds=FORGOTTEN,
        check_unused_sessions_milliseconds=FORGOTTEN // 4,
        keep_alive_milliseconds=10_000,
    )
