"""Jobs for the workers of a cluster, in the order in which they are wanted at this moment.

How they are sent, tried again and given up is that of all work on a cluster, see ``atlas.service.dispatch``. What is
no longer wanted is dropped: here at once, on the cluster where it has not begun. Dask cannot interrupt what has; its
results come back all the same, and are handed on.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from atlas.errors import InputError, RunError
from atlas.explore.threads import restarting_thread, why
from atlas.service.batches import MIN_WORKER_MEMORY
from atlas.service.cluster import CLUSTER_LOST_MESSAGE, loss_reported
from atlas.service.dispatch import Dispatcher, WorkerStatus
from atlas.service.summary import TileFailure
from atlas.service.timing import TIMING, Timing

if TYPE_CHECKING:
    from distributed import Client

RATE_WINDOW_SECONDS = 10.0
"""The rate is taken over this number of last seconds."""

A = TypeVar("A")
Task = tuple[Callable[[Any], Any], Any]
"""A function and its argument."""
Take = Callable[[Any], int]
"""Takes the result of a task, and returns how many cells that has."""


@dataclass(frozen=True)
class ServiceState:
    """How the work is going.

    trouble   why nothing is solved, empty if nothing is wrong
    workers   threads of the cluster
    rate      cells solved per second, of late
    """

    trouble: str = "connecting"
    workers: int = 0
    rate: float = 0.0


class ServiceJob(Protocol):
    """Something that a worker does for those who want it; its methods are called from a thread of this service."""

    def is_ready(self) -> bool:
        """Whether it may be sent now; others go first while it may not."""
        return True

    def build_task(self) -> tuple[Task, Take] | None:
        """The task that is sent, and the function for its result; None if that is known meanwhile."""

    def on_failed(self, reason: str) -> None:
        """Take note that the job is given up, for bad input or after some tries, and the error that it raised."""


@dataclass(frozen=True, eq=False)
class Computation(Generic[A]):
    """A question of a panel to the crew: a function of one value.

    read    the answer that the function's result is, made in a thread of this service
    cells   how many cells are solved for it
    """

    function: Callable[[Any], Any]
    argument: Any
    postprocess: Callable[[Any], A] = lambda result: result
    n_cells: int = 0


@dataclass(frozen=True, eq=False)
class ComputationJob(ServiceJob):
    """A question and who waits for its answer: ``take`` gets that, ``refuse`` why there is none, both in a thread of
    this service.
    """

    question: Computation[Any]
    take: Callable[[Any], None]
    refuse: Callable[[str], None]

    def build_task(self) -> tuple[Task, Take]:
        """See ``ServiceJob``."""
        return (self.question.function, self.question.argument), self._take

    def _take(self, result: Any) -> int:
        self.take(self.question.postprocess(result))
        return self.question.n_cells

    def on_failed(self, reason: str) -> None:
        """See ``ServiceJob``."""
        self.refuse(reason)


@dataclass(frozen=True)
class SubmittedJob:
    """A job on its way: its number, and all that crosses the scheduler."""

    index: tuple[int, ...]
    task: Task


@dataclass(frozen=True)
class JobOutput:
    """The result of the job of this number, or its words about bad input."""

    index: tuple[int, ...]
    result: Any = None
    error: str = ""


def answer(sent: SubmittedJob) -> JobOutput:
    """Do a job on a worker. Bad input stays bad, so that it is no failure that is tried again."""
    function, value = sent.task
    try:
        return JobOutput(sent.index, function(value))
    except InputError as error:
        return JobOutput(sent.index, error=str(error))


class JobQueue(Iterator[ServiceJob]):
    """Which job comes first: of all who want some in turn, the first that is ready and not under way.

    As an iterator it may have none now and one later.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._jobs: dict[Hashable, deque[ServiceJob]] = {}
        self._turn: deque[Hashable] = deque()
        self._under_way: set[ServiceJob] = set()

    def request(self, consumer: Hashable, jobs: Iterable[ServiceJob], keep_earlier: bool) -> None:
        """See ``JobService.want``."""
        wanted = deque(jobs)
        with self._lock:
            wanted.extend(self._jobs.get(consumer, ()) if keep_earlier else ())
            if wanted:
                self._jobs[consumer] = wanted
                if consumer not in self._turn:
                    self._turn.append(consumer)
            else:
                self._jobs.pop(consumer, None)
                if consumer in self._turn:
                    self._turn.remove(consumer)

    def n_remaining(self, consumer: Hashable) -> int:
        """See ``JobService.left``."""
        with self._lock:
            return len(self._jobs.get(consumer, ()))

    def __contains__(self, job: ServiceJob) -> bool:
        """Whether anybody waits for a job."""
        with self._lock:
            return any(job in jobs for jobs in self._jobs.values())

    def __next__(self) -> ServiceJob:
        """The next job, which is under way from now on."""
        with self._lock:
            for _ in range(len(self._turn)):
                who = self._turn[0]
                self._turn.rotate(-1)
                for job in self._jobs.get(who, ()):
                    if job not in self._under_way and job.is_ready():
                        self._under_way.add(job)
                        return job
        raise StopIteration

    def release(self, job: ServiceJob | None = None) -> None:
        """Count a job, or all, as no longer under way."""
        with self._lock:
            self._under_way = self._under_way - {job} if job else set()

    def remove(self, job: ServiceJob) -> None:
        """Have nobody wait for a job any more."""
        with self._lock:
            self._under_way.discard(job)
            for jobs in self._jobs.values():
                with suppress(ValueError):
                    jobs.remove(job)


