"""Claims about who is served by the explorer's server: requests with its token that name its own address, no others.

A name that an attacker resolves to this machine (DNS rebinding) makes the attacker's page the origin of the answer, so
that the host, which browsers send as it was typed, is what tells.
"""

import asyncio
import http.client
from collections.abc import Iterator

import pytest
from bokeh.document import Document
from bokeh.models import Div

from atlas.errors import InputError
from atlas.explore.background import BackgroundTasks
from atlas.explore.server import PageServer, own_hosts, refusal

UPGRADE = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
}
PATHS = ["/", "/ws", "/autoload.js?bokeh-autoload-element=x", "/metadata", "/static/js/bokeh.min.js", "/nothing"]


def fill(document: Document) -> None:
    document.add_root(Div(text="secret"))


@pytest.fixture(scope="module")
def server() -> Iterator[PageServer]:
    made = PageServer(fill)
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


@pytest.mark.parametrize("path", ["/", "/autoload.js?bokeh-autoload-element=x", "/metadata", "/nothing"])
@pytest.mark.parametrize("host", ["127.0.0.1:{port}", "localhost:{port}"])
def test_another_user_of_this_machine_who_has_no_token_gets_403(server: PageServer, host: str, path: str) -> None:
    """Truth: another user pressed the buttons of a page on the loopback and had files written in its owner's name."""
    assert len(server.token) > 16
    for given in (path, f"{path}{'&' if '?' in path else '?'}token={server.token[:-1]}"):
        status, body = answer(server, given, Host=host.format(port=server.port))
        assert status == 403 and b"secret" not in body


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost", "LOCALHOST"])
def test_the_servers_own_address_is_served(server: PageServer, name: str) -> None:
    host = f"{name}:{server.port}"
    status, body = answer(server, with_token(server, "/"), Host=host, Origin=f"http://{host}")
    assert (status, b"token" in body) == (200, True)
    assert answer(server, "/static/js/bokeh.min.js", Host=host)[0] == 200


@pytest.mark.parametrize(("host", "served"), [("localhost", True), ("127.0.0.1:80", True), ("evil.example", False)])
def test_at_port_80_a_host_is_served_as_browsers_write_it(host: str, served: bool) -> None:
    from bokeh.server.util import check_allowlist
    from tornado.httputil import HTTPHeaders, HTTPServerRequest, RequestStartLine

    headers = HTTPHeaders({"Host": host, "Origin": f"http://{host}"})
    request = HTTPServerRequest(start_line=RequestStartLine("GET", "/?token=t", "HTTP/1.1"), headers=headers)
    assert (refusal(request, own_hosts(80), "t") is None) == served
    assert check_allowlist(host, own_hosts(80)) == served  # what decides about websockets
    assert refusal(request, own_hosts(5006), "t") == 403


@pytest.fixture(scope="module")
def shared() -> Iterator[PageServer]:
    """A server behind a proxy."""
    made = PageServer(fill, token="a-secret")
    yield made
    made.stop()


@pytest.mark.parametrize("host", ["hub.example", "127.0.0.1:{port}"])
def test_with_a_token_a_page_is_served_to_any_host_that_a_proxy_names(shared: PageServer, host: str) -> None:
    host = host.format(port=shared.port)
    assert answer(shared, "/?token=a-secret", Host=host, Origin=f"https://{host}")[0] == 200
    for query in ("", "?token=", "?token=another", "?token=a-secret&token=x", "?kind=a-secret"):
        status, body = answer(shared, f"/{query}", Host=host)
        assert status == 403 and b"secret" not in body
    for path in ("/autoload.js?bokeh-autoload-element=x", "/metadata"):
        assert answer(shared, path, Host=host)[0] == 403


@pytest.mark.parametrize("proxied", [True, False])
def test_a_websocket_goes_to_sessions_that_a_page_with_the_token_signed_alone(
    shared: PageServer, server: PageServer, proxied: bool
) -> None:
    from bokeh.util.token import generate_jwt_token, generate_session_id
    from tornado.httpclient import HTTPRequest
    from tornado.websocket import websocket_connect

    asked, host = (shared, "hub.example") if proxied else (server, f"127.0.0.1:{server.port}")

    async def heard(token: str) -> object:
        headers = {"Host": host, "Origin": f"http://{host}"}
        request = HTTPRequest(f"ws://127.0.0.1:{asked.port}/ws", headers=headers)
        connection = await websocket_connect(request, subprotocols=["bokeh", token])
        first = found = await asyncio.wait_for(connection.read_message(), 10.0)
        connection.close()
        while found is not None:
            found = await asyncio.wait_for(connection.read_message(), 10.0)
        return first

    forged = generate_jwt_token(generate_session_id(signed=False), signed=False)
    assert asyncio.run(heard(forged)) is None  # closed without a word
    _, body = answer(asked, with_token(asked, "/"), Host=host)
    signed = body.split(b'"token":"')[1].split(b'"')[0].decode()
    assert asyncio.run(heard(signed)) is not None


def test_a_page_holds_neither_the_cookies_nor_the_headers_of_its_request(shared: PageServer) -> None:
    from bokeh.util.token import get_token_payload

    given = {"Cookie": "jupyterhub-session=c1", "Authorization": "token c2"}
    _, body = answer(shared, "/?token=a-secret&omega=2:3", Host="hub.example", **given)
    payload = get_token_payload(body.split(b'"token":"')[1].split(b'"')[0].decode())
    assert (payload["cookies"], payload["headers"]) == ({}, {})
    assert "omega" in payload["arguments"]


def test_the_address_of_a_host_of_the_sixth_version_has_its_brackets() -> None:
    try:
        made = PageServer(fill, host="::1")
    except InputError:
        pytest.skip("this machine has no such address")
    made.stop()
    assert made.url == f"http://[::1]:{made.port}/"


def test_a_page_behind_the_token_finds_its_scripts_in_its_own_folder(shared: PageServer) -> None:
    _, body = answer(shared, "/?token=a-secret", Host="hub.example")
    assert b'src="./static/js/bokeh' in body and b'src="/static' not in body


def test_each_server_has_a_token_of_its_own_which_its_bare_address_lacks(server: PageServer) -> None:
    made = PageServer(fill, host="0.0.0.0")
    made.stop()
    assert len(made.token) > 16 and made.token != server.token
    assert "127.0.0.1" not in made.url and "token" not in made.url + server.url


@pytest.mark.parametrize("query", ["omega=%ff", "%fe=1&kind=%c3"])
def test_an_address_that_is_no_text_gets_400(server: PageServer, query: str) -> None:
    assert answer(server, with_token(server, f"/?{query}"), Host=f"127.0.0.1:{server.port}")[0] == 400


async def _shown_after_its_end() -> None:
    document = Document()
    background = BackgroundTasks(document, pytest.fail)
    session = object()
    document.callbacks.on_change_dispatch_to(session)
    document.destroy(session)
    background.call_in_document(lambda: pytest.fail("something is shown"))
    await asyncio.sleep(0)
    background.close()


def test_nothing_is_shown_in_a_document_that_has_ended() -> None:
    asyncio.run(_shown_after_its_end())
