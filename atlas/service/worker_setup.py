"""The setup of a worker once per run, before its first job, by a plugin of Dask's workers.

Dask sends the plugin to every worker, including workers that join later. The setup runs in a thread of its own, since
Dask's event loop must not stand still while kernels are compiled. Jobs that arrive meanwhile wait for the setup.
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
    """The setup of one run on a worker.

    name     name of the plugin
    prepare  function that prepares the worker; all jobs that wait raise its exception
    forget   function that drops the state of ``prepare``

    A worker that refuses does so for good. Any other failure may be temporary, so the next job tries again.
    """

    def __init__(self, name: str, prepare: Callable[[], object], forget: Callable[[], object]) -> None:
        self.name, self._prepare, self._forget = name, prepare, forget

    def setup(self, worker: Any) -> None:
        """Begin the setup; see Dask."""
        self._lock, self._ready, self._refusal = threading.Lock(), False, ""
        threading.Thread(target=self._begin, name="atlas-setup", daemon=True).start()

    def teardown(self, worker: Any) -> None:
        """Drop the state kept for the run's jobs; see Dask."""
        self._forget()

    def wait(self) -> None:
        """Return once this worker is ready for jobs of the run; raise the exception of its setup."""
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
    """Do a job once the setup of its run is finished; at once on a worker without the plugin."""
    plugin = get_worker().plugins.get(name)
    if isinstance(plugin, WorkerSetup):
        plugin.wait()
    return act(job)


@contextmanager
def prepare_workers(client: "Client", job_type: JobType[J, R], seconds: float) -> Iterator[Callable[[J], R]]:
    """Prepare every worker once, and yield ``job_type.run`` as a function that waits for its worker's setup.

    A run that resumes after a kill has the same name, and replaces the setup left behind. Dask asks all workers; this
    function waits for at most ``seconds``, so that a worker that hangs does not hold up the others. A worker without
    the setup does its jobs all the same, since every job checks what it needs.
    """
    name = job_type.name
    _asked(client, lambda: client.register_plugin(WorkerSetup(name, job_type.setup, job_type.teardown)), seconds)
    try:
        yield partial(run_after_setup, name, job_type.run)
    finally:
        _asked(client, lambda: client.unregister_worker_plugin(name), seconds)


def _asked(client: "Client", request: Callable[[], Any], seconds: float) -> None:
    """Make a request of a client, which returns a coroutine in the thread of its loop; errors are ignored."""

    async def answer() -> None:
        await asyncio.wait_for(request(), seconds)

    with suppress(Exception):
        client.sync(answer)
