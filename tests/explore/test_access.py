"""The page for fingers, keyboards and screen readers, and on a dark or a narrow screen, in a real browser."""

from collections.abc import Iterator
from io import BytesIO
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from PIL import Image

from atlas.explore.session import ExplorerSession
from tests.explore.test_static_page_browser import contrast
from tests.support.browser import Tab, opened

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning:playwright")]

WINDOW = "omega=3.2:4.2&b=0.3:0.5"
PHONE: dict[str, Any] = {"width": 390, "height": 844, "has_touch": True, "is_mobile": True}
NAMED = """
const name = (each) => (each.ariaLabel || [...(each.labels ?? [])].map((label) => label.textContent).join(" ").trim()
    || each.textContent.trim() || each.title || each.alt || "")
"""


@pytest.fixture
def phone(running: ExplorerSession, browser: Any) -> Iterator[Tab]:
    """The page on a phone."""
    with opened(browser, f"{running.url}&{WINDOW}", **PHONE) as made:
        made.until(made.image)
        made.until(lambda: "kind=" in made.address())
        yield made
        assert made.complaints == []


@pytest.fixture
def desk(running: ExplorerSession, browser: Any) -> Iterator[Tab]:
    """The page on a wide screen."""
    with opened(browser, f"{running.url}&{WINDOW}", 1440, 900) as made:
        made.until(made.image)
        yield made
        assert made.complaints == []


def ends(tab: Tab, name: str) -> np.ndarray:
    """The window of an axis, as the address has it."""
    return np.array([float(end) for end in parse_qs(urlsplit(tab.address()).query)[name][0].split(":")])


def touch(tab: Tab, *steps: list[tuple[float, float]]) -> None:
    """Put fingers onto the page, move them through these places, and take them away."""
    session = tab.page.context.new_cdp_session(tab.page)
    for k, places in enumerate(steps):
        points = [{"x": x, "y": y, "id": finger} for finger, (x, y) in enumerate(places)]
        session.send("Input.dispatchTouchEvent", {"type": "touchMove" if k else "touchStart", "touchPoints": points})
        tab.page.wait_for_timeout(30)
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})


def test_two_fingers_that_part_zoom_about_their_middle(phone: Tab) -> None:
    left, top, width, height = phone.plot()
    x, y = left + 0.5 * width, top + 0.5 * height
    before = ends(phone, "omega"), ends(phone, "b")
    touch(phone, *[[(x - apart, y), (x + apart, y)] for apart in (30, 40, 50, 60)])
    phone.until(lambda: np.ptp(ends(phone, "omega")) < 0.55 * np.ptp(before[0]), 20.0)
    phone.page.wait_for_timeout(500)
    after = ends(phone, "omega"), ends(phone, "b")
    for old, new in zip(before, after, strict=True):
        assert np.ptp(new) == pytest.approx(0.5 * np.ptp(old), rel=0.01)
        assert abs(new.mean() - old.mean()) < 0.01 * np.ptp(old)
    assert phone.mark() is None


def test_a_finger_moves_the_view_and_not_the_page(phone: Tab) -> None:
    left, top, width, height = phone.plot()
    x, y = left + 0.5 * width, top + 0.5 * height
    before = ends(phone, "omega")
    touch(phone, *[[(x + moved, y + moved)] for moved in (0, 20, 40, 60)])
    phone.until(lambda: np.abs(ends(phone, "omega") - before).max() > 0.01)
    phone.page.wait_for_timeout(500)
    after = ends(phone, "omega")
    assert np.ptp(after) == pytest.approx(np.ptp(before))
    assert (before - after)[0] == pytest.approx(60 / width * np.ptp(before), rel=0.2)
    assert phone.page.evaluate("() => window.scrollY") == 0


