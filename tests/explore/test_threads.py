"""No thread of the explorer ends silently: what it raises is logged and shown, and its work begins again."""

import asyncio
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest
from distributed import Client
from tornado.ioloop import IOLoop

from atlas.explore import threads
from atlas.explore.explorer import Explorer
from atlas.explore.jobs import Computation, ComputationJob, JobService
from atlas.explore.picture_renderer import PictureRenderer, RenderedPicture
from atlas.explore.server import PageServer
from atlas.explore.view_state import initial_view
from tests.explore.test_solving import exploring, waited

CANCELLED, FROM_DASK = asyncio.CancelledError("gone"), UnboundLocalError("cannot access local variable 'result'")
"""What is no Exception, and what Dask's ``sync`` was seen to raise."""
FROM_DISK = OSError(5, "EIO")


def raise_once(monkeypatch: pytest.MonkeyPatch, owner: type, name: str, error: BaseException) -> list[str]:
    """Have a method raise when it is called first; the list returned has an entry for each call."""
    function, calls = getattr(owner, name), list[str]()

    @wraps(function)
    def once(*given: Any, **named: Any) -> Any:
        calls.append(name)
        if len(calls) == 1:
            raise error
        return function(*given, **named)

    monkeypatch.setattr(owner, name, once)
    return calls


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Work begins again after moments: 30 tests would wait for a second or two each."""
    monkeypatch.setattr(threads, "PAUSE", 0.01)


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """All that patches have said of trouble."""
    said, patched = list[str](), JobService._say

    def patches_say(self: JobService, trouble: str, workers: int = 0) -> None:
        said.append(trouble)
        patched(self, trouble, workers)

    monkeypatch.setattr(JobService, "_say", patches_say)
    return said


@pytest.mark.parametrize("error", [CANCELLED, FROM_DASK], ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("step", ["_serve", "_work", "_look", "_made", "_take"])
def test_the_thread_that_has_jobs_done_goes_on_with_a_new_client_after_any_exception(
    client: Client, monkeypatch: pytest.MonkeyPatch, shown: list[str], step: str, error: BaseException
) -> None:
    connected, found = list[int](), list[int]()

    @contextmanager
    def connect() -> Iterator[Client]:
        connected.append(1)
        yield client

    raise_once(monkeypatch, JobService, step, error)
    patches = JobService(connect)
    try:
        patches.request("test", [ComputationJob(Computation(abs, -3), found.append, pytest.fail)])
        assert waited(lambda: patches.n_remaining("test") == 0)
        assert patches.state.trouble == ""
    finally:
        patches.stop()
    assert found == [3] and len(connected) == (1 if step == "_serve" else 2)
    assert any(str(error) in said for said in shown)


@pytest.fixture
def explorer(finished: Path, client: Client) -> Iterator[Explorer]:
    with exploring(finished, client) as made:
        yield made


@pytest.mark.parametrize("error", [CANCELLED, FROM_DISK], ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("step", ["_serve", "_find", "_paint"])
def test_the_thread_that_paints_says_what_went_wrong_and_paints_on(
    explorer: Explorer, monkeypatch: pytest.MonkeyPatch, step: str, error: BaseException
) -> None:
    raise_once(monkeypatch, PictureRenderer, step, error)
    came, refused = list[RenderedPicture](), list[str]()
    painter = PictureRenderer(explorer, came.append, refused.append)
    view = replace(initial_view(explorer.subject), x=(2.5, 3.5), y=(0.15, 0.25))
    try:
        painter.show(view, (48, 40))
        assert waited(lambda: len(refused) == 1)
        assert str(error.args[-1]) in refused[0]
        painter.show(replace(view, kind="period"), (48, 40))
        assert waited(lambda: bool(came) and not painter.is_busy)
    finally:
        painter.close()
        painter.wait()


def test_a_server_that_cannot_begin_says_why_and_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ValueError("no pages")

    monkeypatch.setattr("atlas.explore.server._application", broken)
    with pytest.raises(RuntimeError, match="ValueError: no pages"):
        PageServer(lambda arguments: "", lambda send, arguments: pytest.fail("no page"))


def test_a_server_whose_loop_ends_by_an_exception_serves_on_at_its_address() -> None:
    made = list[int]()

    def page(arguments: object) -> str:
        made.append(1)
        if len(made) == 1:
            IOLoop.current().add_callback(sys.exit, "the loop ends")
        return "a page"

    def answers() -> bool:
        with suppress(OSError), urlopen(f"{server.url}?token={server.token}", timeout=20.0) as found:
            return int(found.status) == 200
        return False

    server = PageServer(page, lambda send, arguments: pytest.fail("no page"))
    try:
        assert waited(lambda: answers() and len(made) > 1)
    finally:
        server.stop()
    assert not answers()
