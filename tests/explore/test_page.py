"""The explorer's page in a real browser."""

import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from distributed import Client

import atlas
from atlas.explore.picture_renderer import PictureRenderer
from atlas.explore.session import ExplorerSession, explore
from atlas.explore.view_state import from_address
from atlas.explore.viewport import STAGES, TileKey, Viewport
from atlas.query.queries import nearest_cell
from atlas.render.class_maps import PALETTE
from tests.support.browser import Tab, opened
from workers.results import PENDING, REGIME

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning:playwright")]

SECONDS = 6.0
"""Of two processors, within which the first picture is to be seen."""


WINDOW = "omega=3.2:4.2&b=0.3:0.5"
"""A part of the plane whose cells are cheap: orbits of period 1, and motion without impact."""


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory, client: Client, browser: Any) -> Iterator[ExplorerSession]:
    """An explorer of a small atlas of the packaged system."""
    folder = tmp_path_factory.mktemp("explore")
    spec = atlas.Spec(
        "two-mass",
        {"omega": {"start": 1.0, "stop": 4.5, "num": 40}, "b": {"start": 0.05, "stop": 0.6, "num": 30}},
        solve={"tolerance": 0.1, "survival": 500, "max_periods": 2000},
    )
    atlas.run(spec, folder / "plane.zarr", client=client)
    made = explore(str(folder / "plane.zarr"), client=client, folder=folder)
    yield made
    made.stop()


@pytest.fixture
def tab(running: ExplorerSession, browser: Any) -> Iterator[Tab]:
    """Its page, once there is a picture; afterwards nothing may have gone wrong in the browser."""
    with opened(browser, f"{running.url}&{WINDOW}") as made:
        made.until(made.image)
        yield made
        assert made.complaints == []
        assert made.hosts == {"127.0.0.1"}


def arguments(tab: Tab) -> dict[str, list[bytes]]:
    """The arguments of a tab's address, as the server gets them."""
    found = parse_qs(urlsplit(tab.address()).query)
    return {name: [value.encode() for value in values] for name, values in found.items()}


def painter_of(running: ExplorerSession, tab: Tab) -> PictureRenderer:
    """The painter of the only page there is, once others that were left are forgotten."""

    def painters() -> list[PictureRenderer]:
        return [who for who in running.explorer.listeners if isinstance(who, PictureRenderer)]

    tab.until(lambda: len(painters()) == 1, 20.0)
    (painter,) = painters()
    return painter


def settled(running: ExplorerSession, tab: Tab, seconds: float = 300.0) -> Viewport:
    """Wait until all in view is solved and drawn, and return what is in view."""
    painter = painter_of(running, tab)
    tab.until(lambda: painter.sight is not None and not painter.is_busy, seconds)
    assert painter.sight is not None
    return painter.sight


def zoomed(tab: Tab, times: int, at: tuple[float, float] = (0.3, 0.6)) -> None:
    """Turn the wheel, and wait for another picture."""
    window = tab.image()
    tab.wheel(times, at)
    tab.until(lambda: tab.image() != window)


def click(tab: Tab, across: float, down: float) -> None:
    """Click a point of the plane, given as shares of its width and height, and wait for its numbers."""
    left, top, width, height = tab.plot()
    tab.page.mouse.click(left + across * width, top + down * height)
    tab.page.get_by_role("button", name="copy all numbers").wait_for(timeout=120_000)


def test_the_packaged_plane_is_seen_within_six_seconds_of_two_processors(client: Client, browser: Any) -> None:
    running = explore("omega-b", client=client)
    try:
        begin, used = time.monotonic(), time.process_time()
        with opened(browser, running.url, 1280, 800) as tab:
            painter, known, plane = painter_of(running, tab), running.explorer.known, running.explorer.subject.plane
            tab.until(lambda: known.tiles.tiles_of_plane(plane), 120.0)
            first = time.monotonic() - begin, (time.process_time() - used) / 2

            def seen_whole() -> bool:
                sight = painter.sight
                return sight is not None and not np.any(
                    known.visible_cells(plane, sight, []).ds[REGIME.name].values == PENDING
                )

            tab.until(seen_whole, 300.0)
            whole = time.monotonic() - begin, (time.process_time() - used) / 2
        for what, (passed, spent) in (("first tile", first), ("whole plane", whole)):
            print(f"{what} after {passed:.1f} s, {spent:.1f} s of two processors")
        assert whole[1] < SECONDS
    finally:
        running.stop()


