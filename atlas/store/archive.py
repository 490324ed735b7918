"""An atlas as one zip file, for reading: its objects as the members of Zarr's ZipStore, so that xarray opens it too."""

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

from atlas.errors import InputError
from atlas.platform import file_lock

SUFFIX = ".zip"
_SINCE = (1980, 1, 1, 0, 0, 0)
"""The date of every member, so that equal atlases are equal files."""
_LARGEST_UNPACKED = 2**28
"""Bytes that a member may have that is compressed, as none of ours is: its few bytes may say that they are many."""
_PARTIAL = re.compile(r"\.[0-9a-f]{32}\.partial")
_DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError)
"""What zipfile raises for bytes that nobody packed: a wrong checksum, an unknown method, a mark of encryption."""


@dataclass(frozen=True)
class ZipPlace:
    """A zip file as a place that is read only: see ``location.Place``. A damaged one raises OSErrors."""

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    @property
    def local(self) -> None:
        """See Place: it is no folder."""

    def get(self, key: str) -> bytes | None:
        """See Place."""
        archive = self._archive()
        if archive is None:
            return None
        with archive.lock, reading(self.path):
            try:
                return archive.file.read(key)
            except KeyError:
                return None

    def exists(self, key: str) -> bool:
        """See Place."""
        archive = self._archive()
        return archive is not None and key in archive.keys

    def get_all(self, keys: Iterable[str]) -> dict[str, bytes]:
        """See Place."""
        return {key: data for key in keys if (data := self.get(key)) is not None}

    def version(self, key: str) -> Hashable:
        """See Place."""
        return self.path.stat().st_mtime_ns if self.exists(key) else None

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        """See Place."""
        archive = self._archive()
        yield from (key for key in (archive.keys if archive else ()) if key.startswith(prefix))

    def put(self, key: str, data: bytes) -> None:
        """See Place: refused."""
        raise self._read_only()

    def put_new(self, key: str, data: bytes) -> bool:
        """See Place: refused."""
        raise self._read_only()

    def remove(self, key: str) -> None:
        """See Place: refused."""
        raise self._read_only()

    def remove_all(self, keys: Iterable[str]) -> None:
        """See Place: refused."""
        raise self._read_only()

    def _archive(self) -> "_Archive | None":
        """The open file, None where there is none."""
        try:
            found = os.stat(self.path)
        except (FileNotFoundError, NotADirectoryError):
            return None
        with reading(self.path):
            return _opened(self.path, found.st_ino, found.st_size, found.st_mtime_ns, os.getpid())

    def _read_only(self) -> OSError:
        return OSError(errno.EROFS, "a zip file is read only", str(self.path))


@dataclass(frozen=True)
class _Archive:
    file: zipfile.ZipFile
    keys: dict[str, None]
    lock: threading.Lock


@lru_cache(maxsize=8)  # its table of contents is read once, and again where another file or process is meant
def _opened(path: Path, inode: int, size: int, changed: int, process: int) -> _Archive:
    file = zipfile.ZipFile(path)
    for member in file.infolist():
        if member.compress_size > size or member.file_size > max(member.compress_size, _LARGEST_UNPACKED):
            raise zipfile.BadZipFile(f"{member.filename} says that it has {member.file_size} bytes")
    return _Archive(file, dict.fromkeys(name for name in file.namelist() if not name.endswith("/")), threading.Lock())


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """What zipfile raises for a damaged file becomes an OSError that says so: EIO, as of a bad sector."""
    try:
        yield
    except _DAMAGE as error:
        raise OSError(errno.EIO, f"the zip file is damaged or incomplete: {error}", str(path)) from None


def refuse_packed(place: object) -> None:
    """InputError where a place that is to be written is a zip file."""
    if isinstance(place, ZipPlace):
        raise InputError(f"{place}: a zip file is read only; give a folder such as {place.path.with_suffix('.zarr')}")


def _remove_left(target: Path) -> None:
    begin = f".{target.name}"
    for left in target.parent.glob(f"{glob.escape(begin)}.*.partial"):
        if _PARTIAL.fullmatch(left.name.removeprefix(begin)):
            with suppress(OSError), _held(left, timeout=0):
                left.unlink()


@contextmanager
def _held(unfinished: Path, timeout: float = -1) -> Iterator[None]:
    """Hold the lock of an unfinished file, which goes with it; an OSError where another process does."""
    path = unfinished.with_suffix(".lock")
    path.touch()  # the lock would make a missing folder
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

    Nothing is compressed: the chunks of a store are, and its few metadata are small. What writers left behind that were
    killed is removed: the files whose lock nobody holds.
    """
    _remove_left(target)
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
                os.fsync(file.fileno())  # or a rename could outlive the content
            size = unfinished.stat().st_size
            os.replace(unfinished, target)
        finally:
            unfinished.unlink(missing_ok=True)
    return size
