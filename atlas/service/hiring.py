"""The workers of a run: those of a client, or processes started for it."""

from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING

from atlas.errors import InputError
from atlas.service.cluster import dashboard_link, has_dashboard, local_cluster, loss_reported, performance_reported
from atlas.service.options import RunOptions
from atlas.service.progress import Progress
from atlas.text import plural

if TYPE_CHECKING:
    from distributed import Client


def hired(client: "Client | None", count: int, options: RunOptions, stack: ExitStack) -> "Client":
    """The client to work on: the one given, or that of ``count`` processes, which are started now, as is reported.

    ``stack`` ends them, and before them the performance report that the options ask for.
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


def check_report(client: "Client | None", options: RunOptions) -> None:
    """InputError if a performance report is asked for that the scheduler, or this process for None, cannot draw."""
    if options.performance_report is None:
        return
    if client is None:
        found = has_dashboard()
    else:
        with loss_reported(client):
            found = client.run_on_scheduler(has_dashboard)
    if not found:
        raise InputError("performance_report: the scheduler draws it, and has no Bokeh: pip install bokeh")


def _not_written(options: RunOptions, why: str) -> None:
    stage = "ending"
    options.report(Progress(stage, note=f"performance report {options.performance_report}: not written ({why})"))
