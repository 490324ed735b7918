"""Run an atlas: lease and create or resume its store, solve the unfinished tiles on workers, and add up their
reports.
"""

import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from atlas.argument_checks import validate_type
from atlas.errors import InputError, RunError
from atlas.formatting import plural
from atlas.overview.builder import OverviewBuilder
from atlas.service.dispatch import MIN_WORKER_MEMORY, WorkerStatus
from atlas.service.options import DEFAULTS, RunOptions, with_fields
from atlas.service.plan import Plan, check_free_space, plan_of_run
from atlas.service.progress import Progress, prepare_kernels
from atlas.service.store_call import StoreCall, store_call
from atlas.service.summary import RunSummary, TileFailure
from atlas.service.tile_order import TileOrder
from atlas.service.worker_pool import WorkerPool
from atlas.spec.spec import Spec
from atlas.store.create import check_run, create_store
from atlas.store.groups import ATTRACTORS, group_attributes
from atlas.store.object_backend import Given
from atlas.store.origin import Origin
from atlas.store.store import AtlasStore, done_mask, find_store
from atlas.store.tile_records import RunTileRecords, TileRecords
from atlas.store.tiling import Index
from atlas.task.label_basins import labelling_bytes
from atlas.task.solve_block import kernels_of
from atlas.task.tile_job import LABELS, DerivedReport, RunJob, TileReport, execute_job, run_tile_job

if TYPE_CHECKING:
    from distributed import Client


SMALL_TILE_CELLS, BYTES_PER_CELL = 4096, 750
"""Number of cells of a tile that fits into any worker's memory, and bytes of memory for each further cell.

The further cells of a tile of 512 x 512 cells take 200 MB.
"""


@with_fields
def run(
    spec: Spec,
    store: Given,
    client: "Client | None" = None,
    options: RunOptions = DEFAULTS,
    **fields: Any,
) -> RunSummary:
    """Compute an atlas into a store, or complete one that an earlier run of the same spec began.

    ``fields`` are those of ``RunOptions``, as in ``run(spec, "plane.zarr", workers=4)``; they replace those of
    ``options``. The tiles are solved on ``client``, which stays open. Without it the workers are those of the options'
    scheduler, else of the Dask client that the caller has open, else of a local cluster. In a notebook a bar shows the
    progress, unless there is an ``on_progress``. The store is a path, a URL (with ``storage_options``), or an obstore
    store. If a server stops responding, the run waits ``patience`` seconds for it.

    Raise InputError, before anything is written, for input that cannot be run, or if another run holds the lease of the
    store. Raise RunError if the cluster is lost, the store is full, or the run is cancelled. Raise NetworkError if a
    server does not respond. A tile that raises does not stop the others: see ``RunSummary.failures``. After Ctrl-C the
    same call resumes.

    ``client`` is a Dask client here:

    >>> import atlas
    >>> spec = atlas.Spec("two-mass", {"omega": [3.0, 3.5], "b": [0.1, 0.2]}, solve={"tolerance": 0.1, "survival": 0})
    >>> summary = atlas.run(spec, "small.zarr", client)
    >>> summary.cells_solved, summary.failures
    (4, ())
    """
    validate_type("spec", spec, Spec, "an atlas.Spec")
    with store_call(store, client, options, fields) as call:
        return complete(spec, call)


def complete(spec: Spec, call: StoreCall, origin: Origin | None = None) -> RunSummary:
    """Create or complete the store of a call to ``run``, and return the summary of the run.

    spec    spec of the atlas
    call    the call, with its store, options and client
    origin  store whose cells are reused; None if all cells are solved
    """
    options, tile = call.options, call.options.tile
    handle = find_store(call.backend)  # reads only, so that bad input leaves no trace
    check_run(call.backend, spec, handle, origin)
    call.connect()
    plan = plan_of_run(spec, call.backend, handle, call.threads, tile)
    call.acquire_lease()
    before = handle  # before the lease another run may have created or replaced the store
    handle = find_store(call.backend) if before is None else before.with_backend(call.backend).current()
    if handle is None or before is None or handle.run_id != before.run_id:
        check_run(call.backend, spec, handle, origin)
    if handle is None:
        options.report(Progress("creating the store"))
        handle = create_store(call.backend, spec, plan.tiling.tile, origin)
    pool = WorkerPool(call, handle, execute_job, kernels_of(handle.spec), memory_of(math.prod(handle.tile)))
    run = _Run(handle, pool, replace(plan, tiling=handle.tiling))
    if tile is not None:
        run.do_alone(tile)
        return run.totals
    run.begin()
    if run.needs_workers or (call.client is not None and run.overviews):
        run.hand_out()
    run.finish()
    return run.totals