def test_a_zoom_by_the_wheel_is_looked_up_once_it_rests(running: ExplorerSession, tab: Tab) -> None:
    settled(running, tab)
    painter = painter_of(running, tab)
    before = painter.n_lookups
    zoomed(tab, 6)
    settled(running, tab)
    assert painter.n_lookups == before + 1


def test_tiles_appear_from_the_centre_out(running: ExplorerSession, tab: Tab) -> None:
    came: list[TileKey] = []
    settled(running, tab)
    running.explorer.subscribe("test", lambda _, key: came.append(key))
    zoomed(tab, 8, (0.2, 0.8))
    sight = settled(running, tab)
    running.explorer.subscribe("test", None)
    order = {key: k for k, key in enumerate(sight.tiles(0))}
    places = [order[key] for key in came if key in order]
    half = len(places) // 2
    assert half > 2 and np.mean(places[:half]) < np.mean(places[half:])


def test_the_text_about_the_cell_under_the_pointer_is_that_of_at(running: ExplorerSession, tab: Tab) -> None:
    settled(running, tab)
    left, top, width, height = tab.plot()
    tab.page.mouse.move(left + 0.7 * width, top + 0.2 * height)

    def told() -> str:
        """What the page says, once it says all of a cell; read at once, since it may be about to say something new."""
        text = tab.page.locator("#readout").inner_text()
        return text if "largest Lyapunov exponent" in text else ""

    text = tab.until(told)
    x, y = (float(text.split(f"{symbol} = ")[1].split(",")[0].split(":")[0]) for symbol in ("ω", "b"))
    ds = running.explorer.subject.ds
    assert ds is not None
    found = nearest_cell(ds, {"omega": x, "b": y})
    assert f": {found['regime'].replace('_', ' ')}; largest Lyapunov exponent" in text


def test_a_click_shows_the_line_that_solves_the_cell_alone_and_its_attractors(tab: Tab) -> None:
    click(tab, 0.6, 0.4)
    line = tab.page.locator("#cell code").inner_text()
    assert line.startswith("atlas point --set ") and "--set omega=" in line
    tab.until(lambda: "initial states" in tab.text() and "searching from" not in tab.text())
    assert "100 % (" in tab.text() or "n-p-q" in tab.text()


def test_a_click_shows_the_portraits_of_all_attractors_and_sets_the_machine_in_motion(
    running: ExplorerSession, browser: Any
) -> None:
    """At omega = 4, b = 0.0939 an orbit of period 1 coexists with two mirror images of period 3."""
    with opened(browser, f"{running.url}&omega=3.9:4.1&b=0.09:0.1", 1440, 900) as tab:
        tab.until(tab.image)
        click(tab, 0.475, 0.614)
        tab.until(lambda: all(tab.inked(".phase", color) for color in PALETTE[:3]), 120.0)
        tab.page.get_by_role("button", name="move the machine").click()
        first = tab.inked(".machine", PALETTE[0])
        tab.until(lambda: tab.inked(".machine", PALETTE[0]) != first)
        assert tab.complaints == []


def test_a_slider_solves_another_plane(running: ExplorerSession, tab: Tab) -> None:
    tab.page.get_by_label("coefficient of restitution, R", exact=True).focus()
    tab.page.keyboard.press("ArrowLeft")
    tab.until(lambda: "R=" in tab.address())
    tab.until(lambda: "not the plane of the atlas" in tab.text())
    plane = from_address(running.explorer.subject, arguments(tab)).plane
    tab.until(
        lambda: len({key.level_x for key, _ in running.explorer.tiles.tiles_of_plane(plane)}) == STAGES + 1, 120.0
    )


def test_a_number_typed_beside_a_slider_moves_it_and_one_out_of_range_is_refused(tab: Tab) -> None:
    typed = tab.page.get_by_label("coefficient of restitution, R: value")
    typed.fill("0.7123")
    typed.press("Enter")
    tab.until(lambda: "R=0.7123" in tab.address())
    slider = tab.page.get_by_label("coefficient of restitution, R", exact=True)
    assert float(slider.input_value()) == 0.7123
    typed.fill("1.5")
    typed.press("Enter")
    tab.until(lambda: "R = 1.5: must satisfy 0 <= R <= 1" in tab.text())
    tab.until(lambda: "R=0.7123" in tab.address() and float(slider.input_value()) == 0.7123)


