"""Workers and schedulers that die while somebody explores: the page's line says so, and the work goes on."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from atlas.explore.explorer import Explorer
from atlas.explore.subject import subject_of
from atlas.explore.text import progress
from atlas.explore.viewport import Viewport
from atlas.service.cluster import connect_to_scheduler, local_cluster
from tests.explore.test_solving import waited
from workers.results import PENDING, REGIME

pytestmark = pytest.mark.slow

WINDOW = (3.2, 4.2), (0.3, 0.5)
"""Cells that are cheap: orbits of period 1, and motion without impact."""


@contextmanager
def process(*words: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process of Dask's, ended by force."""
    environment = os.environ | {"PYTHONPATH": os.getcwd()}
    quiet = subprocess.DEVNULL
    made = subprocess.Popen([sys.executable, "-m", *words], env=environment, stdout=quiet, stderr=quiet)
    try:
        yield made
    finally:
        made.kill()
        made.wait()


def scheduler(port: int) -> partial[object]:
    """A scheduler at this port."""
    return partial(
        process, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"
    )


def worker(port: int) -> partial[object]:
    """A worker of it."""
    return partial(process, "distributed.cli.dask_worker", f"tcp://127.0.0.1:{port}", "--no-nanny", "--nthreads", "1")


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def line(explorer: Explorer) -> str:
    """What the page says of the work."""
    state = explorer.patches.state
    return f"{state.trouble} · {progress(state, explorer.patches.n_remaining('test'), [])}"


def begun(explorer: Explorer, pixels: int) -> Viewport:
    """Have a view solved, and wait for the first of its tiles."""
    sight = explorer.subject.viewport(*WINDOW, (pixels, pixels))
    explorer.subscribe("test", lambda *_: None)
    count = explorer.request_tiles("test", explorer.subject.plane, sight, range(3, -1, -1))
    assert waited(lambda: explorer.patches.n_remaining("test") < count, 120.0)
    return sight


def all_solved(explorer: Explorer, sight: Viewport) -> bool:
    """Whether the view is solved, once nothing of it is left."""
    assert waited(lambda: explorer.patches.n_remaining("test") == 0, 240.0), line(explorer)
    regime = explorer.known.visible_cells(explorer.subject.plane, sight, []).ds[REGIME.name].values
    return not explorer.failures and not np.any(regime == PENDING)


def test_a_worker_that_is_killed_is_missed_and_another_goes_on(finished: Path) -> None:
    port = free_port()
    with scheduler(port)(), worker(port)() as first:  # type: ignore[attr-defined]
        assert waited(lambda: reachable(port))
        explorer = Explorer(subject_of(str(finished)), partial(connect_to_scheduler, f"tcp://127.0.0.1:{port}"))
        try:
            sight = begun(explorer, 150)
            first.kill()
            assert waited(lambda: "no workers connected: waiting for one to join" in line(explorer))
            with worker(port)():  # type: ignore[attr-defined]
                assert all_solved(explorer, sight)
                assert explorer.patches.state.trouble == ""
        finally:
            explorer.stop()


def test_a_scheduler_that_is_killed_is_missed_and_called_again(finished: Path) -> None:
    port = free_port()
    explorer = None
    try:
        with scheduler(port)(), worker(port)():  # type: ignore[attr-defined]
            assert waited(lambda: reachable(port))
            explorer = Explorer(subject_of(str(finished)), partial(connect_to_scheduler, f"tcp://127.0.0.1:{port}"))
            sight = begun(explorer, 150)
        assert waited(lambda: "trying again" in line(explorer))  # type: ignore[arg-type]
        with scheduler(port)(), worker(port)():  # type: ignore[attr-defined]
            assert all_solved(explorer, sight)
    finally:
        if explorer is not None:
            explorer.stop()


def test_a_local_worker_that_is_killed_is_started_anew(finished: Path) -> None:
    explorer = Explorer(subject_of(str(finished)), partial(local_cluster, 1))
    try:
        sight = begun(explorer, 150)
        for child in children():
            os.kill(child, signal.SIGKILL)
        assert all_solved(explorer, sight)
    finally:
        explorer.stop()


def children() -> list[int]:
    """The worker processes of this one."""
    import multiprocessing

    return [child.pid for child in multiprocessing.active_children() if child.pid is not None]


def reachable(port: int) -> bool:
    """Whether something answers at this port."""
    with socket.socket() as trial:
        time.sleep(0.1)
        return trial.connect_ex(("127.0.0.1", port)) == 0