def test_a_tap_chooses_the_cell_and_controls_unfold_between_the_plane_and_its_details(phone: Tab) -> None:
    left, top, width, height = phone.plot()
    phone.page.touchscreen.tap(left + 0.6 * width, top + 0.4 * height)
    mark = phone.until(phone.mark)
    x, y = ends(phone, "omega"), ends(phone, "b")
    assert abs(mark[0] - (x[0] + 0.6 * np.ptp(x))) < 0.02 * np.ptp(x)
    assert abs(mark[1] - (y[0] + 0.6 * np.ptp(y))) < 0.02 * np.ptp(y)
    phone.page.get_by_role("button", name="copy all numbers").wait_for(timeout=120_000)
    phone.page.get_by_text("controls", exact=True).click()
    cuts = phone.page.get_by_role("button", name="cut across")
    cuts.wait_for()
    clicked = phone.page.get_by_text("cell clicked").bounding_box()
    assert top + height < cuts.bounding_box()["y"] < clicked["y"]
    assert phone.page.evaluate("() => document.documentElement.scrollWidth") == 390


def go(tab: Tab, query: str) -> None:
    """Open another address of the page, with its token."""
    address, _, given = tab.page.url.partition("?")
    (token,) = parse_qs(given)["token"]
    tab.page.goto(f"{address}?{query}&token={token}")


def cut(tab: Tab) -> list[tuple[float, float, float, float]]:
    """Open a cut by its link, and give the plot areas of the plane and of the two diagrams."""
    go(tab, f"{WINDOW}&cut=3.2,0.4,4.2,0.4")
    tab.until(lambda: "257 cells along the cut" in tab.text(), 120.0)
    return [tab.plot(label) for label in ("map of", "section states along", "exponent along")]


def test_a_cut_on_a_phone_has_its_diagrams_between_the_plane_and_the_details_of_cells(phone: Tab) -> None:
    (_, top, _, height), *diagrams = cut(phone)
    for _, below, across, down in diagrams:
        assert below > top + height and across > 250 and down > 90
        top, height = below, down
    button = phone.page.get_by_text("controls", exact=True).bounding_box()
    details = phone.page.get_by_text("Click a cell: its motion").bounding_box()
    assert top + height < button["y"] < details["y"]
    assert phone.page.evaluate("() => document.documentElement.scrollWidth") == 390


def test_a_cut_across_has_its_diagrams_right_below_the_plane(desk: Tab) -> None:
    planes, *diagrams = cut(desk)
    for left, top, width, _ in diagrams:
        assert abs(left - planes[0]) <= 1 and abs(width - planes[2]) <= 12 and top > planes[1] + planes[3]


def test_nothing_but_the_page_is_to_be_scrolled_to(desk: Tab) -> None:
    assert desk.page.evaluate("() => [document.documentElement, document.body].map((e) => e.scrollHeight)") == [900] * 2


def test_a_finger_drags_an_orbit_along_its_branch(phone: Tab) -> None:
    go(phone, "omega=1.7:1.8&b=0.12:0.13&cell=1.75,0.125")
    follow = phone.page.get_by_role("button", name="follow", exact=True)
    follow.wait_for(timeout=120_000)
    follow.tap()
    phone.until(lambda: "orbit followed" in phone.text(), 120.0)
    slider = phone.page.get_by_label("along the branch")
    slider.scroll_into_view_if_needed()
    box, last = slider.bounding_box(), int(slider.get_attribute("max"))
    x, y = box["x"] + box["width"] * int(slider.input_value()) / last, box["y"] + box["height"] / 2
    touch(phone, *([(x - step, y)] for step in range(0, 41, 10)))
    phone.until(lambda: "follow.orbit" in phone.address())
    phone.until(lambda: int(parse_qs(urlsplit(phone.address()).query)["follow.orbit"][0].split(",")[3]) < -2)


def test_buttons_are_large_enough_for_a_finger(phone: Tab) -> None:
    phone.page.get_by_text("controls", exact=True).click()
    button = phone.page.get_by_role("button", name="cut across")
    button.wait_for()
    assert button.bounding_box()["height"] >= 36


