"""How an explorer is started and ended: by the command, and in a notebook."""

import asyncio
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from pathlib import Path

import nbclient
import nbformat
import pytest
from distributed import Client
from tornado.websocket import websocket_connect

import atlas
from atlas.errors import InputError
from atlas.explore.session import explore
from tests.explore.test_solving import waited
from tests.paths import ROOT
from tests.support.browser import opened, started

COMMAND = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # what is started in the background may ignore it
from atlas.cli.main import main
main(sys.argv[1:])
"""


def test_a_dataset_is_explored_in_a_frame_that_shows_its_window_and_stop_ends_its_server(
    finished: Path, client: Client
) -> None:
    ds = atlas.open(finished)
    shown = ds.sel(omega=slice(2.5, 3.5)).atlas.explore(client=client)
    try:
        frame = shown._repr_html_()
        assert f'<iframe src="{shown.url}"' in frame and shown.url.startswith("http://127.0.0.1:")
        assert re.search(r"\?omega=2\.66\d+:3\.33\d+", shown.url)
        with urllib.request.urlopen(shown.url, timeout=30.0) as page:
            assert page.status == 200 and b"</html>" in page.read()
    finally:
        shown.stop()
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(shown.url, timeout=5.0)
    assert client.status == "running"  # it is the caller's


async def threads_of_a_page(url: str) -> set[str]:
    """The names of all threads while the websocket of a page is open."""
    connection = await websocket_connect(url.replace("http", "ws", 1).replace("/?", "/ws?"))
    assert await asyncio.wait_for(connection.read_message(), 30.0)
    names = {thread.name for thread in threading.enumerate()}
    connection.close()
    while await asyncio.wait_for(connection.read_message(), 30.0) is not None:
        pass
    return names


def test_stop_ends_the_threads_of_every_page(finished: Path, client: Client) -> None:
    before = set(threading.enumerate())
    shown = atlas.open(finished).atlas.explore(client=client)
    try:
        names = asyncio.run(threads_of_a_page(shown.url))
        assert {"atlas-page", "atlas-painter", "atlas-patches"} <= names
    finally:
        shown.stop()
    left = {thread.name for thread in set(threading.enumerate()) - before}
    assert not {name for name in left if name.startswith("atlas-")}


@pytest.mark.slow
def test_a_notebook_shows_the_page_whose_server_answers_and_stop_leaves_no_process(finished: Path) -> None:
    cells = (
        "import atlas, multiprocessing, urllib.request",
        f"shown = atlas.open({str(finished)!r}).atlas.explore(workers=1)",
        "shown",
        "print(urllib.request.urlopen(shown.url).status)",
        "shown.stop()\nprint(len(multiprocessing.active_children()))",
    )
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    nbclient.NotebookClient(book, timeout=300, resources={"metadata": {"path": str(finished.parent)}}).execute()
    outputs = [cell.outputs for cell in book.cells]
    assert '<iframe src="http://127.0.0.1:' in outputs[2][0]["data"]["text/html"]
    assert [output[0]["text"].strip() for output in outputs[3:]] == ["200", "0"]


def in_session(session: int) -> list[int]:
    """The processes of a session that are still there, zombies aside."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, of = stat.read_text().rpartition(")")[2].split()[:4]
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(of) == session and state != "Z":
            found.append(int(stat.parent.name))
    return found


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning:playwright")
def test_ctrl_c_ends_the_explorer_and_leaves_no_process(finished: Path) -> None:
    program = [sys.executable, "-c", COMMAND, "explore", str(finished), "--no-browser", "--workers", "2"]
    with subprocess.Popen(
        program,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        cwd=finished.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as running:
        try:
            assert running.stdout is not None
            url = running.stdout.readline().strip()
            assert url.startswith("http://127.0.0.1:")
            with started() as browser, opened(browser, url) as tab:
                tab.until(lambda: "cells/s" in tab.text() and " 0 cells/s" not in tab.text(), 120.0)
                os.killpg(running.pid, signal.SIGINT)  # as a terminal does
                _, said = running.communicate(timeout=120.0)
        finally:
            running.kill()
    assert running.returncode == 130
    assert said.splitlines()[-1] == "ended" and "Traceback" not in said
    assert waited(lambda: not in_session(running.pid), 10.0)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # Tornado leaves such sockets open
def test_an_address_that_cannot_be_used_is_refused_before_anything_is_compiled(finished: Path, client: Client) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        for given, says in (
            ({"port": port}, f"host 127.0.0.1, port {port}: cannot be used: "),
            ({"host": "no-such-host.invalid"}, "host no-such-host.invalid, port 0: cannot be used: "),
            ({"port": 65536}, "port: found 65536, must be 0 to 65535"),
            ({"port": -1}, "port: found -1, must be"),
        ):
            with pytest.raises(InputError, match=f"^{says}"):
                explore(str(finished), client=client, prepare=lambda: pytest.fail("compiled"), **given)  # type: ignore[arg-type]


@pytest.mark.parametrize("tolerance", [float("nan"), float("inf"), -1.0])
def test_a_tolerance_that_is_none_is_refused(finished: Path, tolerance: float) -> None:
    with pytest.raises(InputError, match="tolerance: found"):
        explore(str(finished), tolerance=tolerance, prepare=lambda: pytest.fail("kernels are compiled"))


@pytest.mark.parametrize("options", [{"tolerance": 0}, {"tolerance": 0.0}, {"workers": 0}])
def test_zero_is_not_taken_for_the_default_but_refused(finished: Path, options: dict[str, float]) -> None:
    (name,) = options
    with pytest.raises(InputError, match=f"{name}: found 0"):
        atlas.open(finished).atlas.explore(**options)  # type: ignore[arg-type]
