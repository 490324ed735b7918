"""Two planes side by side on the explorer's page, in a real browser."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from distributed import Client

import atlas
from atlas.explore.session import Exploration, explore
from tests.browser import Tab, opened

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning:playwright")]

WINDOW = "omega=3.2:4.2&b=0.3:0.5"
"""A part of the plane whose cells are cheap: orbits of period 1, and motion without impact."""


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory, client: Client, browser: Any) -> Iterator[Exploration]:
    """An explorer of a small atlas and of another one, of the same cells and with another restitution."""
    folder = tmp_path_factory.mktemp("compare")
    axes = {"omega": {"start": 1.0, "stop": 4.5, "num": 40}, "b": {"start": 0.05, "stop": 0.6, "num": 30}}
    for name, R in (("one", 0.8), ("other", 0.6)):
        spec = atlas.Spec("two-mass", axes, {"R": R}, {"tolerance": 0.1, "survival": 500, "max_periods": 2000})
        atlas.run(spec, folder / f"{name}.zarr", client=client)
    made = explore(str(folder / "one.zarr"), other=str(folder / "other.zarr"), client=client, folder=folder)
    yield made
    made.stop()


@pytest.fixture
def tab(running: Exploration, browser: Any) -> Iterator[Tab]:
    """Its page with both planes, once there are pictures; afterwards nothing may have gone wrong in the browser."""
    with shown(running, browser, "second.of=R,0.7") as made:
        yield made
        assert made.complaints == []
        assert made.hosts == {"127.0.0.1"}


@contextmanager
def shown(running: Exploration, browser: Any, query: str, width: int = 1440, height: int = 900) -> Iterator[Tab]:
    with opened(browser, f"{running.url.partition('?')[0]}?{WINDOW}&{query}", width, height) as tab:
        tab.until(lambda: all(windows(tab)) and len(windows(tab)) == 2, 120.0)
        yield tab


PLANES = """() => {
    if (!window.Bokeh || !Bokeh.documents.length) return []
    const found = [], find = (view) => {
        if (view.model.type === "Figure" && view.model.renderers.some((each) => each.data_source?.data.image))
            found.push(view)
        for (const child of view.child_views || []) find(child)
    }
    for (const root of [...Bokeh.index.roots]) find(root)
    return found.map((view) => {
        const box = view.el.getBoundingClientRect(), inner = view.frame.bbox
        const image = view.model.renderers.map((each) => each.data_source.data).filter((data) => data.image)[0]
        return {
            box: [box.left + inner.left, box.top + inner.top, inner.width, inner.height],
            window: image.image.length ? ["x", "y", "dw", "dh"].map((name) => image[name][0]) : null,
            range: [view.model.x_range.start, view.model.x_range.end, view.model.y_range.start,
                    view.model.y_range.end],
            sum: image.image.length ? image.image[0].reduce((sum, each) => (sum * 31 + each) % 1e9, 0) : 0,
        }
    })
}"""


def planes(tab: Tab) -> list[dict[str, Any]]:
    """Of each plane on the page: its plot area in pixels, the window of its picture, the view, and a sum of colours."""
    return list(tab.page.evaluate(PLANES))


def windows(tab: Tab) -> list[list[float] | None]:
    """The windows that the pictures of the planes fill."""
    return [plane["window"] for plane in planes(tab)]


def select(tab: Tab, title: str, label: str) -> None:
    """Choose an option of a menu by the title above it."""
    tab.page.locator(".bk-input-group").filter(has_text=title).locator("select").first.select_option(label=label)


def said(tab: Tab) -> str:
    """All that stands on the page, with single spaces."""
    return " ".join(tab.text().split())


def query(tab: Tab) -> dict[str, str]:
    return {name: values[-1] for name, values in parse_qs(urlsplit(tab.address()).query).items()}


def crossed(tab: Tab, omega: float) -> bool:
    """Whether the one pair of lines of a crosshair, which both planes share, is at a parameter."""
    return sum(abs((place or 0.0) - omega) < 0.01 for place in tab.models("Span", "location")) == 1


@pytest.mark.parametrize("which", [0, 1])
def test_a_zoom_of_one_plane_is_a_zoom_of_both(tab: Tab, which: int) -> None:
    before = windows(tab)
    left, top, width, height = planes(tab)[which]["box"]
    tab.page.mouse.move(left + 0.4 * width, top + 0.4 * height)
    for _ in range(4):
        tab.page.mouse.wheel(0, -120)
    tab.until(lambda: all(new and new != old for new, old in zip(windows(tab), before, strict=True)))
    first, second = planes(tab)
    assert first["range"] == second["range"]
    assert np.allclose(first["window"], second["window"])
    low, high = map(float, query(tab)["omega"].split(":"))
    assert [low, high] == first["range"][:2] and high - low < 1.0


def test_the_pointer_over_one_plane_is_a_crosshair_on_both_which_show_their_cells(tab: Tab) -> None:
    for which in (0, 1):
        left, top, width, height = planes(tab)[which]["box"]
        tab.page.mouse.move(left + (0.3 + 0.2 * which) * width, top + 0.5 * height)
        tab.until(partial(crossed, tab, 3.2 + 0.3 + 0.2 * which))
        tab.until(lambda: said(tab).count("largest exponent") == 3)  # with the one in the column on cells
    assert "R = 0.7" in said(tab)


def test_another_value_is_typed_and_one_out_of_range_refused(tab: Tab) -> None:
    before = planes(tab)
    value = tab.page.locator(".bk-input-group").filter(has_text="with the value").locator("input").first
    value.fill("0.4")
    value.press("Enter")
    tab.until(lambda: query(tab).get("second.of") == "R,0.4")
    tab.until(lambda: planes(tab)[1]["sum"] not in (0, before[1]["sum"]), 120.0)
    value.fill("1.4")
    value.press("Enter")
    tab.until(lambda: "R = 1.4: must satisfy 0 <= R <= 1" in said(tab))
    assert query(tab)["second.of"] == "R,0.4"


def test_a_slider_moves_the_first_plane_and_not_the_value_of_the_second(tab: Tab) -> None:
    tab.page.locator(".noUi-handle").first.focus()
    tab.page.keyboard.press("ArrowLeft")
    tab.until(lambda: "R" in query(tab))
    assert query(tab)["second.of"] == "R,0.7"


def test_the_other_atlas_is_shown_and_its_difference_counts_the_cells_of_another_class(tab: Tab) -> None:
    select(tab, "the second plane shows", "the atlas other.zarr")
    tab.until(lambda: query(tab).get("second.of") == "atlas" and len(windows(tab)) == 2 and all(windows(tab)))
    tab.until(lambda: "R = 0.6" in said(tab))
    select(tab, "map", "period")
    select(tab, "drawn as", "the difference")
    tab.until(lambda: query(tab).get("second.drawn") == "difference")
    text = tab.until(
        lambda: said(tab) if "cells differ, compared where both are known at the same" in said(tab) else ""
    )
    differ, of, cells = text.partition(" cells differ")[0].split()[-3:]
    assert of == "of" and 0 < int(differ) < int(cells)


def test_a_difference_of_exponents_is_on_a_scale_about_zero_and_zero_where_the_planes_are_one(
    running: Exploration, browser: Any
) -> None:
    with shown(running, browser, "second.of=plane&second.drawn=difference") as tab:
        tab.until(lambda: "mean difference 0, mean size 0" in said(tab), 120.0)
        assert tab.complaints == []


def test_a_link_restores_both_planes_and_escape_closes_the_second(running: Exploration, browser: Any) -> None:
    with shown(running, browser, "second.of=atlas&second.drawn=difference&kind=period") as tab:
        tab.until(lambda: "cells differ" in said(tab), 120.0)
        tab.page.goto(tab.address())
        tab.until(lambda: len(windows(tab)) == 2 and all(windows(tab)) and "cells differ" in said(tab), 120.0)
        assert (query(tab)["second.of"], query(tab)["second.drawn"]) == ("atlas", "difference")
        tab.page.keyboard.press("Escape")
        tab.until(lambda: "second.of" not in query(tab) and len(planes(tab)) == 1)
        assert tab.complaints == []


def test_back_leads_to_the_page_without_the_second_plane_and_a_button_closes_it(
    running: Exploration, browser: Any
) -> None:
    with opened(browser, f"{running.url.partition('?')[0]}?{WINDOW}", 1440, 900) as tab:
        tab.until(tab.image)
        tab.until(lambda: "kind" in query(tab))
        tab.page.wait_for_timeout(2000)  # for a view at which one rests
        tab.page.get_by_role("button", name="compare").click()
        tab.until(lambda: query(tab).get("second.of") == "atlas" and len(windows(tab)) == 2)
        tab.page.go_back()
        tab.until(lambda: "second.of" not in query(tab) and len(planes(tab)) == 1)
        tab.page.go_forward()
        tab.until(lambda: len(windows(tab)) == 2 and all(windows(tab)))
        tab.page.get_by_role("button", name="close the second plane").click()
        tab.until(lambda: len(planes(tab)) == 1)
        assert tab.complaints == []


def test_a_second_plane_that_there_is_not_is_named_and_the_first_shown(running: Exploration, browser: Any) -> None:
    with opened(browser, f"{running.url.partition('?')[0]}?{WINDOW}&second.of=R,7") as tab:
        tab.until(lambda: "R = 7.0: must satisfy 0 <= R <= 1" in said(tab))
        tab.until(tab.image)
        assert len(planes(tab)) == 1 and tab.complaints == []


@pytest.mark.parametrize(("width", "beside"), [(1920, True), (1440, True), (940, False), (390, False)])
def test_both_planes_have_the_room_of_the_page_side_by_side_or_one_below_the_other(
    running: Exploration, browser: Any, width: int, beside: bool
) -> None:
    with shown(running, browser, "second.of=R,0.7", width, 800) as tab:
        (left, top, across, down), (x, y, also, tall) = (plane["box"] for plane in planes(tab))
        assert abs(across - also) <= 2 and abs(down - tall) <= 2
        assert (y == top and x >= left + across) if beside else (x == left and y >= top + down)
        assert across > (0.2 if beside else 0.6) * width and down > 200
        assert tab.page.evaluate("() => document.documentElement.scrollWidth") <= width
        assert tab.complaints == []


def test_the_page_of_an_explorer_with_another_atlas_begins_with_both(running: Exploration, browser: Any) -> None:
    with opened(browser, running.url, 1440, 900) as tab:
        tab.until(lambda: len(windows(tab)) == 2 and all(windows(tab)), 120.0)
        tab.until(lambda: "R = 0.6" in said(tab) and "other.zarr" in said(tab))
        assert tab.complaints == []
