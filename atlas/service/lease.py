"""The lease of a store: at most one coordinator writes a store at a time.

A lease is a small object in the store's sidecar, which only one of several processes can create. Its holder renews it
with heartbeats, each of which increments a counter. A run that finds a lease watches the counter by its own clock, so
clocks of different hosts need not agree. If the counter moves, the lease is valid. If the counter stands still for
``Timing.expire_after`` seconds, or the holder's process no longer exists, the lease has expired, and another run writes
its own token over it. The run whose token the object holds has the lease: a heartbeat and every commit read the token
first. A holder that was suspended, or one of two runs that took over at the same time, therefore notices that it has
no lease. What it wrote before was right too, since the cells of a store are a function of its spec and solver version.
``atlas status`` and ``atlas cancel`` report an expired lease and leave it in place.
"""

import json
import os
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from atlas.errors import InputError, NetworkError, RunError, to_one_line
from atlas.platform import is_running, process_name
from atlas.service.timing import TIMING, Timing
from atlas.store.object_backend import StoreBackend, with_patience
from atlas.store.sidecar import LEASE_NAME, clear_sidecar, read_lease_token, with_confirmation

_RELEASES = 3
"""Number of attempts to remove the lease at the end of a run; if all fail, the lease expires."""
STOP = "stop"
"""Name of the object in a store's sidecar by which a run is asked to stop; it holds the token of the run's lease."""


@dataclass(frozen=True)
class LeaseRecord:
    """The contents of a lease, the object that gives one run the right to write a store.

    token      unique identifier of the lease
    beat       number of renewals so far
    host       name of the holder's host
    pid        process id of the holder
    process    unique name of the holder's process; empty on systems without such names
    cancelled  True if the holder has been asked to stop
    progress   the holder's report of its progress; empty before the first report

    Raise ValueError for a field that no holder writes.
    """

    token: str
    beat: int
    host: str
    pid: int
    process: str
    cancelled: bool = False
    progress: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        kinds = {"token": str, "beat": int, "host": str, "pid": int, "process": str, "cancelled": bool}
        wrong = [name for name, kind in kinds.items() if type(getattr(self, name)) is not kind]
        if wrong or not isinstance(self.progress, Mapping):
            raise ValueError(f"wrong type of {', '.join(wrong) or 'progress'}")
        if not 0 < self.pid < 2**31 or len(self.process.split()) not in (0, 4):
            raise ValueError(f"no process: {self.pid}, {self.process!r}")

    def pack(self) -> bytes:
        """Return the record as bytes, the content of a lease."""
        return json.dumps(asdict(self)).encode()

    @classmethod
    def unpack(cls, data: bytes) -> "LeaseRecord | None":
        """Return the record from the bytes of a lease; None if they are damaged, for example by a crash of the
        system.
        """
        try:
            return cls(**json.loads(data))
        except (ValueError, TypeError, RecursionError):
            return None

    def number(self, name: str) -> float:
        """Return a number from the holder's report of its progress, by name; 0 if it is missing."""
        value = self.progress.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            return 0
        return value if abs(value) < 2**63 else 0  # NaN fails the comparison

    @property
    def trouble(self) -> str:
        """The holder's reason why the run makes no progress; empty if it reports none."""
        value = self.progress.get("trouble")
        return to_one_line(value) if isinstance(value, str) else ""

    @property
    def is_alive(self) -> bool | None:
        """True if the holder's process runs, False if it does not; None if this host cannot know."""
        return is_running(self.pid, self.process)

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}"


