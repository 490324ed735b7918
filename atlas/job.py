"""One tile's work, as it runs on a worker: solve it, write it, give a receipt."""

import time
from dataclasses import dataclass

import numpy as np

from atlas.errors import RunError
from atlas.plan import make_plan
from atlas.store import read_header, write_tile
from atlas.takeover import fill_tile
from workers import SOLVER_VERSION
from workers.results import REGIME, REGIMES


@dataclass(frozen=True)
class Job:
    """Which tile of which store. All that crosses the scheduler; ``run_job`` redoes it by hand."""

    index: tuple[int, ...]
    store: str
    run_id: str
    solver_version: int


@dataclass(frozen=True)
class Receipt:
    """What a finished tile reports.

    cells, counts, reasons   solved for it, in all and of each regime; failures by reason
    seconds, periods         spent on it; forcing periods simulated
    """

    index: tuple[int, ...]
    cells: int
    counts: dict[str, int]
    reasons: dict[str, int]
    seconds: float
    periods: int


def run_job(job: Job) -> Receipt:
    """Solve a tile and write it; RunError where this worker must not: another solver, or another store at the path."""
    begin = time.perf_counter()
    if job.solver_version != SOLVER_VERSION:
        raise RunError(f"this worker has solver version {SOLVER_VERSION}, the run needs {job.solver_version}")
    header = read_header(job.store)
    if header.run_id != job.run_id:
        raise RunError(f"{job.store} is not the store of run {job.run_id}; is the path the same on all hosts?")
    tile = make_plan(header.spec, workers=1, tile=header.tile).at(job.index)
    arrays, solved, reasons = fill_tile(header, tile.slices)
    write_tile(header, job.index, arrays)
    codes = arrays[REGIME.name][solved]
    counts = {regime.name: int(np.count_nonzero(codes == regime.code)) for regime in REGIMES}
    return Receipt(
        index=job.index,
        cells=codes.size,
        counts={name: count for name, count in counts.items() if count},
        reasons=dict(reasons),
        seconds=time.perf_counter() - begin,
        periods=int(arrays["periods_used"][solved].sum(dtype="int64")),
    )
