"""The lease of a store: at most one coordinator writes a store at a time.

A lease is a small file in the store's sidecar. Its holder renews it with heartbeats, each of which increments a
counter. A run that finds a lease watches the counter by its own clock, so clocks of different hosts need not agree. If
the counter moves, the lease is valid. If the counter stands still for ``Timing.expire_after`` seconds, or the holder's
process no longer exists, the lease has expired and is taken over. All of this rests on one operation, compare-and-set:
a file is written only if it still holds the bytes that were read. A holder that was suspended therefore notices at its
next heartbeat that it has lost the lease. ``atlas status`` and ``atlas cancel`` report an expired lease and leave it in
place.
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
from atlas.service.process_identity import is_name, is_running, this_process
from atlas.service.timing import TIMING, Timing
from atlas.store.object_backend import StoreBackend
from atlas.store.sidecar import LEASE_NAME, Sidecar, token_fence


@dataclass(frozen=True)
class LeaseRecord:
    """The contents of a lease file.

    token      unique identifier of the lease
    beat       number of heartbeats so far
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
        if not 0 < self.pid < 2**31 or not is_name(self.process):
            raise ValueError(f"no process: {self.pid}, {self.process!r}")

    def pack(self) -> bytes:
        """Return the record as the bytes of a lease file."""
        return json.dumps(asdict(self)).encode()

    @classmethod
    def unpack(cls, data: bytes) -> "LeaseRecord | None":
        """Return the record of a lease file; None if the file is damaged.

        It is damaged, for example, if its holder was killed while writing.
        """
        try:
            return cls(**json.loads(data))
        except (ValueError, TypeError, RecursionError):
            return None

    def number(self, name: str) -> float:
        """Return a number of the holder's progress report; 0 if it is missing."""
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

    def __init__(self, sidecar: Sidecar, record: LeaseRecord, timing: Timing = TIMING, patience: float = 0.0) -> None:
        self._notes, self._record, self._data, self._timing = sidecar, record, record.pack(), timing
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
        """Set the progress that the next heartbeats write.

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

    def fence_backend(self, place: StoreBackend) -> StoreBackend:
        """Return the backend behind a fence: before each write and removal the lease is checked and read.

        The read is needed because a process that was suspended does not know yet that its lease was taken over.
        """
        lost = "lease lost: another run has taken over the store; finished tiles are kept"
        look = token_fence(place, LEASE_NAME, self.token, RunError, lost)

        def fence() -> None:
            self.check()
            look()

        return place.with_fence(fence)

    def release(self) -> None:
        """Stop the heartbeats and remove the lease file."""
        self._released.set()
        self._thread.join()
        with suppress(OSError):
            self._beat()  # a cancellation may have changed the bytes that are to be removed
            self._notes.compare_and_remove(LEASE_NAME, self._data)

    def _beat_on(self) -> None:
        while not self._released.wait(self._timing.heartbeat) and not self.lost:
            try:
                self._beat()
            except OSError as error:  # an unreachable disk returns, or another run takes over
                self._failure = error

    def _beat(self) -> None:
        with self._one_beat:
            while not self.lost:
                advanced = replace(self._record, beat=self._record.beat + 1, progress=self._progress)
                begin = time.monotonic()
                if self._notes.compare_and_set(LEASE_NAME, advanced.pack(), expected=self._data):
                    self._record, self._data, self._advanced = advanced, advanced.pack(), begin
                    self._failure = None
                    return
                data = self._notes.read(LEASE_NAME)
                record = LeaseRecord.unpack(data) if data is not None else None
                if data is None:
                    self.lost = "lease lost: its file was removed; finished tiles are kept"
                elif record is None or record.token != self._record.token:
                    self.lost = f"lease lost: another run has taken over the store ({record or 'its file is damaged'})"
                else:
                    self._record, self._data = record, data


@contextmanager
def hold_lease(
    sidecar: Sidecar,
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
    mine = LeaseRecord(uuid.uuid4().hex, 0, socket.gethostname(), os.getpid(), this_process())
    try:
        while not sidecar.compare_and_set(LEASE_NAME, mine.pack(), expected=None):
            other = sidecar.read(LEASE_NAME)
            abandoned = other is not None and _is_abandoned(sidecar, name, other, notify, timing)
            if abandoned and sidecar.compare_and_set(LEASE_NAME, mine.pack(), expected=other):
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
    """A lease as it was last observed.

    record   contents of the lease file; None if it is damaged
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
            return "the lease file is damaged; the next run takes it over"
        if self.alive is False:
            return f"{self.record} ended without releasing its lease; the next run takes it over"
        if self.alive is None and self.silence >= self.timing.warn_after:
            return (
                f"no heartbeat from {self.record} for {self.silence:.0f} s; "
                f"its lease expires after {self.timing.expire_after:.0f} s"
            )
        return ""


