"""What the service itself costs: time a tile, memory by the number of tiles, and the order of tiles on a large cluster.

overhead  An atlas of N tiles of one cell is run through a scheduler of its own process, with two workers that give a
          receipt and do nothing else: all that is left is the service. Growth of memory is from before the run to the
          highest under way. What grows in the scheduler is Dask's cache of the last 100,000 names of tasks.
store     The same with real tiles of one cell, solved and written.
order     256 workers are simulated on the costs of a real atlas, each of its cells split into smaller ones, since it
          has too few for so many: share of the workers' time spent solving, for each order of tiles. The bound is that
          of the costliest tile. The plane is taken as it is and turned, since the order by rows depends on which
          corner is costly. "probe" solves some cells of each tile beforehand, and pays for it.

Usage: .venv/bin/python -m scripts.bench_scale [--tiles N ...] [--real N] [--atlas STORE] [--workers W]
"""

import argparse
import heapq
import math
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np

import atlas
from atlas.overview.pyramid import Pyramid
from atlas.service import dispatch as fanout
from atlas.service.schedule import Order
from atlas.service.summary import Summary
from atlas.task.task import Job, Receipt

SIZES = (100, 1000, 10_000, 50_000)
ROOT = Path(__file__).parent.parent
SPLIT = 4
"""Along each axis, into how many cells one cell of the real atlas is split."""
SIDES = (16, 10, 8)
"""Cells along each side of a tile, after the split."""
PROBED = 4
"""Cells of each tile that the probe solves."""


@dataclass(frozen=True)
class Scale:
    """What a run of some size took: its summary, and the growth of two processes in bytes."""

    summary: Summary
    coordinator: int
    scheduler: int

    def __str__(self) -> str:
        each = 1e3 * self.summary.seconds / self.summary.tiles
        return f"{self.summary.tiles:>6} {each:>8.2f} {self.coordinator / 1e6:>16.1f} {self.scheduler / 1e6:>14.1f}"


def nothing(act: Callable[[Job], Receipt], job: Job) -> fanout.Done[Receipt]:
    """A worker's work without the work; it stores nothing, so that there is nothing to make overviews of."""
    return fanout.Done("", Receipt(job.index, 1, {"periodic": 1}, {}, 0.0, 0.0, 1, 0))


def no_overview(*_: object) -> None:
    """In place of making an overview."""


def measure(tiles: int, work: Callable[..., object] = fanout.work) -> Scale:
    """Run an atlas of about that many tiles of one cell."""
    side = math.isqrt(tiles)
    spec = atlas.Spec(
        "two-mass",
        axes={"omega": {"start": 2.0, "stop": 4.0, "num": side}, "b": {"start": 0.2, "stop": 0.5, "num": side}},
        solve={"exponents": "none", "max_periods": 50},
        store={"tile": (1, 1)},
    )
    with (
        tempfile.TemporaryDirectory(prefix="bench-scale-") as folder,
        _cluster(Path(folder)) as (address, scheduler),
        mock.patch.object(fanout, "work", work),
        mock.patch.object(Pyramid, "make", no_overview if work is nothing else Pyramid.make),
        _growth(os.getpid()) as ours,
        _growth(scheduler) as theirs,
    ):
        summary = atlas.run(spec, Path(folder) / "out.zarr", options=atlas.RunOptions(scheduler=address))
    return Scale(summary, ours[0], theirs[0])