def stops(tab: Tab) -> list[dict[str, Any]]:
    """What the key Tab leads to, from the first to the last: its name, its place, and whether the focus is seen."""
    found: list[dict[str, Any]] = []
    script = (
        "() => {"
        + NAMED
        + """
        const at = document.activeElement
        if (!at || at === document.body) return null
        const box = at.getBoundingClientRect(), look = getComputedStyle(at)
        const seen = look.outlineStyle !== "none" && parseFloat(look.outlineWidth) >= 1
        return {name: name(at), tag: at.outerHTML.slice(0, 200), x: box.left, y: box.top, seen}
    }"""
    )
    for _ in range(150):
        tab.page.keyboard.press("Tab")
        stop = tab.page.evaluate(script)
        if stop is None or (found and stop["tag"] == found[0]["tag"]):
            break
        found.append(stop)
    return found


def test_tab_leads_through_controls_plane_and_details_each_named_and_seen(desk: Tab) -> None:
    left, top, width, _ = desk.plot()
    found = stops(desk)
    names = [stop["name"] for stop in found]
    assert len(found) > 30
    assert [stop["tag"] for stop in found if not stop["name"]] == []
    assert [stop["tag"] for stop in found if not stop["seen"]] == []
    parts = [0 if stop["y"] < top - 12 else 1 if stop["x"] < left + width else 2 for stop in found]
    assert parts == sorted(parts) and {*parts} == {0, 1, 2}
    assert names[0] == "move" and any(name.startswith("map of ") for name in names)
    assert any("coefficient of restitution" in name for name in names)


def test_enter_on_the_plane_chooses_the_cell_in_the_middle(desk: Tab) -> None:
    while not desk.page.evaluate("() => document.activeElement.id === 'map'"):
        desk.page.keyboard.press("Tab")
    desk.page.keyboard.press("Enter")
    mark = desk.until(desk.mark)
    assert abs(mark[0] - 3.7) < 0.02 and abs(mark[1] - 0.4) < 0.01


def test_the_focus_is_seen_on_the_plane_and_in_the_dark(running: ExplorerSession, browser: Any) -> None:
    with opened(browser, f"{running.url}&{WINDOW}", 1440, 900, color_scheme="dark") as tab:
        tab.until(tab.image)
        found = stops(tab)
        assert all(stop["seen"] for stop in found) and any(stop["name"].startswith("map of") for stop in found)


def test_everything_that_can_be_used_has_a_name(desk: Tab) -> None:
    unnamed = desk.page.evaluate(
        "() => {"
        + NAMED
        + """
        return [...document.querySelectorAll("button, select, input, img, [tabindex], [role]")]
            .filter((each) => !each.matches("[role=alert], [role=status]"))
            .filter((each) => each.getBoundingClientRect().width && !name(each)).map((each) => each.outerHTML)
    }"""
    )
    assert unnamed == []


def test_the_progress_of_the_view_is_shown_until_all_is_solved(running: ExplorerSession, browser: Any) -> None:
    with opened(browser, f"{running.url}&omega=3.3:4.3&b=0.31:0.51", 1440, 900) as tab:
        bar = tab.page.get_by_role("progressbar")
        share = int(tab.until(lambda: bar.count() and bar.get_attribute("aria-valuenow")))
        assert 0 <= share < 100
        tab.until(lambda: "of full resolution" in tab.text() or "all visible cells are solved" in tab.text())
        tab.until(lambda: "all visible cells are solved" in tab.text() and bar.count() == 0, 240.0)
        assert tab.complaints == []


