"""Running an atlas: plan, create or resume, fan the tiles out, gather receipts. The only file that uses Dask."""

import asyncio
import logging
import multiprocessing
import os
import signal
import threading
import uuid
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from atlas import plan as planning
from atlas.errors import InputError, RunError
from atlas.job import Job, Receipt, run_job
from atlas.layout import Origin
from atlas.place import place_of
from atlas.progress import Progress
from atlas.spec import Spec
from atlas.store import create, done_tiles, find
from atlas.summary import Summary, Tally, TileFailure

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECT_SECONDS = 5
"""How long a scheduler may take to answer."""
WORKER_SECONDS = 30
"""How long a scheduler may take to have its first worker."""
_LOST = "the cluster was lost; run again to go on from the stored tiles"
IN_FLIGHT = 2
"""Tiles under way for each thread: one running, one waiting, so that no thread idles and no queue grows."""


def run(
    spec: Spec,
    store: str | os.PathLike[str],
    client: "Client | None" = None,
    workers: int | None = None,
    scheduler: str | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    probe: bool = False,
    origin: Origin | None = None,
) -> Summary:
    """Compute an atlas into a store, going on where an earlier run of the same spec stopped.

    The tiles run on ``client`` (used, not closed), on the cluster at address ``scheduler``, or on a local cluster of
    ``workers`` processes. ``on_progress`` is called with each Progress; ``probe`` has the plan measure a few cells.
    A new store takes over the cells that ``origin`` has, see ``extend``.
    Raises InputError, before anything is written, for input that cannot be run; RunError where the cluster is lost.
    A tile that raises does not stop the others: see ``Summary.failures``. After Ctrl-C the same call goes on.
    """
    if workers is not None and (workers < 1 or client is not None or scheduler is not None):
        raise InputError(f"workers: found {workers}, must be 1 or more, and goes with a local cluster only")
    _leave_if_bootstrapping()
    tell = on_progress or (lambda _: None)
    place = place_of(store)
    header = find(place, spec)
    done = done_tiles(header) if header else set()
    with ExitStack() as stack:
        if scheduler is not None and client is None:
            tell(Progress(f"connecting to {scheduler}", passing=True))
            client = stack.enter_context(_connected(scheduler))
        count = (workers or planning.default_workers()) if client is None else _count_threads(client, tell)
        plan = planning.make_plan(spec, count, header.tile if header else None)
        pending = [tile for tile in plan.tiles() if tile.index not in done]
        if pending and (client is None or probe):
            tell(Progress("compiling the kernels (kept for the next run)"))
            planning.warm_up(spec)
        if pending and probe:
            tell(Progress("probing a few cells"))
            plan = replace(plan, probe=planning.probe(spec))
        tally = Tally(plan, done)
        tell(
            tally.progress(f"going on: {len(done)} of {plan.tile_count} tiles are done" if done else "making the store")
        )
        if place.local is not None:
            planning.check_disk(plan, place.local, len(pending))
        header = header or create(place, spec, plan.tile, origin)
        jobs = [Job(tile.index, str(header.place), header.run_id, header.solver_version) for tile in pending]
        if pending and client is None:
            tell(tally.progress(f"starting {planning.plural(count, 'worker')}"))
            client = stack.enter_context(_local_cluster(count))
        if client is not None:
            tally.start()
            tell(tally.progress("solving"))
            try:
                for outcome in _outcomes(client, jobs, tally):
                    tally.add(outcome)
                    tell(tally.progress("solving"))
            except KeyboardInterrupt:
                tell(tally.progress("interrupted, dropping the tiles under way"))
                raise
        return tally.summary(str(header.place))


