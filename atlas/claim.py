"""Who is at work on a store: one coordinator at a time, proved by a counter that moves, never by a clock.

A claim is one small note beside the store. Its holder counts a number in it up, every BEAT_SECONDS. Who finds a claim
watches that number: it moves, and the claim is respected; it stands still for PATIENCE_SECONDS of the watcher's own
time, or its process is seen to be gone, and the claim is taken over. All of it rests on one operation, "put this note
if what is there is still what I read", so that a holder that was only asleep finds out at its next beat.
"""

import glob
import json
import os
import shutil
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from atlas.beside import Notes
from atlas.errors import InputError, NetworkError, RunError

BEAT_SECONDS = 2.0
"""How often a holder moves its counter."""
PATIENCE_SECONDS = 20.0
"""How long a counter must stand still until its holder counts as dead: ten beats, for a busy network disk."""
CLAIM, ENDED = "claim", "ended"
"""Names of notes: who is at work; how the last run ended that nobody watched."""


@dataclass(frozen=True)
class Record:
    """What a claim says. ``process`` names its holder beyond doubt on this machine, or is empty where nothing can."""

    token: str
    beat: int
    host: str
    pid: int
    process: str
    cancelled: bool = False
    progress: Mapping[str, Any] = field(default_factory=dict)

    def pack(self) -> bytes:
        """As the bytes of a note."""
        return json.dumps(asdict(self)).encode()

    @classmethod
    def unpack(cls, data: bytes) -> "Record | None":
        """The inverse, None for bytes that are no claim, such as those of a holder killed while it wrote them."""
        try:
            return cls(**json.loads(data))
        except (ValueError, TypeError):
            return None

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}"


class Claim:
    """A claim that is held: its counter moves in a thread of its own, until ``release``."""

    def __init__(self, notes: Notes, record: Record) -> None:
        self._notes, self._record, self._data = notes, record, record.pack()
        self._lost = ""
        self._released = threading.Event()
        self._progress: Mapping[str, Any] = {}
        self._thread = threading.Thread(target=self._beat_on, name="atlas-claim", daemon=True)
        self._thread.start()

    def report(self, progress: Mapping[str, Any]) -> None:
        """What the next beats are to tell those who ask for the status."""
        self._progress = progress

    def check(self) -> None:
        """Raise RunError where the claim is no longer this run's, or somebody asked it to stop."""
        if self._lost:
            raise RunError(self._lost)
        if self._record.cancelled:
            raise RunError("stopped by atlas cancel; finished tiles are kept, and running it again goes on from them")

    def release(self) -> None:
        """Give the store free."""
        self._released.set()
        self._thread.join()
        with suppress(OSError):
            self._beat()  # learns of a cancellation, which changed the bytes that are to be removed
            self._notes.remove(CLAIM, self._data)

    def _beat_on(self) -> None:
        while not self._released.wait(BEAT_SECONDS) and not self._lost:
            with suppress(OSError):  # a disk away for a while: either it comes back, or another takes over
                self._beat()

    def _beat(self) -> None:
        while not self._lost:
            moved = replace(self._record, beat=self._record.beat + 1, progress=self._progress)
            if self._notes.put(CLAIM, moved.pack(), expected=self._data):
                self._record, self._data = moved, moved.pack()
                return
            found = self._notes.read(CLAIM)
            record = Record.unpack(found) if found is not None else None
            if found is None:
                self._lost = "this run's claim of the store was removed; finished tiles are kept"
            elif record is None or record.token != self._record.token:
                self._lost = f"another run has taken this store over ({record or 'its claim is torn'})"
            else:
                self._record, self._data = record, found


@contextmanager
def claimed(notes: Notes, name: str, say: Callable[[str], None] = lambda _: None) -> Iterator[Claim]:
    """Hold the claim of a store; InputError, naming ``name``, where another run that is alive holds it.

    Watching a claim that nobody seems to hold takes up to PATIENCE_SECONDS, which ``say`` tells.
    """
    mine = Record(uuid.uuid4().hex, 0, socket.gethostname(), os.getpid(), _this_process())
    try:
        while not notes.put(CLAIM, mine.pack(), expected=None):
            found = notes.read(CLAIM)
            abandoned = found is not None and _is_abandoned(notes, name, found, say)
            if abandoned and notes.put(CLAIM, mine.pack(), expected=found):
                break
    except NetworkError:
        raise
    except OSError as error:
        raise InputError(f"{name}: cannot be written: {error.strerror or error}") from None
    claim = Claim(notes, mine)
    try:
        yield claim
    finally:
        claim.release()