class Lease:
    """A lease held by this run; a background thread renews it until ``release``.

    ``lost`` is the reason why the lease is no longer held, and empty while it is. If no heartbeat succeeds for
    ``timing.expire_after`` seconds, another run may take the lease over as soon as the store responds again. This run
    then waits for a heartbeat to succeed, which is possible only if no other run has taken over. It waits at most
    ``patience`` seconds, or ``timing.expire_after`` if that is longer.
    """

    def __init__(
        self, sidecar: StoreBackend, record: LeaseRecord, timing: Timing = TIMING, patience: float = 0.0
    ) -> None:
        self._sidecar, self._record, self._timing = sidecar.with_lease(self._confirm), record, timing
        self._advanced, self._most_silent = time.monotonic(), max(timing.expire_after, patience)
        self.lost = ""
        self._failure: OSError | None = None
        self._released, self._one_beat = threading.Event(), threading.Lock()
        self._progress: Mapping[str, Any] = {}
        self._thread = threading.Thread(target=self._beat_on, name="atlas-lease", daemon=True)
        self._thread.start()

    @property
    def token(self) -> str:
        """The unique token of this run's lease."""
        return self._record.token

    def set_progress(self, progress: Mapping[str, Any]) -> None:
        """Set the report of progress that the next renewals of the lease write with it.

        The first report is written at once, before the first tile.
        """
        first, self._progress = not self._progress, progress
        if first:
            with suppress(OSError):
                self._beat()

    def check(self, waiting: Callable[[], None] = lambda: None) -> None:
        """Raise RunError if this run has lost the lease or has been asked to stop.

        While it is unknown whether another run has taken over, wait; ``waiting`` is called before each pause.
        """
        while (silent := time.monotonic() - self._advanced) > self._timing.expire_after and not self.lost:
            if silent > self._most_silent or isinstance(self._failure, PermissionError):  # it does not pass
                reason = f" ({self._failure.strerror or self._failure})" if self._failure else ""
                self.lost = (
                    f"lease lost: no heartbeat succeeded for {silent:.0f} s{reason}, so another run may have taken "
                    "over; finished tiles are kept, rerun the same command to resume"
                )
                break
            waiting()
            time.sleep(self._timing.lease_poll)
        if self.lost:
            raise RunError(self.lost)
        if self._record.cancelled:
            raise RunError("stopped by atlas cancel; finished tiles are kept, rerun the same command to resume")

    def bind(self, backend: StoreBackend) -> StoreBackend:
        """Return a backend that writes a finished tile only if this run still has the lease.

        Before such a write, a commit, the lease is checked and its token is read. The read is needed because a process
        that was suspended does not know yet that its lease was taken over.
        """
        lost = "lease lost: another run has taken over the store; finished tiles are kept"
        return with_confirmation(backend, self.token, RunError, lost, before=self.check)

    def release(self) -> None:
        """Stop the renewals, and remove the lease if it still belongs to this run."""
        self._released.set()
        self._thread.join()
        once = with_patience(self._sidecar, 0.0)
        for _ in range(_RELEASES):  # each after a look: if only the answer was lost, the lease may be another run's
            with suppress(OSError):
                if read_lease_token(once) != self.token:
                    return
                clear_sidecar(once, (LEASE_NAME, STOP))

    def _beat_on(self) -> None:
        while not self._released.wait(self._timing.heartbeat) and not self.lost:
            try:
                self._beat()
            except OSError as error:  # an unreachable disk returns, or another run takes over
                self._failure = error

    def _beat(self) -> None:
        with self._one_beat:
            begin, stop = time.monotonic(), self._sidecar.get(STOP) == self.token.encode()
            advanced = replace(self._record, beat=self._record.beat + 1, cancelled=stop, progress=self._progress)
            try:
                self._sidecar.commit(LEASE_NAME, advanced.pack())
            except RunError as error:
                self.lost = str(error)
                return
            self._record, self._advanced, self._failure = advanced, begin, None

    def _confirm(self) -> None:
        """Raise RunError unless the lease still belongs to this run."""
        data = self._sidecar.get(LEASE_NAME)
        record = LeaseRecord.unpack(data) if data is not None else None
        if data is None:
            raise RunError("lease lost: its file was removed; finished tiles are kept")
        if record is None or record.token != self.token:
            raise RunError(f"lease lost: another run has taken over the store ({record or 'its file is damaged'})")


@contextmanager
def hold_lease(
    sidecar: StoreBackend,
    name: str,
    notify: Callable[[str], None] = lambda _: None,
    timing: Timing = TIMING,
    patience: float = 0.0,
) -> Iterator[Lease]:
    """Acquire the lease of a store and hold it within the block.

    Raise InputError, naming the store as ``name``, if another live run holds the lease. Waiting for a lease that may
    have expired takes up to ``timing.expire_after`` seconds; ``notify`` is called with a line of text about it.
    ``patience`` is explained at ``Lease``.
    """
    mine = LeaseRecord(uuid.uuid4().hex, 0, socket.gethostname(), os.getpid(), process_name())
    try:
        while not sidecar.put_new(LEASE_NAME, mine.pack()):
            other = sidecar.get(LEASE_NAME)
            if other is None or not _is_abandoned(sidecar, name, other, notify, timing):
                continue  # released meanwhile
            sidecar.put(LEASE_NAME, mine.pack())
            time.sleep(timing.lease_poll)  # another run may take over at the same time: the later one has the lease
            if read_lease_token(sidecar) == mine.token:
                break
    except NetworkError:
        raise
    except OSError as error:
        raise InputError(f"{name}: cannot be written: {error.strerror or error}") from None
    claim = Lease(sidecar, mine, timing, patience)
    try:
        yield claim
    finally:
        claim.release()


