"""Following an orbit on the explorer's page, in a browser, with mouse and keyboard."""

from collections.abc import Iterator
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest

import atlas
from atlas.explore.session import ExplorerSession
from atlas.render.class_maps import PALETTE
from tests.support.browser import Tab, opened

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning:playwright")]

VIEW = "omega=1.7:1.8&b=0.12:0.13&cell=1.75,0.125"
"""A view in which the orbit of the cell turns back at a fold, and beyond which it breaks its symmetry."""


@pytest.fixture
def tab(running: ExplorerSession, browser: Any) -> Iterator[Tab]:
    """A page that shows the cell; afterwards nothing may have gone wrong in the browser."""
    with opened(browser, f"{running.url}&{VIEW}", 1440, 900) as made:
        made.page.get_by_role("button", name="copy all numbers").wait_for(timeout=120_000)
        yield made
        assert made.complaints == []


@pytest.fixture(scope="module")
def events() -> dict[str, float]:
    """The events of the branch, by their kinds."""
    found = atlas.branch({"omega": 1.75, "b": 0.125}, along="omega", window=(1.0, 4.5)).events
    return dict(zip(found["kind"], found["omega"], strict=True))


def start(tab: Tab) -> None:
    """Press the button, and wait for the branch."""
    tab.page.get_by_role("button", name="follow", exact=True).click()
    tab.until(lambda: "orbit followed" in tab.text(), 120.0)


def followed(tab: Tab) -> tuple[str, float, float, int, float]:
    """What the address says is followed."""
    along, *numbers = parse_qs(urlsplit(tab.address()).query)["follow.orbit"][0].split(",")
    low, high, step, value = map(float, numbers)
    return along, low, high, int(step), value


def marks(tab: Tab) -> Any:
    """The marks of the followed orbit over the plane; None if there are none."""
    return tab.page.evaluate("() => follow.marks()")


def slider(tab: Tab) -> Any:
    """The slider along the branch."""
    return tab.page.get_by_label("along the branch")


def test_the_mouse_drags_the_orbit_along_its_branch_and_the_marker_moves_with_it(tab: Tab) -> None:
    start(tab)
    tab.until(lambda: marks(tab)["at"] == [1.75, 0.125])
    before, gap = tab.text(), marks(tab)["gap"]
    slider(tab).scroll_into_view_if_needed()
    box, last = slider(tab).bounding_box(), int(slider(tab).get_attribute("max"))
    x, y = box["x"] + 8 + (box["width"] - 16) * int(slider(tab).input_value()) / last, box["y"] + box["height"] / 2
    tab.page.mouse.move(x, y)
    tab.page.mouse.down()
    tab.page.mouse.move(x - 20, y, steps=5)
    tab.page.mouse.up()
    tab.until(lambda: "follow.orbit=" in tab.address() and followed(tab)[3] < -2)
    tab.until(lambda: marks(tab)["value"] == followed(tab)[4])
    value = followed(tab)[4]
    assert value < 1.75 and tab.text() != before
    assert marks(tab)["gap"] != gap and marks(tab)["at"] == [value, 0.125]


def test_arrows_of_the_keyboard_walk_over_the_fold_where_the_parameter_turns_back(
    tab: Tab, events: dict[str, float]
) -> None:
    start(tab)
    assert "turns back at" in tab.text()
    slider(tab).focus()
    values = [1.75]
    while len(values) < 60 and (len(values) < 2 or values[-1] > values[-2]):
        tab.page.keyboard.press("ArrowRight")
        tab.until(lambda: followed(tab)[3] == len(values))
        values.append(followed(tab)[4])
    assert values[-2] == pytest.approx(events["fold"], abs=1e-9) and values[-1] < values[-2]
    tab.until(lambda: "unstable, 1 multiplier outside the unit circle" in tab.text())


def test_arrows_lead_to_the_fold_and_to_the_edge_of_the_view_with_their_distances(
    tab: Tab, events: dict[str, float]
) -> None:
    start(tab)
    tab.until(lambda: len(marks(tab)["arrows"]) == 2)
    arrows = marks(tab)["arrows"]
    assert [arrow["ends"][2] for arrow in arrows] == [1.7, pytest.approx(events["fold"], abs=1e-9)]
    fold = arrows[1]["text"].removesuffix(" →")
    assert fold.startswith("fold +") and float(fold.split("+")[1]) == pytest.approx(events["fold"] - 1.75, rel=1e-4)


def test_a_typed_value_is_solved_exactly_and_one_beyond_the_branch_is_refused(tab: Tab) -> None:
    start(tab)
    typed = tab.page.get_by_label("ω", exact=True)
    typed.fill("1.7312345")
    typed.press("Enter")
    tab.until(lambda: followed(tab)[4] == 1.7312345)
    tab.until(lambda: "1.7312345" in tab.text())
    typed.fill("2.5")
    typed.press("Enter")
    tab.until(lambda: "found 2.5, must be" in tab.text())
    assert followed(tab)[4] == 1.7312345


def test_a_link_opens_the_followed_orbit_again_back_leads_there_and_escape_ends_it(tab: Tab) -> None:
    start(tab)
    slider(tab).focus()
    tab.page.keyboard.press("ArrowLeft")
    tab.until(lambda: followed(tab)[3] == -1)
    address, value = tab.address(), followed(tab)[4]
    tab.page.goto("about:blank")
    tab.page.goto(address)
    tab.until(lambda: "orbit followed" in tab.text(), 120.0)
    tab.until(lambda: (marks(tab) or {}).get("at") == [value, 0.125])
    tab.page.wait_for_timeout(2000)
    slider(tab).focus()
    tab.page.keyboard.press("Escape")
    tab.until(lambda: "follow.orbit=" not in tab.address())
    assert marks(tab) is None and "orbit followed" not in tab.text()
    tab.page.go_back()
    tab.until(lambda: "orbit followed" in tab.text(), 120.0)
    assert followed(tab)[4] == value


def test_the_machine_moves_on_the_orbit_that_is_followed(tab: Tab) -> None:
    start(tab)
    tab.page.get_by_role("button", name="move the machine").first.click()
    before = tab.inked(".machine", PALETTE[0])
    tab.until(lambda: tab.inked(".machine", PALETTE[0]) != before)
    slider(tab).focus()
    tab.page.keyboard.press("ArrowLeft")
    tab.until(lambda: followed(tab)[3] == -1)
    tab.page.keyboard.press("Escape")
    tab.until(lambda: "follow.orbit=" not in tab.address())


def test_an_orbit_that_cannot_be_followed_says_so_in_one_line(running: ExplorerSession, browser: Any) -> None:
    query = "omega=1.4:1.6&b=0.05:0.15&cell=1.5,0.1&follow.orbit=omega,1.4,1.6,0,1.5"
    with opened(browser, f"{running.url}&{query}", 1440, 900) as tab:
        tab.until(lambda: "this cell is chaotic: a branch starts from a periodic cell" in tab.text(), 120.0)
        tab.until(lambda: "follow.orbit=" not in tab.address())
        assert tab.complaints == []
