"""The Dask client of a run: the given client, that of a scheduler, an active one, or that of a new local cluster."""

from contextlib import ExitStack
from typing import TYPE_CHECKING

from atlas.errors import InputError, brief_repr
from atlas.formatting import plural
from atlas.platform import processors
from atlas.service.cluster import (
    active_client,
    check_startable,
    connect_to_scheduler,
    count_threads,
    dashboard_link,
    has_dashboard,
    local_cluster,
    loss_reported,
    performance_reported,
    task_client,
)
from atlas.service.options import RunOptions
from atlas.service.progress import Progress

if TYPE_CHECKING:
    from distributed import Client


def start_client(client: "Client | None", count: int, options: RunOptions, stack: ExitStack) -> "Client":
    """Return ``client``, or start a local cluster of ``count`` processes and return its client.

    Closing ``stack`` ends the performance report, if the options ask for one, and then the processes.
    """
    if client is None:
        stage = f"starting {plural(count, 'worker')}"
        options.report(Progress(stage))
        client = stack.enter_context(local_cluster(count, options.dashboard))
        link = dashboard_link(client) if options.dashboard and has_dashboard() else ""
        if link:
            options.report(Progress(stage, note=f"dashboard of the workers: {link}"))
    if (path := options.performance_report) is not None:

        def failed(reason: str) -> None:
            options.report(Progress("ending", note=f"performance report {path}: not written ({reason})"))

        stack.enter_context(performance_reported(client, path, failed))
    return client


def check_client(client: "Client | None", options: RunOptions) -> None:
    """Raise InputError if ``client`` is not a Dask client, or if a number of workers is given together with a
    client.
    """
    if client is not None:
        check_kind(client)
    if client is not None and options.workers is not None:
        raise InputError(f"workers: found {options.workers}, applies to a local cluster only, not to a client")


def check_kind(client: object) -> None:
    """Raise InputError if ``client`` is not a Dask client."""
    if not hasattr(client, "nthreads"):
        how = "; a cluster has one: client=cluster.get_client()" if hasattr(client, "get_client") else ""
        raise InputError(f"client: found {brief_repr(client)}, must be a Dask client{how}")


def connect_client(client: "Client | None", options: RunOptions, stack: ExitStack) -> "Client | None":
    """Return ``client``, a new client of the options' scheduler, or the active client of the caller.

    In a Dask task the active client is that of the task. Return None if a local cluster is needed, because no client is
    active or the options have a number of workers. Raise InputError if the options ask for a performance report that
    the scheduler cannot draw.
    """
    if client is None and options.scheduler is not None:
        client = stack.enter_context(connect_to_scheduler(options.scheduler, options.tls, options.timing))
    elif client is None and options.workers is None:
        task = task_client()
        client = active_client() if task is None else stack.enter_context(task)
        if client is not None:
            address = getattr(client.scheduler, "address", "a lost scheduler")
            options.report(Progress(f"using the active Dask client, connected to {address}"))
    check_report(client, options)
    return client


def worker_count(client: "Client | None", options: RunOptions) -> int:
    """Return the number of threads of a run's cluster; without a client, the number of processes that will be started.

    Raise InputError if this process cannot start processes.
    """
    if client is None:
        count = options.workers or processors()
        if options.tile is None:
            check_startable(count)
        return count
    return count_threads(client, options.wait_for_first, options.wait, options.timing.poll)


def check_report(client: "Client | None", options: RunOptions) -> None:
    """Raise InputError if the options ask for a performance report that the scheduler cannot draw.

    Without a client the scheduler will run in this process.
    """
    if options.performance_report is None:
        return
    if client is None:
        drawable = has_dashboard()
    else:
        with loss_reported(client):
            drawable = client.run_on_scheduler(has_dashboard)
    if not drawable:
        raise InputError("performance_report: needs Bokeh on the scheduler's host: pip install bokeh")
