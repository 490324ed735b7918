"""Workers for jobs whose results are parts of a store: those of a client, or processes that the first job starts."""

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

from atlas.errors import RunError
from atlas.service.batches import J, Labour, R
from atlas.service.dispatch import Workers, workforce
from atlas.service.hiring import hired
from atlas.service.lease import Claim
from atlas.service.options import RunOptions
from atlas.service.progress import LOG_INTERVAL, Progress, prepare_kernels
from atlas.service.summary import TileFailure
from atlas.store.location import sendable
from atlas.store.store import Header
from atlas.task.known import forget_header
from atlas.task.part import Site, prepare
from workers import SOLVER_VERSION

if TYPE_CHECKING:
    from distributed import Client


@dataclass
class Crew:
    """The workers of a store that is claimed; processes of this machine live until ``stack`` is closed.

    kernels   that the jobs take
    threads   threads of the workers: those asked for, or as many as were seen
    begin     when the jobs began, by the monotonic clock
    """

    header: Header
    kernels: tuple[str, ...]
    options: RunOptions
    claim: Claim
    stack: ExitStack
    threads: int
    client: "Client | None"
    begin: float = field(default_factory=time.monotonic)
    reported: float = 0.0
    last: str = ""

    @cached_property
    def site(self) -> Site:
        """The store as the jobs get it."""
        header = self.header
        return Site(sendable(header.place), header.run_id, SOLVER_VERSION, self.options.patience, self.claim.token)

    @cached_property
    def hired(self) -> "Client":
        """The client that the jobs go to, with processes that are started for the first of them if none was given."""
        if self.client is None:
            prepare_kernels(self.options.report, *self.kernels)
        client = hired(self.client, self.threads, self.options, self.stack)
        self.begin = time.monotonic() if self.client is None else self.begin
        return client

    def do(
        self, work: Callable[[J], R], jobs: Sequence[J], take: Callable[[R], None], doing: Callable[[], Progress]
    ) -> None:
        """Have ``work`` done on each job; ``take`` gets each receipt, ``doing`` says how far they are.

        RunError if a job fails for good.
        """
        if not jobs:
            return
        client, site = self.hired, self.site
        leave = partial(forget_header, site.store, site.patience)
        labour = Labour(str(site.store), work, partial(prepare, site, self.kernels), leave)
        with workforce(client, labour, self.options.timing) as force:

            def tick(workers: Workers) -> None:
                self.claim.check()
                self.threads = max(self.threads, workers.threads)
                waiting = "" if workers.threads else "no worker left: waiting for one"
                self._report(doing(), workers.trouble or waiting)

            try:
                for outcome in force.outcomes(jobs, tick):
                    if isinstance(outcome, TileFailure):
                        kept = "what is found is kept, and the same command resumes"
                        raise RunError(f"a task failed: {outcome.message}; {kept}")
                    take(outcome)
                    self._report(doing())
            except RunError:
                with suppress(OSError):  # a store that cannot be reached says nothing of its claim
                    self.header.place.confirm()  # if the claim was taken, workers refuse for that reason
                raise

    def _report(self, progress: Progress, trouble: str = "") -> None:
        """Report how far the jobs are; in a log once every few seconds."""
        now = time.monotonic()
        stage = trouble or progress.stage
        passing = now - self.reported < LOG_INTERVAL or stage == self.last
        if not passing:
            self.reported, self.last = now, stage
        self.options.report(replace(progress, stage=stage, passing=passing))