class LeaseObserver:
    """An observer of a store's lease from outside. It measures how long the heartbeat counter stands still.

    Whether a process of this host is alive is known at once. For a holder on another host a single observation says
    nothing, since clocks of hosts differ. ``observe_until_settled`` therefore observes until the counter moves, for at
    most ``timing.warn_after`` seconds. ``mark`` is the part of the lease file that only its holder changes.
    """

    def __init__(self, sidecar: Sidecar, timing: Timing = TIMING, sleep: Callable[[float], None] = time.sleep) -> None:
        self._notes, self._timing, self._sleep = sidecar, timing, sleep
        self.mark, self._since = object(), 0.0

    def observe(self) -> LeaseObservation | None:
        """Return the present lease; None if there is none."""
        begin = time.monotonic()
        data = self._notes.read(LEASE_NAME)
        mark, now = None if data is None else _mark(data), time.monotonic()
        if mark != self.mark or now - begin > self._timing.expire_after / 4:  # nor could the holder write
            self.mark, self._since = mark, now
        if data is None:
            return None
        record = LeaseRecord.unpack(data)
        return LeaseObservation(record, record.is_alive if record else None, now - self._since, self._timing)

    def observe_until_settled(self) -> LeaseObservation | None:
        """Return the lease once its counter is known to move or to stand still; None once the lease is gone."""
        seen, first = self.observe(), self.mark
        while seen and seen.record and seen.alive is None and not seen.trouble and self.mark == first:
            self._sleep(self._timing.lease_poll)
            seen = self.observe()
        return seen


def cancel(
    sidecar: Sidecar,
    name: str,
    wait_seconds: float,
    notify: Callable[[str], None] = lambda _: None,
    timing: Timing = TIMING,
) -> LeaseRecord:
    """Ask the run that holds a store's lease to stop, wait until it has stopped, and return its record.

    Raise InputError if no run holds the lease. Raise RunError if the lease file is damaged, if no heartbeat is
    observed, or if the lease is still held after ``wait_seconds``. The request to stop remains.
    """
    while True:
        data = sidecar.read(LEASE_NAME)
        if data is None:
            raise InputError(f"{name}: no run is at work on it")
        record = LeaseRecord.unpack(data)
        if record is None:
            raise RunError(f"{name}: {LeaseObservation(None).trouble}")
        if record.is_alive is False:
            raise InputError(f"{name}: no run is at work on it: {LeaseObservation(record, alive=False).trouble}")
        if record.cancelled or sidecar.compare_and_set(
            LEASE_NAME, replace(record, cancelled=True).pack(), expected=data
        ):
            break
    notify(f"asked {record} to stop")
    observer, end = LeaseObserver(sidecar, timing), time.monotonic() + wait_seconds
    while time.monotonic() < end:
        seen = observer.observe()
        if seen is None or seen.record is None or seen.record.token != record.token or seen.alive is False:
            return record
        if seen.trouble:
            raise RunError(f"{name}: {seen.trouble}")
        time.sleep(timing.lease_poll)
    raise RunError(f"{name}: {record} has not stopped within {wait_seconds:g} s; it stops at its next heartbeat")


def _is_abandoned(sidecar: Sidecar, name: str, data: bytes, notify: Callable[[str], None], timing: Timing) -> bool:
    """Return True once a lease has expired.

    Its counter has then stood still for ``timing.expire_after`` seconds, or its holder is gone. Raise InputError as
    soon as the counter moves.
    """
    record = LeaseRecord.unpack(data)
    if record and record.is_alive is False:
        notify(f"taking over the lease of {record}, which no longer runs")
        return True
    notify(
        f"the store is leased by {record}: waiting for a heartbeat"
        if record
        else "the lease file is damaged: waiting for its holder to rewrite it"
    )
    observer = LeaseObserver(sidecar, timing)
    while (seen := observer.observe()) is not None:
        if observer.mark != _mark(data):
            raise InputError(
                f"{name}: leased by another run ({seen.record or record}); wait until it finishes, or stop it with: "
                f"atlas cancel {name}"
            )
        if seen.silence >= timing.expire_after:
            notify("taking over an expired lease")
            return True
        time.sleep(min(timing.lease_poll, timing.expire_after / 4))
    return False  # released meanwhile


def _mark(data: bytes) -> object:
    """Return the part of a lease file that only its holder changes.

    A request to stop, written by others, is no heartbeat.
    """
    record = LeaseRecord.unpack(data)
    return (record.token, record.beat) if record else data
