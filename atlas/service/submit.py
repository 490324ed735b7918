"""Submitted runs: the coordinator is a Dask task on the cluster, and outlives the program that submitted it."""

import os
import time
import uuid
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from atlas.errors import InputError, NetworkError, RunError
from atlas.formatting import plural
from atlas.service.cluster import CLUSTER_LOST_MESSAGE, connect_to_scheduler, count_threads, worker_threads
from atlas.service.lease import record_end
from atlas.service.options import RunOptions
from atlas.service.progress import Progress
from atlas.service.run import complete
from atlas.service.worker_health import WorkerRefusal
from atlas.spec.spec import Spec
from atlas.store.access import BY_ENVIRONMENT
from atlas.store.object_backend import LocalBackend, StoreBackend, open_backend
from atlas.store.origin import Origin
from atlas.store.sidecar import sidecar_of
from atlas.store.store import find_store, open_store
from atlas.store.zarr_backend import check_not_packed
from atlas.task.store_ref import WorkerRefusedError, check_solver, open_checked
from workers import SOLVER_VERSION

if TYPE_CHECKING:
    from distributed import Client, Event, Future


@dataclass(frozen=True)
class Submission:
    """A run sent to the coordinator on a cluster.

    spec            spec of the atlas
    store           path or URL of the store
    options         options of the run, without a scheduler
    name            unique name of this submission on the scheduler
    solver_version  the submitter's version: workers of another version must not coordinate
    run_id          run id of the store; empty if the submitter sees no store
    origin          the store whose cells the run reuses, or None
    refused         reasons of the workers that refused to coordinate, by address
    """

    spec: Spec
    store: str
    options: RunOptions
    name: str
    solver_version: int
    run_id: str
    origin: Origin | None = None
    refused: Mapping[str, str] = field(default_factory=dict)

    def without(self, refusal: WorkerRefusal) -> "Submission":
        """Return the same submission, without the worker that refused."""
        return replace(self, refused={**self.refused, refusal.worker: refusal.reason})


def submit(
    spec: Spec, store: str | os.PathLike[str] | StoreBackend, options: RunOptions, origin: Origin | None = None
) -> str:
    """Start the coordinator of a run on the cluster at ``options.scheduler``, and return the address of its worker.

    Return once tiles are being solved, or the atlas is complete. The coordinator is a Dask task that takes no thread
    from the tiles. If its worker dies, Dask starts it on another, up to three times (the scheduler's
    ``allowed-failures``), and the coordinator resumes from the stored tiles. A worker refuses to coordinate if it has
    another solver version than this program, or finds another store at the path. The next worker is then tried. Raise
    the errors that ``atlas.run`` raises before its first tile, and RunError if all workers refuse.
    """
    from distributed import Event, Variable

    scheduler, timing = options.scheduler, options.timing
    if scheduler is None:
        raise InputError("submit: needs the address of a scheduler")
    place = open_backend(store)
    check_not_packed(place)
    known = isinstance(place, LocalBackend) or getattr(place, "access", None) == BY_ENVIRONMENT
    if options.storage_options is not None or not known or open_backend(str(place)) != place:
        raise InputError("submit: the coordinator reaches the store by its own environment; give a path or a URL only")
    options.report(Progress(f"connecting to {scheduler}", transient=True))
    with connect_to_scheduler(scheduler, options.tls, timing) as client:
        count_threads(client, options.wait_for_first, options.wait, timing.poll)
        path, name = str(place), f"atlas-{uuid.uuid4().hex[:8]}"
        settled = replace(options, scheduler=None, tls=None, on_progress=None)
        task = Submission(spec, path, settled, name, SOLVER_VERSION, _run_id(path), origin)
        options.report(Progress("starting the coordinator on the cluster"))
        begun, run_id = Event(name, client=client), Variable(name, client=client)
        run_id.set("")
        while True:
            try:
                willing = _willing(client, task)
            except RunError:
                run_id.delete()
                raise
            future = _start(client, task, willing)
            refusal = _refusal(future, begun, timing.poll)
            if refusal is None:
                break
            reason = f"{refusal.worker} cannot coordinate: {refusal.reason}"
            options.report(Progress(f"{reason}; trying another worker"))
            task = task.without(refusal)
        where = client.who_has([future]) if future.done() else client.processing()
        return next((worker for worker, keys in where.items() if future.key in keys), "the cluster")


