"""Running an atlas: plan, claim, create or resume, solve the tiles due, add up their receipts."""

import math
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Unpack

import numpy as np

from atlas.errors import InputError, RunError
from atlas.overview.pyramid import drop
from atlas.overview.upkeep import Overviews
from atlas.platform import processors
from atlas.service.cluster import connected, count_threads, leave_if_bootstrapping, local_cluster
from atlas.service.dispatch import Workers, tile_outcomes
from atlas.service.lease import Claim, claimed
from atlas.service.notebook import reporting
from atlas.service.options import DEFAULTS, RunFields, RunOptions
from atlas.service.plan import Plan, disk_shortage, make_plan
from atlas.service.progress import Progress, prepare_kernels
from atlas.service.schedule import Due
from atlas.service.summary import Summary, Totals
from atlas.spec.spec import Spec
from atlas.store.added import add_allowances, add_records
from atlas.store.location import Place, place_of, waiting
from atlas.store.making import remove_half_made
from atlas.store.records import Records, RunRecords
from atlas.store.schema import Origin
from atlas.store.sidecar import CLAIM, claim_token, notes_of
from atlas.store.store import Header, create, done_tiles, find, is_done
from atlas.store.tiles import finish_replacement, listed_tiles, read_tile
from atlas.task.basins import complete_basins
from atlas.task.retry import NEEDED, Retry
from atlas.task.solving import kernels_of
from atlas.task.task import Job, MadeChunk, Receipt
from atlas.text import plural

if TYPE_CHECKING:
    from distributed import Client


def run(
    spec: Spec,
    store: str | os.PathLike[str] | Place,
    client: "Client | None" = None,
    options: RunOptions = DEFAULTS,
    **fields: Unpack[RunFields],
) -> Summary:
    """Compute an atlas into a store, or complete one that an earlier run of the same spec began.

    ``fields`` are those of ``RunOptions``, as in ``run(spec, "plane.zarr", workers=4)``; they replace those of
    ``options``. The tiles run on ``client`` (used, not closed), or where the options say: on the cluster of a
    scheduler, or on a local one, the default. In a notebook a bar shows the progress, unless there is an
    ``on_progress``. Where a store at a URL stops answering, the run waits ``patience`` seconds for it.
    Raises InputError, before anything is written, for input that cannot be run, and where another run is at work on
    the store; RunError where the cluster is lost, the store has no room, or the run is cancelled; NetworkError where a
    server does not answer.
    A tile that raises does not stop the others: see ``Summary.failures``. After Ctrl-C the same call resumes.

    ``client`` is a Dask client here:

    >>> import atlas
    >>> spec = atlas.Spec("two-mass", {"omega": [3.0, 3.5], "b": [0.1, 0.2]}, solve={"tolerance": 0.1, "survival": 0})
    >>> summary = atlas.run(spec, "small.zarr", client)
    >>> summary.cells_solved, summary.failures
    (4, ())
    """
    options = options.updated(**fields)
    with reporting(options.on_progress) as report:
        return complete(Target(spec, place_of(store)), client, replace(options, on_progress=report))


@dataclass(frozen=True)
class Target:
    """The store that a run makes or completes.

    origin   the store whose cells it reuses, None for no other
    run_id   of the run that it must belong to, or that it gets when it is made; empty for any
    """

    spec: Spec
    place: Place
    origin: Origin | None = None
    run_id: str = ""

    def find(self) -> Header | None:
        """The header of the store, None where it is still to be made; InputError or RunError where it is another."""
        header = find(self.place, self.spec)
        if header is None:
            return None
        if self.run_id and self.run_id != header.run_id:
            raise RunError(f"{self.place}: not the store of run {self.run_id}")
        if self.origin and self.origin != header.origin:
            other = f"is a store already, and not one that extends {self.origin.store}"
            raise InputError(f"{self.place}: {other}; choose another path")
        return header

    def create(self, tile: tuple[int, ...]) -> Header:
        """Make the store."""
        return create(self.place, self.spec, tile, self.origin, self.run_id)


def complete(target: Target, client: "Client | None" = None, options: RunOptions = DEFAULTS) -> Summary:
    """Make or complete a store; see ``run``. Raises RunError also where the store is of another run than asked for."""
    leave_if_bootstrapping()
    check_client(client, options)
    with ExitStack() as stack:
        header = target.find()  # only read, so that bad input leaves no trace
        if options.retry is not None:
            _check_retry(target, header)
        client = joined(client, options, stack)
        plan = make_plan(target.spec, worker_count(client, options), header.tile if header else None)
        _check_room(target, header, plan)
        claim = stack.enter_context(claimed_place(target.place, options))
        target = replace(target, place=waiting(target.place, options.patience))
        held = partial(claim.confirm, target.place)
        header, work, totals = _found_or_made(target, plan, client, held, options)
        # Before the first tile is written: what overviews say of tiles that are solved again is dropped.
        overviews = Overviews(header, work.again, held)
        records = RunRecords(header, work.records or Records(header, ()), work.due)
        if work.due.any() and client is None:
            options.report(totals.progress(f"starting {plural(plan.workers, 'worker')}"))
            client = stack.enter_context(local_cluster(plan.workers))
        if client is not None and (work.due.any() or overviews):
            _hand_out(client, header, Due(work.due, overviews), options, claim, totals, records)
        _finish(header, overviews, records, totals, held, options)
    return totals.summary(str(header.place))


