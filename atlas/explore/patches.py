"""Patches out to a cluster and their cells back, in the order in which they are wanted at this moment.

What is no longer wanted is dropped: here at once, on the cluster where it has not begun. Dask cannot interrupt what
has; its cells come back all the same, and are handed on.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from atlas.errors import InputError, RunError
from atlas.explore.patch import Patch, solve_patch
from atlas.service.cluster import LOST, loss_reported, worker_threads
from atlas.service.timing import TIMING, Timing

if TYPE_CHECKING:
    from distributed import Client, Future

ATTEMPTS = 3
"""How often a patch that raises, or whose workers die, is tried."""
SPARE = 1
"""Patches under way beyond one for each thread: the next begins as soon as one ends, and little is to be dropped."""
RATE_SECONDS = 10.0
"""The rate is taken over this number of last seconds."""

_LOST = LOST.partition(";")[0]  # what follows is advice for a run

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class State:
    """How the work is going.

    trouble   why nothing is solved, empty if nothing is wrong
    workers   threads of the cluster
    rate      cells solved per second, of late
    """

    trouble: str = "connecting"
    workers: int = 0
    rate: float = 0.0


@dataclass(frozen=True)
class Events:
    """The callbacks, called from a thread of this service.

    make      the patch of a key, just before it is sent; None if it is known meanwhile
    solved    the cells of a patch
    failed    a patch that was tried ATTEMPTS times, and what it raised
    dropped   a patch that was sent and failed: ``make`` is called for it again if it is still wanted
    """

    make: Callable[[Hashable], Patch | None]
    solved: Callable[[Hashable, Patch, Arrays], None]
    failed: Callable[[Hashable, str], None]
    dropped: Callable[[Hashable], None]


class Patches:
    """Solves patches on the cluster that ``connect`` leads to; connects again whenever that is lost."""

    def __init__(
        self, connect: Callable[[], "AbstractContextManager[Client]"], events: Events, timing: Timing = TIMING
    ) -> None:
        self._connect, self._events, self._timing = connect, events, timing
        self._lock, self._stopped = threading.Lock(), threading.Event()
        self._wanted: dict[Hashable, deque[Hashable]] = {}
        self._turn: deque[Hashable] = deque()
        self._ended: SimpleQueue[Future[Arrays] | None] = SimpleQueue()
        self._running: dict[Future[Arrays], tuple[Hashable, Patch]] = {}
        self._under_way: set[Hashable] = set()
        self._tries: dict[Hashable, int] = {}
        self._solved: deque[tuple[float, int]] = deque()
        self._state = State()
        self._thread = threading.Thread(target=self._serve, name="atlas-patches", daemon=True)
        self._thread.start()

    def want(self, who: Hashable, keys: Iterable[Hashable]) -> None:
        """From now on these patches are wanted, in this order; an empty list cancels all."""
        wanted = deque(keys)
        with self._lock:
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
        """Patches that somebody still waits for."""
        with self._lock:
            return len(self._wanted.get(who, ()))

    @property
    def state(self) -> State:
        """How the work is going."""
        since = time.monotonic() - RATE_SECONDS
        with self._lock:
            while self._solved and self._solved[0][0] < since:
                self._solved.popleft()
            cells = sum(count for _, count in self._solved)
            return State(self._state.trouble, self._state.workers, cells / RATE_SECONDS)

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
                with self._lock:
                    lost = [key for key, _ in self._running.values()]
                    self._running.clear()
                    self._under_way.clear()
                for key in lost:
                    self._events.dropped(key)
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
                while len(self._running) < threads + SPARE and threads and self._submit(client):
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
            self._state = State(trouble, workers)

    def _drop(self, client: "Client") -> None:
        """Cancel what nobody wants any more and no worker has."""
        with self._lock:
            wanted = {key for keys in self._wanted.values() for key in keys}
            stale = [future for future, (key, _) in self._running.items() if key not in wanted]
        if not stale:
            return
        with suppress(OSError):
            begun = {key for keys in client.processing().values() for key in keys}
            idle = [future for future in stale if future.key not in begun and not future.done()]
            client.cancel(idle)
            for future in idle:
                self._events.dropped(self._forget(future))

    def _next(self) -> Hashable | None:
        """The next patch to send: of all who want some in turn, the first that is not under way."""
        with self._lock:
            for _ in range(len(self._turn)):
                who = self._turn[0]
                self._turn.rotate(-1)
                for key in self._wanted.get(who, ()):
                    if key not in self._under_way:
                        self._under_way.add(key)
                        return key
        return None

    def _submit(self, client: "Client") -> bool:
        key = self._next()
        if key is None:
            return False
        patch = self._events.make(key)
        if patch is None:
            self._done_with(key)
            return True
        future = client.submit(solve_patch, patch, pure=False)
        with self._lock:
            self._running[future] = (key, patch)
        future.add_done_callback(self._ended.put)
        return True

    def _finish(self, future: "Future[Arrays]") -> None:
        key, patch = self._running[future]
        if future.status == "finished":
            arrays = future.result()
            self._forget(future)
            with self._lock:
                self._solved.append((time.monotonic(), int(patch.mask.sum())))
            self._events.solved(key, patch, arrays)
            self._done_with(key)  # not before it is known: who asks meanwhile would have it solved again
            return
        if future.status != "error":
            raise RunError(LOST)
        error = future.exception()
        self._forget(future)
        self._tries[key] = self._tries.get(key, 0) + 1
        if self._tries[key] >= ATTEMPTS:
            self._tries.pop(key)
            self._done_with(key)
            self._events.failed(key, " ".join(f"{type(error).__name__}: {error}".split()))
        else:
            self._events.dropped(key)

    def _forget(self, future: "Future[Arrays]") -> Hashable:
        """Count a patch as no longer sent, and return its key."""
        with self._lock:
            key, _ = self._running.pop(future)
            self._under_way.discard(key)
        future.release()
        return key

    def _done_with(self, key: Hashable) -> None:
        """Nobody has to wait for a patch any more."""
        with self._lock:
            self._under_way.discard(key)
            for keys in self._wanted.values():
                with suppress(ValueError):
                    keys.remove(key)
