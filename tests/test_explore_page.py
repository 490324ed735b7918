"""The explorer's page in a real browser."""

import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from distributed import Client

import atlas
from atlas.explore.chosen import from_address
from atlas.explore.painter import Painter
from atlas.explore.session import Exploration, explore
from atlas.explore.view import STAGES
from atlas.query.queries import at
from tests.browser import Tab, needs_browser, opened

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning:playwright")]

SECONDS = 6.0
"""Within which the first picture is to be seen."""


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory, client: Client) -> Iterator[Exploration]:
    """An explorer of a small atlas of the packaged system."""
    needs_browser()
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
def tab(running: Exploration) -> Iterator[Tab]:
    """Its page, once there is a picture; afterwards nothing may have gone wrong in the browser."""
    with opened(running.url) as made:
        made.until(made.image)
        yield made
        assert made.complaints == []
        assert made.hosts == {"127.0.0.1"}


def arguments(tab: Tab) -> dict[str, list[bytes]]:
    """The arguments of a tab's address, as the server gets them."""
    found = parse_qs(urlsplit(tab.address()).query)
    return {name: [value.encode() for value in values] for name, values in found.items()}


def painter_of(running: Exploration) -> Painter:
    """The painter of the only page there is, once others that were left are forgotten."""
    end = time.monotonic() + 20.0
    while True:
        painters = [who for who in running.explorer.listeners if isinstance(who, Painter)]
        if len(painters) == 1 or time.monotonic() > end:
            (painter,) = painters
            return painter
        time.sleep(0.1)


def settled(running: Exploration, tab: Tab) -> None:
    """Wait until all in view is solved and shown."""
    time.sleep(0.5)
    tab.until(lambda: not painter_of(running).busy, 300.0)
    time.sleep(1.0)


def test_the_first_picture_is_there_within_six_seconds(running: Exploration) -> None:
    with opened("about:blank") as tab:
        begin = time.monotonic()
        tab.page.goto(running.url)
        tab.until(tab.image, SECONDS)
        print(f"first picture after {time.monotonic() - begin:.1f} s")


def test_a_zoom_by_the_wheel_is_looked_up_once_it_rests(running: Exploration, tab: Tab) -> None:
    settled(running, tab)
    painter = painter_of(running)
    before, window = painter.looked, tab.image()
    tab.wheel(6)
    tab.until(lambda: tab.image() != window)
    time.sleep(1.0)
    assert painter.looked == before + 1


def test_tiles_appear_from_the_centre_out(running: Exploration, tab: Tab) -> None:
    came: list[object] = []
    running.explorer.listen("test", lambda _, key: came.append(key))
    window = tab.image()
    tab.wheel(8, (0.2, 0.8))
    tab.until(lambda: tab.image() != window)
    settled(running, tab)
    running.explorer.listen("test", None)
    sight = painter_of(running).sight
    assert sight is not None
    finest = [key for key in came if key.level_x == sight.level_x]  # type: ignore[attr-defined]
    order = {key: k for k, key in enumerate(sight.tiles(0))}
    places = [order[key] for key in finest if key in order]
    half = len(places) // 2
    assert half > 2 and np.mean(places[:half]) < np.mean(places[half:])


def test_the_text_about_the_cell_under_the_pointer_is_that_of_at(running: Exploration, tab: Tab) -> None:
    left, top, width, height = tab.plot()
    tab.page.mouse.move(left + 0.7 * width, top + 0.2 * height)
    tab.until(lambda: "periods_used" in tab.text())
    time.sleep(1.0)
    text = tab.text()
    x, y = (float(text.split(f" {symbol} ")[1].split()[0]) for symbol in ("ω", "b"))
    ds = running.explorer.subject.ds
    assert ds is not None
    found = at(ds, {"omega": x, "b": y})
    assert f"regime {found['regime'].replace('_', ' ')}" in " ".join(text.split())
    if "cell of the atlas" in text:
        assert f"periods_used {found['periods_used']}" in " ".join(text.split())


def test_a_click_draws_the_portrait_and_gives_the_line_that_solves_the_cell_alone(tab: Tab) -> None:
    left, top, width, height = tab.plot()
    tab.page.mouse.click(left + 0.6 * width, top + 0.4 * height)
    tab.until(lambda: tab.page.locator("img.portrait").count() == 1)
    line = tab.page.evaluate(
        "() => [...Bokeh.documents[0]._all_models.values()].filter((m) => m.type === 'TextInput')[0].value"
    )
    assert line.startswith("atlas point --set ") and "--set omega=" in line