def _check_room(target: Target, header: Header | None, plan: Plan) -> None:
    """InputError where the disk cannot hold the tiles that are due."""
    if target.place.local is None:
        return
    due = plan.tiling.count - (len(done_tiles(header)) if header else 0)
    if shortage := disk_shortage(plan, target.place.local, due):
        raise InputError(shortage)


def _found_or_made(
    target: Target, plan: Plan, client: "Client | None", held: Callable[[], None], options: RunOptions
) -> "tuple[Header, _Work, Totals]":
    """The store of a run that holds its claim, the work that is due there, and the totals that it begins with.

    It is looked for once more: before the claim another run may have made it, with tiles of another shape, or have
    finished some of them.
    """
    done, finished = set[tuple[int, ...]](), list[tuple[int, ...]]()
    header = target.find()
    if header is not None:
        done, left = listed_tiles(header)
        finished = _finish_replacements(header, left, held)
        if header.tile != plan.tiling.tile:
            plan = make_plan(target.spec, plan.workers, header.tile)
    work = _work(header, plan, options, done.union(finished))
    if work.due.any():
        if client is None:
            prepare_kernels(options.report, *kernels_of(target.spec))
        work = replace(work, plan=options.estimate(target.spec, work.plan, options.report))
    totals = Totals(work.plan, work.tiles, work.cells, work.tiles_done, work.cells_done, work.retry)
    options.report(totals.progress(work.beginning))
    held()
    header = add_records(header or target.create(plan.tiling.tile))
    if options.retry is not None:
        add_allowances(header, options.retry.raises)
    return header, work, totals


def _finish(
    header: Header,
    overviews: Overviews,
    records: RunRecords,
    totals: Totals,
    held: Callable[[], None],
    options: RunOptions,
) -> None:
    """The end of a run: labels of basins, overviews that no worker has made, records in one chunk."""
    if header.spec.basins:
        options.report(totals.progress("labelling the attractors"))
        complete_basins(header, held, lambda index, row: records.add(index, row.tolist()))
    overviews.finish(lambda done, of: options.report(totals.progress(f"writing overviews: {done} of {of} parts")))
    records.compact(held, lambda n: options.report(totals.progress(f"counting the cells of {plural(n, 'tile')}")))


def _finish_replacements(header: Header, left: set[tuple[int, ...]], held: Callable[[], None]) -> list[tuple[int, ...]]:
    """Write what a run that was killed while it replaced finished tiles has left beside them; these tiles."""
    if left:
        held()
        drop(header, left)
    for index in sorted(left):
        finish_replacement(header, index, held)
    return [index for index in sorted(left) if is_done(header, index)]


def _check_retry(target: Target, header: Header | None) -> None:
    if header is None:
        raise InputError(f"{target.place}: no such store, so there is nothing to retry")
    if target.spec.attractors is not None:
        raise InputError(
            f"{target.place}: an atlas of all attractors cannot be retried: run it again with more periods"
        )
    if target.spec.continuation is not None:
        raise InputError(
            f"{target.place}: a continued sweep cannot be retried: each cell of it depends on those before it"
        )


def check_client(client: "Client | None", options: RunOptions) -> None:
    """InputError where a number of workers is given for a cluster that is the caller's."""
    if client is not None and options.workers is not None:
        raise InputError(f"workers: found {options.workers}, goes with a local cluster only, not with a client")


def joined(client: "Client | None", options: RunOptions, stack: ExitStack) -> "Client | None":
    """The client to work on: the one given, or one of the scheduler asked for; None where a local cluster is."""
    if client is not None or options.scheduler is None:
        return client
    options.report(Progress(f"connecting to {options.scheduler}", passing=True))
    return stack.enter_context(connected(options.scheduler, options.tls, options.timing))


def worker_count(client: "Client | None", options: RunOptions) -> int:
    """Threads of the cluster that a run works on, or the processes that it is going to start."""
    if client is None:
        return options.workers or processors()
    waiting = Progress("waiting for the scheduler's first worker")
    return count_threads(client, lambda: options.report(waiting), options.timing)


