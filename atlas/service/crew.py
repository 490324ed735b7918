"""Workers for the jobs of a run: those of a client, or processes that the first job starts."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from atlas.errors import RunError
from atlas.service.batches import LEAST_MEMORY, J, Labour, R
from atlas.service.cluster import leave_if_bootstrapping
from atlas.service.dispatch import Workers, Workforce, workforce
from atlas.service.hiring import check_client, hired, joined, worker_count
from atlas.service.lease import Claim, claimed
from atlas.service.notebook import reporting
from atlas.service.options import RunOptions
from atlas.service.progress import LOG_INTERVAL, Progress, prepare_kernels
from atlas.service.summary import TileFailure
from atlas.store.location import Given, Place, place_of, sendable, waiting
from atlas.store.making import remove_half_made
from atlas.store.sidecar import CLAIM, claim_token, notes_of
from atlas.store.store import Atlas, open_handle
from atlas.task.site import Site, prepare
from workers import SOLVER_VERSION

if TYPE_CHECKING:
    from distributed import Client


class Timed(Protocol):
    """The receipt of a job."""

    @property
    def processor_seconds(self) -> float:
        """The time of a worker's processor that it took."""


T = TypeVar("T", bound=Timed)


@dataclass
class Crew(Generic[J, R]):
    """The workers of a store that is claimed, set up when ``force`` is first asked for, if need be as new processes.

    act       does a job
    kernels   that the jobs take
    threads   threads of the workers: those asked for, or as many as were seen
    memory    bytes that a worker needs
    begin     when the jobs began, by the monotonic clock

    ``tasks`` and ``processor_seconds`` are the jobs that ``do`` has had done, and what they took.
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
    tasks: int = 0
    processor_seconds: float = 0.0
    reported: float = 0.0
    last: str = ""

    @classmethod
    def at_work(
        cls,
        handle: Atlas,
        act: Callable[[J], R],
        kernels: tuple[str, ...],
        client: "Client | None",
        options: RunOptions,
        stack: ExitStack,
        needed: bool = True,
    ) -> "Crew[J, R]":
        """The crew of a store that is claimed from now on, until ``stack`` is closed; without workers if not needed.

        Its handle writes behind the fence of the claim.
        """
        client = joined(client, options, stack) if needed else None
        threads = worker_count(client, options) if needed else 0
        claim = stack.enter_context(claimed_place(handle.place, options))
        return cls(handle.at(claim.guard(handle.place)), act, kernels, options, claim, stack, threads, client)

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

    def do(
        self: "Crew[J, T]", jobs: Sequence[J], doing: Callable[[], Progress], take: Callable[[T], None] = lambda _: None
    ) -> None:
        """Have jobs done whose results are parts of the store; ``doing`` says how far, ``take`` gets each receipt.

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
            self.tasks += 1
            self.processor_seconds += outcome.processor_seconds
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


@contextmanager
def called(
    store: "Given | Atlas", client: "Client | None", options: RunOptions
) -> Iterator[tuple[Atlas, RunOptions, ExitStack]]:
    """A call that works on a store: its handle, the options with what reports progress, and what ends with the call.

    InputError for a client that does not go with the options, and if there is no atlas.
    """
    leave_if_bootstrapping()
    check_client(client, options)
    with reporting(options.on_progress) as report, ExitStack() as stack:
        options = replace(options, on_progress=report)
        yield waiting_handle(store, options), options, stack


def waiting_handle(store: "Given | Atlas", options: RunOptions) -> Atlas:
    """The handle of a store that a call works on, which waits for its server as long as the options say."""
    if isinstance(store, Atlas):
        return store.at(waiting(store.place, options.patience))
    return open_handle(waiting(place_of(store, storage_options=options.storage_options), options.patience))


@contextmanager
def claimed_place(place: Place, options: RunOptions) -> Iterator[Claim]:
    """Hold the claim of a store. Leftovers of dead runs are removed when it begins, their notes when it ends.

    A beat waits only for the place's own patience: another follows, and none should delay the end of a run whose store
    is away. To remove the notes, and for a beat to succeed, a run waits as long as the options say; meanwhile nothing
    is written without a look at the claim.
    """
    notes = notes_of(waiting(place, options.patience))

    def say(text: str) -> None:
        options.report(Progress(text))

    def tidy() -> None:
        if claim_token(notes) == claim.token:  # else they are another run's
            notes.clear(keep=CLAIM)

    patience = options.patience if place.local is None else 0.0
    with claimed(notes_of(place), str(place), say, options.timing, patience) as claim:
        if place.local is not None:
            remove_half_made(place.local)
        try:
            yield claim
        except Exception:
            raise  # tiles that were begun may have something to do with it: their notes stay
        except BaseException:
            tidy()
            raise
        tidy()
