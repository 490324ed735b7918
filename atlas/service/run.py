"""Running an atlas: plan, claim, create or resume, fan the tiles out, gather receipts."""

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from atlas.errors import InputError, RunError
from atlas.overview.pyramid import Overviews
from atlas.service import plan as planning
from atlas.service.cluster import Tls, connected, count_threads, leave_if_bootstrapping, local_cluster
from atlas.service.dispatch import outcomes
from atlas.service.lease import CLAIM, Claim, claimed, remove_half_made
from atlas.service.plan import Plan
from atlas.service.probe import probe as measure
from atlas.service.progress import Progress
from atlas.service.schedule import Order
from atlas.service.summary import Summary, Tally
from atlas.spec.spec import Spec
from atlas.store.location import Place, place_of, waiting
from atlas.store.outage import LONG
from atlas.store.schema import Origin
from atlas.store.sidecar import notes_of
from atlas.store.store import Header, add_budget, create, done_tiles, find
from atlas.store.tally import TallyKeeper
from atlas.store.tiles import read_tile
from atlas.task.compile import compile_once, warming
from atlas.task.retry import NEEDED, Retry
from atlas.task.task import Job, Receipt
from atlas.text import plural

if TYPE_CHECKING:
    from distributed import Client


def run(
    spec: Spec,
    store: str | os.PathLike[str] | Place,
    client: "Client | None" = None,
    workers: int | None = None,
    scheduler: str | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    probe: bool = False,
    retry: Retry | None = None,
    tls: Tls | None = None,
    origin: Origin | None = None,
    run_id: str = "",
    patience: float = LONG,
) -> Summary:
    """Compute an atlas into a store, going on where an earlier run of the same spec stopped.

    The tiles run on ``client`` (used, not closed), on the cluster at address ``scheduler`` (by ``tls`` where it wants
    it), or on a local cluster of ``workers`` processes. ``on_progress`` is called with each Progress; ``probe`` has the
    plan measure a few cells. With ``retry`` the chosen cells of finished tiles are solved again, and nothing else.
    A new store reuses the cells that ``origin`` has, see ``extend``; it gets the ``run_id``, where one is given. A
    store at a URL that stops answering is waited for ``patience`` seconds.
    Raises InputError, before anything is written, for input that cannot be run, and where another run is at work on
    the store; RunError where the cluster is lost, the store has no room or is of another run than ``run_id``, or the
    run is cancelled; NetworkError where a server does not answer.
    A tile that raises does not stop the others: see ``Summary.failures``. After Ctrl-C the same call goes on.
    """
    if workers is not None and (workers < 1 or client is not None or scheduler is not None):
        raise InputError(f"workers: found {workers}, must be 1 or more, and goes with a local cluster only")
    leave_if_bootstrapping()
    tell = on_progress or (lambda _: None)
    place = place_of(store)
    header = find(place, spec)
    if retry is not None and header is None:
        raise InputError(f"{place}: no such store, so there is nothing to retry")
    if retry is not None and spec.continuation is not None:
        raise InputError(f"{place}: a continued sweep cannot be retried: each cell of it depends on those before it")
    with ExitStack() as stack:
        if scheduler is not None and client is None:
            tell(Progress(f"connecting to {scheduler}", passing=True))
            client = stack.enter_context(connected(scheduler, tls))
        count = workers or planning.default_workers()
        if client is not None:
            count = count_threads(client, lambda: tell(Progress("waiting for the scheduler's first worker")))
        plan = planning.make_plan(spec, count, header.tile if header else None)
        if place.local is not None:
            planning.check_disk(plan, place.local, plan.tiling.count - (len(done_tiles(header)) if header else 0))

        claim = stack.enter_context(_claimed(place, patience, tell))
        place = waiting(place, patience)  # it answers, and there is something to lose from now on
        header = find(place, spec)  # once more: before the claim another may have made or extended it
        if header is not None and run_id not in ("", header.run_id):
            raise RunError(f"{place}: not the store of run {run_id}")
        plan = planning.make_plan(spec, count, header.tile if header else plan.tiling.tile)
        work = _work(header, plan, retry, tell)
        if work.due.any() and (client is None or probe):
            tell(Progress(warming(spec.settings.exponents)))
            compile_once(spec.system, spec.settings)
        if work.due.any() and probe:
            tell(Progress("probing a few cells"))
            work = replace(work, plan=replace(plan, probe=measure(spec, plan.tiling.tile)))
        tally = Tally(work.plan, work.tiles_done, work.cells_done, work.tiles, work.cells)
        tell(tally.progress(_beginning(work, retry)))
        header = header or create(place, spec, plan.tiling.tile, origin, run_id)
        if retry is not None and retry.max_periods is not None:
            add_budget(header)
        if work.due.any() and client is None:
            tell(tally.progress(f"starting {plural(count, 'worker')}"))
            client = stack.enter_context(local_cluster(count))
        # Before the first tile is written: what overviews and tally say of tiles that are solved again is dropped.
        again = list(_indices(work.due)) if retry is not None else []
        tallies = stack.enter_context(TallyKeeper(header, again))
        overviews = stack.enter_context(Overviews(header, pending=again))
        if work.due.any() and client is not None:

            def written(receipt: Receipt) -> None:
                overviews.add(receipt.index)
                tallies.add(receipt.index, receipt.entry)

            _solve(client, header, work.due, retry, patience, claim, tally, written, tell)
        overviews.finish(lambda done, parts: tell(tally.progress(f"writing overviews: {done} of {parts} parts")))
        tallies.finish(lambda tiles: tell(tally.progress(f"counting the cells of {plural(tiles, 'tile')}")))
        return replace(tally.summary(str(header.place)), retried=retry is not None)