def test_in_dark_mode_the_key_has_a_dark_paper_and_the_colours_of_the_map(
    running: ExplorerSession, browser: Any
) -> None:
    shots = {}
    for scheme in ("light", "dark"):
        with opened(browser, f"{running.url}&{WINDOW}", 1440, 900, color_scheme=scheme) as tab:
            tab.until(tab.image)
            key = tab.page.locator("#legend")
            key.wait_for()
            tab.page.wait_for_timeout(1500)
            shots[scheme] = np.asarray(Image.open(BytesIO(key.screenshot())).convert("RGB")).astype(int)
    light, dark = shots["light"], shots["dark"]
    assert np.median(light) > 240 and np.median(dark) < 40
    vivid = [np.ptp(shot, axis=-1) > 40 for shot in (light, dark)]
    assert vivid[0].sum() > 1000
    colors = [set(map(tuple, shot[where] // 8)) for shot, where in zip((light, dark), vivid, strict=True)]
    assert len(colors[0] & colors[1]) > 0.8 * len(colors[0])


def place_of(tab: Tab, text: str) -> float:
    """Where a text stands, in pixels from above."""
    return float(tab.page.get_by_text(text).first.bounding_box()["y"])


def test_what_is_said_of_the_cell_under_the_pointer_moves_nothing_below_it(desk: Tab) -> None:
    before, (left, top, width, height) = place_of(desk, "exploring tolerance"), desk.plot()
    for share in (0.1, 0.4, 0.7):
        desk.page.mouse.move(left + share * width, top + 0.4 * height)
        desk.until(lambda: "largest Lyapunov exponent" in desk.page.locator("#readout").inner_text())
        assert place_of(desk, "exploring tolerance") == before and desk.plot() == (left, top, width, height)


def test_a_choice_of_another_map_moves_no_control(desk: Tab) -> None:
    names = "logarithmic", "cut across", "grazing"
    before = [place_of(desk, name) for name in names]
    desk.page.locator("#look select").select_option("number-largest")
    desk.until(lambda: "kind=scalar" in desk.address())
    assert [place_of(desk, name) for name in names] == before


def test_each_number_of_a_cell_and_of_the_title_stands_on_one_line(phone: Tab) -> None:
    left, top, width, height = phone.plot()
    phone.page.touchscreen.tap(left + 0.5 * width, top + 0.5 * height)
    phone.until(lambda: "cell clicked" in phone.text() and "peak to peak" in phone.text(), 120.0)
    lines = phone.page.evaluate(
        """() => [...document.querySelectorAll(".number")].filter((each) => each.getClientRects().length)
            .map((each) => {
                const range = document.createRange()
                range.selectNodeContents(each)
                const bottoms = [...range.getClientRects()].map((box) => box.bottom)
                return Math.max(...bottoms) - Math.min(...bottoms) < 8 ? 1 : 2
            })"""
    )
    assert len(lines) > 15 and set(lines) == {1}


def test_the_key_of_a_plane_that_becomes_lower_is_not_cut_off(desk: Tab) -> None:
    key = desk.page.locator("#legend")
    key.wait_for()
    for height in (560, 900):
        desk.page.set_viewport_size({"width": 1440, "height": height})
        desk.page.wait_for_timeout(500)
        last = key.locator("li").last
        last.scroll_into_view_if_needed()
        box, host = last.bounding_box(), key.bounding_box()
        assert box["y"] + box["height"] <= height and host["x"] <= box["x"]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1024, 1440])
def test_text_stands_out_from_what_is_behind_it_and_nothing_is_wider_than_the_page(
    running: ExplorerSession, browser: Any, width: int, scheme: str
) -> None:
    with opened(browser, f"{running.url}&{WINDOW}&cell=3.7,0.4", width, 900, color_scheme=scheme) as tab:
        tab.page.get_by_role("button", name="copy all numbers").wait_for(timeout=120_000)
        assert tab.page.evaluate("() => document.documentElement.scrollWidth") == width
        for name in ("--ink", "--faint", "--trouble", "--accent"):
            paper, ink = (tab.page.evaluate(f"() => themed('{color}')") for color in ("--paper", name))
            assert contrast(paper, ink) >= 4.5  # WCAG AA
