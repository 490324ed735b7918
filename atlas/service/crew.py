"""Workers for jobs whose results are parts of a store: those of a client, or processes that the first job starts."""

import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from atlas.errors import RunError
from atlas.service.batches import J, Labour, R
from atlas.service.cluster import local_cluster
from atlas.service.dispatch import Workers, workforce
from atlas.service.lease import Claim
from atlas.service.options import RunOptions
from atlas.service.progress import LOG_INTERVAL, Progress, prepare_kernels
from atlas.service.summary import TileFailure
from atlas.text import plural

if TYPE_CHECKING:
    from distributed import Client


@dataclass
class Crew:
    """The workers of a store that is claimed; processes of this machine live until ``stack`` is closed.

    kernels   those that the jobs take
    threads   threads of the workers: those asked for, or as many as were seen
    begin     when the jobs began, by the monotonic clock
    """

    kernels: Iterable[str]
    options: RunOptions
    claim: Claim
    stack: ExitStack
    threads: int
    client: "Client | None"
    begin: float = field(default_factory=time.monotonic)
    told: float = 0.0
    last: str = ""

    def do(
        self, labour: Labour[J, R], jobs: Sequence[J], take: Callable[[R], None], doing: Callable[[], Progress]
    ) -> None:
        """Do jobs; ``take`` gets each receipt, ``doing`` says how far they are. RunError if a job fails for good."""
        if not jobs:
            return
        if self.client is None:
            prepare_kernels(self.options.report, *self.kernels)
            self.options.report(Progress(f"starting {plural(self.threads, 'worker')}"))
            self.client = self.stack.enter_context(local_cluster(self.threads))
            self.begin = time.monotonic()
        with workforce(self.client, labour, self.options.timing) as force:

            def tick(workers: Workers) -> None:
                self.claim.check()
                self.threads = max(self.threads, workers.threads)
                waiting = "" if workers.threads else "no worker left: waiting for one"
                self._report(doing(), workers.trouble or waiting)

            for outcome in force.outcomes(jobs, tick):
                if isinstance(outcome, TileFailure):
                    kept = "what is found is kept, and the same command resumes"
                    raise RunError(f"a task failed: {outcome.message}; {kept}")
                take(outcome)
                self._report(doing())

    def _report(self, progress: Progress, trouble: str = "") -> None:
        """Report how far the jobs are; in a log once every few seconds."""
        now = time.monotonic()
        stage = trouble or progress.stage
        passing = now - self.told < LOG_INTERVAL or stage == self.last
        if not passing:
            self.told, self.last = now, stage
        self.options.report(replace(progress, stage=stage, passing=passing))
