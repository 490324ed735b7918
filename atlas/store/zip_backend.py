"""The backend of an atlas in one zip file, read-only.

Its members are those of Zarr's ZipStore, so xarray opens the file too.
"""

import errno
import glob
import os
import re
import threading
import uuid
import zipfile
import zlib
from collections.abc import Hashable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from stat import S_ISREG

from atlas.errors import InputError
from atlas.platform import file_lock
from atlas.store.backend import StoreBackend

SUFFIX = ".zip"
_SINCE = (1980, 1, 1, 0, 0, 0)
"""Date of every member, so that equal atlases give equal files."""
_LARGEST_UNPACKED = 2**28
"""Maximum unpacked size, in bytes, of a compressed member.

Packed atlases are not compressed; others may be zip bombs.
"""
_PARTIAL = re.compile(r"\.[0-9a-f]{32}\.partial")
_DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError)
"""Exceptions of zipfile for damaged files: a wrong checksum, an unknown method, a mark of encryption."""


@dataclass(frozen=True)
class ZipBackend(StoreBackend):
    """A zip file as a read-only backend. A damaged file raises OSErrors."""

    path: Path

    read_only_reason = "a zip file"

    def __str__(self) -> str:
        return str(self.path)

    def get(self, key: str) -> bytes | None:
        archive = self._archive()
        if archive is None:
            return None
        with archive.lock, zip_errors_as_os_errors(self.path):
            return archive.file.read(key) if key in archive.keys else None

    def version(self, key: str) -> Hashable:
        archive = self._archive()
        return self.path.stat().st_mtime_ns if archive is not None and key in archive.keys else None

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        archive = self._archive()
        yield from (key for key in (archive.keys if archive else ()) if key.startswith(prefix))

    def _archive(self) -> "_Archive | None":
        """Return the open file; None if it does not exist."""
        try:
            stat = os.stat(self.path)
        except (FileNotFoundError, NotADirectoryError):
            return None
        if not S_ISREG(stat.st_mode):  # a pipe could block its reader forever
            raise OSError(errno.EINVAL, "not a regular file", str(self.path))
        with zip_errors_as_os_errors(self.path):
            return _opened(self.path, stat.st_ino, stat.st_size, stat.st_mtime_ns, os.getpid())


@dataclass(frozen=True)
class _Archive:
    file: zipfile.ZipFile
    keys: dict[str, None]
    lock: threading.Lock


@lru_cache(maxsize=8)  # reads the table of contents once for each file and process
def _opened(path: Path, inode: int, size: int, changed: int, process: int) -> _Archive:
    file = zipfile.ZipFile(path)
    for member in file.infolist():
        if member.compress_size > size or member.file_size > max(member.compress_size, _LARGEST_UNPACKED):
            raise zipfile.BadZipFile(f"{member.filename} states a size of {member.file_size} bytes")
    return _Archive(file, dict.fromkeys(name for name in file.namelist() if not name.endswith("/")), threading.Lock())


@contextmanager
def zip_errors_as_os_errors(path: Path) -> Iterator[None]:
    """Convert zipfile's exceptions for a damaged file into an OSError with EIO, as for a bad sector."""
    try:
        yield
    except _DAMAGE as error:
        raise OSError(errno.EIO, f"the zip file is damaged or incomplete: {error}", str(path)) from None


def check_not_packed(place: StoreBackend) -> None:
    """Raise InputError if a backend that is to be written is read-only, such as a zip file."""
    if place.read_only_reason:
        name = f"folder such as {place.path.with_suffix('.zarr')}" if isinstance(place, ZipBackend) else "path or a URL"
        raise InputError(f"{place}: {place.read_only_reason} is read-only; give a {name}")


@contextmanager
def _held(unfinished: Path, timeout: float = -1) -> Iterator[None]:
    """Hold the lock of an unfinished file; the lock is deleted at the end.

    Raise OSError if another process holds it.
    """
    path = unfinished.with_suffix(".lock")
    path.touch()  # the lock would create a missing folder
    lock = file_lock(path)
    lock.acquire(timeout=timeout)
    try:
        yield
    finally:
        with suppress(OSError):
            path.unlink()
        lock.release()


def write_zip(target: Path, members: Iterable[tuple[str, bytes]]) -> int:
    """Write a zip file of these members, and return its size in bytes. It appears whole, or not at all.

    Nothing is compressed: chunks already are, and metadata are small. Unlocked files left by killed writers are
    removed.
    """
    begin = f".{target.name}"
    for left in target.parent.glob(f"{glob.escape(begin)}.*.partial"):
        if _PARTIAL.fullmatch(left.name.removeprefix(begin)):
            with suppress(OSError), _held(left, timeout=0):
                left.unlink()
    unfinished = target.with_name(f".{target.name}.{uuid.uuid4().hex}.partial")
    with ExitStack() as held:
        with suppress(OSError):  # a file system without locks
            held.enter_context(_held(unfinished))
        try:
            with unfinished.open("wb") as file:
                with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED, strict_timestamps=True) as archive:
                    for key, data in members:
                        member = zipfile.ZipInfo(key, _SINCE)
                        member.external_attr = 0o644 << 16
                        archive.writestr(member, data)
                file.flush()
                os.fsync(file.fileno())  # otherwise a crash may keep the rename and lose the content
            size = unfinished.stat().st_size
            os.replace(unfinished, target)
        finally:
            unfinished.unlink(missing_ok=True)
    return size
