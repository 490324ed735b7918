"""The page of an atlas in a real browser, opened from disk."""

import json
from collections.abc import Iterator
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import atlas
from tests import pictures, synthetic
from tests.support.browser import Tab, opened

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning:playwright")]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a small store of made-up results, with curves; the store lies beside it."""
    folder = tmp_path_factory.mktemp("page")
    synthetic.complete(folder / "plane.zarr")
    with pictures.keeping(pictures.curves()):
        return Path(atlas.open(folder / "plane.zarr").atlas.to_html(folder / "plane.html"))


@pytest.fixture(scope="module")
def ds(page: Path) -> Any:
    return atlas.open(page.with_name("plane.zarr"))


def look_at(browser: Any, page: Path, address: str = "", width: int = 1000, height: int = 800) -> Any:
    return opened(browser, f"file://{page}{address}", width, height)


@pytest.fixture
def tab(browser: Any, page: Path) -> Iterator[Tab]:
    """The page as it opens; nothing may go wrong in it, and it may ask for nothing but itself."""
    with look_at(browser, page) as made:
        said: list[str] = []
        made.page.on("console", lambda message: said.append(message.text))
        ready(made)
        yield made
        assert said == made.complaints == []
        assert made.hosts == {""}  # file:// has no host


def ready(tab: Tab) -> None:
    tab.until(lambda: tab.page.evaluate("() => shown !== null && !draw.due"))


def state(tab: Tab) -> dict[str, Any]:
    found: dict[str, Any] = tab.page.evaluate(
        "() => ({map: state.map, window: state.window, cell: state.cell, ends: state.ends})"
    )
    return found


def at_cell(tab: Tab, column: int, row: int) -> tuple[float, float]:
    """The centre of a cell in pixels of the tab."""
    x, y = tab.page.evaluate(
        """([column, row]) => {
            const box = map.getBoundingClientRect()
            return [box.left + place(scene(), X.values[column], 0), box.top + place(scene(), Y.values[row], 1)]
        }""",
        [column, row],
    )
    return float(x), float(y)


def numbers(tab: Tab) -> dict[str, str]:
    """The table of the cell: label and value."""
    tab.until(lambda: tab.page.locator("#cell table").count() == 1)
    rows = tab.page.locator("#cell tr").all()
    return {row.locator("th").inner_text(): row.locator("td").inner_text() for row in rows}


ALL_LINES = "without=fold,period_doubling,graze,codimension_two"


def test_the_map_has_the_colours_that_a_file_has(browser: Any, page: Path, ds: Any, tmp_path: Path) -> None:
    """A picture without texture, at one pixel of each cell; a page of other pixels has the same cells."""
    expected = period_colors(ds)
    with look_at(browser, page, f"#kind=period&{ALL_LINES}") as tab:
        ready(tab)
        tab.page.evaluate("() => { atlas.lines.curves.ends.length = 0; draw(); }")
        ready(tab)
        places = [[at_cell(tab, column, row) for column in range(45)] for row in range(38)]
        image = np.asarray(Image.open(BytesIO(tab.page.screenshot())).convert("RGB"))
    textured = np.isin(ds.regime.values, (2, 5, 6, 7))
    found = np.array([[image[int(y), int(x)] for x, y in row] for row in places])
    assert np.array_equal(found[~textured], expected[~textured])


def period_colors(ds: Any) -> np.ndarray:
    """The colours (y, x, 3) that files give the cells by their period."""
    from atlas.query.plane import Plane
    from atlas.render.kinds import KIND_TABLE
    from atlas.render.layers import MapView, paint
    from atlas.render.layout import STANDARD
    from atlas.render.painters import PAINTERS
    from atlas.render.request import PictureRequest

    view = MapView(KIND_TABLE["period"], ds, Plane.from_dataset(ds, ["period"]), PictureRequest(STANDARD))
    return np.asarray(paint(PAINTERS["period"](view))[..., :3])