class _Run:
    """A run on a leased store: solves its unfinished tiles on the workers, and then writes overviews and records."""

    def __init__(self, handle: AtlasStore, pool: WorkerPool[RunJob, TileReport | DerivedReport], plan: Plan) -> None:
        self.handle, self.pool, self.plan, self.stage = handle, pool, plan, "solving"
        self.stored = TileRecords(handle, done_mask(handle))
        self.due, cells = ~self.stored.finished_mask, int(plan.tiling.sizes()[self.stored.finished_mask].sum())
        retried = handle.origin is not None and handle.origin.retry is not None
        n_tiles, n_done, store = plan.tiling.count, int(self.stored.finished_mask.sum()), str(handle.backend)
        self.totals = RunSummary(store, n_tiles, n_done, workers=plan.workers, retried=retried)
        self.totals.cells, self.totals.cells_done, self.start = plan.tiling.cells, cells, time.perf_counter()

    def begin(self) -> None:
        """Report the progress of the store, create the groups of its overviews, and write its table of tile records."""
        totals, stage = self.totals, "starting"
        if totals.tiles_done:
            stage = f"resuming: {totals.tiles_done} of {totals.tiles} tiles are done"
            if self.handle.backend.local is not None:
                check_free_space(self.plan, self.handle.backend.local, int(self.due.sum()))
        self.report(stage)
        self.overviews = OverviewBuilder(self.handle)
        self.records = RunTileRecords(self.handle, self.stored)
        self.records.write()

    @property
    def needs_workers(self) -> bool:
        """True if a tile is unfinished, or basins are not labelled yet."""
        return bool(self.due.any()) or (self.handle.spec.basins and group_attributes(self.handle, ATTRACTORS) is None)

    def do_alone(self, index: Index) -> None:
        """Solve one unfinished tile in this process. Its exceptions are not caught."""
        handle = self.handle
        if not self.due[index]:
            raise InputError(f"{handle.backend}: tile {index} is already finished")
        prepare_kernels(self.pool.call.options.report, *self.pool.kernels)
        self.begin()
        self.start = time.perf_counter()
        self.report(f"solving tile {index} in this process")
        report = run_tile_job(RunJob(index, self.pool.store_ref))
        self.records.add(report.index, report.record)
        self.records.write()
        self._add(report)

    def hand_out(self) -> None:
        """Send unfinished tiles to the workers and add up their reports, then build the overviews.

        Overviews are coarser copies of the atlas; they are built level by level.
        """
        handle, order, site = self.handle, TileOrder(self.due), self.pool.store_ref
        dispatcher = self.pool.dispatcher
        self.start = time.perf_counter()
        try:
            for outcome in self.pool.iter_outcomes((RunJob(index, site) for index in order), self._tick):
                if isinstance(outcome, TileReport):
                    order.record_cost(outcome.index, outcome.solve_seconds)
                    self.records.add(outcome.index, outcome.record)
                if not isinstance(outcome, DerivedReport):
                    self._add(outcome)
                self.report("solving")
            if handle.spec.basins:
                self.stage = "labelling the attractors"
                dispatcher.require_memory(dispatcher.memory + labelling_bytes(handle))
                self.records.clear_table()
                self._make([RunJob((), site, LABELS)])
            self.stage = "writing overviews"
            for level in self.overviews.levels:
                self._make([RunJob(index, site, level) for index in self.overviews.missing_chunks(level)])
        except KeyboardInterrupt:
            self.report("interrupted, cancelling the tiles in flight")
            self.records.write()
            raise

    def _add(self, outcome: TileReport | TileFailure) -> None:
        self.totals.add(outcome)
        self.totals.seconds = time.perf_counter() - self.start

    def _make(self, jobs: list[RunJob]) -> None:
        """Run jobs other than tiles, such as chunks of overviews, on the workers.

        A failed chunk of an overview is built again by ``finish``, whose exceptions are not caught.
        """
        for outcome in self.pool.iter_outcomes(jobs, self._tick):
            if isinstance(outcome, TileFailure) and jobs[0].level == LABELS:
                raise RunError(f"labelling the attractors failed: {outcome.message}; rerun the same command to resume")
            if isinstance(outcome, DerivedReport):
                for index, row in outcome.records:
                    self.records.add(index, row)
            failed = outcome.message if isinstance(outcome, TileFailure) else ""
            if fault := outcome.fault if isinstance(outcome, DerivedReport) else failed:
                note = f"overview {jobs[0].level}, chunk {outcome.index}: {fault}; this process builds it at the end"
                self.pool.call.options.report(replace(self._progress(self.stage), note=note))

    def _tick(self, workers: WorkerStatus) -> None:
        totals = self.totals
        self.pool.call.lease.check(lambda: self.report("waiting for the store: no response"))
        totals.workers, totals.refused = max(totals.workers, workers.threads), workers.excluded
        self.records.save()
        now = {name: getattr(totals, name) for name in ("cells", "cells_done", "cells_solved", "seconds")}
        state = {"workers": workers.threads, "trouble": workers.trouble, "holds": self.records.counts}
        self.pool.call.lease.set_progress(now | state)
        self.report(
            workers.trouble or (self.stage if workers.threads else "no workers connected: waiting for one to join")
        )

    def finish(self) -> None:
        """Build the overviews that no worker has built, and write the records of all tiles."""
        self.overviews.finish(lambda written, total: self.report(f"writing overviews: {written} of {total} parts"))
        self.records.finish(lambda n: self.report(f"counting the cells of {plural(n, 'tile')}"))

    def report(self, stage: str) -> None:
        """Report the progress of the run, with ``stage`` as its present activity."""
        self.pool.call.options.report(self._progress(stage))

    def _progress(self, stage: str) -> Progress:
        totals = self.totals
        names = ("tiles", "cells", "tiles_done", "cells_done", "cells_solved", "seconds", "counts")
        now: dict[str, Any] = {name: getattr(totals, name) for name in names}
        return Progress(stage, self.plan, **now, failures=len(totals.failures))


def memory_of(cells: int) -> int:
    """Return the bytes of memory that a worker needs for tiles of ``cells`` cells."""
    return MIN_WORKER_MEMORY + BYTES_PER_CELL * max(0, cells - SMALL_TILE_CELLS)