def holder(notes: Notes) -> Record | None:
    """Who claims the store at this moment, or None; one that is known to be dead does not count."""
    found = notes.read(CLAIM)
    record = None if found is None else Record.unpack(found)
    return None if record is None or _is_gone(record) else record


def cancel(notes: Notes, name: str, wait_seconds: float, say: Callable[[str], None] = lambda _: None) -> Record:
    """Ask the run that holds a store to stop, and wait until it has; InputError where no run holds it.

    Raises RunError where it has not stopped after ``wait_seconds``; the request stands.
    """
    while True:
        found = notes.read(CLAIM)
        record = None if found is None else Record.unpack(found)
        if found is None or record is None or _is_gone(record):
            raise InputError(f"{name}: no run is at work on it")
        if record.cancelled or notes.put(CLAIM, replace(record, cancelled=True).pack(), expected=found):
            break
    say(f"asked {record} to stop")
    end = time.monotonic() + wait_seconds
    while time.monotonic() < end:
        now = notes.read(CLAIM)
        current = None if now is None else Record.unpack(now)
        if current is None or current.token != record.token or _is_gone(current):
            return record
        time.sleep(0.2)
    raise RunError(f"{name}: {record} has not stopped after {wait_seconds:g} s; it will at its next sign of life")


def leave_word(notes: Notes, text: str) -> None:
    """Note how a run ended that nobody watched, for the status; the next run to end well clears it."""
    with suppress(OSError):
        notes.put(ENDED, text.encode(), expected=notes.read(ENDED))


def last_word(notes: Notes) -> str:
    """How the last run ended that nobody watched, or nothing where it ended well."""
    return (notes.read(ENDED) or b"").decode()


def remove_half_made(store: Path) -> None:
    """Remove what runs left behind that were killed while they made this store. For the claim's holder only."""
    for leftover in store.absolute().parent.glob(f".{glob.escape(store.name)}.*.partial"):
        shutil.rmtree(leftover, ignore_errors=True)


def _is_abandoned(notes: Notes, name: str, found: bytes, say: Callable[[str], None]) -> bool:
    """Watch a claim: True once it is certain that nobody moves it, InputError as soon as somebody does."""
    record = Record.unpack(found)
    if record and _is_gone(record):
        say(f"taking over from {record}, which is gone")
        return True
    say(f"another run may be at work ({record}): watching for a sign of life" if record else "watching a torn claim")
    end = time.monotonic() + PATIENCE_SECONDS
    while time.monotonic() < end:
        time.sleep(min(0.2, PATIENCE_SECONDS / 4))
        now = notes.read(CLAIM)
        if now != found:
            if now is None:
                return False  # released meanwhile
            raise InputError(
                f"{name}: another run is at work on it ({Record.unpack(now) or record}); wait for it to end, or stop "
                f"it: atlas cancel {name}"
            )
    say("taking over: no sign of life")
    return True


def _this_process() -> str:
    """Boot, process namespace, process and the moment it began, so that nothing else ever has this name."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')} {os.getpid()} {_began(os.getpid())}"
    except OSError:
        return ""  # no such system: only the counter tells


def _began(pid: int) -> str:
    """Clock ticks from boot to the start of a process; "dead" for one that only waits to be collected."""
    state, *rest = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return "dead" if state in "ZX" else rest[18]


def _is_gone(record: Record) -> bool:
    """Whether the holder certainly runs no more; False also where this machine cannot know."""
    here, there = _this_process().split(), record.process.split()
    if not here or here[:2] != there[:2]:
        return False
    try:
        os.kill(record.pid, 0)
    except ProcessLookupError:
        return True
    except PermissionError:
        pass
    try:
        return _began(record.pid) != there[3]
    except OSError:
        return False