@contextmanager
def claimed_place(place: Place, options: RunOptions) -> Iterator[Claim]:
    """The claim of a store. What dead runs left half made is removed when it begins, their notes when it ends.

    Its beats have the place's own patience: one that fails is followed by another, and none may delay for long the end
    of a run whose store is away. Only removing the notes waits as long as the options say; and a run waits that long
    for a beat to succeed, since what it writes meanwhile is written only after a look at the claim.
    """
    notes = notes_of(waiting(place, options.patience))

    def say(text: str) -> None:
        options.report(Progress(text))

    def tidy() -> None:
        if claim_token(notes) == claim.token:  # else they are another run's
            notes.clear(keep=CLAIM)

    patience = options.patience if place.local is None else 0.0
    with claimed(notes_of(place), str(place), say, options.timing, patience) as claim:
        if place.local is not None:
            remove_half_made(place.local)
        try:
            yield claim
        except Exception:
            raise  # tiles that were begun may have something to do with it: their notes stay
        except BaseException:
            tidy()
            raise
        tidy()


@dataclass(frozen=True)
class _Work:
    """The work of a run.

    due                      mask of the tiles due
    tiles, cells             in all: of the atlas, or in a retry of the tiles to solve again
    tiles_done, cells_done   how many of these are done
    retry                    whether the tiles due are finished ones
    records                  of the tiles done, None where the store is still to be made
    """

    plan: Plan
    due: np.ndarray
    tiles: int
    cells: int
    tiles_done: int
    cells_done: int
    retry: bool = False
    records: Records | None = None

    @property
    def again(self) -> list[tuple[int, ...]]:
        """The finished tiles that are solved again."""
        return list(_indices(self.due)) if self.retry else []

    @property
    def beginning(self) -> str:
        """What the run begins with, in words."""
        if self.retry:
            return f"solving {plural(self.cells, 'cell')} in {plural(self.tiles, 'tile')} again"
        return f"resuming: {self.tiles_done} of {self.tiles} tiles are done" if self.tiles_done else "making the store"


def _work(header: Header | None, plan: Plan, options: RunOptions, done: set[tuple[int, ...]]) -> _Work:
    if header is None:
        return _Work(plan, np.ones(plan.tiling.grid, dtype=bool), plan.tiling.count, plan.tiling.cells, 0, 0)
    records = Records(header, done)
    if options.retry is not None:
        options.report(Progress("looking for the cells to solve again"))
        return _retried(header, plan, records, options.retry)
    tiles, cells = int(records.done.sum()), int(plan.tiling.sizes()[records.done].sum())
    return _Work(plan, ~records.done, plan.tiling.count, plan.tiling.cells, tiles, cells, records=records)


def _retried(header: Header, plan: Plan, records: Records, retry: Retry) -> _Work:
    selected = np.zeros(plan.tiling.grid, dtype=np.int64)
    for index in _indices(records.done & ~records.lack(map(int, retry.regimes))):
        selected[index] = retry.selects(read_tile(header, index, NEEDED)).sum()
    due = selected > 0
    return _Work(plan, due, int(due.sum()), int(selected.sum()), 0, 0, retry=True, records=records)


def _hand_out(
    client: "Client",
    header: Header,
    due: Due,
    options: RunOptions,
    claim: Claim,
    totals: Totals,
    records: RunRecords,
) -> None:
    """Send the jobs due to the workers, and add up their receipts."""

    def tick(workers: Workers) -> None:
        claim.check(lambda: options.report(totals.progress("waiting for the store, which does not answer")))
        totals.workers, totals.refused = max(totals.workers, workers.threads), workers.left_out
        totals.trouble = workers.trouble
        claim.report(totals.report(workers.threads) | {"holds": records.counts})
        doing = "solving" if workers.threads else "no worker left: waiting for one"
        options.report(totals.progress(workers.trouble or doing))

    job = Job((), str(header.place), header.run_id, header.solver_version, options.retry, options.patience, claim.token)
    totals.start()
    try:
        for outcome in tile_outcomes(client, job, due, tick, options.timing, math.prod(header.tile)):
            if isinstance(outcome, MadeChunk) or outcome.index[0] < 0:
                due.take(outcome.index, made=isinstance(outcome, MadeChunk) and not outcome.fault)
                continue
            if isinstance(outcome, Receipt):
                due.order.note(outcome.index, outcome.solve_seconds)
                due.overviews.add(outcome.index, outcome.overview)
                records.add(outcome.index, outcome.record)
            totals.add(outcome)
            options.report(totals.progress("solving"))
    except KeyboardInterrupt:
        options.report(totals.progress("interrupted, dropping the tiles under way"))
        raise
    due.return_failed()


def _indices(mask: np.ndarray) -> Iterator[tuple[int, ...]]:
    """Indices where the mask is set, row by row, one at a time."""
    for position in np.flatnonzero(mask):
        yield tuple(map(int, np.unravel_index(position, mask.shape)))