class JobService:
    """Has jobs done on the cluster that ``connect`` leads to; connects again whenever that is lost."""

    def __init__(self, connect: Callable[[], "AbstractContextManager[Client]"], timing: Timing = TIMING) -> None:
        self._connect, self._timing = connect, timing
        self._lock, self._stopped, self._woken = threading.Lock(), threading.Event(), threading.Event()
        self._wanted, self._numbers = JobQueue(), count()
        self._sent: dict[tuple[int, ...], tuple[ServiceJob, Take]] = {}  # for this service's own thread alone
        self._solved: deque[tuple[float, int]] = deque()
        self._state = ServiceState()
        self._thread = restarting_thread(
            "atlas-patches", self._serve, lambda error: self._say(f"{error}; trying again")
        )

    def request(self, consumer: Hashable, jobs: Iterable[ServiceJob], keep_earlier: bool = False) -> None:
        """Want these jobs from now on, in this order, with ``keep_earlier`` before the earlier ones; none cancels
        all.
        """
        self._wanted.request(consumer, jobs, keep_earlier)
        self._woken.set()

    def n_remaining(self, consumer: Hashable) -> int:
        """Jobs that somebody still waits for."""
        return self._wanted.n_remaining(consumer)

    @property
    def state(self) -> ServiceState:
        """How the work is going."""
        since = time.monotonic() - RATE_WINDOW_SECONDS
        with self._lock:
            while self._solved and self._solved[0][0] < since:
                self._solved.popleft()
            cells = sum(count for _, count in self._solved)
            return ServiceState(self._state.trouble, self._state.workers, cells / RATE_WINDOW_SECONDS)

    def stop(self) -> None:
        """End the work, and the cluster where it is a local one."""
        self._stopped.set()
        self._woken.set()
        self._thread.join()

    def _serve(self) -> None:
        while not self._stopped.is_set():
            try:
                with self._connect() as client, loss_reported(client), suppress(_StoppedError):
                    while True:
                        self._work(client)
            except (InputError, RunError, OSError) as error:
                self._say(f"{_without_advice(error)}; trying again")
            finally:
                self._forget()
            self._stopped.wait(self._timing.poll)

    def _work(self, client: "Client") -> None:
        """Have jobs done until no worker may have one: then give up the jobs under way, and readmit all.

        _StoppedError once this service is to end.
        """
        dispatcher = Dispatcher(client, answer, self._timing, MIN_WORKER_MEMORY, queued_seconds=0.0)
        try:
            while True:
                self._woken.clear()
                for outcome in dispatcher.iter_outcomes(
                    filter(None, map(self._made, self._wanted)), partial(self._look, dispatcher)
                ):
                    self._take(outcome)
                self._woken.wait(self._timing.tick)
        except RunError as error:
            if client.status != "running" or str(error) == CLUSTER_LOST_MESSAGE:
                raise
            for job, _ in self._sent.values():
                self._give_up(job, _without_advice(error))
            self._forget()

    def _look(self, force: "Dispatcher[SubmittedJob, JobOutput]", workers: WorkerStatus) -> None:
        """Report the state of the cluster, and cancel what nobody wants any more and no worker has."""
        if self._stopped.is_set():
            raise _StoppedError
        self._say(workers.trouble or ("" if workers.threads else "no worker: waiting for one"), workers.threads)
        for sent in force.cancel_stale(lambda sent: self._sent[sent.index][0] not in self._wanted):
            job, _ = self._sent.pop(sent.index)
            self._wanted.release(job)

    def _say(self, trouble: str, workers: int = 0) -> None:
        with self._lock:
            self._state = ServiceState(trouble, workers)

    def _made(self, job: ServiceJob) -> SubmittedJob | None:
        """A job as it is sent; None if it needs not be."""
        made = self._tried(job, job.build_task)
        if made is None:
            self._wanted.remove(job)
            return None
        task, take = made
        sent = SubmittedJob((next(self._numbers),), task)
        self._sent[sent.index] = job, take
        return sent

    def _take(self, outcome: JobOutput | TileFailure) -> None:
        """Hand on the result of a job, or why it is given up."""
        job, take = self._sent.pop(outcome.index)
        if isinstance(outcome, TileFailure):
            self._give_up(job, outcome.message)
        elif outcome.error:
            self._give_up(job, outcome.error)
        else:
            cells = self._tried(job, partial(take, outcome.result)) or 0
            with self._lock:
                self._solved.append((time.monotonic(), cells))
        self._wanted.remove(job)  # not before it is known: who asks meanwhile would have it solved again

    def _forget(self) -> None:
        """Count nothing as sent."""
        self._sent.clear()
        self._wanted.release()

    def _tried(self, job: ServiceJob, step: Callable[[], Any]) -> Any:
        """The result of a step of a job; None after an unexpected exception, which ends that job alone."""
        try:
            return step()
        except (RunError, OSError):
            raise
        except Exception as error:
            logging.getLogger(__name__).exception("a job could not be done")
            self._give_up(job, str(error) if isinstance(error, InputError) else why(error))
            return None

    def _give_up(self, job: ServiceJob, reason: str) -> None:
        """Give a job up; an exception of its ``failed`` is logged."""
        try:
            job.on_failed(reason)
        except Exception:
            logging.getLogger(__name__).exception("the end of a job could not be reported")
        self._wanted.remove(job)


class _StoppedError(Exception):
    """This service is to end."""


def _without_advice(error: Exception) -> str:
    """The text of an error, without the advice for a run that follows."""
    return str(error).partition("; ")[0]