def test_a_wheel_zooms_about_the_pointer_and_a_drag_moves(tab: Tab) -> None:
    x, y = at_cell(tab, 30, 10)
    (low, high), (bottom, top) = before = state(tab)["window"]
    tab.page.mouse.move(x, y)
    tab.page.mouse.wheel(0, -300)
    tab.until(lambda: state(tab)["window"] != before)
    (left, right), (down, up) = window = state(tab)["window"]
    assert right - left == pytest.approx(np.exp(-0.5) * (high - low))
    assert up - down == pytest.approx(np.exp(-0.5) * (top - bottom))
    assert at_cell(tab, 30, 10) == pytest.approx((x, y), abs=1.0)  # of whole pixels
    tab.page.mouse.down()
    tab.page.mouse.move(x + 60, y + 40, steps=4)
    tab.page.mouse.up()
    assert at_cell(tab, 30, 10) == pytest.approx((x + 60, y + 40), abs=1.0)
    assert state(tab)["cell"] is None
    assert np.ptp(state(tab)["window"][0]) == pytest.approx(np.ptp(window[0]))


def test_no_gesture_leaves_the_plane_or_goes_below_some_cells(tab: Tab) -> None:
    whole = state(tab)["window"]
    x, y = at_cell(tab, 30, 10)
    tab.page.mouse.move(x, y)
    for _ in range(30):
        tab.page.mouse.wheel(0, -400)
    tab.until(lambda: np.ptp(state(tab)["window"][0]) == pytest.approx(4 / 45 * np.ptp(whole[0])))
    for _ in range(40):
        tab.page.mouse.wheel(0, 400)
    tab.until(lambda: state(tab)["window"] == whole)


