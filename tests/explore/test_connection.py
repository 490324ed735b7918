"""What a live page asks and what it is answered and told, in messages, without a browser."""

import asyncio
import base64
import json
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from distributed import Client

from atlas.explore.connection import PageConnection, page_for
from atlas.explore.explorer import Explorer
from atlas.explore.view_state import from_address
from tests.explore.messages import opened
from tests.explore.test_axes import arguments
from tests.explore.test_solving import exploring

HERE = "omega=2.5:3.5&b=0.15:0.25&kind=exponent"
SIZE = {"size": [48, 40], "rests": True, "shows": "gap at t = kT"}


class Visitor:
    """Somebody at a page: the messages that came, and a way to ask."""

    def __init__(self, explorer: Explorer, folder: Path, query: str) -> None:
        self.told, self.pictures = list[dict[str, Any]](), list[bytes]()
        self.page = PageConnection(explorer, folder, self._take, arguments(query))
        self._count = 0

    def _take(self, message: str | bytes) -> None:
        if isinstance(message, bytes):
            self.pictures.append(message)
        else:
            self.told.append(json.loads(message))

    async def until(self, condition: Callable[[], Any]) -> Any:
        """The value of a condition once it is true."""
        for _ in range(6000):
            if found := condition():
                return found
            await asyncio.sleep(0.02)
        raise AssertionError(f"not within two minutes; told: {self.told[-3:]}")

    async def ask(self, what: str, query: str = HERE, **given: Any) -> dict[str, Any]:
        """The answer to a request."""
        self._count += 1
        self.page.hear(json.dumps({"ask": what, "id": self._count, "query": query, **given}))
        return dict(await self.until(lambda: next((m for m in self.told if m.get("id") == self._count), None)))

    async def hears(self, what: str) -> dict[str, Any]:
        """The first thing told with this name."""
        return dict(await self.until(lambda: next((m for m in self.told if m.get("tell") == what), None)))


@pytest.fixture
def visit(finished: Path, client: Client, tmp_path: Path) -> Any:
    """Runs what somebody does at a page of a small atlas; the argument is a function of the visitor."""
    folder = tmp_path / "specs"
    folder.mkdir()

    def run(act: Callable[[Visitor], Coroutine[Any, Any, None]], query: str = HERE) -> None:
        async def whole() -> None:
            with exploring(finished, client) as explorer:
                visitor = Visitor(explorer, folder, query)
                try:
                    await act(visitor)
                finally:
                    visitor.page.close()
                    await asyncio.to_thread(visitor.page.wait)

        asyncio.run(whole())

    return run


def test_a_view_is_answered_and_its_cells_come_as_bytes_with_the_progress(visit: Any) -> None:
    async def act(visitor: Visitor) -> None:
        answer = await visitor.ask("view", **SIZE)
        assert answer == {"id": 1}
        await visitor.until(lambda: visitor.pictures)

        about, _ = opened(np.frombuffer(visitor.pictures[0], np.uint8))
        assert about["maps"][0]["name"] == "exponent" and about["axes"][0]["edges"][0] <= 2.5
        progress = await visitor.hears("progress")
        assert "exploring tolerance 0.1" in progress["text"] and 0.0 <= progress["share"] <= 1.0

    visit(act)


@pytest.mark.parametrize(
    ("query", "said"),
    [(f"{HERE}&R=1.5", "R = 1.5: must satisfy 0 <= R <= 1"), ("omega=3:2", "omega: found '3:2', must be LOW:HIGH")],
)
def test_a_view_that_there_is_not_is_refused_with_its_reason(visit: Any, query: str, said: str) -> None:
    async def act(visitor: Visitor) -> None:
        assert (await visitor.ask("view", query, **SIZE))["error"].startswith(said)
        assert visitor.pictures == []

    visit(act)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"ask": "fly", "id": 1, "query": ""}', '"view"', "\xff"])
def test_what_is_no_request_is_refused(visit: Any, text: str) -> None:
    async def act(visitor: Visitor) -> None:
        visitor.page.hear(text)
        assert visitor.told[-1]["error"] == "this is no request of a page"

    visit(act)


def test_a_request_without_what_it_needs_is_refused_and_the_page_goes_on(
    visit: Any, caplog: pytest.LogCaptureFixture
) -> None:
    async def act(visitor: Visitor) -> None:
        assert "this could not be done: TypeError" in (await visitor.ask("cell"))["error"]
        assert await visitor.ask("view", **SIZE) == {"id": 2}

    visit(act)
    assert "could not be answered" in caplog.text


