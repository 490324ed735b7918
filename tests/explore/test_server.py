"""Claims about who is served by the explorer's server: requests with its token that name its own address, no others.

A name that an attacker resolves to this machine (DNS rebinding) makes the attacker's page the origin of the answer, so
that the host, which browsers send as it was typed, is what tells.
"""

import asyncio
import http.client
from collections.abc import Callable, Iterator, Mapping

import pytest
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.httputil import HTTPHeaders, HTTPServerRequest, RequestStartLine
from tornado.websocket import websocket_connect

from atlas.errors import InputError
from atlas.explore.background import BackgroundTasks
from atlas.explore.server import PageServer, own_hosts, refusal

UPGRADE = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
}
PATHS = ["/", "/ws", "/nothing"]


class Echo:
    """A connection that sends back what it hears, after a greeting."""

    def __init__(self, send: Callable[[str | bytes], None], arguments: Mapping[str, list[bytes]]) -> None:
        self.hear = send
        send("secret")

    def close(self) -> None:
        """Nothing."""


def page(arguments: Mapping[str, list[bytes]]) -> str:
    return f"secret {sorted(arguments)}"


@pytest.fixture(scope="module")
def server() -> Iterator[PageServer]:
    made = PageServer(page, Echo)
    yield made
    made.stop()


def with_token(server: PageServer, path: str) -> str:
    return f"{path}{'&' if '?' in path else '?'}token={server.token}"


def answer(server: PageServer, path: str, **headers: str) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=30.0)
    try:
        connection.putrequest("GET", path, skip_host=True)
        for name, value in headers.items():
            connection.putheader(name.replace("_", "-"), value)
        connection.endheaders()
        found = connection.getresponse()
        return found.status, b"" if found.status == 101 else found.read()
    finally:
        connection.close()


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1:1", "localhost.evil.example:{port}"]
)
def test_a_foreign_host_gets_403_and_no_token(server: PageServer, host: str, path: str) -> None:
    headers = {"Host": host.format(port=server.port)} | (UPGRADE if path == "/ws" else {})
    status, body = answer(server, with_token(server, path), **headers)
    assert status == 403
    assert b"token" not in body and b"secret" not in body


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1"])
def test_a_page_from_elsewhere_gets_403(server: PageServer, origin: str, path: str) -> None:
    headers = {"Host": f"127.0.0.1:{server.port}", "Origin": origin} | (UPGRADE if path == "/ws" else {})
    assert answer(server, with_token(server, path), **headers)[0] == 403


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("host", ["127.0.0.1:{port}", "localhost:{port}"])
def test_another_user_of_this_machine_who_has_no_token_gets_403(server: PageServer, host: str, path: str) -> None:
    """Truth: another user pressed the buttons of a page on the loopback and had files written in its owner's name."""
    assert len(server.token) > 16
    for given in (path, f"{path}{'&' if '?' in path else '?'}token={server.token[:-1]}"):
        headers = {"Host": host.format(port=server.port)} | (UPGRADE if path == "/ws" else {})
        status, body = answer(server, given, **headers)
        assert status == 403 and b"secret" not in body


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost", "LOCALHOST"])
def test_the_servers_own_address_is_served(server: PageServer, name: str) -> None:
    host = f"{name}:{server.port}"
    status, body = answer(server, with_token(server, "/"), Host=host, Origin=f"http://{host}")
    assert (status, b"secret" in body) == (200, True)
    assert answer(server, with_token(server, "/ws"), Host=host, Origin=f"http://{host}", **UPGRADE)[0] == 101
    assert answer(server, with_token(server, "/nothing"), Host=host)[0] == 404


@pytest.mark.parametrize(("host", "served"), [("localhost", True), ("127.0.0.1:80", True), ("evil.example", False)])
def test_at_port_80_a_host_is_served_as_browsers_write_it(host: str, served: bool) -> None:
    headers = HTTPHeaders({"Host": host, "Origin": f"http://{host}"})
    request = HTTPServerRequest(start_line=RequestStartLine("GET", "/?token=t", "HTTP/1.1"), headers=headers)
    assert (refusal(request, own_hosts(80), "t") is None) == served
    assert refusal(request, own_hosts(5006), "t") == 403


@pytest.fixture(scope="module")
def shared() -> Iterator[PageServer]:
    """A server behind a proxy."""
    made = PageServer(page, Echo, token="a-secret")
    yield made
    made.stop()


@pytest.mark.parametrize("host", ["hub.example", "127.0.0.1:{port}"])
def test_with_a_token_a_page_is_served_to_any_host_that_a_proxy_names(shared: PageServer, host: str) -> None:
    host = host.format(port=shared.port)
    assert answer(shared, "/?token=a-secret", Host=host, Origin=f"https://{host}")[0] == 200
    for query in ("", "?token=", "?token=another", "?token=a-secret&token=x", "?kind=a-secret"):
        status, body = answer(shared, f"/{query}", Host=host)
        assert status == 403 and b"secret" not in body
    assert answer(shared, "/ws", Host=host, **UPGRADE)[0] == 403


@pytest.mark.parametrize("proxied", [True, False])
def test_a_websocket_goes_to_those_who_have_the_token_alone(
    shared: PageServer, server: PageServer, proxied: bool
) -> None:
    asked, host = (shared, "hub.example") if proxied else (server, f"127.0.0.1:{server.port}")

    async def heard(query: str) -> list[object]:
        headers = {"Host": host, "Origin": f"http://{host}"}
        connection = await websocket_connect(HTTPRequest(f"ws://127.0.0.1:{asked.port}/ws{query}", headers=headers))
        try:
            await connection.write_message("again")
            return [await asyncio.wait_for(connection.read_message(), 10.0) for _ in range(2)]
        finally:
            connection.close()
            while await asyncio.wait_for(connection.read_message(), 10.0) is not None:
                pass

    for query in ("", "?token=", f"?token={asked.token[:-1]}"):
        with pytest.raises(HTTPClientError, match="403"):
            asyncio.run(heard(query))
    assert asyncio.run(heard(f"?token={asked.token}")) == ["secret", "again"]


def test_the_address_of_a_host_of_the_sixth_version_has_its_brackets() -> None:
    try:
        made = PageServer(page, Echo, host="::1")
    except InputError:
        pytest.skip("this machine has no such address")
    made.stop()
    assert made.url == f"http://[::1]:{made.port}/"


def test_each_server_has_a_token_of_its_own_which_its_bare_address_lacks(server: PageServer) -> None:
    made = PageServer(page, Echo, host="0.0.0.0")
    made.stop()
    assert len(made.token) > 16 and made.token != server.token
    assert "127.0.0.1" not in made.url and "token" not in made.url + server.url


@pytest.mark.parametrize("query", ["omega=%ff", "%fe=1&kind=%c3"])
def test_an_address_that_is_no_text_gets_400(server: PageServer, query: str) -> None:
    assert answer(server, with_token(server, f"/?{query}"), Host=f"127.0.0.1:{server.port}")[0] == 400


async def _shown_after_its_end() -> None:
    background = BackgroundTasks(pytest.fail)
    later = background.deferred_call(lambda: pytest.fail("something is shown"))
    background.close()
    later()
    await asyncio.sleep(0)


def test_nothing_is_shown_on_a_page_that_is_closed() -> None:
    asyncio.run(_shown_after_its_end())