def test_other_axes_are_chosen_in_the_page_and_back_leads_to_those_before(tab: Tab) -> None:
    address = tab.address()
    tab.page.get_by_text("axes", exact=True).click()
    tab.page.get_by_label("up", exact=True).select_option(label="R coefficient of restitution")
    tab.page.wait_for_url("**axes=omega,R**")
    tab.until(tab.image)
    assert tab.page.evaluate("() => held.axes[1].label") == "coefficient of restitution R"
    assert "b=0.4" in tab.address()  # the middle of the view
    tab.page.go_back()
    tab.page.wait_for_url(address)
    tab.until(tab.image)


def pointed(tab: Tab, canvas: str) -> bool:
    """Whether a diagram of the cut marks the middle of the cut."""
    _, _, width, _ = tab.plot("section states along")
    return any(abs(x - 64 - width / 2) < 0.02 * width and count > 10 for x, count in tab.inked(canvas, "#c25a6c"))


def test_a_cut_is_drawn_over_the_plane_and_shares_the_pointer_with_it(tab: Tab) -> None:
    left, top, width, height = tab.plot()
    tab.page.get_by_title("draw a cut").click()
    tab.page.mouse.move(left + 0.2 * width, top + 0.5 * height)
    tab.page.mouse.down()
    tab.page.mouse.move(left + 0.5 * width, top + 0.3 * height, steps=4)
    tab.page.mouse.move(left + 0.8 * width, top + 0.5 * height, steps=4)
    tab.page.mouse.up()
    tab.until(lambda: "257 cells along the cut" in tab.text(), 120.0)
    tab.until(lambda: "cut=" in tab.address())
    x0, y0, x1, y1 = (float(part) for part in arguments(tab)["cut"][0].split(b","))
    assert abs(x0 - 3.4) < 0.02 and abs(x1 - 4.0) < 0.02 and abs(y0 - y1) < 0.01
    left, top, width, height = tab.plot()
    tab.page.mouse.move(left + 0.5 * width, top + 0.1 * height)
    for name in ("first", "last"):
        tab.until(partial(pointed, tab, f"#cut canvas:{name}-of-type"))
    tab.page.get_by_role("button", name="close the cut").click()
    tab.until(lambda: "cut=" not in tab.address())


def test_a_reload_restores_window_kind_and_parameters(running: ExplorerSession, tab: Tab) -> None:
    tab.page.goto(running.url + "&omega=2.0:3.0&b=0.1:0.3&kind=period&R=0.75")
    tab.until(tab.image)
    zoomed(tab, 2)
    address = tab.address()
    assert "omega=2.0:3.0" not in address
    tab.page.reload()
    tab.until(tab.image)
    assert tab.address() == address and "kind=period" in address and "R=0.75" in address


@pytest.mark.parametrize(("width", "share"), [(1440, 0.7), (1000, 0.7), (940, 0.7), (700, 0.7), (390, 0.7)])
def test_the_plane_has_most_of_the_width_of_a_notebook_and_of_a_phone(
    running: ExplorerSession, browser: Any, width: int, share: float
) -> None:
    """At 940 pixels, the width of a notebook, columns beside the plane left it 135; at 390 they covered it."""
    with opened(browser, f"{running.url}&{WINDOW}", width, 720) as tab:
        tab.until(tab.image)
        left, top, across, down = tab.plot()
        assert across > share * width and left + across <= width
        assert top >= 0 and top + down <= 720 and 0.3 < down / across < 1.6
        assert tab.page.evaluate("() => document.documentElement.scrollWidth") <= width
        tall = "() => document.documentElement.scrollHeight"
        # What lies below the plane can be scrolled to, once it is laid out.
        tab.until(lambda: tab.page.evaluate(tall) > 800 if width < 1100 else tab.page.evaluate(tall) <= 720)
        assert tab.complaints == []


def test_the_plane_takes_most_of_a_wide_window(running: ExplorerSession, browser: Any) -> None:
    with opened(browser, f"{running.url}&{WINDOW}", 1440, 900) as tab:
        tab.until(tab.image)
        _, _, across, down = tab.plot()
        assert across * down > 0.58 * 1440 * 900


def test_a_phone_has_the_controls_folded_until_they_are_asked_for(running: ExplorerSession, browser: Any) -> None:
    with opened(browser, f"{running.url}&{WINDOW}", 390, 844) as tab:
        tab.until(tab.image)
        cut = tab.page.get_by_role("button", name="cut across")
        assert not cut.is_visible()
        tab.page.get_by_text("controls", exact=True).click()
        tab.until(cut.is_visible)