def _outcomes(client: "Client", jobs: Iterable[Job], tally: Tally) -> Iterator[Receipt | TileFailure]:
    """Submit jobs in a window and give each one's outcome as it ends; what is under way is dropped on the way out."""
    from distributed import as_completed

    waiting = iter(jobs)
    token = uuid.uuid4().hex[:8]
    running: dict[Future[Receipt], Job] = {}
    feed = as_completed(loop=client.loop)

    def submit() -> None:
        threads = _threads(client)  # asked again each time, since a cluster may grow under way
        tally.workers = max(tally.workers, threads)
        for _, job in zip(range(IN_FLIGHT * threads - len(running)), waiting, strict=False):
            key = f"tile-{token}-{'-'.join(map(str, job.index))}"
            future = client.submit(run_job, job, key=key)
            running[future] = job
            feed.add(future)

    try:
        submit()
        for future in feed:
            outcome = _outcome(future, running.pop(future))
            future.release()
            yield outcome
            submit()
    finally:
        if running:
            with suppress(Exception):  # a cluster that is gone has nothing to cancel
                client.cancel(list(running))


def _outcome(future: "Future[Receipt]", job: Job) -> Receipt | TileFailure:
    if future.status == "finished":
        return future.result()
    if future.status == "error":
        error = future.exception()
        return TileFailure(job.index, " ".join(f"{type(error).__name__}: {error}".split()))
    raise RunError(_LOST)


def _threads(client: "Client") -> int:
    if client.status != "running":
        raise RunError(_LOST)
    try:
        return max(1, sum(client.nthreads().values()))
    except OSError:
        raise RunError(_LOST) from None


def _count_threads(client: "Client", tell: Callable[[Progress], None]) -> int:
    if client.asynchronous:
        raise InputError("client: found an asynchronous one, must be synchronous")
    if not client.nthreads():
        tell(Progress("waiting for the scheduler's first worker"))
        try:
            client.wait_for_workers(1, timeout=WORKER_SECONDS)
        except TimeoutError:
            raise InputError(
                f"the scheduler has no worker after {WORKER_SECONDS} s; start one: dask worker ADDRESS"
            ) from None
    return _threads(client)


async def _knock(scheduler: str) -> None:
    """Connect and hang up; OSError or ValueError where nothing answers."""
    from distributed.comm.core import connect

    comm = await connect(scheduler, timeout=CONNECT_SECONDS)
    await comm.close()


@contextmanager
def _connected(scheduler: str) -> Iterator["Client"]:
    """A client of the scheduler at an address; InputError where none answers in time."""
    from distributed import Client

    with _quiet():
        try:
            # A Client that fails to start is closed only when it is collected, which may block the next one's start.
            with ThreadPoolExecutor(1) as apart:  # a notebook's own thread has a loop running
                apart.submit(asyncio.run, _knock(scheduler)).result()
            client = Client(scheduler, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError) as error:
            detail = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(f"{scheduler}: no scheduler answers ({detail})") from None
        with client:
            yield client


@contextmanager
def _local_cluster(count: int) -> Iterator["Client"]:
    """Worker processes of one thread each, reachable from this machine only."""
    from distributed import Client, LocalCluster

    with _quiet(), ExitStack() as stack:
        try:
            with _interrupts_ignored():
                cluster = LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    dashboard_address="127.0.0.1:0",
                    scheduler_kwargs={"dashboard": False},
                    memory_limit=0,
                    silence_logs=logging.CRITICAL,
                )
        except RuntimeError as error:
            raise RunError(
                f"the worker processes did not start ({error}); a script that calls atlas.run must do so under "
                'if __name__ == "__main__": or pass client=distributed.Client(processes=False)'
            ) from error
        stack.enter_context(cluster)
        yield stack.enter_context(Client(cluster, set_as_default=False))


def _leave_if_bootstrapping() -> None:
    """End a worker process that is importing its parent's script, where a call without a __main__ guard leads to.

    The parent then says what to do; an exception here would print a traceback for every worker.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise SystemExit(1)


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Ctrl-C reaches every process of a terminal; those started in here leave it to their parent."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _quiet() -> Iterator[None]:
    """Dask's log kept off the terminal: what matters of it comes back as an outcome or an error."""
    # Importing distributed has given several of its loggers a level and a handler of their own.
    names = [name for name in logging.root.manager.loggerDict if name.partition(".")[0] in ("distributed", "tornado")]
    before = {logger: logger.level for logger in map(logging.getLogger, names)}
    for logger in before:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in before.items():
            logger.setLevel(level)
