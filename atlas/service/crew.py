"""Workers for the jobs of a run: those of a client, or processes that the first job starts."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Generic

from atlas.errors import RunError
from atlas.service.batches import LEAST_MEMORY, J, Labour, R
from atlas.service.dispatch import Workers, Workforce, workforce
from atlas.service.hiring import hired
from atlas.service.lease import Claim
from atlas.service.options import RunOptions
from atlas.service.progress import LOG_INTERVAL, Progress, prepare_kernels
from atlas.service.summary import TileFailure
from atlas.store.location import sendable
from atlas.store.store import Atlas
from atlas.task.site import Site, prepare
from workers import SOLVER_VERSION

if TYPE_CHECKING:
    from distributed import Client


@dataclass
class Crew(Generic[J, R]):
    """The workers of a store that is claimed, set up when ``force`` is first asked for, if need be as new processes.

    act       does a job
    kernels   that the jobs take
    threads   threads of the workers: those asked for, or as many as were seen
    memory    bytes that a worker needs
    begin     when the jobs began, by the monotonic clock
    """

    handle: Atlas
    act: Callable[[J], R]
    kernels: tuple[str, ...]
    options: RunOptions
    claim: Claim
    stack: ExitStack
    threads: int
    client: "Client | None"
    memory: int = LEAST_MEMORY
    begin: float = field(default_factory=time.monotonic)
    reported: float = 0.0
    last: str = ""

    @cached_property
    def site(self) -> Site:
        """The store as the jobs get it."""
        handle = self.handle
        return Site(sendable(handle.place), handle.run_id, SOLVER_VERSION, self.options.patience, self.claim.token)

    @cached_property
    def force(self) -> Workforce[J, R]:
        """The workers, until ``stack`` is closed."""
        site = self.site
        if self.client is None:
            prepare_kernels(self.options.report, *self.kernels)
        client = hired(self.client, self.threads, self.options, self.stack)
        self.begin = time.monotonic() if self.client is None else self.begin
        labour = Labour(str(site.store), self.act, partial(prepare, site, self.kernels), site.forget, self.memory)
        return self.stack.enter_context(workforce(client, labour, self.options.timing))

    def outcomes(self, jobs: Iterable[J], tick: Callable[[Workers], None]) -> Iterator[R | TileFailure]:
        """The outcomes of jobs, see ``Workforce.outcomes``; RunError, too, if the claim has been taken meanwhile."""
        try:
            yield from self.force.outcomes(jobs, tick)
        except RunError:
            with suppress(OSError):  # a store that cannot be reached says nothing of its claim
                self.handle.place.confirm()  # if the claim was taken, workers refuse for that reason
            raise

    def do(self, jobs: Sequence[J], take: Callable[[R], None], doing: Callable[[], Progress]) -> None:
        """Have jobs done whose results are parts of the store; ``take`` gets each receipt, ``doing`` says how far.

        RunError if a job fails for good.
        """

        def tick(workers: Workers) -> None:
            self.claim.check()
            self.threads = max(self.threads, workers.threads)
            waiting = "" if workers.threads else "no worker left: waiting for one"
            self._report(doing(), workers.trouble or waiting)

        for outcome in self.outcomes(jobs, tick) if jobs else ():
            if isinstance(outcome, TileFailure):
                raise RunError(
                    f"a task failed: {outcome.message}; finished parts are kept, and the same command resumes"
                )
            take(outcome)
            self._report(doing())

    def _report(self, progress: Progress, trouble: str = "") -> None:
        """Report how far the jobs are; in a log once every few seconds."""
        now = time.monotonic()
        stage = trouble or progress.stage
        passing = now - self.reported < LOG_INTERVAL or stage == self.last
        if not passing:
            self.reported, self.last = now, stage
        self.options.report(replace(progress, stage=stage, passing=passing))
