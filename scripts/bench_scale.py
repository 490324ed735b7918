"""What the service costs on a thousand workers: one atlas of 10^10 cells, through a real scheduler.

cluster   The atlas is run on pretended workers (``scripts.fake_cluster``): real Dask workers whose tiles are sleep.
          Share of their time that they are busy; processor time of the coordinator, from the first tile on, and of the
          scheduler, a tile; their most memory. Each is a process of its own. Several numbers of workers show the law:
          they are busy as long as neither process needs more than a tile's time divided by their number.
store     The store lies on a server of objects whose every request takes 25 ms. Its tiles up to half, and then all,
          are put there in the form in which workers leave them: seconds and requests of a status of it, of a second
          look at it, of a resume up to the first tile handed out, of the end of its run.

What is replaced is printed. Nothing is in the path of the coordinator.

Usage: python -m scripts.bench_scale [--workers N ...] [--seconds S] [--side CELLS] [--no-store] [--keep]
"""

import argparse
import json
import math
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import psutil

import atlas
from atlas.platform import peak_memory
from atlas.service.plan import make_plan
from atlas.service.progress import Progress
from atlas.service.status import StatusReader
from atlas.store.create import create_store
from atlas.store.object_backend import open_backend
from atlas.store.store import AtlasStore, chunk_key, open_store
from atlas.store.tiles import write_tile
from scripts.measured import parsed, print_table
from tests.support import ROOT
from tests.support.fake_object_store import FakeObjectStore, object_store
from workers.results import PERIODIC, REGIME, empty_results

TILE = 512
SIDE = 196 * TILE
"""Cells along each side: 1.007e10 in all, in whole tiles."""
ROUNDS = 40
"""Tiles of each worker."""
WORKERS = (125, 250, 500, 1000)
PER_PROCESS = 500
"""Pretended workers in one process: more, and its interpreter is what is measured."""
REPLACED = """\
replaced: what a worker does for a run and for a tile (it sleeps, solves nothing, writes marks of overviews alone);
many workers share a process; scheduler, coordinator, workers and the server of objects share this machine"""


def spec_of(side: int) -> atlas.Spec:
    """The plane that is run."""
    axes = {"omega": {"start": 2.0, "stop": 4.0, "num": side}, "b": {"start": 0.2, "stop": 0.5, "num": side}}
    return atlas.Spec("two-mass", axes=axes, solve={"exponents": "largest"}, store={"tile": (TILE, TILE)})


def side_for(workers: int) -> int:
    """Cells along each side of the plane that gives each worker ROUNDS tiles, 10^10 cells at most."""
    return min(SIDE, TILE * math.isqrt(ROUNDS * workers))


@dataclass(frozen=True)
class Load:
    """What a process took: processor seconds, and its most resident bytes."""

    seconds: float
    peak_bytes: int

    @classmethod
    def of(cls, pid: int) -> "Load":
        """Of a process so far; of its memory now."""
        process = psutil.Process(pid)
        times = process.cpu_times()
        return cls(times.user + times.system, process.memory_info().rss)


@dataclass(frozen=True)
class Cluster:
    """A scheduler, and how to reach it."""

    address: str
    pid: int


@contextmanager
def cluster(folder: Path, workers: int, seconds: float) -> Iterator[Cluster]:
    """A scheduler and its pretended workers, once all of them are there."""
    from distributed import Client

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    scheduler = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", address.rpartition(":")[2]]
    commands = [[*scheduler, "--no-dashboard"]]
    for first in range(0, workers, PER_PROCESS):
        here = min(PER_PROCESS, workers - first)
        commands.append(["scripts.fake_cluster", address, str(here), str(seconds), str(folder), str(first)])
    with ExitStack() as stack:
        started = [stack.enter_context(_process(command, folder)) for command in commands]
        with Client(address, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=60 + workers / 5)
        yield Cluster(address, started[0].pid)