def test_a_slider_solves_another_plane(running: Exploration, tab: Tab) -> None:
    tab.page.locator(".noUi-handle").first.focus()
    tab.page.keyboard.press("ArrowLeft")
    tab.until(lambda: "R=" in tab.address())
    tab.until(lambda: "another plane than the atlas's" in tab.text())
    tab.until(lambda: painter_of(running).sight is not None and not painter_of(running).busy, 120.0)
    plane = from_address(running.explorer.subject, arguments(tab)).plane
    levels = {key.level_x for key, _ in running.explorer.known.tiles.of(plane)}
    assert len(levels) == STAGES + 1


def test_a_reload_restores_window_kind_and_parameters(running: Exploration, tab: Tab) -> None:
    tab.page.goto(running.url + "?omega=2.0:3.0&b=0.1:0.3&kind=period&R=0.75")
    tab.until(tab.image)
    tab.wheel(2)
    tab.until(lambda: "omega=2.0:3.0" not in tab.address())
    time.sleep(0.5)
    address = tab.address()
    tab.page.reload()
    tab.until(tab.image)
    time.sleep(0.5)
    assert tab.address() == address and "kind=period" in address and "R=0.75" in address


def test_two_pages_at_once_show_different_windows(running: Exploration, tab: Tab) -> None:
    other = Tab(tab.page.context.new_page())
    other.page.goto(running.url + "?omega=2.0:3.0&b=0.1:0.3")
    window = other.until(other.image)
    assert window[0] > 1.9 and (tab.image() or [0.0])[0] < 1.1


def test_pages_that_are_closed_free_their_work(running: Exploration) -> None:
    with opened(running.url) as tab:
        tab.until(tab.image)
        assert running.explorer.listeners
    assert tab.until(lambda: not running.explorer.listeners, 20.0)


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_the_picture_in_view_is_saved(tab: Tab, suffix: str, tmp_path: Path) -> None:
    with tab.page.expect_download(timeout=60_000) as download:
        tab.page.get_by_role("button", name=suffix.upper()).click()
    path = tmp_path / f"picture.{suffix}"
    download.value.save_as(path)
    begins = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}
    assert path.read_bytes().startswith(begins[suffix])


def test_the_view_is_made_the_spec_of_an_atlas(running: Exploration, tab: Tab) -> None:
    tab.page.get_by_role("button", name="make this an atlas").click()
    tab.until(lambda: "atlas run plane-1.toml -o plane-1.zarr" in tab.text())
    assert "probed on" in tab.text()


def test_a_million_times_deeper_cells_are_those_of_the_point_command_to_the_bit(running: Exploration, tab: Tab) -> None:
    centre, half = (1.7300123456789, 0.2000123456789), 1.75e-6
    (x, y) = (f"{value - half!r}:{value + half!r}" for value in centre)
    tab.page.goto(f"{running.url}?omega={x}&b={y}")
    tab.until(tab.image)
    settled(running, tab)
    script = (
        "() => [...Bokeh.documents[0]._all_models.values()].map((model) => model.axis_label).filter(Boolean).join()"
    )
    assert "distance from 1.73001" in tab.page.evaluate(script)
    left, top, width, height = tab.plot()
    tab.page.mouse.click(left + 0.5 * width, top + 0.5 * height)
    tab.until(lambda: tab.page.locator("img.portrait").count() == 1)
    explorer, sight = running.explorer, painter_of(running).sight
    assert sight is not None
    cell = explorer.known.cell(explorer.subject.plane, sight, *centre)
    assert cell is not None and abs(cell.parameters["omega"] - centre[0]) < half / 100
    alone = atlas.point(cell.parameters, settings=explorer.subject.settings)
    assert all(alone[name] == value for name, value in cell.results.items() if name in ("largest", "error", "regime"))


def test_an_address_that_is_wrong_is_said_and_the_whole_plane_shown(running: Exploration) -> None:
    with opened(running.url + "?kind=sweep") as tab:
        tab.until(lambda: "found 'sweep'" in tab.text())
