"""The options of a run beyond its spec and its store: where it computes, what it reports, how long it waits."""

from collections.abc import Callable
from dataclasses import dataclass

from atlas.errors import InputError, shown
from atlas.service.cluster import Tls
from atlas.service.plan import Plan
from atlas.service.progress import Progress
from atlas.service.timing import TIMING, Timing
from atlas.spec.spec import Spec
from atlas.store.outage import LONG
from atlas.task.retry import Retry

MOST_WORKERS = 1024
"""Processes of a local cluster: more than a machine has processors, and few enough to start."""


Report = Callable[[Progress], None]


def without_time(spec: Spec, plan: Plan, report: Report) -> Plan:
    """The plan as it is: nothing is solved to know how long a run will take."""
    return plan


@dataclass(frozen=True)
class RunOptions:
    """Options of ``run``, ``extend`` and ``submit``; InputError for options that contradict each other.

    workers       processes of a local cluster, by default one a processor; not with a scheduler or a client
    scheduler     address of a Dask scheduler, such as ``tcp://host:8786``
    tls           files for an encrypted connection to it
    retry         which cells of finished tiles to solve again; nothing else is solved then
    estimate      adds an expected time to a plan before the first tile is solved, such as
                  ``service.probe.estimated``; called with the spec, the plan and a function for progress
    on_progress   called with each Progress; None for a bar in a notebook, and nothing elsewhere
    patience      seconds to wait for a server at a URL that stops answering
    timing        how long the run waits for everything else
    """

    workers: int | None = None
    scheduler: str | None = None
    tls: Tls | None = None
    retry: Retry | None = None
    estimate: Callable[[Spec, Plan, Report], Plan] = without_time
    on_progress: Callable[[Progress], None] | None = None
    patience: float = LONG
    timing: Timing = TIMING

    def __post_init__(self) -> None:
        if self.workers is not None and (not 1 <= self.workers <= MOST_WORKERS or self.scheduler is not None):
            found, most = shown(self.workers), f"must be 1 to {MOST_WORKERS}"
            raise InputError(f"workers: found {found}, {most}, and goes with a local cluster only")
        if not self.patience >= 0:
            raise InputError(f"patience: found {shown(self.patience)}, must be 0 s or more")

    def report(self, progress: Progress) -> None:
        """Hand a snapshot to ``on_progress``, where there is one."""
        if self.on_progress is not None:
            self.on_progress(progress)


DEFAULTS = RunOptions()
