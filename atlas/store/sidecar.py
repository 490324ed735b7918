"""Notes beside a store: small named texts that processes share, with a conditional write.

A run claims a store by a note, and an attempt at a tile claims the tile by one. Notes are files next to a folder, and
objects next to a store at a URL.
"""

import errno
import json
import os
import socket
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit

import google_crc32c

from atlas.errors import InputError, RunError
from atlas.platform import file_lock
from atlas.store.backend import Fence
from atlas.store.object_backend import Given, ObjectBackend, StoreBackend, open_backend
from atlas.store.zip_backend import ZipBackend

LEASE_NAME = "claim"
"""The name of the note by which a run claims a store."""
_LOCK, _PARTIAL = ".lock", ".partial"
_READ_ATTEMPTS, _READ_PAUSE = 100, 0.01
"""Attempts to read a note that is being written in place, and the seconds between them."""
_LOCK_SECONDS = 10.0
"""Seconds to wait for the lock, which is held for an instant."""
_BLOCK, _END = 4096, 18
"""Block size of a note's file in bytes, and bytes at its end: length and checksum of the text."""


class Sidecar(Protocol):
    """Small named notes of one store that several processes share, with a conditional write."""

    def read(self, name: str) -> bytes | None:
        """A note's bytes, None if there is none."""

    def compare_and_set(self, name: str, data: bytes, expected: bytes | None) -> bool:
        """Write a note if it is absent (``expected`` None) or holds the expected bytes; else return False."""

    def compare_and_remove(self, name: str, expected: bytes) -> bool:
        """Remove a note that holds the expected bytes; else return False. For the note's maker only."""

    def clear(self, keep: str) -> None:
        """Remove all notes but one. For the holder of that note only."""


def sidecar_of(store: Given) -> Sidecar:
    """The notes of a store, next to it: a claim precedes the store, and Zarr owns its inside.

    If the store's path is a link, they are next to its target, so that a store has one claim.
    """
    place = open_backend(store)
    if isinstance(place, ObjectBackend):
        return object_sidecar(place)
    path = place.path if isinstance(place, ZipBackend) else place.local  # a file is never claimed, so it has no notes
    if path is None:
        return NullSidecar()
    path = Path(os.path.realpath(path))
    return LocalSidecar(path.parent / f".{path.name}.run")


class NullSidecar:
    """The notes of a read-only store, which is never claimed."""

    def read(self, name: str) -> bytes | None:
        return None

    def compare_and_set(self, name: str, data: bytes, expected: bytes | None) -> bool:
        return False

    def compare_and_remove(self, name: str, expected: bytes) -> bool:
        return False

    def clear(self, keep: str) -> None:
        pass


def read_lease_token(sidecar: Sidecar) -> str:
    """The token of the run that has claimed a store, by one read; empty if there is none or it is damaged."""
    return _token(sidecar.read(LEASE_NAME))


def token_fence(store: StoreBackend, name: str, token: str, error: type[RunError], reason: str) -> Fence:
    """A fence that raises ``error`` with the text ``reason`` unless a note of a store holds a token: one read."""
    notes = sidecar_of(store)

    def check() -> None:
        if _token(notes.read(name)) != token:
            raise error(f"{store}: {reason}")

    return check


@dataclass(frozen=True)
class TileAttempt:
    """An attempt at a tile, the content of a note: tokens of the attempt and of its run, its number, its process."""

    token: str
    run: str
    number: int
    process: str

    def pack(self) -> bytes:
        """The note's bytes."""
        return json.dumps(vars(self)).encode()

    def remove(self, sidecar: Sidecar, name: str) -> None:
        """Remove the attempt's note, unless a later attempt has replaced it."""
        sidecar.compare_and_remove(name, self.pack())


def start_attempt(sidecar: Sidecar, name: str, run: str, limit: int) -> TileAttempt:
    """Write the note of a new attempt of a run, replacing an older note.

    RunError if the older note is of attempt number ``limit`` of that run: all of them died before they removed it.
    """
    note, process = None, f"{socket.gethostname()}, process {os.getpid()}"
    while True:
        before = _read_note(note)
        number = before.get("number") if before.get("run") == run else 0
        number = number if isinstance(number, int) else 0
        if number >= limit:
            last = before.get("process", "an unknown one")
            raise RunError(f"the process that solves it has died {number} times, the last was {last}")
        attempt = TileAttempt(uuid.uuid4().hex, run, number + 1, process)
        if sidecar.compare_and_set(name, attempt.pack(), expected=note):
            return attempt
        note = sidecar.read(name)


def _token(note: bytes | None) -> str:
    return str(_read_note(note).get("token", ""))


