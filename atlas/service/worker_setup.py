"""The setup of a worker once per run, before its first job: a plugin of Dask's workers.

Dask hands it to every worker, also to one that joins later. It runs in a thread of its own, since Dask's event loop
must not stand still while kernels are compiled; jobs that come meanwhile wait for it.
"""

import asyncio
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from distributed import WorkerPlugin, get_worker

from atlas.service.batches import J, JobType, R
from atlas.task.store_ref import WorkerRefusedError

if TYPE_CHECKING:
    from distributed import Client


class WorkerSetup(WorkerPlugin):
    """The setup of one run, by ``prepare``; all jobs that waited raise its exception.

    A worker that refuses does so for good. Any other failure may pass, so the next job tries again.
    """

    def __init__(self, name: str, prepare: Callable[[], object], forget: Callable[[], object]) -> None:
        self.name, self._prepare, self._forget = name, prepare, forget

    def setup(self, worker: Any) -> None:
        """Begin; see Dask."""
        self._lock, self._ready, self._refusal = threading.Lock(), False, ""
        threading.Thread(target=self._begin, name="atlas-setup", daemon=True).start()

    def teardown(self, worker: Any) -> None:
        """Drop the state kept for the run's jobs; see Dask."""
        self._forget()

    def wait(self) -> None:
        """Return once this worker is ready for jobs of the run; raises if its setup fails."""
        with self._lock:
            if self._ready:
                return
            if self._refusal:
                raise WorkerRefusedError(self._refusal)
            try:
                self._prepare()
            except WorkerRefusedError as error:
                self._refusal = str(error)
                raise
            self._ready = True

    def _begin(self) -> None:
        with suppress(Exception):  # the first job raises it again
            self.wait()


def run_after_setup(name: str, act: Callable[[J], R], job: J) -> R:
    """Do a job once the setup of its run is done; at once on a worker without the plugin."""
    plugin = get_worker().plugins.get(name)
    if isinstance(plugin, WorkerSetup):
        plugin.wait()
    return act(job)


@contextmanager
def prepare_workers(client: "Client", job_type: JobType[J, R], seconds: float) -> Iterator[Callable[[J], R]]:
    """Prepare every worker once, and yield ``labour.act`` as a function that waits for its worker's preparation.

    A run that resumes after a kill has the same name, and replaces the setup left behind. Dask asks all workers; this
    waits for at most ``seconds``, so that a worker that hangs does not hold up the others. A worker without the setup
    does its jobs all the same, since every job checks what it needs.
    """
    name = job_type.name
    _asked(client, lambda: client.register_plugin(WorkerSetup(name, job_type.setup, job_type.teardown)), seconds)
    try:
        yield partial(run_after_setup, name, job_type.run)
    finally:
        _asked(client, lambda: client.unregister_worker_plugin(name), seconds)


def _asked(client: "Client", request: Callable[[], Any], seconds: float) -> None:
    """Make a request of a client, which gives a coroutine in the thread of its loop; errors are ignored."""

    async def answer() -> None:
        await asyncio.wait_for(request(), seconds)

    with suppress(Exception):
        client.sync(answer)
