"""Jobs that the explorer runs on a Dask cluster, in the order of priority that its pages give at the moment.

Submission, retries and failures are those of ``atlas.service.dispatch``. A job is submitted only while a consumer, a
page or a panel, waits for it. A job that has been submitted is done and delivered even if no consumer waits any more.
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
from atlas.service.cluster import CLUSTER_LOST_MESSAGE, loss_reported
from atlas.service.dispatch import Dispatcher, WorkerStatus
from atlas.service.summary import TileFailure
from atlas.service.timing import TIMING, Timing

if TYPE_CHECKING:
    from distributed import Client

RATE_WINDOW_SECONDS = 10.0
"""Length, in seconds, of the sliding window over which the solving rate is averaged."""

A = TypeVar("A")
Task = tuple[Callable[[Any], Any], Any]
"""A module-level function and its argument."""
Take = Callable[[Any], int]
"""A function that takes the result of a task, and returns the number of cells in the result."""


@dataclass(frozen=True)
class ServiceState:
    """The state of the job service.

    trouble   why no cells are solved; empty if nothing is wrong
    workers   number of worker threads of the cluster
    rate      cells solved per second, averaged over RATE_WINDOW_SECONDS
    """

    trouble: str = "connecting"
    workers: int = 0
    rate: float = 0.0


class ServiceJob(Protocol):
    """A job of the ``JobService``, which calls all its methods in the service's own thread."""

    def build_task(self) -> tuple[Task, Take] | None:
        """Return the task to submit and the function that takes its result.

        Return None if the result has become known meanwhile.
        """

    def on_failed(self, reason: str) -> None:
        """React to a job that is given up for ``reason``, after invalid input or repeated failures."""


@dataclass(frozen=True, eq=False)
class Computation(Generic[A]):
    """A function call that a panel of the page has done on a worker.

    function      module-level function of one argument
    argument      its argument
    postprocess   turns the result into what the panel shows, in the service's thread
    n_cells       number of cells that the call solves, for the displayed solving rate
    """

    function: Callable[[Any], Any]
    argument: Any
    postprocess: Callable[[Any], A] = lambda result: result
    n_cells: int = 0


@dataclass(frozen=True, eq=False)
class ComputationJob(ServiceJob):
    """A ``Computation`` as a job, with the callbacks for its outcome.

    question   the computation
    take       receives the post-processed result, in the service's thread
    refuse     receives the error message, in the service's thread
    """

    question: Computation[Any]
    take: Callable[[Any], None]
    refuse: Callable[[str], None]

    def build_task(self) -> tuple[Task, Take]:
        """Return the function and argument of the computation, and the function that delivers its result."""
        return (self.question.function, self.question.argument), self._take

    def _take(self, result: Any) -> int:
        self.take(self.question.postprocess(result))
        return self.question.n_cells

    def on_failed(self, reason: str) -> None:
        """Deliver the reason why the computation failed."""
        self.refuse(reason)


@dataclass(frozen=True)
class SubmittedJob:
    """A job as it is sent through the scheduler to a worker.

    index   number that identifies the job
    task    the function to call on the worker, and its argument
    """

    index: tuple[int, ...]
    task: Task


@dataclass(frozen=True)
class JobOutput:
    """What a worker sends back for a job.

    index    number that identifies the job
    result   the result of the task
    error    the message about invalid input; empty if there is none
    """

    index: tuple[int, ...]
    result: Any = None
    error: str = ""


def answer(sent: SubmittedJob) -> JobOutput:
    """Run a job on a worker and return its output; an InputError becomes a message, so that the job is not retried."""
    function, value = sent.task
    try:
        return JobOutput(sent.index, function(value))
    except InputError as error:
        return JobOutput(sent.index, error=str(error))