@pytest.mark.parametrize("width", [1440, 940, 390])
def test_a_reload_shows_the_map_also_where_a_line_over_it_cannot_be_drawn(
    running: ExplorerSession, browser: Any, width: int
) -> None:
    """The store has no curves: asking for them must not cost the map."""
    with opened(browser, f"{running.url}&{WINDOW}&overlay=curves,boundaries", width, 720) as tab:
        tab.until(tab.image)
        tab.until(lambda: "has no curves yet" in tab.text())
        tab.page.reload()
        tab.until(tab.image)
        assert "overlay=curves,boundaries" in tab.address()


def test_the_cell_clicked_is_marked_in_its_plane_alone(tab: Tab) -> None:
    assert tab.mark() is None
    click(tab, 0.6, 0.4)
    line = tab.page.locator("#cell code").inner_text()
    words = dict(word.split("=") for word in line.split() if word.startswith(("omega=", "b=")))
    assert tab.mark() == (float(words["omega"]), float(words["b"]))
    tab.page.get_by_label("coefficient of restitution, R", exact=True).focus()
    tab.page.keyboard.press("ArrowLeft")
    tab.until(lambda: tab.mark() is None)
    tab.page.keyboard.press("ArrowRight")
    tab.until(tab.mark)


def test_curves_of_another_plane_are_said_to_be_lacking(running: ExplorerSession, browser: Any) -> None:
    with opened(browser, f"{running.url}&{WINDOW}&R=0.7&overlay=curves") as tab:
        said = "no curves at R = 0.7: a store has curves only of its own plane, R = 0.8"
        tab.until(lambda: said in tab.text())
        assert tab.until(tab.image)


def test_two_pages_at_once_show_different_windows(running: ExplorerSession, tab: Tab) -> None:
    other = Tab(tab.page.context.new_page())
    other.page.goto(running.url + "&omega=2.0:3.0&b=0.1:0.3")
    window = other.until(other.image)
    assert 1.9 < window[0] < 2.1 and (tab.image() or [0.0])[0] > 3.1


def test_pages_that_are_closed_free_their_work(running: ExplorerSession, browser: Any) -> None:
    with opened(browser, f"{running.url}&{WINDOW}") as tab:
        tab.until(tab.image)
        assert running.explorer.listeners
    with opened(browser, "about:blank") as tab:
        assert tab.until(lambda: not running.explorer.listeners)


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_the_picture_in_view_is_saved(tab: Tab, suffix: str, tmp_path: Path) -> None:
    tab.page.get_by_text("save the picture").click()
    with tab.page.expect_download(timeout=60_000) as download:
        tab.page.get_by_role("button", name=suffix.upper()).click()
    path = tmp_path / f"picture.{suffix}"
    download.value.save_as(path)
    begins = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}
    assert path.read_bytes().startswith(begins[suffix])


def test_the_view_is_made_the_spec_of_an_atlas(running: ExplorerSession, tab: Tab) -> None:
    tab.page.get_by_text("new atlas of the view").click()
    tab.page.get_by_role("button", name="make this an atlas").click()
    tab.until(lambda: "atlas run plane-1.toml -o plane-1.zarr" in tab.text())
    assert "probed on" in tab.text()


def test_a_million_times_deeper_cells_are_those_of_the_point_command_to_the_bit(
    running: ExplorerSession, tab: Tab
) -> None:
    centre, half = (3.7300123456789, 0.3000123456789), 1.75e-6
    (x, y) = (f"{value - half!r}:{value + half!r}" for value in centre)
    tab.page.goto(f"{running.url}&omega={x}&b={y}")
    tab.until(tab.image)
    sight = settled(running, tab)
    script = "() => tickFormat(held.axes[0], ...plane.scene().window[0]).label"
    assert "distance from 3.73001" in tab.page.evaluate(script)
    click(tab, 0.5, 0.5)
    explorer = running.explorer
    cell = explorer.known.cell(explorer.subject.plane, sight, *centre)
    assert cell is not None and abs(cell.parameters["omega"] - centre[0]) < half / 100
    alone = atlas.point(cell.parameters, settings=explorer.subject.settings)
    assert all(alone[name] == value for name, value in cell.results.items() if name in ("largest", "error", "regime"))


def test_an_address_that_is_wrong_is_said_and_the_whole_plane_shown(running: ExplorerSession, browser: Any) -> None:
    with opened(browser, running.url + "&kind=sweep") as tab:
        tab.until(lambda: "found 'sweep'" in tab.text())