def test_a_click_shows_all_numbers_of_the_cell_and_the_command_that_solves_it_again(tab: Tab, ds: Any) -> None:
    periodic = np.argwhere((ds.regime.values == 1) & np.isfinite(ds.largest.values))
    row, column = periodic[len(periodic) // 2].tolist()
    tab.page.mouse.click(*at_cell(tab, column, row))
    shown = numbers(tab)
    cell = ds.isel(omega=column, b=row)
    assert shown["regime of motion"] == "periodic"
    exponent = shown["largest Lyapunov exponent [per forcing period]"].partition(" ±")[0]
    assert float(exponent.replace("−", "-")) == pytest.approx(float(cell.largest), rel=5e-6)
    assert int(shown["forcing periods per orbit"]) == int(cell.period)
    line = tab.page.locator("#cell code").inner_text()
    assert line == f"atlas point --set omega={float(cell.omega)!r} --set b={float(cell.b)!r}"
    copied = json.loads(tab.page.evaluate("async () => JSON.stringify(await fullNumbers(state.cell))"))
    assert copied["largest"] == float(cell.largest)
    assert copied["regime"] == "periodic"


def test_numbers_that_are_no_results_of_a_regime_are_not_shown(tab: Tab, ds: Any) -> None:
    row, column = np.argwhere(ds.regime.values == 5)[7].tolist()
    tab.page.mouse.click(*at_cell(tab, column, row))
    shown = numbers(tab)
    assert shown["regime of motion"] == "invalid"
    assert not {"forcing periods per orbit", "largest Lyapunov exponent [per forcing period]"} & shown.keys()


def test_keys_choose_cells_zoom_move_and_let_go(tab: Tab) -> None:
    whole = state(tab)["window"]
    tab.page.locator("#map").focus()
    tab.page.keyboard.press("ArrowRight")
    column, row = tab.until(lambda: state(tab)["cell"], 10.0)
    assert (column, row) in ((22, 18), (22, 19))  # of 45 x 38 cells the middle
    for key, cell in (("Right", [23, row]), ("Up", [23, row + 1]), ("Left", [22, row + 1]), ("Down", [22, row])):
        tab.page.keyboard.press(f"Arrow{key}")
        tab.until(lambda cell=cell: state(tab)["cell"] == cell, 10.0)
    assert "ω = " in tab.page.locator("#readout").inner_text()
    tab.page.keyboard.press("+")
    assert np.ptp(state(tab)["window"][0]) == pytest.approx(0.7 * np.ptp(whole[0]))
    before = state(tab)["window"]
    tab.page.keyboard.press("Shift+ArrowRight")
    assert state(tab)["window"][0][0] > before[0][0]
    tab.page.keyboard.press("0")
    assert state(tab)["window"] == whole
    tab.page.keyboard.press("Escape")
    tab.until(lambda: state(tab)["cell"] is None)


def test_the_cell_chosen_by_keys_stays_in_view(tab: Tab) -> None:
    tab.page.locator("#map").focus()
    for _ in range(6):
        tab.page.keyboard.press("+")
    for _ in range(12):
        tab.page.keyboard.press("ArrowRight")
    found = state(tab)
    column = found["cell"][0]
    low, high = found["window"][0]
    edges = tab.page.evaluate("() => X.cuts")
    assert low - 1e-12 <= edges[column] and edges[column + 1] <= high + 1e-12


def test_a_link_gives_the_same_view_and_back_goes_to_the_one_before(browser: Any, page: Path, tab: Tab) -> None:
    tab.page.locator("#look select").select_option("combined")
    tab.until(lambda: state(tab)["map"] == "combined")
    tab.page.locator("#closer").click()
    tab.page.mouse.click(*at_cell(tab, 20, 20))
    numbers(tab)
    tab.page.locator(".ends input").first.fill("0.1")
    tab.page.locator(".ends input").last.fill("0.7")
    tab.page.keyboard.press("Enter")
    tab.until(lambda: state(tab)["ends"] == [0.1, 0.7])
    there, address = state(tab), tab.address()
    with look_at(browser, page, f"#{address.partition('#')[2]}") as other:
        ready(other)
        again = state(other)
        assert np.allclose(again.pop("window"), there["window"], rtol=1e-9)
        assert again == {name: there[name] for name in again}
        assert numbers(other) == numbers(tab)
    tab.page.go_back()
    tab.until(lambda: state(tab)["cell"] is None and state(tab)["ends"] is None, 20.0)
    assert state(tab)["map"] == "combined"
    tab.page.go_back()
    tab.until(lambda: state(tab)["map"] == "exponent", 20.0)


@pytest.mark.parametrize(
    "address", ["#kind=none&cell=x:y", "#omega=9:2&cell=1", "#vmin=2&vmax=1", "#cell=NaN:0", "#%E0%A4%A"]
)
def test_a_link_that_means_nothing_shows_the_whole_plane(browser: Any, page: Path, address: str) -> None:
    with look_at(browser, page, address) as tab:
        ready(tab)
        assert state(tab)["map"] == "exponent"
        assert state(tab)["cell"] is None
        assert state(tab)["window"] == tab.page.evaluate("() => whole()")
        assert tab.complaints == []


def test_curves_are_switched_by_their_entries(tab: Tab) -> None:
    box = tab.page.locator("#key li", has_text="fold").locator("input")
    before = tab.page.screenshot(clip=tab.page.locator("#map").bounding_box())
    box.uncheck()
    tab.until(lambda: "without=fold" in tab.address())
    ready(tab)
    assert tab.page.screenshot(clip=tab.page.locator("#map").bounding_box()) != before
    assert not tab.page.locator("#key li", has_text="fold").locator("input").is_checked()


def test_two_fingers_zoom(browser: Any, page: Path) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    try:
        tab = Tab(context.new_page())
        tab.page.goto(f"file://{page}")
        ready(tab)
        assert tab.page.evaluate("() => document.documentElement.scrollWidth") == 390
        whole = state(tab)["window"]
        (x, y), session = at_cell(tab, 22, 19), context.new_cdp_session(tab.page)
        for kind, apart in (("touchStart", 40), ("touchMove", 60), ("touchMove", 80)):
            points = [{"x": x - apart / 2, "y": y, "id": 0}, {"x": x + apart / 2, "y": y, "id": 1}]
            session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        tab.until(lambda: np.ptp(state(tab)["window"][0]) == pytest.approx(0.5 * np.ptp(whole[0]), rel=1e-3))
        assert at_cell(tab, 22, 19) == pytest.approx((x, y), abs=0.5)
        tab.page.touchscreen.tap(*at_cell(tab, 23, 20))
        tab.until(lambda: state(tab)["cell"] == [23, 20])
        assert tab.complaints == []
    finally:
        context.close()


@pytest.mark.parametrize("width", [390, 1024, 1440])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_from_what_is_behind_it_and_nothing_is_wider_than_the_page(
    browser: Any, page: Path, width: int, scheme: str
) -> None:
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    try:
        tab = Tab(context.new_page())
        tab.page.goto(f"file://{page}#cell=2:0.3")
        ready(tab)
        numbers(tab)
        assert tab.page.evaluate("() => document.documentElement.scrollWidth") == width
        for name in ("--ink", "--faint"):
            paper, ink = (tab.page.evaluate(f"() => themed('{color}')") for color in ("--paper", name))
            assert contrast(paper, ink) >= 4.5  # WCAG AA
    finally:
        context.close()


def contrast(one: str, other: str) -> float:
    """The contrast of two colours by WCAG 2.1."""

    def luminance(color: str) -> float:
        parts = np.frombuffer(bytes.fromhex(color[1:]), np.uint8) / 255
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def test_everything_on_the_page_that_can_be_used_has_a_name(tab: Tab) -> None:
    unnamed = tab.page.evaluate(
        """() => {
            const used = [...document.querySelectorAll("button, select, input, canvas[role], [tabindex]")]
            const name = (each) => each.ariaLabel || each.textContent || each.labels?.[0]?.textContent || ""
            return used.filter((each) => !name(each).trim()).map((each) => each.outerHTML)
        }"""
    )
    assert unnamed == []


def test_a_page_inside_another_page_works_without_an_address(browser: Any, page: Path, tmp_path: Path) -> None:
    inside = escape(page.read_text(encoding="utf-8"))
    (tmp_path / "outer.html").write_text(f'<iframe width="900" height="700" srcdoc="{inside}"></iframe>', "utf-8")
    with look_at(browser, tmp_path / "outer.html") as tab:
        frame = tab.page.frames[1]
        tab.until(lambda: frame.evaluate("() => shown !== null && !draw.due"))
        frame.locator("#map").click()
        tab.until(lambda: frame.locator("#cell table").count() == 1)
        frame.locator("#closer").click()
        assert tab.complaints == []
        assert tab.address().endswith("outer.html")


def test_the_command_of_a_cell_that_was_solved_with_a_larger_limit_sets_it(tab: Tab, ds: Any) -> None:
    tab.page.evaluate("() => { atlas.allowances = {periods_used: '--max-periods', survived: '--survival'} }")
    tab.page.mouse.click(*at_cell(tab, 10, 12))
    numbers(tab)
    used = int(ds.periods_used[12, 10])
    assert tab.page.locator("#cell code").inner_text().endswith(f" --max-periods {used}")


def test_by_plain_http_where_there_is_no_clipboard_the_command_is_copied_all_the_same(tab: Tab) -> None:
    tab.page.evaluate(
        """() => {
            Object.defineProperty(navigator, "clipboard", {value: undefined})
            document.addEventListener("copy", () => { window.wasCopied = document.activeElement.value })
        }"""
    )
    tab.page.mouse.click(*at_cell(tab, 20, 20))
    tab.page.get_by_role("button", name="copy command").click()
    assert tab.until(lambda: tab.page.evaluate("() => window.wasCopied")).startswith("atlas point --")
    assert tab.page.get_by_role("button", name="copied").count() == 1
    assert tab.page.locator("textarea").count() == 0