def coordinate(task: Submission) -> WorkerRefusal | None:
    """Coordinate a run on this worker, or return a refusal that names the worker.

    As soon as tiles are in flight, a variable of the scheduler with the submission's name holds the store's run id. An
    event is then set, at which the submitter returns. A coordinator that finds a run id replaces one whose worker died.
    It resumes that run only, and if its own worker must not coordinate, it starts the next coordinator itself. An error
    that no submitter waits for is recorded for ``atlas status``.
    """
    from distributed import Event, Variable, get_worker, worker_client

    with worker_client() as client:  # frees this thread for the tiles
        begun, known, unwatched = Event(task.name, client=client), Variable(task.name, client=client), False

        def begin(run_id: str) -> None:
            nonlocal unwatched
            if not unwatched:
                known.set(run_id)
                begun.set()
                unwatched = True

        def forget() -> None:  # else the scheduler keeps both
            known.delete()
            begun.clear()

        try:
            with suppress(TimeoutError):  # the variable is gone
                earlier = str(known.get(timeout=task.options.timing.poll))
                unwatched = bool(earlier)
                task = replace(task, run_id=earlier or task.run_id)
            try:
                check_coordinator(task)
            except WorkerRefusedError as error:
                refusal = WorkerRefusal(get_worker().address, str(error))
                if unwatched:
                    time.sleep(task.options.timing.poll)  # a busy worker may lose the task back to this one repeatedly
                    task = task.without(refusal)
                    _start(
                        client, task, _willing(client, task, task.options.timing.replacement_worker)
                    )  # a worker may be reconnecting
                return refusal
            _run(task, client, begin)
        except BaseException as error:
            # The submitter reports bad input; without a store nobody asks for a status.
            if (unwatched or not isinstance(error, InputError)) and _run_id(task.store):
                record_end(sidecar_of(task.store), _in_words(error))
            forget()
            raise
        forget()
        return None


def check_coordinator(task: Submission) -> None:
    """Raise WorkerRefusedError if this worker must not coordinate."""
    if not task.run_id:
        check_solver(task.solver_version)
        return
    try:
        open_checked(task.store, task.run_id, task.solver_version)
    except NetworkError:
        raise
    except OSError as error:
        raise WorkerRefusedError(
            f"{task.store}: {error.strerror or error}; check that the path is the same on every host"
        ) from None


def _run(task: Submission, client: "Client", begin: Callable[[str], None]) -> None:
    run_id = task.run_id
    if not run_id:
        handle = find_store(task.store)
        run_id = handle.run_id if handle else uuid.uuid4().hex

    def report(progress: Progress) -> None:
        if progress.stage == "solving":
            begin(run_id)

    options = replace(task.options, on_progress=report)
    summary = complete(task.spec, open_backend(task.store), client, options, task.origin, run_id)
    if summary.failures:
        first, count = summary.failures[0], plural(len(summary.failures), "tile")
        record_end(sidecar_of(task.store), f"{count} failed, the first is {first.index}: {first.message}")


def _run_id(store: str) -> str:
    """Return the run id of the store at a path; empty if this host sees no store, which is allowed."""
    try:
        return open_store(store).run_id
    except (InputError, OSError):
        return ""


def _start(client: "Client", task: Submission, willing: list[str]) -> "Future[WorkerRefusal | None]":
    """Submit the coordinator to workers that may take it, so that it outlives this client."""
    from distributed import fire_and_forget

    future = client.submit(
        coordinate,
        task,
        key=f"{task.name}-{uuid.uuid4().hex[:8]}",  # a key of its own for each attempt
        pure=False,
        workers=willing if task.refused else None,
        allow_other_workers=bool(task.refused),  # else Dask waits for ever for workers that are gone
    )
    fire_and_forget(future)
    return future


def _willing(client: "Client", task: Submission, seconds: float = 0.0) -> list[str]:
    """Return the addresses of the workers that have not refused.

    Raise RunError if all workers have refused and no other joins within ``seconds``.
    """
    end = time.monotonic() + seconds
    while not (willing := [worker for worker in worker_threads(client) if worker not in task.refused]) and task.refused:
        if time.monotonic() >= end:
            worker, reason = next(iter(task.refused.items()))
            raise RunError(f"no worker may coordinate this run, for example {worker}: {reason}")
        time.sleep(task.options.timing.poll)
    return willing


def _refusal(future: "Future[WorkerRefusal | None]", begun: "Event", poll: float) -> WorkerRefusal | None:
    """Wait until the coordinator has begun or ended, and return its refusal; None if it did not refuse.

    Raise its exception.
    """
    while not future.done():
        if begun.wait(timeout=poll):
            return None
    if future.status == "error":
        error = future.exception()
        raise error if isinstance(error, InputError | RunError) else RunError(_in_words(error))
    if future.status != "finished":
        raise RunError(CLUSTER_LOST_MESSAGE)
    return future.result()


def _in_words(error: BaseException) -> str:
    """Return the message of one of this package's errors; for others with the type of the error."""
    return str(error) if isinstance(error, InputError | RunError) else f"{type(error).__name__}: {error}".rstrip(": ")
