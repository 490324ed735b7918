"""A page of the explorer in Debian's chromium, driven by Playwright; tests skip without it, except in CI."""

import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
WHY = "needs chromium: apt-get install -y chromium"


def needs_browser() -> None:
    """Skip without chromium; fail in CI, where it is required."""
    if CHROMIUM is None:
        (pytest.fail if os.environ.get("CI") else pytest.skip)(WHY)


class Tab:
    """A tab: complaints of the browser, hosts asked, and what a live page shows.

    ``sent`` and ``received`` are the bytes of each message of its websockets.
    """

    def __init__(self, page: Any) -> None:
        self.page = page
        self.complaints: list[str] = []
        self.hosts: set[str] = set()
        self.sent: list[int] = []
        self.received: list[int] = []
        page.on("websocket", self._listen)
        page.on("console", self._hear)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda request: self.hosts.add(request.url.split("/")[2].split(":")[0]))

    def _hear(self, said: Any) -> None:
        known = "GL Driver Message", "willReadFrequently"  # a driver speaks of its speed, and so of reading pixels here
        if said.type in ("error", "warning") and not any(words in said.text for words in known):
            self.complaints.append(said.text)

    def _listen(self, socket: Any) -> None:
        for event, sizes in (("framesent", self.sent), ("framereceived", self.received)):
            socket.on(event, lambda content, sizes=sizes: sizes.append(len(content)))

    def address(self) -> str:
        """The address shown in the tab."""
        return str(self.page.evaluate("() => window.location.href"))

    def image(self) -> list[float] | None:
        """The window (x, y, width, height) filled by the cells of the picture; None if there is none."""
        found = self.page.evaluate(
            """() => {
                if (typeof shown === "undefined" || !shown || !held || plane.draw.due) return null
                const [across, up] = held.axes.map(({edges}) => [edges[0], edges.at(-1) - edges[0]])
                return [across[0], up[0], across[1], up[1]]
            }"""
        )
        return found if found is None else list(found)

    def mark(self) -> tuple[float, float] | None:
        """The cell marked on the page, (x, y); None if there is none."""
        found = self.page.evaluate("() => (isInPlane(state) ? state.cell.at : null)")
        return (float(found[0]), float(found[1])) if found else None

    def inked(self, canvas: str, color: str) -> list[tuple[float, int]]:
        """The columns of a canvas that have a colour, such as #aa3377: CSS pixels from its left, and how many there."""
        found = self.page.evaluate(
            """([name, color]) => {
                const canvas = document.querySelector(name), {width, height} = canvas
                if (!width || !height) return []
                const data = new Uint32Array(canvas.getContext("2d").getImageData(0, 0, width, height).data.buffer)
                const one = pixel(rgb(color)), counts = new Map()
                data.forEach((each, k) => { if (each === one) counts.set(k % width, (counts.get(k % width) || 0) + 1) })
                return [...counts].map(([x, count]) => [x * canvas.getBoundingClientRect().width / width, count])
            }""",
            [canvas, color],
        )
        return [(float(x), int(count)) for x, count in found]

    def text(self) -> str:
        """All text on the page, except the options of its menus."""
        return str(
            self.page.evaluate(
                """() => {
                    const unread = ["STYLE", "SCRIPT", "OPTION"]
                    const read = (node) => node.nodeType === 3 ? node.textContent
                        : [...node.childNodes].filter((each) => !unread.includes(each.nodeName)).map(read).join(" ")
                    return read(document.body)
                }"""
            )
        )

    def plot(self, label: str = "map of") -> tuple[float, float, float, float]:
        """The plot area of the canvas with such a label, in pixels of the tab: left, top, width, height."""
        left, top, width, height = self.page.evaluate(
            """(label) => {
                const canvas = document.querySelector(`canvas[aria-label^="${label}"]`)
                const box = canvas.getBoundingClientRect()
                if (canvas.id === "map") {
                    const {plot} = plane.scene()
                    return [box.left + plot.left, box.top + plot.top, plot.width, plot.height]
                }
                return [box.left + 64, box.top + 6, box.width - 76, box.height - 52]
            }""",
            label,
        )
        return left, top, width, height

    def wheel(self, times: int, at: tuple[float, float] = (0.3, 0.6)) -> None:
        """Turn the wheel this many times at once over a point of the plane, given as shares of its width and height."""
        left, top, width, height = self.plot()
        self.page.evaluate(
            """([x, y, times]) => {
                const node = document.elementFromPoint(x, y)
                for (let k = 0; k < times; k++)
                    node.dispatchEvent(new WheelEvent("wheel",
                        {clientX: x, clientY: y, deltaY: -120, bubbles: true, cancelable: true}))
            }""",
            [left + at[0] * width, top + at[1] * height, times],
        )

    def until(self, condition: Callable[[], Any], seconds: float = 60.0) -> Any:
        """The value of a condition once it is true; fails after this many seconds."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            with suppress_navigation():
                found = condition()
                if found:
                    return found
            self.page.wait_for_timeout(50)  # events of the browser are handled meanwhile
        raise AssertionError(f"not within {seconds:g} s; the page says: {self.text()[-600:]}")


@contextmanager
def suppress_navigation() -> Iterator[None]:
    """Ignore that a page was left while it was read."""
    from playwright.sync_api import Error

    try:
        yield
    except Error as error:
        if "navigation" not in str(error):
            raise


@contextmanager
def started() -> Iterator[Any]:
    """A browser."""
    needs_browser()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def opened(browser: Any, url: str, width: int = 1000, height: int = 440, **options: Any) -> Iterator[Tab]:
    """A tab that shows an address; further options go to a context of Playwright."""
    context = browser.new_context(viewport={"width": width, "height": height}, **options)
    try:
        tab = Tab(context.new_page())
        tab.page.goto(url)
        yield tab
    finally:
        context.close()
