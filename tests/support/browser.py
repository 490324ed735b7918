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
    """A tab: complaints of the browser, hosts asked, and the state of the page's models.

    ``sent`` and ``received`` are the bytes of each frame of its websockets; ``messages`` how many of Bokeh's messages
    these make up, both ways.
    """

    def __init__(self, page: Any) -> None:
        self.page = page
        self.complaints: list[str] = []
        self.hosts: set[str] = set()
        self.sent: list[int] = []
        self.received: list[int] = []
        self.messages = 0
        page.on("websocket", self._listen)
        page.on("console", self._hear)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda request: self.hosts.add(request.url.split("/")[2].split(":")[0]))

    def _hear(self, said: Any) -> None:
        # A driver speaks of its own speed, and Bokeh of plots without data yet.
        known = "GL Driver Message", "could not set initial ranges"
        if said.type in ("error", "warning") and not any(words in said.text for words in known):
            self.complaints.append(said.text)

    def _listen(self, socket: Any) -> None:
        for event, sizes in (("framesent", self.sent), ("framereceived", self.received)):
            socket.on(event, lambda content, sizes=sizes: self._count(content, sizes))

    def _count(self, content: str | bytes, sizes: list[int]) -> None:
        sizes.append(len(content))
        self.messages += isinstance(content, str) and content.startswith('{"msgid"')

    def address(self) -> str:
        """The address shown in the tab."""
        return str(self.page.evaluate("() => window.location.href"))

    def image(self) -> list[float] | None:
        """The window (x, y, width, height) filled by the cells of the picture; None if there is none."""
        found = self.page.evaluate(
            """() => {
                if (!window.Bokeh || !Bokeh.documents.length) return null
                for (const model of Bokeh.documents[0]._all_models.values())
                    if (model.type === "ColumnDataSource" && model.data.cells && model.data.cells.length)
                        return model.data.cells[0]
                return null
            }"""
        )
        return found if found is None else list(found)

    def mark(self) -> tuple[float, float] | None:
        """The cell marked on the page, (x, y); None if there is none."""
        found = self.page.evaluate(
            """() => {
                for (const model of Bokeh.documents[0]._all_models.values())
                    if (model.type === "ColumnDataSource" && Object.keys(model.data).join() === "x,y")
                        return [...model.data.x, ...model.data.y]
            }"""
        )
        return (float(found[0]), float(found[1])) if found else None

    def models(self, kind: str, name: str) -> list[Any]:
        """A property of all models of a type on the page."""
        script = """([kind, name]) => [...Bokeh.documents[0]._all_models.values()]
            .filter((model) => model.type === kind).map((model) => model[name])"""
        return list(self.page.evaluate(script, [kind, name]))

    def text(self) -> str:
        """All text on the page, except the options of its menus."""
        return str(
            self.page.evaluate(
                """() => {
                    const unread = ["STYLE", "SCRIPT", "OPTION"]
                    const read = (node) => node.nodeType === 3 ? node.textContent
                        : [...(node.shadowRoot ? node.shadowRoot.childNodes : []), ...node.childNodes]
                            .filter((each) => !unread.includes(each.nodeName)).map(read).join(" ")
                    return read(document.body)
                }"""
            )
        )

    def plot(self, label: str = "") -> tuple[float, float, float, float]:
        """The plot area of the first plot with such a label, in pixels of the tab: left, top, width, height."""
        box = self.page.evaluate(
            """(label) => {
                const view = [...Bokeh.index.roots].map(function find(view) {
                    const named = view.model.html_attributes?.["aria-label"] ?? ""
                    if (view.model.type === "Figure" && named.startsWith(label)) return view
                    for (const child of view.child_views || []) { const found = find(child); if (found) return found }
                    return null
                }).filter(Boolean)[0]
                const inner = view.frame.bbox, box = view.el.getBoundingClientRect()
                return [box.left + inner.left, box.top + inner.top, inner.width, inner.height]
            }""",
            label,
        )
        left, top, width, height = box
        return left, top, width, height

    def wheel(self, times: int, at: tuple[float, float] = (0.3, 0.6)) -> None:
        """Turn the wheel this many times at once over a point of the plane, given as shares of its width and height."""
        left, top, width, height = self.plot()
        self.page.evaluate(
            """([x, y, times]) => {
                let node = document.elementFromPoint(x, y)
                for (let inner = node; inner; node = inner || node) {
                    inner = node.shadowRoot && node.shadowRoot.elementFromPoint(x, y)
                    if (!inner || inner === node) break
                    node = inner
                }
                for (let k = 0; k < times; k++)
                    node.dispatchEvent(new WheelEvent("wheel",
                        {clientX: x, clientY: y, deltaY: -120, bubbles: true, composed: true, cancelable: true}))
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