def test_a_click_is_answered_by_the_nearest_cell_whose_details_are_then_told(visit: Any) -> None:
    async def act(visitor: Visitor) -> None:
        await visitor.ask("view", **SIZE)
        await visitor.until(lambda: visitor.pictures)
        x, y = (await visitor.ask("cell", at=[2.9, 0.2]))["cell"]
        assert abs(x - 2.9) < 0.02 and abs(y - 0.2) < 0.01
        await visitor.ask("view", f"{HERE}&cell={x},{y}", **SIZE)
        await visitor.hears("motion")
        cells = [message for message in visitor.told if message.get("tell") == "cell"]
        assert cells[0]["solving"] and cells[1]["command"].startswith("atlas point --set ")
        assert json.loads(cells[1]["text"])["omega"] == x == cells[1]["given"]["places"][0][1]
        assert "initial state" in str(await visitor.hears("attractors"))
        assert (await visitor.hears("offer"))["possible"] in (True, False)

    visit(act)


def test_a_cut_tells_its_cells_as_they_are_solved(visit: Any) -> None:
    async def act(visitor: Visitor) -> None:
        await visitor.ask("view", f"{HERE}&cut=3.7,0.45,3.9,0.45", **SIZE)
        cuts = [message for message in visitor.told if message.get("tell") == "cut"]
        assert cuts[0]["shown"] == {"x": [], "y": []} and cuts[0]["range"] == [3.7, 3.9] and cuts[0]["axis"] == 0
        await visitor.until(lambda: visitor.told[-1].get("says") == "257 cells along the cut")
        last = visitor.told[-1]
        assert len(last["exponents"]["x"]) == 257 <= len(last["shown"]["x"]) == len(last["shown"]["y"])

    visit(act)


def test_other_axes_go_through_the_chosen_cell_or_the_middle_in_the_style_of_the_page(visit: Any) -> None:
    async def act(visitor: Visitor) -> None:
        query = (await visitor.ask("turn", "omega=3.2:4.2&b=0.3:0.5&kind=period", axes=["omega", "R"]))["query"]
        assert query.startswith("axes=omega,R&") and "&b=0.4" in query and "kind=period" in query
        there = (await visitor.ask("turn", f"{HERE}&cell=2.9,0.2", axes=["omega", "R"]))["query"]
        assert "&b=0.2" in there

    visit(act)


def test_an_orbit_that_is_not_followed_has_no_values(visit: Any) -> None:
    async def act(visitor: Visitor) -> None:
        assert (await visitor.ask("find", value=2.0))["error"] == "no orbit is followed"
        assert "must be a parameter and a cell" in (await visitor.ask("follow", along="omega"))["error"]
        follow = (await visitor.ask("follow", f"{HERE}&cell=2.9,0.2", along="omega"))["follow"]
        assert follow == "omega,2.5,3.5,0,2.9"

    visit(act)


def test_the_picture_in_view_and_the_spec_of_a_box_are_answered(visit: Any, tmp_path: Path) -> None:
    async def act(visitor: Visitor) -> None:
        assert (await visitor.ask("save", suffix="png"))["error"] == "there is no picture yet"
        await visitor.ask("view", **SIZE)
        await visitor.until(lambda: visitor.pictures)
        saved = await visitor.ask("save", suffix="png")
        assert saved["name"].endswith("-exponent.png")
        assert base64.b64decode(saved["href"].partition(",")[2]).startswith(b"\x89PNG")
        made = await visitor.ask("make", box=[[2.5, 2.75], [0.2, 0.21]], cells=4)
        assert Path(made["file"]).read_text(encoding="utf-8") == made["text"]
        assert "start = 2.5" in made["text"] and made["line"].startswith("atlas run ")

    visit(act)


def test_a_page_that_is_closed_wants_nothing_more(finished: Path, client: Client, tmp_path: Path) -> None:
    async def whole() -> None:
        with exploring(finished, client) as explorer:
            visitor = Visitor(explorer, tmp_path, HERE)
            await visitor.ask("view", f"{HERE}&cut=3.7,0.45,3.9,0.45&cell=2.9,0.2", **SIZE)
            assert explorer.listeners
            visitor.page.close()
            count = len(visitor.told)
            await asyncio.to_thread(visitor.page.wait)
            assert not explorer.listeners and visitor.page.is_closed
            await asyncio.sleep(0.1)
            assert len(visitor.told) == count

    asyncio.run(whole())


def test_an_address_that_is_wrong_has_the_whole_plane_and_the_reason(finished: Path, client: Client) -> None:
    with exploring(finished, client) as explorer:
        html = page_for(explorer, arguments("kind=sweep"))
        subject = json.loads(html.partition('id="subject">')[2].partition("</script>")[0])
    assert subject["trouble"].startswith("kind: found 'sweep'; possible: ")
    whole = from_address(explorer.subject, {})
    assert (subject["view"]["x"], subject["view"]["y"]) == (list(whole.x), list(whole.y))


def test_a_page_requests_nothing_from_elsewhere(finished: Path, client: Client) -> None:
    with exploring(finished, client) as explorer:
        html = page_for(explorer, {})
    assert "default-src 'none'" in html and "src=" not in html.replace("-src", "") and "http://" not in html
