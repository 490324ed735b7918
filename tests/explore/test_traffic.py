"""What goes between the browser and the explorer, in messages and bytes: pictures, views, and scales."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from atlas.explore.chosen import from_address
from atlas.explore.session import Exploration
from atlas.explore.style import KEY_WIDTH
from atlas.render.screen import screen
from rig.browser import Tab, opened
from tests.explore.test_page import arguments, painter_of, settled

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning:playwright")]

WINDOW = "omega=3.2:4.2&b=0.3:0.5&kind=scalar&variable=peak_to_peak"
SMALL = 60_000
"""Bytes that no picture has, and no other message exceeds."""
IMAGE = "[...Bokeh.documents[0]._all_models.values()].find((model) => model.data?.image?.length)"
INPUT = '[...Bokeh.documents[0]._all_models.values()].find((model) => model.title === "scale from")'


@pytest.fixture
def tab(running: Exploration, browser: Any) -> Iterator[Tab]:
    """Its page, once all in view is solved and drawn."""
    with opened(browser, f"{running.url}?{WINDOW}") as made:
        made.until(made.image)
        rested(running, made)
        yield made
        assert made.complaints == []


def rested(running: Exploration, tab: Tab) -> None:
    """Wait until nothing more is to come."""
    settled(running, tab)
    tab.page.wait_for_timeout(1200)


def pictures(tab: Tab, since: int) -> list[int]:
    """The sizes of the messages since then that may hold a picture."""
    return [size for size in tab.received[since:] if size > SMALL]


def pixels(tab: Tab) -> np.ndarray:
    """The picture (y, x, 4) from below, as the browser shows it."""
    script = f"() => {{ const [image] = {IMAGE}.data.image; return [image.shape, Array.from(image)] }}"
    shape, values = tab.page.evaluate(script)
    return np.array(values, dtype="<u4").view(np.uint8).reshape(*shape, 4)


def test_other_ends_of_the_scale_recolour_the_map_at_once_and_send_no_picture(running: Exploration, tab: Tab) -> None:
    received, sent = len(tab.received), len(tab.sent)
    changed = tab.page.evaluate(
        f"""async () => {{
            const image = {IMAGE}, before = Uint32Array.from(image.data.image[0]), input = {INPUT}
            input.value = 0.3
            await new Promise((done) => setTimeout(done, 50))
            const after = image.data.image[0]
            return before.filter((color, k) => color !== after[k]).length / before.length
        }}"""
    )  # the server waits three times as long before it looks at a choice at all
    assert changed > 0.2
    tab.until(lambda: "vmin=0.3" in tab.address())
    rested(running, tab)
    assert pictures(tab, received) == []
    print(f"{len(tab.sent) - sent} sent, {len(tab.received) - received} received, {sum(tab.received[received:])} bytes")
    assert sum(tab.sent[sent:]) < 10_000 and len(tab.sent) - sent < 10


def test_the_browser_has_the_colours_that_the_server_draws(running: Exploration, tab: Tab) -> None:
    for ends in ((None, None), (0.3, 0.9)):
        if ends[0] is not None:
            tab.page.goto(f"{running.url}?{WINDOW}&vmin={ends[0]}&vmax={ends[1]}")
            tab.until(tab.image)
            rested(running, tab)
        painter, shown = painter_of(running, tab), pixels(tab)
        chosen = from_address(running.explorer.subject, arguments(tab))
        assert painter.sight is not None
        ds = running.explorer.known.seen(chosen.plane, painter.sight, chosen.names)
        low, high = ends if ends[0] is not None else painter.fitted(chosen) or (None, None)
        look: dict[str, Any] = {"variable": "peak_to_peak", "vmin": low, "vmax": high}
        drawn = screen(ds, "scalar", shown.shape[1::-1], KEY_WIDTH, **look).cells[::-1]
        off = np.abs(shown.astype(int) - drawn).max(axis=-1)
        assert np.mean(off > 8) < 1e-3
        assert len(np.unique(shown.reshape(-1, 4), axis=0)) > 50


def test_a_scale_fitted_to_the_view_sends_no_picture(running: Exploration, tab: Tab) -> None:
    received = len(tab.received)
    tab.page.get_by_role("button", name="fit the scale to the view").click()
    tab.until(lambda: "vmin=" in tab.address())
    rested(running, tab)
    assert pictures(tab, received) == []


def test_the_first_view_of_known_cells_is_one_picture(running: Exploration, browser: Any, tab: Tab) -> None:
    count = pixels(tab).shape[0] * pixels(tab).shape[1]
    with opened(browser, f"{running.url}?{WINDOW}") as other:
        other.until(other.image)
        other.page.wait_for_timeout(2500)
        assert len(pictures(other, 0)) == 2  # the page itself, and the picture
        print(f"{len(other.received)} messages of {sum(other.received)} bytes, {4 * count} of them pixels")
        assert sum(other.received) < 4 * count + 500_000 and len(other.received) < 60


def test_a_wheel_to_known_cells_is_one_picture_and_few_messages(running: Exploration, tab: Tab) -> None:
    def turned(key: str) -> tuple[list[int], int, int]:
        received, sent, window = len(tab.received), len(tab.sent), tab.image()
        tab.page.keyboard.press(key)
        tab.until(lambda: tab.image() != window)
        rested(running, tab)
        return pictures(tab, received), len(tab.sent) - sent, sum(tab.sent[sent:])

    turned("-")
    for key in ("+", "-"):
        found, messages, size = turned(key)
        print(f"{key}: pictures {found}, {messages} messages of {size} bytes sent")
        assert len(found) == 1 and messages < 20 and size < 20_000