@dataclass(frozen=True)
class LeaseObservation:
    """The state of a lease when it was last observed, and for how long it has not been renewed.

    record   contents of the lease; None if it is damaged
    alive    True if the holder's process runs; None if this host cannot know
    silence  seconds, by the observer's clock, since the counter was first seen at its present value
    timing   ``timing.warn_after`` and ``timing.expire_after``: silences that are reported, and that end a lease
    """

    record: LeaseRecord | None
    alive: bool | None = None
    silence: float = 0.0
    timing: Timing = TIMING

    @property
    def trouble(self) -> str:
        """The reason to doubt that a run writes the store in spite of this lease; empty if there is no reason."""
        if self.record is None:
            return "the lease is damaged; the next run takes it over"
        if self.alive is False:
            return f"{self.record} ended without releasing its lease; the next run takes it over"
        if self.alive is None and self.silence >= self.timing.warn_after:
            return (
                f"no heartbeat from {self.record} for {self.silence:.0f} s; "
                f"its lease expires after {self.timing.expire_after:.0f} s"
            )
        return ""


class LeaseObserver:
    """Observes a store's lease without holding it, and measures how long its counter of renewals stands still.

    Whether a process of this host is alive is known at once. For a holder on another host a single observation says
    nothing, since clocks of hosts differ. ``observe_until_settled`` therefore observes until the counter moves, for at
    most ``timing.warn_after`` seconds. ``mark`` changes with every renewal.
    """

    def __init__(
        self, sidecar: StoreBackend, timing: Timing = TIMING, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self._sidecar, self._timing, self._sleep = sidecar, timing, sleep
        self.mark: object = object()
        self._since = 0.0

    def observe(self) -> LeaseObservation | None:
        """Return the present state of the lease; None if there is no lease."""
        begin = time.monotonic()
        data = self._sidecar.get(LEASE_NAME)
        now = time.monotonic()
        if data != self.mark or now - begin > self._timing.expire_after / 4:  # nor could the holder write
            self.mark, self._since = data, now
        if data is None:
            return None
        record = LeaseRecord.unpack(data)
        return LeaseObservation(record, record.is_alive if record else None, now - self._since, self._timing)

    def observe_until_settled(self) -> LeaseObservation | None:
        """Observe the lease until it is known to be renewed, or known not to be, and return its state; None if it is
        gone.
        """
        seen, first = self.observe(), self.mark
        while seen and seen.record and seen.alive is None and not seen.trouble and self.mark == first:
            self._sleep(self._timing.lease_poll)
            seen = self.observe()
        return seen


def cancel(
    sidecar: StoreBackend,
    name: str,
    wait_seconds: float,
    notify: Callable[[str], None] = lambda _: None,
    timing: Timing = TIMING,
) -> LeaseRecord:
    """Ask the run that holds a store's lease to stop, wait until it has stopped, and return its record.

    Raise InputError if no run holds the lease. Raise RunError if the lease is damaged, if no heartbeat is
    observed, or if the lease is still held after ``wait_seconds``. The request to stop remains.
    """
    data = sidecar.get(LEASE_NAME)
    if data is None:
        raise InputError(f"{name}: no run is at work on it")
    record = LeaseRecord.unpack(data)
    if record is None:
        raise RunError(f"{name}: {LeaseObservation(None).trouble}")
    if record.is_alive is False:
        raise InputError(f"{name}: no run is at work on it: {LeaseObservation(record, alive=False).trouble}")
    sidecar.put(STOP, record.token.encode())
    notify(f"asked {record} to stop")
    observer, end = LeaseObserver(sidecar, timing), time.monotonic() + wait_seconds
    while time.monotonic() < end:
        seen = observer.observe()
        if seen is None or seen.record is None or seen.record.token != record.token or seen.alive is False:
            clear_sidecar(sidecar, (STOP,))
            return record
        if seen.trouble:
            raise RunError(f"{name}: {seen.trouble}")
        time.sleep(timing.lease_poll)
    raise RunError(f"{name}: {record} has not stopped within {wait_seconds:g} s; it stops at its next heartbeat")


def _is_abandoned(sidecar: StoreBackend, name: str, data: bytes, notify: Callable[[str], None], timing: Timing) -> bool:
    """Wait until a lease is known to be renewed or to have expired, and return True if it has expired.

    A lease has expired if its counter stands still for ``timing.expire_after`` seconds, or its holder is gone. ``data``
    are its bytes when it was found. Raise InputError as soon as the counter moves.
    """
    record = LeaseRecord.unpack(data)
    if record and record.is_alive is False:
        notify(f"taking over the lease of {record}, which no longer runs")
        return True
    notify(
        f"the store is leased by {record}: waiting for a heartbeat"
        if record
        else "the lease is damaged: waiting for its holder to rewrite it"
    )
    observer = LeaseObserver(sidecar, timing)
    while (seen := observer.observe()) is not None:
        if observer.mark != data:
            raise InputError(
                f"{name}: leased by another run ({seen.record or record}); wait until it finishes, or stop it with: "
                f"atlas cancel {name}"
            )
        if seen.silence >= timing.expire_after:
            notify("taking over an expired lease")
            return True
        time.sleep(min(timing.lease_poll, timing.expire_after / 4))
    return False  # released meanwhile
