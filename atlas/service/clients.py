"""The workers of a run: those of a client, or processes started for it."""

from contextlib import ExitStack
from functools import partial
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
    """The client to work on: the given one, or a client of ``count`` processes, which are started now.

    Closing ``stack`` ends the performance report, if the options ask for one, and then the processes.
    """
    if client is None:
        stage = f"starting {plural(count, 'worker')}"
        options.report(Progress(stage))
        client = stack.enter_context(local_cluster(count, options.dashboard))
        link = dashboard_link(client) if options.dashboard and has_dashboard() else ""
        if link:
            options.report(Progress(stage, note=f"dashboard of the workers: {link}"))
    stack.enter_context(performance_reported(client, options.performance_report, partial(_not_written, options)))
    return client


def check_client(client: "Client | None", options: RunOptions) -> None:
    """InputError for an object that is no client, and if a number of workers is given for the caller's cluster."""
    if client is not None:
        check_kind(client)
    if client is not None and options.workers is not None:
        raise InputError(f"workers: found {options.workers}, applies to a local cluster only, not to a client")


def check_kind(client: object) -> None:
    """InputError for an object that is no client."""
    if not hasattr(client, "nthreads"):
        how = "; a cluster has one: client=cluster.get_client()" if hasattr(client, "get_client") else ""
        raise InputError(f"client: found {brief_repr(client)}, must be a Dask client{how}")


def connect_client(client: "Client | None", options: RunOptions, stack: ExitStack) -> "Client | None":
    """The client to work on: the given one, a new client of the options' scheduler, or the client the caller has open.

    In a Dask task that is the client of the task. None if a local cluster is needed: no client is open, or the options
    have a number of workers. InputError if the options ask for a performance report that the scheduler cannot draw.
    """
    if client is None and options.scheduler is not None:
        options.report(Progress(f"connecting to {options.scheduler}", transient=True))
        client = stack.enter_context(connect_to_scheduler(options.scheduler, options.tls, options.timing))
    elif client is None and options.workers is None:
        task = task_client()
        client = active_client() if task is None else stack.enter_context(task)
        if client is not None:
            address = getattr(client.scheduler, "address", "a scheduler that is gone")
            options.report(Progress(f"using the Dask client that is open, of {address}"))
    check_report(client, options)
    return client


def worker_count(client: "Client | None", options: RunOptions) -> int:
    """The number of threads of a run's cluster, or of processes that it is going to start.

    InputError if this process cannot start them.
    """
    if client is None:
        count = options.workers or processors()
        if options.tile is None:
            check_startable(count)
        return count
    return count_threads(client, options.wait_for_first, options.wait, options.timing.poll)


def check_report(client: "Client | None", options: RunOptions) -> None:
    """InputError if the options ask for a performance report that the scheduler cannot draw.

    Without a client this process is going to be the scheduler.
    """
    if options.performance_report is None:
        return
    if client is None:
        drawable = has_dashboard()
    else:
        with loss_reported(client):
            drawable = client.run_on_scheduler(has_dashboard)
    if not drawable:
        raise InputError("performance_report: the scheduler draws it, and has no Bokeh: pip install bokeh")


def _not_written(options: RunOptions, reason: str) -> None:
    stage = "ending"
    options.report(Progress(stage, note=f"performance report {options.performance_report}: not written ({reason})"))
