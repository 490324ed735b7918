"""The claim of a store by one coordinator at a time, proved by a counter that advances, not by a clock.

A claim is one small note outside the store. At every beat its holder increments a counter in it. Another run that
finds a claim watches the counter. If it moves, the claim stands; if it stands still for ``Timing.dead`` seconds by the
watcher's own clock, or the holder's process is gone, the claim is replaced. Everything rests on one operation: write a
note only if the stored note is still the one that was read. A holder that merely slept thus learns of its replacement
at its next beat. Status and cancel report a silent claim, and leave it in place.
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

ENDED = "ended"
"""The name of the note about the end of the last submitted run."""


@dataclass(frozen=True)
class LeaseRecord:
    """The contents of a claim. ``process`` is a unique name of the holder's process; empty where no such name exists.

    ValueError for a field that no holder writes.
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
        """The record as the bytes of a note."""
        return json.dumps(asdict(self)).encode()

    @classmethod
    def unpack(cls, data: bytes) -> "LeaseRecord | None":
        """The inverse; None for a damaged claim, for example if its holder was killed while it wrote."""
        try:
            return cls(**json.loads(data))
        except (ValueError, TypeError, RecursionError):
            return None

    def number(self, name: str) -> float:
        """A number in the holder's report of its progress; 0 if it is missing."""
        value = self.progress.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            return 0
        return value if abs(value) < 2**63 else 0  # nor is NaN

    @property
    def trouble(self) -> str:
        """The holder's reason why the run makes no progress; empty if it reports none."""
        value = self.progress.get("trouble")
        return to_one_line(value) if isinstance(value, str) else ""

    @property
    def is_alive(self) -> bool | None:
        """Whether the holder runs; None if this machine cannot know."""
        return is_running(self.pid, self.process)

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}"


