"""Leaving a run to a cluster: the coordinator is a task there, and outlives the program that submitted it."""

import os
import uuid
from collections.abc import Callable

from atlas.beside import notes_of
from atlas.claim import leave_word
from atlas.cluster import LOST, Tls, connected, count_threads
from atlas.errors import InputError, RunError
from atlas.place import place_of
from atlas.plan import plural
from atlas.progress import Progress
from atlas.retry import Retry
from atlas.run import run
from atlas.spec import Spec

WAIT_SECONDS = 0.5
"""How often it is looked whether the coordinator has begun, or ended before it did."""


def submit(
    spec: Spec,
    store: str | os.PathLike[str],
    scheduler: str,
    on_progress: Callable[[Progress], None] | None = None,
    retry: Retry | None = None,
    tls: Tls | None = None,
) -> str:
    """Have the cluster at an address compute an atlas, and leave: the address of the worker that coordinates it.

    Returns once tiles are being solved, or the atlas is complete. The coordinator is a task beside the tiles; when its
    worker dies, Dask starts it on another (as often as the scheduler's ``allowed-failures`` grants, by default three
    times), and it goes on by what is stored. It takes no thread from the tiles. The workers must see the store's path.
    Raises what ``atlas.run`` raises before its first tile.
    """
    from distributed import Event, fire_and_forget

    tell = on_progress or (lambda _: None)
    tell(Progress(f"connecting to {scheduler}", passing=True))
    with connected(scheduler, tls) as client:
        count_threads(client, lambda: tell(Progress("waiting for the scheduler's first worker")))
        name = f"atlas-{uuid.uuid4().hex[:8]}"
        tell(Progress("starting the coordinator on the cluster"))
        begun = Event(name, client=client)
        future = client.submit(coordinate, spec, str(place_of(store)), retry, name, key=name, pure=False)
        fire_and_forget(future)
        while not begun.wait(timeout=WAIT_SECONDS) and not future.done():
            pass
        if future.status == "error":
            error = future.exception()
            raise error if isinstance(error, InputError | RunError) else RunError(f"{type(error).__name__}: {error}")
        if future.status in ("cancelled", "lost"):
            raise RunError(LOST)
        where = client.who_has([future]) if future.done() else client.processing()
        return next((worker for worker, keys in where.items() if name in keys), "the cluster")


def coordinate(spec: Spec, store: str, retry: Retry | None, name: str) -> None:
    """The coordinator, as a worker runs it; sets the event of that name as soon as tiles are under way."""
    from distributed import Event, worker_client

    with worker_client() as client:  # gives this thread's place to the tiles
        begun, told = Event(name, client=client), False

        def tell(progress: Progress) -> None:
            nonlocal told
            if not told and progress.stage == "solving":
                begun.set()
                told = True

        try:
            summary = run(spec, store, client=client, on_progress=tell, retry=retry)
            if summary.failures:
                first = summary.failures[0]
                count = plural(len(summary.failures), "tile")
                leave_word(notes_of(store), f"{count} raised, the first being {first.index}: {first.message}")
        except RunError as error:
            leave_word(notes_of(store), str(error))
            raise
        finally:
            begun.clear()  # the scheduler forgets it