@contextmanager
def _process(command: list[str], folder: Path, out: int | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """A module of Python in a process of its own, killed afterwards; it prints into the folder's log, or ``out``."""
    env = os.environ | {"PYTHONPATH": str(ROOT), "DASK_LOGGING__DISTRIBUTED": "error"}
    with (folder / "log").open("ab") as log:
        process = subprocess.Popen([sys.executable, "-m", *command], env=env, stdout=out or log, stderr=log)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def coordinate(store: str, address: str, side: int) -> None:
    """Run the atlas in this process; a line of JSON when the first tiles are out, and one at the end."""
    begin, before, first = time.perf_counter(), 0.0, True

    def look(progress: Progress) -> None:
        nonlocal before, first
        if progress.stage == "solving" and first:
            before, first = time.process_time(), False
            print(json.dumps({"first": time.perf_counter() - begin}), flush=True)

    options = atlas.RunOptions(scheduler=address, on_progress=look)
    summary = atlas.run(spec_of(side), store, options=options)
    made = {
        "workers": summary.workers,
        "tiles": summary.tiles_solved,
        "busy": summary.efficiency,
        "solving": summary.solve_seconds,
        "seconds": time.perf_counter() - begin,
        "processor": time.process_time() - before,
        "peak": peak_memory(),
    }
    print(json.dumps(made), flush=True)


@contextmanager
def coordinator(found: Cluster, store: str, side: int, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A coordinator in a process of its own; its lines come from its stdout."""
    command = ["scripts.bench_scale", "coordinate", store, found.address, str(side)]
    with _process(command, folder, subprocess.PIPE) as process:
        yield process


def line_of(process: subprocess.Popen[bytes], folder: Path) -> dict[str, Any]:
    """The next line that a coordinator prints."""
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line:
        raise RuntimeError((folder / "log").read_text()[-2000:])
    found: dict[str, Any] = json.loads(line)
    return found


def run_on(found: Cluster, store: str, side: int, folder: Path) -> tuple[dict[str, Any], Load]:
    """What a coordinator reports of a whole run, and what the scheduler took for it."""
    before = Load.of(found.pid)
    with coordinator(found, store, side, folder) as process:
        made = line_of(process, folder)
        if "first" in made:
            made = line_of(process, folder)
    after = Load.of(found.pid)
    return made, Load(after.seconds - before.seconds, after.peak_bytes)


def row(made: dict[str, Any], scheduler: Load) -> list[str]:
    """A row of the table of the cluster."""
    per_tile = 1e3 / made["tiles"]
    return [
        str(made["workers"]),
        f"{made['tiles']:,}",
        f"{100 * made['busy']:.1f} %",
        f"{per_tile * made['processor']:.2f}",
        f"{per_tile * scheduler.seconds:.2f}",
        f"{made['peak'] / 1e6:.0f}",
        f"{scheduler.peak_bytes / 1e6:.0f}",
    ]


HEAD = (
    "workers",
    "tiles",
    "workers busy",
    "coordinator, ms per tile",
    "scheduler, ms per tile",
    "coordinator, MB",
    "scheduler, MB",
)


def left_by_workers(handle: AtlasStore, indices: Iterable[tuple[int, ...]]) -> dict[str, bytes]:
    """The objects by which tiles are done, as workers leave them: regimes, all those of the first tile."""
    first = (0,) * len(handle.spec.shape)
    states = handle.spec.extra_sizes
    arrays = empty_results(handle.spec.variables, handle.tiling.at(first).shape, states)
    arrays[REGIME.name][...] = PERIODIC
    write_tile(handle, first, arrays)
    data = handle.backend.get(chunk_key(handle.regime, first))
    assert data is not None
    return {chunk_key(handle.regime, index): data for index in indices}


class Counted:
    """Seconds, and the requests of a server, from one call to the next."""

    def __init__(self, server: FakeObjectStore) -> None:
        self._server, self._begin = server, time.perf_counter()
        server.forget()

    def columns(self) -> tuple[str, str]:
        """The seconds and the requests until now."""
        return f"{time.perf_counter() - self._begin:.2f}", f"{self._server.counts.total():,}"


def measure_store(side: int, delay: float, folder: Path) -> list[tuple[str, str, str]]:
    """What it takes to look at and to resume an atlas on a slow store, half done and finished: seconds, requests."""
    rows: list[tuple[str, str, str]] = []
    with object_store() as server, mock.patch.dict(os.environ, server.environment):
        url = "s3://scale/plane.zarr"
        plan = make_plan(spec_of(side), 1000)
        handle = create_store(open_backend(url), spec_of(side), plan.tiling.tile)
        tiles = [tile.index for tile in plan.tiling.tiles()]
        half, bucket = tiles[: len(tiles) // 2], "scale/plane.zarr/"
        objects = {bucket + key: data for key, data in left_by_workers(handle, tiles).items()}
        done = {bucket + chunk_key(handle.regime, index) for index in half}
        server.put({key: data for key, data in objects.items() if key in done})
        server.delay(delay)
        print(f"store: {plan.tiling.count} tiles, {1e3 * delay:.0f} ms a request, half of them done", flush=True)
        with cluster(folder, 50, 1000.0) as found:
            for lacking in (" that lacks its overviews' metadata", ""):
                counted = Counted(server)
                with coordinator(found, url, side, folder) as process:
                    line_of(process, folder)
                    rows.append((f"resume of a half-done run{lacking}, to the first tile", *counted.columns()))
                    time.sleep(3.0)
                    if not lacking:
                        rows.append(_status(url, server, "a running atlas", len(half)))
        server.put(objects)
        with cluster(folder, 50, 0.0) as found:
            counted = Counted(server)
            made, _ = run_on(found, url, side, folder)
            ended = "end of a run whose tiles are all done, after a kill before that"
            rows.append((ended, *counted.columns()))
            print(f"{ended}: {made['processor']:.1f} s of the coordinator, {made['peak'] / 1e6:.0f} MB", flush=True)
        rows.append(_status(url, server, "a finished atlas", len(tiles)))
    return rows


def _status(url: str, server: FakeObjectStore, whose: str, tiles: int) -> tuple[str, str, str]:
    """What a first and a second status of an atlas take, of which so many tiles are done."""
    counted = Counted(server)
    census = StatusReader(open_store(open_backend(url)))
    looks = []
    for settled in (True, False):
        counted = counted if settled else Counted(server)
        found = census.read(settled=settled)
        assert found.tiles_done == tiles
        looks.append(counted.columns())
    seconds, requests = (", ".join(column) for column in zip(*looks, strict=True))
    return f"status of {whose}, first and next", seconds, requests


def main(argv: list[str] | None = None) -> int:
    """Print both parts."""
    given = sys.argv[1:] if argv is None else argv
    if given[:1] == ["coordinate"]:
        store, address, side = given[1:]
        coordinate(store, address, int(side))
        return 0
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workers", type=int, nargs="*", default=WORKERS)
    parser.add_argument("--seconds", type=float, default=3.0, help="of a tile, on average")
    parser.add_argument("--side", type=int, default=SIDE, help="cells along each side of the plane of the second part")
    parser.add_argument("--delay", type=float, default=0.025, help="seconds of a request")
    parser.add_argument("--no-store", action="store_true", help="leave out the second part")
    asked = parsed(parser, given)
    print(REPLACED, flush=True)
    rows = []
    for workers in asked.workers:
        with tempfile.TemporaryDirectory(prefix="bench-scale-") as name, object_store() as server:
            server.delay(asked.delay)
            with mock.patch.dict(os.environ, server.environment), cluster(Path(name), workers, asked.seconds) as found:
                rows.append(row(*run_on(found, "s3://scale/plane.zarr", side_for(workers), Path(name))))
    if rows:
        print_table("scale-workers", HEAD, rows, asked.keep)
    if not asked.no_store:
        with tempfile.TemporaryDirectory(prefix="bench-scale-") as name:
            print_table(
                "scale-store", ("", "s", "requests"), measure_store(asked.side, asked.delay, Path(name)), asked.keep
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