class Lease:
    """A claim held by this run: a thread advances its counter until ``release``.

    ``lost`` is the reason why this run no longer holds the claim, empty while it does. If the counter stands still for
    ``timing.dead`` seconds because the store does not answer, another run may replace the claim as soon as the store is
    back. This run then waits for a beat to succeed, which happens only if nobody has replaced the claim; it waits at
    most ``patience`` seconds, or ``timing.dead`` if that is more.
    """

    def __init__(self, sidecar: Sidecar, record: LeaseRecord, timing: Timing = TIMING, patience: float = 0.0) -> None:
        self._notes, self._record, self._data, self._timing = sidecar, record, record.pack(), timing
        self._advanced, self._most_silent = time.monotonic(), max(timing.expire_after, patience)
        self.lost = ""
        self._failure: OSError | None = None
        self._released, self._one_beat = threading.Event(), threading.Lock()
        self._progress: Mapping[str, Any] = {}
        self._thread = threading.Thread(target=self._beat_on, name="atlas-claim", daemon=True)
        self._thread.start()

    @property
    def token(self) -> str:
        """The unique token of this run's claim."""
        return self._record.token

    def set_progress(self, progress: Mapping[str, Any]) -> None:
        """Set the progress that the next beats write; the first report is written at once, before the first tile."""
        first, self._progress = not self._progress, progress
        if first:
            with suppress(OSError):
                self._beat()

    def check(self, waiting: Callable[[], None] = lambda: None) -> None:
        """Raise RunError if this run has lost the claim, or has been asked to stop.

        While it is unknown whether another run has replaced the claim, wait; ``waiting`` is called before each pause.
        """
        while (silent := time.monotonic() - self._advanced) > self._timing.expire_after and not self.lost:
            if silent > self._most_silent or isinstance(self._failure, PermissionError):  # which does not pass
                reason = f" ({self._failure.strerror or self._failure})" if self._failure else ""
                self.lost = (
                    f"this run could not renew its claim of the store for {silent:.0f} s{reason}, so that another run "
                    "may have replaced it; finished tiles are kept, and the same command resumes"
                )
                break
            waiting()
            time.sleep(self._timing.lease_poll)
        if self.lost:
            raise RunError(self.lost)
        if self._record.cancelled:
            raise RunError("stopped by atlas cancel; finished tiles are kept, and the same command resumes from them")

    def fence_backend(self, place: StoreBackend) -> StoreBackend:
        """The claimed place behind a fence: every write and removal first calls ``check`` and reads the claim.

        A process that has slept since the last beat may not know yet that its claim was replaced.
        """
        lost = "this run has lost its claim of the store: another run has taken it; finished tiles are kept"
        look = token_fence(place, LEASE_NAME, self.token, RunError, lost)

        def fence() -> None:
            self.check()
            look()

        return place.with_fence(fence)

    def release(self) -> None:
        """Free the store."""
        self._released.set()
        self._thread.join()
        with suppress(OSError):
            self._beat()  # a cancellation may have changed the bytes that are to be removed
            self._notes.compare_and_remove(LEASE_NAME, self._data)

    def _beat_on(self) -> None:
        while not self._released.wait(self._timing.heartbeat) and not self.lost:
            try:
                self._beat()
            except OSError as error:  # a disk that is away comes back, or another run replaces the claim
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
                    self.lost = "this run's claim of the store was removed; finished tiles are kept"
                elif record is None or record.token != self._record.token:
                    self.lost = f"another run has claimed this store ({record or 'its claim is damaged'})"
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
    """Hold the claim of a store; InputError, naming ``name``, if another run that is alive holds it.

    To watch the claim of a holder that may be dead takes up to ``timing.dead`` seconds; ``notify`` is called with a
    line about it. ``patience``: see ``Lease``.
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
    """A claim as it was last seen.

    record    its contents, None for a damaged claim
    alive     whether its holder runs, None if this machine cannot know
    silence   seconds by the observer's own clock since the counter was first seen at its present value
    timing    ``timing.silent`` and ``timing.dead`` decide when the silence is reported, and what it means
    """

    record: LeaseRecord | None
    alive: bool | None = None
    silence: float = 0.0
    timing: Timing = TIMING

    @property
    def trouble(self) -> str:
        """The reason to doubt that a run is at work in spite of this claim; empty without one."""
        if self.record is None:
            return "the claim is damaged; the next run replaces it"
        if self.alive is False:
            return f"{self.record} is gone without releasing its claim; the next run replaces it"
        if self.alive is None and self.silence >= self.timing.warn_after:
            return (
                f"no sign of life of {self.record} for {self.silence:.0f} s; "
                f"if it is dead, the next run replaces its claim after {self.timing.expire_after:.0f} s"
            )
        return ""


class LeaseObserver:
    """An observer of a store's claim from outside; it measures how long the counter stands still.

    Whether a process of this machine is alive is known at once. For a holder on another machine a single look says
    nothing, since clocks of machines differ: ``settle`` looks until the counter moves, for at most ``timing.silent``
    seconds. ``mark`` is the part of the claim that only its holder changes.
    """

    def __init__(self, sidecar: Sidecar, timing: Timing = TIMING, sleep: Callable[[float], None] = time.sleep) -> None:
        self._notes, self._timing, self._sleep = sidecar, timing, sleep
        self.mark, self._since = object(), 0.0

    def observe(self) -> LeaseObservation | None:
        """The present claim, None if there is none."""
        begin = time.monotonic()
        data = self._notes.read(LEASE_NAME)
        mark, now = None if data is None else _mark(data), time.monotonic()
        if mark != self.mark or now - begin > self._timing.expire_after / 4:  # the store was away, for the holder too
            self.mark, self._since = mark, now
        if data is None:
            return None
        record = LeaseRecord.unpack(data)
        return LeaseObservation(record, record.is_alive if record else None, now - self._since, self._timing)

    def observe_until_settled(self) -> LeaseObservation | None:
        """The claim, once it is known to move, to stand still, or to be gone."""
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
    """Ask the run that holds a store to stop, and wait until it has; InputError if no run holds it.

    Raises RunError if the claim is damaged, shows no sign of life, or is still held after ``wait_seconds``; the request
    stands.
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
    raise RunError(f"{name}: {record} has not stopped after {wait_seconds:g} s; it will at its next beat")


def record_end(sidecar: Sidecar, text: str) -> None:
    """Note the end of a submitted run, for the status; the next run that ends well clears the note."""
    with suppress(Exception):  # a failure to write the note must not hide the run's own error
        sidecar.compare_and_set(ENDED, text.encode(), expected=sidecar.read(ENDED))


def read_end(sidecar: Sidecar) -> str:
    """The note about the end of the last submitted run, empty if it ended well."""
    return (sidecar.read(ENDED) or b"").decode(errors="replace")


def _is_abandoned(sidecar: Sidecar, name: str, data: bytes, notify: Callable[[str], None], timing: Timing) -> bool:
    """Watch a claim: True once its counter has stood still long enough; InputError as soon as the counter moves."""
    record = LeaseRecord.unpack(data)
    if record and record.is_alive is False:
        notify(f"replacing the claim of {record}, which is gone")
        return True
    notify(
        f"another run may be at work ({record}): watching for a sign of life" if record else "watching a damaged claim"
    )
    observer = LeaseObserver(sidecar, timing)
    while (seen := observer.observe()) is not None:
        if observer.mark != _mark(data):
            raise InputError(
                f"{name}: another run is at work on it ({seen.record or record}); wait for it to end, or stop it: "
                f"atlas cancel {name}"
            )
        if seen.silence >= timing.expire_after:
            notify("replacing a claim without a sign of life")
            return True
        time.sleep(min(timing.lease_poll, timing.expire_after / 4))
    return False  # released meanwhile


def _mark(data: bytes) -> object:
    """The part of a claim that only its holder changes: a request to stop, written by others, is no sign of life."""
    record = LeaseRecord.unpack(data)
    return (record.token, record.beat) if record else data
