"""Pretended workers: real Dask workers, each with a connection of its own, whose tiles are sleep.

Of what a worker does, the tile is replaced: it checks nothing, sleeps a drawn time and returns a report of the right
form; of a chunk of the overviews it puts the mark that it is there. Nothing is solved and nothing else is written.
All else is Dask's and the project's own.

Usage: python -m scripts.fake_cluster ADDRESS WORKERS SECONDS FOLDER [SEED]
"""

import asyncio
import random
import resource
import sys
import time
from typing import Any

import dask
from distributed import Worker, get_worker

from atlas.overview.pyramid import level_key
from atlas.service import attempts
from atlas.service.attempts import AttemptOutcome
from atlas.store.object_backend import open_backend
from atlas.store.record_format import CELLS, WIDTH
from atlas.task.tile_job import DerivedReport, RunJob, TileReport
from workers.results import PENDING, PERIODIC, REGIME

TOGETHER = 50
"""Workers that connect at once."""
SPREAD = 0.4
"""Standard deviation of the logarithm of a tile's time."""
CELLS_OF_TILE = 512 * 512


def pretend(seconds: float, draw: random.Random) -> None:
    """Replace what a worker does: a tile is a sleep of ``seconds`` on average, which takes no thread."""
    row = [0.0] * WIDTH
    row[CELLS.start + PERIODIC - PENDING] = CELLS_OF_TILE

    async def sleep(_act: object, job: RunJob) -> AttemptOutcome[Any]:
        worker = get_worker().address
        if job.level:
            await asyncio.to_thread(open_backend(job.store_ref.store).put, level_key(job.level, REGIME, job.index), b"")
            return AttemptOutcome(worker, None, DerivedReport(job.index))
        begin = time.perf_counter()
        await asyncio.sleep(seconds * draw.lognormvariate(-(SPREAD**2) / 2, SPREAD))
        solved, counts = time.perf_counter() - begin, {"periodic": CELLS_OF_TILE}
        report = TileReport(job.index, CELLS_OF_TILE, counts, {}, solved, 0.0, 1, 0, record=tuple(row))
        return AttemptOutcome(worker, None, report, solved)

    attempts.run_attempt = sleep  # type: ignore[assignment]


async def work(address: str, workers: int, folder: str) -> None:
    """Start the workers, and serve until they are told to end."""
    serving: list[Worker] = []
    for first in range(0, workers, TOGETHER):
        some = [
            Worker(address, nthreads=1, memory_limit="2GB", dashboard=False, local_directory=folder)
            for _ in range(min(TOGETHER, workers - first))
        ]
        serving += await asyncio.gather(*some)
    await asyncio.gather(*(worker.finished() for worker in serving))


def main(argv: list[str]) -> int:
    """See the module."""
    address, workers, seconds, folder, *seed = argv
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    dask.config.set(
        {
            "distributed.worker.profile.enabled": False,
            "distributed.worker.http.routes": [],
            "distributed.admin.system-monitor.interval": "60s",
            **{f"distributed.worker.memory.{limit}": False for limit in ("target", "spill", "pause", "terminate")},
        }
    )
    pretend(float(seconds), random.Random(int(seed[0]) if seed else 1))
    asyncio.run(work(address, int(workers), folder))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