def _read_note(note: bytes | None) -> dict[str, Any]:
    try:
        content = json.loads(note or b"{}")
    except (ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


@dataclass(frozen=True)
class LocalSidecar:
    """Notes as files of a folder. The folder's lock, held for an instant, makes a conditional write atomic.

    The length of a file is a multiple of _BLOCK, and a checksum ends it. It appears whole, by a rename; it is
    overwritten in place if the disk has no room for a second file, or the system cannot replace an open file. Readers
    need no lock: a text that contradicts its checksum is being written, and is read again.
    """

    path: Path

    def read(self, name: str) -> bytes | None:
        """See Notes. Empty for a note that stays damaged."""
        for _ in range(_READ_ATTEMPTS):
            try:
                text = _text((self.path / name).read_bytes())
            except (FileNotFoundError, NotADirectoryError):
                return None
            except PermissionError:  # Windows: it is just being replaced
                text = None
            if text is not None:
                return text
            time.sleep(_READ_PAUSE)
        return b""

    def compare_and_set(self, name: str, data: bytes, expected: bytes | None) -> bool:
        while True:
            if expected is None:
                self.path.mkdir(parents=True, exist_ok=True)
            elif not (self.path / name).exists():
                return False
            with suppress(FileNotFoundError), self._locked():  # another may just have removed the folder
                return self.read(name) == expected and self._write(name, _file_of(data), new=expected is None)

    def compare_and_remove(self, name: str, expected: bytes) -> bool:
        """See Notes."""
        if not (self.path / name).exists():
            return False
        with self._locked(tidy=True):
            if self.read(name) != expected:
                return False
            (self.path / name).unlink()
            return True

    def clear(self, keep: str) -> None:
        for file in self.path.glob("*"):
            if file.name not in (keep, _LOCK):
                file.unlink(missing_ok=True)

    def _write(self, name: str, data: bytes, new: bool) -> bool:
        """Write a file; False if it is to be ``new`` and exists already."""
        target, whole = self.path / name, self.path / f"{name}.{uuid.uuid4().hex}{_PARTIAL}"
        try:
            whole.write_bytes(data)
            os.link(whole, target) if new else os.replace(whole, target)
        except FileExistsError:
            return False
        except FileNotFoundError:
            raise
        except OSError:  # no room for a second file, no links, or a file that is open on Windows
            with suppress(FileExistsError):
                self._overwrite(target, data, new)
                return True
            return False
        finally:
            whole.unlink(missing_ok=True)
        return True

    def _overwrite(self, target: Path, data: bytes, new: bool) -> None:
        with open(target, "xb" if new else "r+b", buffering=0) as file:
            try:
                file.write(data)
                file.truncate()
            except OSError:
                if new:
                    target.unlink()
                raise

    @contextmanager
    def _locked(self, tidy: bool = False) -> Iterator[None]:
        """Hold the lock of writers; on a file system without locks a race of microseconds remains.

        ``tidy`` deletes the folder and its lock after its last note. TimeoutError if another process keeps the lock:
        what a stopped process writes when it continues must not come after other writes.
        """
        path = self.path / _LOCK
        lock = file_lock(path)
        try:
            lock.acquire(timeout=_LOCK_SECONDS)
        except TimeoutError:
            held = f"{path} has been locked for {_LOCK_SECONDS:g} s by another process, which may be stopped; end it"
            raise TimeoutError(errno.ETIMEDOUT, held) from None
        except OSError:
            pass  # a file system without locks
        try:
            yield
        finally:
            with suppress(OSError):
                files = list(self.path.iterdir()) if tidy else []
                if files and all(file.name == _LOCK or file.suffix == _PARTIAL for file in files):
                    for file in files:
                        file.unlink(missing_ok=True)
            lock.release()
            if tidy:
                with suppress(OSError):
                    self.path.rmdir()


def _file_of(text: bytes) -> bytes:
    """The file of a note, which begins with its text."""
    length = -(-(len(text) + _END) // _BLOCK) * _BLOCK
    end = f"\n{len(text):08x} {google_crc32c.value(text):08x}".encode()
    return text.ljust(length - _END) + end


def _text(file: bytes) -> bytes | None:
    """The inverse; None for an incomplete file."""
    try:
        length, checksum = (int(part, 16) for part in file[-_END:].split())
    except ValueError:
        return None
    text = file[:length]
    whole = len(file) % _BLOCK == 0 and len(text) == length and google_crc32c.value(text) == checksum
    return text if whole else None


@dataclass(frozen=True)
class ObjectSidecar:
    """Notes as small objects under one prefix.

    Writes to an object store can be conditional (If-None-Match, If-Match), removals cannot: a note is removed by one
    request right after a look at it, or is left empty, which counts as absent.
    """

    backend: ObjectBackend

    def read(self, name: str) -> bytes | None:
        return self.backend.get(name) or None

    def compare_and_set(self, name: str, data: bytes, expected: bytes | None) -> bool:
        if expected is None and self.backend.put_new(name, data):
            return True
        tagged = self.backend.get_tagged(name)
        return tagged is not None and tagged[0] == (expected or b"") and self.backend.put_if(name, data, tagged[1])

    def compare_and_remove(self, name: str, expected: bytes) -> bool:
        if self.read(name) != expected:
            return False
        return self.backend.remove_once(name) or self.compare_and_set(name, b"", expected)

    def clear(self, keep: str) -> None:
        self.backend.remove_all(name for name in self.backend.list_keys() if name != keep)


def object_sidecar(store: ObjectBackend) -> ObjectSidecar:
    """The notes of a store at a URL, next to it: ``s3://bucket/.plane.zarr.run/`` for ``s3://bucket/plane.zarr``."""
    parts = urlsplit(store.url)
    above, _, name = parts.path.rstrip("/").rpartition("/")
    if not name:
        raise InputError(f"{store}: a store needs a name below the bucket, such as {store}/plane.zarr")
    return ObjectSidecar(replace(store, url=parts._replace(path=f"{above}/.{name}.run").geturl()))
