"""The sidecar of a store: small named files beside it that processes share, with compare-and-set.

A run leases a store through one sidecar file, and an attempt at a tile marks the tile with another. The sidecar of
``plane.zarr`` is the folder or the object prefix ``.plane.zarr.run`` beside it. It lies outside the store, because a
lease exists before its store and because Zarr owns everything inside.
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
"""Name of the sidecar file that holds the lease of a store."""
_LOCK, _PARTIAL = ".lock", ".partial"
_READ_ATTEMPTS, _READ_PAUSE = 100, 0.01
"""Maximum number of attempts to read a file that is being overwritten in place, and the seconds between them."""
_LOCK_SECONDS = 10.0
"""Maximum wait, in seconds, for the lock, which is held for an instant."""
_BLOCK, _END = 4096, 18
"""Block size of a sidecar file, and size of its end with length and checksum of the content, in bytes."""


class Sidecar(Protocol):
    """Small named files beside one store, shared between processes."""

    def read(self, name: str) -> bytes | None:
        """Return the bytes of a file; None if it does not exist."""

    def compare_and_set(self, name: str, data: bytes, expected: bytes | None) -> bool:
        """Write a file if it holds ``expected``, or does not exist if ``expected`` is None; else return False."""

    def compare_and_remove(self, name: str, expected: bytes) -> bool:
        """Remove a file if it holds ``expected``; else return False. Only its creator may call this."""

    def clear(self, keep: str) -> None:
        """Remove all files but ``keep``. Only the holder of ``keep`` may call this."""


def sidecar_of(store: Given) -> Sidecar:
    """Return the sidecar of a store, which lies beside the store.

    If the path of the store is a link, the sidecar lies beside the target, so that a store has one lease.
    """
    place = open_backend(store)
    if isinstance(place, ObjectBackend):
        return object_sidecar(place)
    path = place.path if isinstance(place, ZipBackend) else place.local  # a zip file is never leased
    if path is None:
        return NullSidecar()
    path = Path(os.path.realpath(path))
    return LocalSidecar(path.parent / f".{path.name}.run")


class NullSidecar:
    """The sidecar of a read-only store, which is never leased; it has no files."""

    def read(self, name: str) -> bytes | None:
        return None

    def compare_and_set(self, name: str, data: bytes, expected: bytes | None) -> bool:
        return False

    def compare_and_remove(self, name: str, expected: bytes) -> bool:
        return False

    def clear(self, keep: str) -> None:
        pass


def read_lease_token(sidecar: Sidecar) -> str:
    """Return the token of the run that leases a store, by one read; empty if there is no lease or it is damaged."""
    return _token(sidecar.read(LEASE_NAME))


def token_fence(store: StoreBackend, name: str, token: str, error: type[RunError], reason: str) -> Fence:
    """Return a fence that raises ``error`` unless the sidecar file ``name`` of the store holds the token.

    store    backend of the store
    name     name of the sidecar file
    token    token that the file must hold
    error    class of the error
    reason   text of the error, after the name of the store

    The fence takes one read.
    """
    notes = sidecar_of(store)

    def check() -> None:
        if _token(notes.read(name)) != token:
            raise error(f"{store}: {reason}")

    return check


@dataclass(frozen=True)
class TileAttempt:
    """An attempt at a tile, stored as JSON in a sidecar file by these field names.

    token     token of the attempt
    run       token of its run
    number    number of the attempt in the run, from 1
    process   host and process, as text
    """

    token: str
    run: str
    number: int
    process: str

    def pack(self) -> bytes:
        """Return the bytes of the sidecar file."""
        return json.dumps(vars(self)).encode()

    def remove(self, sidecar: Sidecar, name: str) -> None:
        """Remove the sidecar file of the attempt, unless a later attempt has replaced it."""
        sidecar.compare_and_remove(name, self.pack())


def start_attempt(sidecar: Sidecar, name: str, run: str, limit: int) -> TileAttempt:
    """Write the sidecar file of a new attempt of a run, replacing an older file, and return the attempt.

    sidecar   sidecar of the store
    name      name of the file
    run       token of the run
    limit     maximum number of attempts of one run

    Raise RunError if the older file is that of attempt number ``limit`` of this run: all of these attempts died before
    they could remove it.
    """
    note, process = None, f"{socket.gethostname()}, process {os.getpid()}"
    while True:
        before = _read_note(note)
        number = before.get("number") if before.get("run") == run else 0
        number = number if isinstance(number, int) else 0
        if number >= limit:
            last = before.get("process", "an unknown one")
            raise RunError(f"its worker process has died {number} times, the last one was {last}")
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
    """A sidecar on a disk. A lock file, held for an instant, makes compare-and-set atomic.

    The length of a file is a multiple of _BLOCK, and a checksum ends it. Files are replaced by a rename. If the disk is
    too full for a second file, or the system cannot replace an open file, they are overwritten in place. Readers take
    no lock: content that contradicts its checksum is being written, and is read again.
    """

    path: Path

    def read(self, name: str) -> bytes | None:
        """See ``Sidecar``. Empty if the file stays damaged."""
        for _ in range(_READ_ATTEMPTS):
            try:
                text = _text((self.path / name).read_bytes())
            except (FileNotFoundError, NotADirectoryError):
                return None
            except PermissionError:  # Windows: the file is just being replaced
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
            with suppress(FileNotFoundError), self._locked():  # another process may just have removed the folder
                return self.read(name) == expected and self._write(name, _file_of(data), new=expected is None)

    def compare_and_remove(self, name: str, expected: bytes) -> bool:
        """See ``Sidecar``."""
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
        """Write a file; return False if it must be ``new`` but exists."""
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

        ``tidy`` deletes the folder and its lock after the last file. Raise TimeoutError if another process keeps the
        lock: a stopped process that continues must not write after other processes have written.
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
    """Return the bytes of a file with this content: content, padding, length and checksum."""
    length = -(-(len(text) + _END) // _BLOCK) * _BLOCK
    end = f"\n{len(text):08x} {google_crc32c.value(text):08x}".encode()
    return text.ljust(length - _END) + end


def _text(file: bytes) -> bytes | None:
    """Return the content of a file made by ``_file_of``; None if it is incomplete."""
    try:
        length, checksum = (int(part, 16) for part in file[-_END:].split())
    except ValueError:
        return None
    text = file[:length]
    whole = len(file) % _BLOCK == 0 and len(text) == length and google_crc32c.value(text) == checksum
    return text if whole else None


@dataclass(frozen=True)
class ObjectSidecar:
    """A sidecar of small objects under one prefix of an object store.

    Writes to an object store can be conditional (If-None-Match, If-Match), removals cannot. A file is removed by one
    request right after it is read; if that fails, it is left empty, which counts as absent.
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
    """Return the sidecar of a store at a URL: ``s3://bucket/.plane.zarr.run/`` for ``s3://bucket/plane.zarr``."""
    parts = urlsplit(store.url)
    above, _, name = parts.path.rstrip("/").rpartition("/")
    if not name:
        raise InputError(f"{store}: a store needs a name below the bucket, such as {store}/plane.zarr")
    return ObjectSidecar(replace(store, url=parts._replace(path=f"{above}/.{name}.run").geturl()))
