"""Links to the explorer's page, in a browser: its history, a cell, and the page behind a proxy in a folder."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from io import BytesIO
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from distributed import Client
from PIL import Image

from atlas.explore.session import HUB, ExplorerSession, explore
from tests.support.browser import Tab, opened

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning:playwright")]

WINDOW = "omega=3.2:4.2&b=0.3:0.5"
FOLDER = "/user/me/proxy/7"


@pytest.fixture
def tab(running: ExplorerSession, browser: Any) -> Iterator[Tab]:
    with opened(browser, f"{running.url}&{WINDOW}", 1440, 800) as made:
        made.until(made.image)
        yield made
        assert made.complaints == []


@contextmanager
def proxy(port: int) -> Iterator[int]:
    """A proxy that serves a port in FOLDER of its own, and passes host and origin on as they came."""
    listening = socket.create_server(("127.0.0.1", 0))
    ends: list[socket.socket] = []

    def pump(source: socket.socket, sink: socket.socket, inward: bool) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                sink.sendall(data.replace(b"GET " + FOLDER.encode(), b"GET ") if inward else data)
        for element in (source, sink):
            with suppress(OSError):
                element.shutdown(socket.SHUT_RDWR)

    def serve() -> None:
        with suppress(OSError):
            while True:
                near, _ = listening.accept()
                far = socket.create_connection(("127.0.0.1", port))
                ends.extend((near, far))
                threading.Thread(target=pump, args=(near, far, True), daemon=True).start()
                threading.Thread(target=pump, args=(far, near, False), daemon=True).start()

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield listening.getsockname()[1]
    finally:
        listening.shutdown(socket.SHUT_RDWR)
        listening.close()
        thread.join()
        for end in ends:
            end.close()


def test_back_leads_to_the_view_at_which_one_rested_and_not_to_those_between(tab: Tab) -> None:
    first = tab.until(lambda: tab.address() if "kind=" in tab.address() else "")
    tab.page.wait_for_timeout(2000)
    tab.wheel(4)
    tab.until(lambda: tab.address() != first)
    tab.wheel(4)
    tab.page.wait_for_timeout(1000)
    last = tab.address()
    tab.page.go_back()
    tab.page.wait_for_url(first)
    tab.until(tab.image)
    tab.page.go_forward()
    tab.page.wait_for_url(last)
    tab.until(tab.image)


def test_the_cell_clicked_comes_back_by_the_link(tab: Tab) -> None:
    left, top, width, height = tab.plot()
    tab.page.mouse.click(left + 0.5 * width, top + 0.6 * height)
    tab.page.get_by_role("button", name="copy all numbers").wait_for(timeout=120_000)
    tab.until(lambda: "cell=" in tab.address())
    mark = tab.mark()
    assert mark is not None
    tab.page.goto(tab.address())
    tab.page.get_by_role("button", name="copy all numbers").wait_for(timeout=120_000)
    assert tab.mark() == mark


def test_keys_move_and_zoom_the_view_and_escape_closes_a_cut(tab: Tab) -> None:
    def window() -> list[float]:
        ends = parse_qs(urlsplit(tab.address()).query)["omega"][0]
        return [float(end) for end in ends.split(":")]

    tab.until(lambda: "kind=" in tab.address())
    moves = {
        "ArrowRight": [3.4, 4.4],
        "ArrowLeft": [3.2, 4.2],
        "-": [3.7 - 0.5 / 0.7, 3.7 + 0.5 / 0.7],
        "+": [3.2, 4.2],
    }
    for key, expected in moves.items():
        tab.page.keyboard.press(key)
        tab.until(partial(lambda ends: np.allclose(window(), ends, rtol=0, atol=1e-9), expected))
    tab.page.get_by_role("button", name="cut up").click()
    tab.until(lambda: "cut=" in tab.address())
    tab.page.keyboard.press("Escape")
    tab.until(lambda: "cut=" not in tab.address())


def test_in_dark_mode_all_is_dark_but_the_map_whose_colours_stay(running: ExplorerSession, browser: Any) -> None:
    def pixels(scheme: str) -> tuple[np.ndarray, np.ndarray]:
        context = browser.new_context(viewport={"width": 1440, "height": 800}, color_scheme=scheme)
        try:
            tab = Tab(context.new_page())
            tab.page.goto(f"{running.url}&omega=3.9:4.0&b=0.5:0.51&kind=period")
            tab.until(tab.image)
            tab.page.wait_for_timeout(1000)
            tab.until(lambda: "all visible cells are solved" in tab.text(), 120.0)
            tab.page.wait_for_timeout(2000)
            left, top, width, height = map(round, tab.plot())
            shot = np.asarray(Image.open(BytesIO(tab.page.screenshot())).convert("RGB"))
            beside = shot[top + height + 42, left - 60]  # below the labels of one axis, and left of the other's
            assert np.array_equal(beside, shot[797, 1115]), "the plane stands in a block of another colour"
            return shot[797, 1115], shot[top + height // 2, left + width // 2]
        finally:
            context.close()

    (light, map_light), (dark, map_dark) = pixels("light"), pixels("dark")
    assert light.tolist() == [255, 255, 255] and dark.tolist() == [0x14, 0x18, 0x1F]
    assert map_light.tolist() == map_dark.tolist() != [255, 255, 255]


def test_behind_the_proxy_of_jupyterhub_the_page_draws_and_hears(
    client: Client, browser: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(HUB, "/user/me/")
    running = explore("omega-b", client=client)
    try:
        frame = running._repr_html_()
        place = frame.split('src="')[1].split('"')[0]
        assert place.startswith("/user/me/proxy/") and "token=" in place
        port = int(place.split("/")[4])
        with proxy(port) as outside:
            url = f"http://127.0.0.1:{outside}{FOLDER}/?{place.partition('?')[2]}&{WINDOW}"
            with opened(browser, url) as tab:
                tab.until(tab.image)
                tab.until(lambda: "kind=" in tab.address() and "token=" in tab.address())
                window = tab.image()
                tab.wheel(4)
                tab.until(lambda: tab.image() != window)
                tab.page.reload()
                tab.until(tab.image)
                assert tab.complaints == []
    finally:
        running.stop()
