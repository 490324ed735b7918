"""What goes between the browser and the explorer, in messages and bytes, and what the browser does without any."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from atlas.explore.front.numbers import round_mantissa
from atlas.explore.plane_message import BITS
from atlas.explore.session import ExplorerSession
from atlas.explore.view_state import from_address
from atlas.query.plane import Plane
from atlas.render.kinds import KIND_TABLE
from atlas.render.layers import MapView, paint
from atlas.render.layout import STANDARD
from atlas.render.painters import PAINTERS
from atlas.render.request import PictureRequest
from tests.explore.test_page import arguments, painter_of, settled
from tests.support.browser import Tab, opened

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning:playwright")]

WINDOW = "omega=3.2:4.2&b=0.3:0.5&kind=scalar&variable=peak_to_peak"


@pytest.fixture
def tab(running: ExplorerSession, browser: Any) -> Iterator[Tab]:
    """Its page, once all in view is solved and drawn."""
    with opened(browser, f"{running.url}&{WINDOW}") as made:
        made.until(made.image)
        rested(running, made)
        yield made
        assert made.complaints == []


def rested(running: ExplorerSession, tab: Tab) -> None:
    """Wait until nothing more is to come."""
    settled(running, tab)
    tab.page.wait_for_timeout(1500)


def pixels(tab: Tab) -> np.ndarray:
    """The picture (y, x, 4) from above, as the browser shows it."""
    script = """() => {
        const {left, top, width, height} = plane.scene().plot
        return [[height, width], Array.from(by("map").getContext("2d").getImageData(left, top, width, height).data)]
    }"""
    shape, values = tab.page.evaluate(script)
    return np.array(values, dtype=np.uint8).reshape(*shape, 4)


def alone(tab: Tab, act: Callable[[], Any], shown: Callable[[], Any]) -> np.ndarray:
    """The picture after something that the browser does without a message, once this is shown."""
    before, sent, received = pixels(tab), len(tab.sent), len(tab.received)
    act()
    tab.until(shown, 10.0)
    tab.page.wait_for_timeout(1500)  # the server waits a tenth as long before it looks at a view at all
    assert (len(tab.sent) - sent, len(tab.received) - received) == (0, 0)
    after = pixels(tab)
    assert before.shape == after.shape and np.mean(np.any(before != after, axis=-1)) > 0.001
    return after


def ends(tab: Tab, low: float, high: float) -> None:
    """Type the ends of the scale."""
    inputs = tab.page.locator(".ends input")
    for place, end in enumerate((low, high)):
        inputs.nth(place).fill(f"{end}")
        inputs.nth(place).press("Enter")


def test_another_scale_needs_no_message(tab: Tab) -> None:
    alone(tab, lambda: ends(tab, 0.3, 0.9), lambda: "vmax=0.9" in tab.address())
    alone(tab, lambda: tab.page.get_by_role("button", name="reset").click(), lambda: "vmax" not in tab.address())
    alone(tab, lambda: tab.page.get_by_label("logarithmic").check(), lambda: "log=1" in tab.address())
    alone(tab, lambda: ends(tab, 0.3, 0.9), lambda: "vmax=0.9" in tab.address())
    fit = tab.page.get_by_role("button", name="fit the scale to the view")
    alone(tab, fit.click, lambda: "vmax=" in tab.address() and "vmax=0.9" not in tab.address())


def test_another_map_of_variables_that_the_page_holds_needs_no_message(running: ExplorerSession, tab: Tab) -> None:
    select = tab.page.locator("#look select")
    select.select_option("combined")
    tab.until(lambda: "period 1" in tab.text())
    rested(running, tab)
    for name, words in (("exponent", "kind=exponent"), ("number-period", "variable=period"), ("period", "kind=period")):
        alone(tab, lambda name=name: select.select_option(name), lambda words=words: words in tab.address())


def test_lines_that_were_drawn_once_are_switched_without_a_message(running: ExplorerSession, tab: Tab) -> None:
    box = tab.page.get_by_label("boundaries", exact=True)
    box.check()
    tab.until(lambda: "regime boundary" in tab.text())
    rested(running, tab)
    alone(tab, box.uncheck, lambda: "overlay" not in tab.address())
    alone(tab, box.check, lambda: "overlay=boundaries" in tab.address())


def test_the_cell_under_the_pointer_is_read_without_a_message(tab: Tab) -> None:
    sent, received = len(tab.sent), len(tab.received)
    left, top, width, height = tab.plot()
    said = set()
    for share in (0.2, 0.5, 0.8):
        tab.page.mouse.move(left + share * width, top + 0.4 * height)
        tab.until(lambda: "peak to peak" in tab.page.locator("#readout").inner_text())
        tab.page.wait_for_timeout(100)
        said.add(tab.page.locator("#readout").inner_text())
    assert len(said) == 3 and (len(tab.sent), len(tab.received)) == (sent, received)


def test_the_server_learns_how_the_plane_looks_before_it_draws_a_file_or_another_view(
    running: ExplorerSession, tab: Tab
) -> None:
    tab.page.get_by_label("logarithmic").check()
    ends(tab, 0.3, 0.9)
    tab.page.get_by_text("save the picture").click()
    with tab.page.expect_download(timeout=60_000):
        tab.page.get_by_role("button", name="PNG").click()
    tab.page.evaluate("() => window.scrollTo(0, 0)")
    tab.wheel(2)
    rested(running, tab)
    asked = painter_of(running, tab)._asked
    assert asked is not None and asked[0].map == "number-peak_to_peak-log"


def test_the_browser_has_the_colours_of_paint(running: ExplorerSession, tab: Tab) -> None:
    for low, high in ((None, None), (0.3, 0.9)):
        if low is not None:
            ends(tab, low, high)
            tab.page.wait_for_timeout(500)
        painter, shown = painter_of(running, tab), pixels(tab)
        chosen = from_address(running.explorer.subject, arguments(tab))
        assert painter.sight is not None
        ds = running.explorer.known.visible_cells(chosen.plane, painter.sight, chosen.names).ds
        ds = ds.assign(peak_to_peak=(ds.peak_to_peak.dims, round_mantissa(ds.peak_to_peak.values, BITS)))
        own = painter.ends(chosen)
        asked = PictureRequest(STANDARD.__class__(vmin=own[0], vmax=own[1]), "scalar", variable="peak_to_peak")
        expected = paint(
            PAINTERS["scalar"](MapView(KIND_TABLE["scalar"], ds, Plane.from_dataset(ds, ["peak_to_peak"]), asked))
        )
        places = []
        for name, (first, last), size in (("b", chosen.y, shown.shape[0]), ("omega", chosen.x, shown.shape[1])):
            share = (ds[name].values - first) / (last - first)
            places.append((np.floor(share * size).astype(int), (share > 0) & (share < 1)))
        (rows, up), (columns, across) = places
        found = shown[np.ix_(shown.shape[0] - 1 - rows[up], columns[across])]
        wanted = expected[np.ix_(np.flatnonzero(up), np.flatnonzero(across))]
        assert np.mean(np.any(found != wanted, axis=-1)) < 0.01  # a pixel on the border of two cells
        assert len(np.unique(found.reshape(-1, 4), axis=0)) > 50


def test_the_first_view_of_known_cells_is_one_picture_and_few_messages(
    running: ExplorerSession, browser: Any, tab: Tab
) -> None:
    with opened(browser, f"{running.url}&{WINDOW}") as other:
        other.until(other.image)
        other.page.wait_for_timeout(2500)
        size = sum(other.received) + sum(other.sent)
        messages = len(other.received) + len(other.sent)
        print(f"{messages} messages, {size} bytes, the largest {sorted(other.received)[-3:]}")
        assert 2 < messages <= 20 and size <= 400_000


def test_a_wheel_to_known_cells_is_one_picture_and_few_messages(running: ExplorerSession, tab: Tab) -> None:
    def turned(key: str) -> tuple[int, int, int]:
        received, sent, window = len(tab.received), len(tab.sent), tab.image()
        tab.page.keyboard.press(key)
        tab.until(lambda: tab.image() != window)
        rested(running, tab)
        return sum(tab.received[received:]), len(tab.received) - received, len(tab.sent) - sent

    turned("-")
    for key in ("+", "-"):
        size, received, sent = turned(key)
        print(f"{key}: {size} bytes in {received} frames, {sent} sent")
        assert size < 150_000 and received < 20 and sent < 20