class JobQueue(Iterator[ServiceJob]):
    """The jobs that consumers (pages and panels) wait for, in each consumer's order; consumers take turns.

    As an iterator it yields the next job that is not in flight, that is, not yet submitted. It may run dry and yield
    again later.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._jobs: dict[Hashable, deque[ServiceJob]] = {}
        self._turn: deque[Hashable] = deque()
        self._under_way: set[ServiceJob] = set()

    def request(self, consumer: Hashable, jobs: Iterable[ServiceJob], keep_earlier: bool) -> None:
        """Replace the jobs that ``consumer`` waits for by ``jobs``, in order of priority.

        See ``JobService.request``.
        """
        queue = deque(jobs)
        with self._lock:
            queue.extend(self._jobs.get(consumer, ()) if keep_earlier else ())
            if queue:
                self._jobs[consumer] = queue
                if consumer not in self._turn:
                    self._turn.append(consumer)
            else:
                self._jobs.pop(consumer, None)
                if consumer in self._turn:
                    self._turn.remove(consumer)

    def n_remaining(self, consumer: Hashable) -> int:
        """Return the number of jobs that a consumer, such as a panel of a page, still waits for."""
        with self._lock:
            return len(self._jobs.get(consumer, ()))

    def __next__(self) -> ServiceJob:
        """Return the next job that is not in flight, and mark it as in flight."""
        with self._lock:
            for _ in range(len(self._turn)):
                who = self._turn[0]
                self._turn.rotate(-1)
                for job in self._jobs.get(who, ()):
                    if job not in self._under_way:
                        self._under_way.add(job)
                        return job
        raise StopIteration

    def release_all(self) -> None:
        """Mark all jobs as not in flight, so that they are submitted again."""
        with self._lock:
            self._under_way = set()

    def remove(self, job: ServiceJob) -> None:
        """Remove a job from the queues of all consumers."""
        with self._lock:
            self._under_way.discard(job)
            for jobs in self._jobs.values():
                with suppress(ValueError):
                    jobs.remove(job)


class JobService:
    """Runs jobs on the Dask cluster that ``connect`` opens, and reconnects whenever the connection is lost."""

    def __init__(self, connect: Callable[[], "AbstractContextManager[Client]"], timing: Timing = TIMING) -> None:
        self._connect, self._timing = connect, timing
        self._lock, self._stopped, self._woken = threading.Lock(), threading.Event(), threading.Event()
        self._wanted, self._numbers = JobQueue(), count()
        self._sent: dict[tuple[int, ...], tuple[ServiceJob, Take]] = {}  # used only in the service's own thread
        self._solved: deque[tuple[float, int]] = deque()
        self._state = ServiceState()
        self._thread = restarting_thread(
            "atlas-patches", self._serve, lambda error: self._say(f"{error}; trying again")
        )

    def request(self, consumer: Hashable, jobs: Iterable[ServiceJob], keep_earlier: bool = False) -> None:
        """Replace the jobs that ``consumer``, a page or a panel, waits for by ``jobs``, in order of priority.

        With ``keep_earlier`` the new jobs go before the consumer's earlier jobs. An empty ``jobs`` cancels all.
        """
        self._wanted.request(consumer, jobs, keep_earlier)
        self._woken.set()

    def n_remaining(self, consumer: Hashable) -> int:
        """Return the number of jobs that a consumer waits for."""
        return self._wanted.n_remaining(consumer)

    @property
    def state(self) -> ServiceState:
        """The state of the service, with the present solving rate."""
        since = time.monotonic() - RATE_WINDOW_SECONDS
        with self._lock:
            while self._solved and self._solved[0][0] < since:
                self._solved.popleft()
            cells = sum(count for _, count in self._solved)
            return ServiceState(self._state.trouble, self._state.workers, cells / RATE_WINDOW_SECONDS)

    def stop(self) -> None:
        """Stop the service, and the cluster if it is a local one."""
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
        """Run jobs until all workers are excluded, that is, get no further jobs; then give up the jobs in flight.

        The caller starts again with all workers admitted. Raise _StoppedError once the service is stopped.
        """
        dispatcher = Dispatcher(client, answer, self._timing, queue=False)
        try:
            while True:
                self._woken.clear()
                for outcome in dispatcher.iter_outcomes(filter(None, map(self._made, self._wanted)), self._look):
                    self._take(outcome)
                self._woken.wait(self._timing.tick)
        except RunError as error:
            if client.status != "running" or str(error) == CLUSTER_LOST_MESSAGE:
                raise
            for job, _ in self._sent.values():
                self._give_up(job, _without_advice(error))
            self._forget()

    def _look(self, workers: WorkerStatus) -> None:
        """Record the state of the cluster's workers. Raise _StoppedError once the service is stopped."""
        if self._stopped.is_set():
            raise _StoppedError
        self._say(
            workers.trouble or ("" if workers.threads else "no workers connected: waiting for one to join"),
            workers.threads,
        )

    def _say(self, trouble: str, workers: int = 0) -> None:
        with self._lock:
            self._state = ServiceState(trouble, workers)

    def _made(self, job: ServiceJob) -> SubmittedJob | None:
        """Return a job in the form that is sent to a worker; None if its result has become known meanwhile."""
        submission = self._tried(job, job.build_task)
        if submission is None:
            self._wanted.remove(job)
            return None
        task, take = submission
        sent = SubmittedJob((next(self._numbers),), task)
        self._sent[sent.index] = job, take
        return sent

    def _take(self, outcome: JobOutput | TileFailure) -> None:
        """Deliver the result of a job, or the reason why the job failed."""
        job, take = self._sent.pop(outcome.index)
        if isinstance(outcome, TileFailure):
            self._give_up(job, outcome.message)
        elif outcome.error:
            self._give_up(job, outcome.error)
        else:
            cells = self._tried(job, partial(take, outcome.result)) or 0
            with self._lock:
                self._solved.append((time.monotonic(), cells))
        self._wanted.remove(job)  # only after the result is delivered: an earlier request would solve the job again

    def _forget(self) -> None:
        """Mark all jobs as not submitted, since the connection is lost or begins anew."""
        self._sent.clear()
        self._wanted.release_all()

    def _tried(self, job: ServiceJob, step: Callable[[], Any]) -> Any:
        """Return the result of ``step``, a function that belongs to a job.

        If the function raises an unexpected exception, give up this job only, and return None.
        """
        try:
            return step()
        except (RunError, OSError):
            raise
        except Exception as error:
            logging.getLogger(__name__).exception("a job could not be done")
            self._give_up(job, str(error) if isinstance(error, InputError) else why(error))
            return None

    def _give_up(self, job: ServiceJob, reason: str) -> None:
        """Remove a job from all queues and call its ``on_failed``, whose exceptions are logged."""
        try:
            job.on_failed(reason)
        except Exception:
            logging.getLogger(__name__).exception("the end of a job could not be reported")
        self._wanted.remove(job)


class _StoppedError(Exception):
    """Ends the loop of the service's thread after the service has been stopped."""


def _without_advice(error: Exception) -> str:
    """Return the text of an error up to the first semicolon, without the advice that holds only for a run."""
    return str(error).partition("; ")[0]
