"""Jobs out to a cluster and their results back, in the order in which they are wanted at this moment.

What is no longer wanted is dropped: here at once, on the cluster where it has not begun. Dask cannot interrupt what
has; its results come back all the same, and are handed on.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from functools import partial
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from atlas.errors import InputError, RunError
from atlas.explore.threads import steady, why
from atlas.service.cluster import LOST, loss_reported, worker_threads
from atlas.service.timing import TIMING, Timing

if TYPE_CHECKING:
    from distributed import Client, Future

ATTEMPTS = 3
"""How often a job that raises, or whose workers die, is tried."""
SPARE = 1
"""Jobs under way beyond one for each thread: the next begins as soon as one ends, and little is to be dropped."""
RATE_SECONDS = 10.0
"""The rate is taken over this number of last seconds."""

_LOST = LOST.partition(";")[0]  # what follows is advice for a run

A = TypeVar("A")
Task = tuple[Callable[[Any], Any], Any]
"""A function and its argument."""


@dataclass(frozen=True)
class WorkState:
    """How the work is going.

    trouble   why nothing is solved, empty if nothing is wrong
    workers   threads of the cluster
    rate      cells solved per second, of late
    """

    trouble: str = "connecting"
    workers: int = 0
    rate: float = 0.0


class PatchJob(Protocol):
    """Something that a worker does for those who want it; its methods are called from a thread of this service."""

    def ready(self) -> bool:
        """Whether it may be sent now; others go first while it may not."""
        return True

    def make(self) -> tuple[Task, Any] | None:
        """What is sent, and what ``solved`` gets beside its result; None if the result is known meanwhile."""

    def solved(self, held: Any, found: Any) -> int:
        """Take the result, and return how many cells it has."""

    def failed(self, why: str) -> None:
        """Take note that the job is given up, for bad input or after ATTEMPTS tries, and what it raised."""


@dataclass(frozen=True, eq=False)
class Question(Generic[A]):
    """What a panel asks of the crew: a function of one value.

    read    the answer that the function's result is, made in a thread of this service
    cells   how many cells are solved for it
    """

    function: Callable[[Any], Any]
    value: Any
    read: Callable[[Any], A] = lambda found: found
    cells: int = 0


@dataclass(frozen=True, eq=False)
class Errand(PatchJob):
    """A question and who waits for its answer: ``take`` gets that, ``refuse`` why there is none, both in a thread of
    this service.
    """

    question: Question[Any]
    take: Callable[[Any], None]
    refuse: Callable[[str], None]

    def make(self) -> tuple[Task, Any]:
        """See ``PatchJob``."""
        return (self.question.function, self.question.value), None

    def solved(self, held: Any, found: Any) -> int:
        """See ``PatchJob``."""
        self.take(self.question.read(found))
        return self.question.cells

    def failed(self, why: str) -> None:
        """See ``PatchJob``."""
        self.refuse(why)


class Patches:
    """Has jobs done on the cluster that ``connect`` leads to; connects again whenever that is lost."""

    def __init__(self, connect: Callable[[], "AbstractContextManager[Client]"], timing: Timing = TIMING) -> None:
        self._connect, self._timing = connect, timing
        self._lock, self._stopped = threading.Lock(), threading.Event()
        self._wanted: dict[Hashable, deque[PatchJob]] = {}
        self._turn: deque[Hashable] = deque()
        self._ended: SimpleQueue[Future[Any] | None] = SimpleQueue()
        self._running: dict[Future[Any], tuple[PatchJob, Any]] = {}  # for this service's own thread alone
        self._tries: dict[PatchJob, int] = {}
        self._solved: deque[tuple[float, int]] = deque()
        self._state = WorkState()
        self._thread = steady("atlas-patches", self._serve, lambda error: self._say(f"{error}; trying again"))

    def want(self, who: Hashable, jobs: Iterable[PatchJob], too: bool = False) -> None:
        """From now on these jobs are wanted, in this order, with ``too`` before those that were; none cancels all."""
        wanted = deque(jobs)
        with self._lock:
            wanted.extend(self._wanted.get(who, ()) if too else ())
            if wanted:
                self._wanted[who] = wanted
                if who not in self._turn:
                    self._turn.append(who)
            else:
                self._wanted.pop(who, None)
                if who in self._turn:
                    self._turn.remove(who)
        self._ended.put(None)  # wakes the thread

    def left(self, who: Hashable) -> int:
        """Jobs that somebody still waits for."""
        with self._lock:
            return len(self._wanted.get(who, ()))

    @property
    def state(self) -> WorkState:
        """How the work is going."""
        since = time.monotonic() - RATE_SECONDS
        with self._lock:
            while self._solved and self._solved[0][0] < since:
                self._solved.popleft()
            cells = sum(count for _, count in self._solved)
            return WorkState(self._state.trouble, self._state.workers, cells / RATE_SECONDS)

    def stop(self) -> None:
        """End the work, and the cluster where it is a local one."""
        self._stopped.set()
        self._ended.put(None)
        self._thread.join()

    def _serve(self) -> None:
        while not self._stopped.is_set():
            try:
                with self._connect() as client, loss_reported(client):
                    self._work(client)
            except (InputError, RunError, OSError) as error:
                self._say(f"{str(error).replace(LOST, _LOST)}; trying again")
            finally:
                self._running.clear()
            self._stopped.wait(self._timing.poll)

    def _work(self, client: "Client") -> None:
        ticked, threads = float("-inf"), 0
        try:
            while not self._stopped.is_set():
                if client.status != "running":
                    raise RunError(LOST)
                if time.monotonic() - ticked >= self._timing.tick:
                    ticked, threads = time.monotonic(), self._looked(client)
                self._drop(client)
                while len(self._running) < threads + SPARE and self._submit(client):
                    pass
                try:
                    ended = self._ended.get(timeout=self._timing.tick)
                except Empty:
                    continue
                if ended is not None and ended in self._running:
                    self._finish(ended)
        finally:
            with suppress(Exception):  # a cluster that is gone has nothing to cancel
                client.cancel(list(self._running))

    def _looked(self, client: "Client") -> int:
        """Threads of the cluster now, which the state reports."""
        threads = sum(worker_threads(client).values())
        self._say("" if threads else "no worker: waiting for one", threads)
        return threads

    def _say(self, trouble: str, workers: int = 0) -> None:
        with self._lock:
            self._state = WorkState(trouble, workers)

    def _drop(self, client: "Client") -> None:
        """Cancel what nobody wants any more and no worker has."""
        with self._lock:
            wanted = {job for jobs in self._wanted.values() for job in jobs}
        stale = [future for future, (job, _) in self._running.items() if job not in wanted]
        if not stale:
            return
        with suppress(OSError):
            begun = {key for keys in client.processing().values() for key in keys}
            idle = [future for future in stale if future.key not in begun and not future.done()]
            client.cancel(idle)
            for future in idle:
                self._forget(future)

    def _next(self) -> PatchJob | None:
        """The next job to send: of all who want some in turn, the first that is not under way."""
        under_way = {job for job, _ in self._running.values()}
        with self._lock:
            for _ in range(len(self._turn)):
                who = self._turn[0]
                self._turn.rotate(-1)
                for job in self._wanted.get(who, ()):
                    if job not in under_way and job.ready():
                        return job
        return None

    def _submit(self, client: "Client") -> bool:
        job = self._next()
        if job is None:
            return False
        made = self._tried(job, job.make)
        if made is None:
            self._done_with(job)
            return True
        task, held = made
        future = client.submit(*task, pure=False)
        self._running[future] = (job, held)
        future.add_done_callback(self._ended.put)
        return True

    def _finish(self, future: "Future[Any]") -> None:
        job, held = self._running[future]
        if future.status == "finished":
            try:
                found = future.result(timeout=self._timing.connect)
            except TimeoutError:  # its worker is gone: Dask has it done again once there is another one
                future.add_done_callback(self._ended.put)
                return
            self._forget(future)
            cells = self._tried(job, partial(job.solved, held, found)) or 0
            with self._lock:
                self._solved.append((time.monotonic(), cells))
            self._done_with(job)  # not before it is known: who asks meanwhile would have it solved again
            return
        if future.status != "error":
            raise RunError(LOST)
        error = future.exception()
        self._forget(future)
        self._tries[job] = self._tries.get(job, 0) + 1
        if self._tries[job] >= ATTEMPTS or isinstance(error, InputError):  # bad input stays bad
            self._done_with(job)
            self._give_up(job, error)

    def _forget(self, future: "Future[Any]") -> None:
        """Count a job as no longer sent."""
        self._running.pop(future)
        future.release()

    def _tried(self, job: PatchJob, step: Callable[[], Any]) -> Any:
        """What a step of a job returns; None after a mistake of ours, which ends that job and not the work for all."""
        try:
            return step()
        except (RunError, OSError):
            raise
        except Exception as error:
            logging.getLogger(__name__).exception("a job could not be done")
            self._give_up(job, error)
            return None

    def _give_up(self, job: PatchJob, error: BaseException | None) -> None:
        """Have a job told that it is given up; a mistake in that is its own."""
        try:
            job.failed(str(error) if isinstance(error, InputError) else why(error))
        except Exception:
            logging.getLogger(__name__).exception("the end of a job could not be reported")

    def _done_with(self, job: PatchJob) -> None:
        """Nobody has to wait for a job any more."""
        self._tries.pop(job, None)
        with self._lock:
            for jobs in self._wanted.values():
                with suppress(ValueError):
                    jobs.remove(job)