@contextmanager
def _claimed(place: Place, patience: float, tell: Callable[[Progress], None]) -> Iterator[Claim]:
    """The claim of a store, with what dead runs left next to it cleared away.

    Its beats have the place's own patience: one that fails is followed by another, and none is to hold up for long
    the end of a run whose store is away. Only the clearing at the end waits for ``patience`` seconds.
    """
    notes = notes_of(waiting(place, patience))
    with claimed(notes_of(place), str(place), lambda text: tell(Progress(text))) as claim:
        if place.local is not None:
            remove_half_made(place.local)
        try:
            yield claim
        except Exception:
            raise  # tiles that were begun may have something to do with it: their notes stay
        except BaseException:
            notes.clear(keep=CLAIM)
            raise
        notes.clear(keep=CLAIM)


def _solve(
    client: "Client",
    header: Header,
    due: np.ndarray,
    retry: Retry | None,
    patience: float,
    claim: Claim,
    tally: Tally,
    written: Callable[[Receipt], None],
    tell: Callable[[Progress], None],
) -> None:
    """Fan the tiles due out to the workers, and add up their receipts."""

    def tick(threads: int, refused: Mapping[str, str]) -> None:
        claim.check()
        tally.workers, tally.refused = max(tally.workers, threads), refused
        claim.report(tally.report(threads))
        tell(tally.progress("solving" if threads else "waiting for a worker: there is none left"))

    order = Order(due)
    store = str(header.place)
    jobs = (Job(index, store, header.run_id, header.solver_version, retry, patience) for index in order)
    tally.start()
    try:
        for outcome in outcomes(client, jobs, tick):
            tally.add(outcome)
            if isinstance(outcome, Receipt):
                order.note(outcome.index, outcome.solve_seconds)
                written(outcome)
            tell(tally.progress("solving"))
    except KeyboardInterrupt:
        tell(tally.progress("interrupted, dropping the tiles under way"))
        raise


@dataclass(frozen=True)
class _Work:
    """What a run has before it: the mask of the tiles due; tiles and cells in all, and how many of them are done."""

    plan: Plan
    due: np.ndarray
    tiles: int
    cells: int
    tiles_done: int
    cells_done: int


def _work(header: Header | None, plan: Plan, retry: Retry | None, tell: Callable[[Progress], None]) -> _Work:
    done = np.zeros(plan.tiling.grid, dtype=bool)
    for index in done_tiles(header) if header else ():
        done[index] = True
    if header is None or retry is None:
        cells_done = int(plan.tiling.sizes()[done].sum())
        return _Work(plan, ~done, plan.tiling.count, plan.tiling.cells, int(done.sum()), cells_done)
    tell(Progress("looking for the cells to solve again"))
    selected = np.zeros(plan.tiling.grid, dtype=np.int64)
    for index in _indices(done):
        selected[index] = retry.selects(read_tile(header, index, NEEDED)).sum()
    return _Work(plan, selected > 0, int((selected > 0).sum()), int(selected.sum()), 0, 0)


def _beginning(work: _Work, retry: Retry | None) -> str:
    if retry is not None:
        return f"solving {plural(work.cells, 'cell')} in {plural(work.tiles, 'tile')} again"
    return f"going on: {work.tiles_done} of {work.tiles} tiles are done" if work.tiles_done else "making the store"


def _indices(mask: np.ndarray) -> Iterator[tuple[int, ...]]:
    """Indices where the mask is set, row by row, one at a time."""
    for place in np.flatnonzero(mask):
        yield tuple(map(int, np.unravel_index(place, mask.shape)))
