"""Notes of a store: small named texts next to it that the processes at work on it share, with a conditional write."""

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from atlas.platform import file_lock
from atlas.store.archive import ZipPlace
from atlas.store.location import ObjectPlace, Place, place_of
from atlas.store.notes import notes_at_url

CLAIM = "claim"
"""The note by which one run at a time has the store."""
_LOCK = ".lock"
_LOOKS, _BETWEEN_LOOKS = 100, 0.01
"""How often, and at which distance in seconds, a note is read that its maker has opened and not yet written."""


class Notes(Protocol):
    """Small named notes of one store that several processes share, with a conditional write.

    An object store gives the same by its conditional puts: If-None-Match: * for an absent note, If-Match with the
    entity tag that came with the expected bytes to replace one.
    """

    def read(self, name: str) -> bytes | None:
        """A note's bytes, None where there is none."""

    def put(self, name: str, data: bytes, expected: bytes | None) -> bool:
        """Write a note if it is absent (``expected`` None) or holds the expected bytes; False, unwritten, if not."""

    def remove(self, name: str, expected: bytes) -> bool:
        """Remove a note that holds the expected bytes; False where it does not."""

    def drop(self, name: str) -> None:
        """Remove a note, whatever it holds: only for its maker, and where nobody else would put another one."""

    def clear(self, keep: str) -> None:
        """Remove all notes but one: only for who holds that one."""


def notes_of(store: str | os.PathLike[str] | Place) -> Notes:
    """The notes of a store: next to it, not in it, since a claim comes before the store, and Zarr owns its inside.

    Of a store that is named by a link they are next to what the link leads to: a store has one claim.
    """
    place = place_of(store)
    if isinstance(place, ObjectPlace):
        return notes_at_url(place)
    path = place.path if isinstance(place, ZipPlace) else place.local  # nobody claims a file, so there are none
    assert path is not None
    path = Path(os.path.realpath(path))
    return Folder(path.parent / f".{path.name}.run")


def claim_token(notes: Notes) -> str:
    """The token of the run that has claimed a store, by one read; empty where there is none or it is damaged."""
    try:
        return str(json.loads(notes.read(CLAIM) or b"{}").get("token", ""))
    except (ValueError, AttributeError, RecursionError):
        return ""


@dataclass(frozen=True)
class Folder:
    """Notes as files of a folder. The folder's lock, held for an instant, makes a conditional write whole.

    Notes are overwritten in place: that needs no room, so a full disk does not cost a run its claim.
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
        """See Notes."""
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
        """See Notes."""
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