@contextmanager
def _cluster(folder: Path) -> Iterator[tuple[str, int]]:
    """A scheduler and two workers of one thread, each a process: address, and the scheduler's process id."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    common = {"env": env, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    serve = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"]
    labour = ["distributed.cli.dask_worker", f"tcp://127.0.0.1:{port}", "--nthreads", "1", "--no-nanny"]
    labour += ["--no-dashboard", "--local-directory", str(folder)]
    processes = [subprocess.Popen([sys.executable, "-m", *args], **common) for args in (serve, labour, labour)]  # type: ignore[call-overload]
    try:
        _wait_for(port)
        yield f"tcp://127.0.0.1:{port}", processes[0].pid
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _wait_for(port: str) -> None:
    from distributed import Client

    with Client(f"tcp://127.0.0.1:{port}", timeout=60, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)


@contextmanager
def _growth(pid: int) -> Iterator[list[int]]:
    """By how many bytes of resident memory a process grows, at its highest, while the block runs."""
    grown, stop = [0], threading.Event()
    before = _resident(pid)

    def look() -> None:
        while not stop.wait(0.05):
            grown[0] = max(grown[0], _resident(pid) - before)

    thread = threading.Thread(target=look)
    thread.start()
    try:
        yield grown
    finally:
        stop.set()
        thread.join()


def _resident(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def costs_of(store: Path) -> np.ndarray:
    """Cost of every cell of an atlas, in impacts and periods, each cell split into smaller ones of its cost."""
    ds = atlas.open(store)
    impacts = np.nan_to_num(ds.impacts_per_period.values, nan=10.0)
    cells = ds.periods_used.values * (0.3 + impacts) + 20.0
    return np.kron(cells, np.ones((SPLIT, SPLIT)))


def tile_costs(cells: np.ndarray, side: int) -> np.ndarray:
    """Costs of tiles of that side."""
    rows, columns = (np.arange(n) // side for n in cells.shape)
    costs = np.zeros((rows[-1] + 1, columns[-1] + 1))
    np.add.at(costs, (rows[:, None], columns[None]), cells)
    return costs


def simulate(
    costs: np.ndarray,
    order: Iterable[tuple[int, ...]],
    workers: int,
    note: Callable[[tuple[int, ...], float], None] = lambda *_: None,
) -> float:
    """Time to the end of the last tile; the window is that of fanout.py, and a free worker takes what is queued."""
    waiting, queue = iter(order), deque[tuple[int, ...]]()
    busy: list[tuple[float, tuple[int, ...]]] = []
    now = 0.0
    while True:
        for _, index in zip(range(fanout.IN_FLIGHT * workers - len(queue) - len(busy)), waiting, strict=False):
            queue.append(index)
        while queue and len(busy) < workers:
            index = queue.popleft()
            heapq.heappush(busy, (now + float(costs[index]), index))
        if not busy:
            return now
        now, index = heapq.heappop(busy)
        note(index, float(costs[index]))


def efficiencies(cells: np.ndarray, side: int, workers: int) -> dict[str, float]:
    """Share of the workers' time spent solving, for each order of the tiles."""
    costs = tile_costs(cells, side)
    ideal = costs.sum() / workers
    learned = Order(np.ones(costs.shape, dtype=bool))
    guess = _probed(cells, costs.shape, side)
    return {
        "rows": ideal / simulate(costs, np.ndindex(costs.shape), workers),
        "lattice": ideal / simulate(costs, learned, workers, learned.note),
        "probe": ideal / (simulate(costs, _descending(guess), workers) + guess.sum() / workers),
        "oracle": ideal / simulate(costs, _descending(costs), workers),
        "bound": min(1.0, ideal / costs.max()),
    }


def _probed(cells: np.ndarray, shape: tuple[int, ...], side: int) -> np.ndarray:
    draw = np.random.default_rng(1)
    guess = np.zeros(shape)
    for _ in range(PROBED):
        places = (
            np.minimum(side * np.arange(n).reshape(along) + draw.integers(0, side, shape), top - 1)
            for n, top, along in zip(shape, cells.shape, ((-1, 1), (1, -1)), strict=True)
        )
        guess += cells[tuple(places)]
    return guess


def _descending(costs: np.ndarray) -> Iterator[tuple[int, ...]]:
    for place in np.argsort(-costs, axis=None, kind="stable"):
        yield tuple(map(int, np.unravel_index(place, costs.shape)))


def main(argv: list[str] | None = None) -> int:
    """Print the three tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tiles", type=int, nargs="*", default=SIZES)
    parser.add_argument("--real", type=int, default=1000, help="tiles of the run that solves and writes")
    parser.add_argument("--atlas", type=Path, help="a store whose costs are taken; default: none, no simulation")
    parser.add_argument("--workers", type=int, default=256)
    given = parser.parse_args(argv)
    if given.tiles:
        measure(64, nothing)  # what is imported at first is no part of it
        print(" tiles  ms/tile  coordinator, MB  scheduler, MB", flush=True)
    for tiles in given.tiles:
        print(measure(tiles, nothing), flush=True)
    if given.real:
        made = measure(given.real).summary
        wall = 1e3 * made.seconds * made.workers / made.tiles
        solve, write = (1e3 * s / made.tiles for s in (made.solve_seconds, made.write_seconds))
        print(f"real tiles: {wall:.1f} ms of a worker each; {solve:.1f} solving, {write:.1f} writing", flush=True)
    if given.atlas:
        started = time.perf_counter()
        cells = costs_of(given.atlas)
        turned = {"as it is": cells, "upside down": cells[::-1], "transposed": cells.T, "both": cells.T[::-1]}
        print(f"order of tiles, {given.workers} workers, {cells.size} cells: share of the time spent solving")
        for side in SIDES:
            for name, plane in turned.items():
                shares = efficiencies(plane, side, given.workers)
                shown = "  ".join(f"{order} {100 * share:3.0f} %" for order, share in shares.items())
                print(f"tiles of {side:>2} x {side:<2} {name:<12} {shown}", flush=True)
        print(f"(simulated in {time.perf_counter() - started:.0f} s)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
