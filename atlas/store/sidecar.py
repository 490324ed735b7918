"""Notes of a store: small named texts next to it that the processes at work on it share, with a conditional write.

A run claims a store by a note. Notes are files next to a folder, and objects next to a store at a URL.
"""

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol
from urllib.parse import urlsplit

from atlas.errors import InputError
from atlas.platform import file_lock
from atlas.store.archive import ZipPlace
from atlas.store.location import ObjectPlace, Place, place_of

CLAIM = "claim"
"""The note by which one run at a time has the store."""
_LOCK = ".lock"
_LOOKS, _BETWEEN_LOOKS = 100, 0.01
"""How often to read a note that its maker has opened and not yet written, and the seconds between two reads."""


class Notes(Protocol):
    """Small named notes of one store that several processes share, with a conditional write."""

    def read(self, name: str) -> bytes | None:
        """A note's bytes, None if there is none."""

    def put(self, name: str, data: bytes, expected: bytes | None) -> bool:
        """Write a note if it is absent (``expected`` None) or holds the expected bytes; False, unwritten, if not."""

    def remove(self, name: str, expected: bytes) -> bool:
        """Remove a note that holds the expected bytes; False if it does not."""

    def drop(self, name: str) -> None:
        """Remove a note, whatever it holds: only for its maker, if nobody else would put another one."""

    def clear(self, keep: str) -> None:
        """Remove all notes but one: only for who holds that one."""


def notes_of(store: str | os.PathLike[str] | Place) -> Notes:
    """The notes of a store: next to it, since a claim comes before the store and Zarr owns its inside.

    If the store's path is a link, they are next to its target, so that a store has one claim.
    """
    place = place_of(store)
    if isinstance(place, ObjectPlace):
        return notes_at_url(place)
    path = place.path if isinstance(place, ZipPlace) else place.local  # nobody claims a file, so there are none
    assert path is not None
    path = Path(os.path.realpath(path))
    return Folder(path.parent / f".{path.name}.run")


def claim_token(notes: Notes) -> str:
    """The token of the run that has claimed a store, by one read; empty if there is none or it is damaged."""
    try:
        return str(json.loads(notes.read(CLAIM) or b"{}").get("token", ""))
    except (ValueError, AttributeError, RecursionError):
        return ""


@dataclass(frozen=True)
class Folder:
    """Notes as files of a folder. The folder's lock, held for an instant, makes a conditional write atomic.

    Notes are overwritten in place, which needs no room: a run on a full disk keeps its claim.
    """

    path: Path

    def read(self, name: str) -> bytes | None:
        """See Notes. An empty file is a note being made: it is waited for, unless its maker was killed there."""
        for _ in range(_LOOKS):
            if not (self.path / name).exists():
                return None
            with self._locked():
                data = self._bytes(name)
            if data != b"":
                break
            time.sleep(_BETWEEN_LOOKS)
        return data

    def put(self, name: str, data: bytes, expected: bytes | None) -> bool:
        if expected is None:
            return self._create(name, data)
        if not (self.path / name).exists():
            return False
        with self._locked():
            if self._bytes(name) != expected:
                return False
            with open(self.path / name, "r+b", buffering=0) as file:
                file.write(data)
                file.truncate()
            return True

    def remove(self, name: str, expected: bytes) -> bool:
        """See Notes."""
        if not (self.path / name).exists():
            return False
        with self._locked():
            if self._bytes(name) != expected:
                return False
            (self.path / name).unlink()
            return True

    def drop(self, name: str) -> None:
        """See Notes."""
        if (self.path / name).exists():
            with self._locked():
                (self.path / name).unlink(missing_ok=True)

    def clear(self, keep: str) -> None:
        for file in self.path.glob("*"):
            if file.name not in (keep, _LOCK):
                file.unlink(missing_ok=True)

    def _bytes(self, name: str) -> bytes | None:
        try:
            return (self.path / name).read_bytes()
        except FileNotFoundError:
            return None

    def _create(self, name: str, data: bytes) -> bool:
        while True:
            self.path.mkdir(parents=True, exist_ok=True)
            with suppress(FileNotFoundError), self._locked():  # another may just have removed the folder
                try:
                    file = open(self.path / name, "xb", buffering=0)  # noqa: SIM115
                except FileExistsError:
                    return False
                try:
                    with file:
                        file.write(data)
                except OSError:
                    (self.path / name).unlink()
                    raise
                return True

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Alone with the notes; on a file system without locks a race of microseconds remains.

        The folder goes with its last note, and its lock with it.
        """
        lock = file_lock(self.path / _LOCK)
        with suppress(OSError):
            lock.acquire()
        try:
            yield
        finally:
            with suppress(OSError):
                if lock.is_locked and [file.name for file in self.path.iterdir()] == [_LOCK]:
                    (self.path / _LOCK).unlink()
            lock.release()
            with suppress(OSError):
                self.path.rmdir()


@dataclass(frozen=True)
class UrlNotes:
    """Notes as small objects under one prefix.

    An object store makes each write one act (If-None-Match, If-Match). It has no removal under a condition, so that a
    note that was removed under one is empty, which reads and counts as none.
    """

    place: ObjectPlace

    def read(self, name: str) -> bytes | None:
        return self.place.get(name) or None

    def put(self, name: str, data: bytes, expected: bytes | None) -> bool:
        if expected is None and self.place.put_new(name, data):
            return True
        found = self.place.get_tagged(name)
        return found is not None and found[0] == (expected or b"") and self.place.put_if(name, data, found[1])

    def remove(self, name: str, expected: bytes) -> bool:
        return self.put(name, b"", expected)

    def clear(self, keep: str) -> None:
        self.place.remove_all(name for name in self.place.list_keys() if name != keep)

    def drop(self, name: str) -> None:
        self.place.remove(name)


def notes_at_url(store: ObjectPlace) -> UrlNotes:
    """The notes of a store at a URL, next to it: ``s3://bucket/.plane.zarr.run/`` for ``s3://bucket/plane.zarr``."""
    above, _, name = str(store).rpartition("/")
    if not urlsplit(str(store)).path.strip("/"):
        raise InputError(f"{store}: a store needs a name below the bucket, such as {store}/plane.zarr")
    return UrlNotes(replace(store, url=f"{above}/.{name}.run"))
