"""The HTTP server of the pages, in a thread of its own, for requests with its token.

Every user of this machine can reach its loopback, and others can reach another address or a proxy. Therefore a page is
sent, and a websocket is opened, only for requests with the server's token.

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
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from typing import Any, Protocol
from urllib.parse import urlsplit

from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.netutil import bind_sockets
from tornado.web import Application, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from atlas.errors import InputError
from atlas.explore.threads import restarting_thread, why

HOST = "127.0.0.1"
EVERY = ("0.0.0.0", "::", "")
"""Addresses that mean all network addresses of a machine."""
PING_SECONDS = 10.0
"""Time, in seconds, between two signs of life that keep a connection open, or show that it is lost."""

Arguments = Mapping[str, list[bytes]]


class Connection(Protocol):
    """The server's side of an open page."""

    def hear(self, text: str | bytes) -> None:
        """Take a message of the page."""

    def close(self) -> None:
        """End the work for the page."""


class PageServer:
    """Serves pages to browsers, and a connection to each, until ``stop``.

    page      returns the HTML of the page for the arguments of an address
    connect   returns the connection of a page, given a function that sends it messages, and the arguments
    port      port to listen at; 0 is any free port
    host      address to listen at
    token     token with which a proxy forwards requests for any host; by default a new token is made

    Both functions are called in the server's thread. Raise InputError if the address cannot be used.
    """

    def __init__(
        self,
        page: Callable[[Arguments], str],
        connect: Callable[[Callable[[str | bytes], None], Arguments], Connection],
        port: int = 0,
        host: str = HOST,
        token: str | None = None,
    ) -> None:
        self._page, self._connect, self._asked, self._host = page, connect, port, host
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
        logging.getLogger("tornado").setLevel(logging.ERROR)
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
            open_pages = set[_Socket]()
            given: dict[str, Any] = {"server": self, "open_pages": open_pages}
            hosts = None if self._any_host else own_hosts(self.port)
            http = HTTPServer(_application(given, hosts, self.token))
            http.add_sockets(sockets)
            ending.callback(loop.run_sync, http.close_all_connections)
            ending.callback(lambda: _end_all(open_pages))
            ending.callback(http.stop)
            self._stop = lambda: loop.add_callback(loop.stop)
            loop.add_callback(self._ready.set)
            if not self._stopped.is_set():
                loop.start()

    def page(self, arguments: Arguments) -> str:
        """Return the HTML of the page for the arguments of an address."""
        return self._page(arguments)

    def connect(self, send: Callable[[str | bytes], None], arguments: Arguments) -> Connection:
        """Return the connection of a page that has opened its websocket."""
        return self._connect(send, arguments)


def listening(port: int, host: str) -> "list[socket.socket]":
    """Return sockets that listen at an address. Raise InputError if the address cannot be used."""
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


def refusal(request: HTTPServerRequest, hosts: list[str] | None, token: str) -> int | None:
    """Return the HTTP status with which a request is refused; None if the request is served.

    request   the request
    hosts     hosts that the request may name; None for any host
    token     token that the request must have
    """
    origin = request.headers.get("Origin")
    if hosts is not None and (
        request.host.lower() not in hosts or (origin is not None and urlsplit(origin).netloc.lower() not in hosts)
    ):
        return 403
    request_token = request.query_arguments.get("token", [b""])[-1]
    if not hmac.compare_digest(request_token, token.encode()):
        return 403
    try:
        for value in (argument for values in request.query_arguments.values() for argument in values):
            value.decode()
    except UnicodeDecodeError:
        return 400
    return None


class _Guarded(RequestHandler):
    """Serves requests that ``refusal`` accepts."""

    def initialize(self, server: PageServer, open_pages: "set[_Socket]") -> None:
        self.server, self.open_pages = server, open_pages

    def prepare(self) -> None:
        status = refusal(self.request, self.settings["hosts"], self.settings["secret"])
        if status is not None:
            self.send_error(status)


class _Page(_Guarded):
    """The page."""

    def get(self) -> None:
        self.set_header("Cache-Control", "no-store")
        self.set_header("Referrer-Policy", "no-referrer")
        self.finish(self.server.page(self.request.query_arguments))


class _Nothing(_Guarded):
    """Any other address."""

    def get(self) -> None:
        self.send_error(404)


class _Socket(_Guarded, WebSocketHandler):
    """The websocket of a page."""

    connection: Connection | None = None

    def check_origin(self, origin: str) -> bool:
        return True  # ``refusal`` has checked it, by the hosts of this server

    def open(self, *_: str, **__: str) -> None:
        self.open_pages.add(self)
        self.connection = self.server.connect(self._send, self.request.query_arguments)

    def _send(self, message: str | bytes) -> None:
        with suppress(WebSocketClosedError):
            sent = self.write_message(message, binary=isinstance(message, bytes))
            sent.add_done_callback(lambda future: future.exception())  # a page that has just been left hears no more

    def on_message(self, message: str | bytes) -> None:
        if self.connection is not None:
            self.connection.hear(message)

    def on_close(self) -> None:
        self.open_pages.discard(self)
        if self.connection is not None:
            self.connection.close()

    def end(self) -> None:
        """Close the connection at once, since the server ends."""
        self.on_close()
        if self.ws_connection is not None and self.ws_connection.stream is not None:
            self.ws_connection.stream.close()


def _end_all(open_pages: set[_Socket]) -> None:
    for page in list(open_pages):
        page.end()


def _application(given: dict[str, Any], hosts: list[str] | None, token: str) -> Application:
    """Return the application that serves a page and its websocket, but only to requests that ``refusal`` accepts."""
    return Application(
        [("/", _Page, given), ("/ws", _Socket, given), ("/.*", _Nothing, given)],
        hosts=hosts,
        secret=token,
        websocket_ping_interval=PING_SECONDS,
    )
