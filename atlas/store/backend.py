"""The interface to whole objects of a store: places in general, and folders of this machine."""

import errno
import os
import uuid
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from stat import S_ISDIR
from typing import Self

_ABSENT = (FileNotFoundError, NotADirectoryError, IsADirectoryError)
"""Exceptions of operating systems for a missing object."""
Fence = Callable[[], None]
"""A function that raises an error once a place must no longer be written."""


class StoreBackend:
    """A root of keys such as ``regime/c/0/1``. Errors of any network are OSErrors. ``str`` is its name.

    A place behind a ``fence`` calls it right before each write and each removal, so a process that has lost its claim
    changes nothing more. The methods of this class are those of a read-only place.
    """

    fence: Fence | None = None
    read_only_reason = ""
    """The kind of place, in words, if it is read-only."""

    def with_fence(self, fence: Fence | None) -> Self:
        """The same place, which calls ``fence`` before it changes anything; None removes the fence."""
        fenced = copy(self)
        object.__setattr__(fenced, "fence", fence)  # no field: two views of one place are equal
        return fenced

    def __deepcopy__(self, memo: object) -> Self:
        return self  # a place is only a name

    def subfolder(self, folder: str) -> "StoreBackend":
        """The place of a store within this one, behind the same fence. ValueError if this place is read-only."""
        raise ValueError(f"{self}: nothing can be kept in a store that is only read")

    def check_fence(self) -> None:
        """Call the fence, if any: it raises an error if this place must no longer be written."""
        if self.fence is not None:
            self.fence()

    @property
    def local(self) -> Path | None:
        """The folder, None if it is not on one of this machine's disks."""
        return None

    def get(self, key: str) -> bytes | None:
        """An object's bytes, None if there is no such object."""
        raise NotImplementedError

    def version(self, key: str) -> Hashable:
        """A token of an object's present state, without its bytes; None if there is no such object."""
        raise NotImplementedError

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        """All keys, or the keys under a prefix that ends in "/", by one listing."""
        raise NotImplementedError

    def exists(self, key: str) -> bool:
        """Whether there is such an object."""
        return self.version(key) is not None

    def whole_keys(self, keys: Iterable[str]) -> Iterator[str]:
        """The keys of the objects among these that are not empty: a crash of a machine may leave empty files."""
        yield from keys

    def get_all(self, keys: Iterable[str]) -> dict[str, bytes]:
        """The bytes of the objects among these that exist, by key; many at once if each takes a while."""
        return {key: data for key in keys if (data := self.get(key)) is not None}

    def put(self, key: str, data: bytes) -> None:
        """Write an object whole, replacing an existing one."""
        raise self._read_only()

    def put_all(self, objects: Mapping[str, bytes]) -> None:
        """Write objects, in no order, all at once if each takes a while."""
        for key, data in objects.items():
            self.put(key, data)

    def put_new(self, key: str, data: bytes) -> bool:
        """Write an object if there is none of that key; else write nothing and return False."""
        raise self._read_only()

    def copy_all(self, other: "StoreBackend", keys: Iterable[str]) -> None:
        """Copy objects from another place, by links or on the server if possible; missing ones are left out."""
        self.put_all(other.get_all(keys))

    def remove(self, key: str) -> None:
        """Remove an object; nothing happens if there is none."""
        raise self._read_only()

    def remove_all(self, keys: Iterable[str]) -> None:
        """Remove objects, in no order, many by one request if the place has such requests."""
        for key in keys:
            self.remove(key)

    def _read_only(self) -> OSError:
        return OSError(errno.EROFS, f"{self.read_only_reason} is read only", str(self))


@dataclass(frozen=True)
class LocalBackend(StoreBackend):
    """A folder. An empty folder or file under the key of an object is no object, and an object may replace it."""

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    @property
    def local(self) -> Path:
        return self.path

    def get(self, key: str) -> bytes | None:
        path = self.path / key
        try:
            return path.read_bytes()
        except _ABSENT:
            return None
        except PermissionError:
            if path.is_dir():  # the error of Windows for a folder
                return None
            raise

    def exists(self, key: str) -> bool:
        try:
            stat = (self.path / key).stat()
        except _ABSENT:
            return False
        return not S_ISDIR(stat.st_mode) and stat.st_size > 0

    def whole_keys(self, keys: Iterable[str]) -> Iterator[str]:
        yield from filter(self.exists, keys)

    def version(self, key: str) -> Hashable:
        try:
            stat = (self.path / key).stat()
        except _ABSENT:
            return None
        # A write puts another file in its place.
        return None if S_ISDIR(stat.st_mode) else (stat.st_ino, stat.st_mtime_ns, stat.st_size)

    def subfolder(self, folder: str) -> "LocalBackend":
        return LocalBackend(self.path / folder).with_fence(self.fence)

    def put(self, key: str, data: bytes) -> None:
        with self._written(key, lambda written: _write_flushed(written, data)) as written:
            os.replace(written, self.path / key)

    def copy_all(self, other: StoreBackend, keys: Iterable[str]) -> None:
        """See Place. On one file system the object gets a second name: no object is ever changed, only replaced."""
        rest = []
        for key in keys:
            try:
                self._link(other, key)
            except FileNotFoundError:
                continue
            except OSError:  # another file system, one without links, or one with too many links to a file
                rest.append(key)
        super().copy_all(other, rest)

    def _link(self, other: StoreBackend, key: str) -> None:
        if other.local is None:
            raise OSError(errno.EXDEV, "not a folder", str(other))
        source = other.local / key
        with self._written(key, lambda written: os.link(source, written)) as written:
            os.replace(written, self.path / key)

    def put_new(self, key: str, data: bytes) -> bool:
        with self._written(key, lambda written: _write_flushed(written, data)) as written:
            try:
                os.link(written, self.path / key)  # it appears whole or not at all, on network disks too
            except FileExistsError:
                return False
            except OSError:  # a file system without links
                return self._reserve(key) and bool(written.replace(self.path / key))
        return True

    def _reserve(self, key: str) -> bool:
        """Make an empty file, which counts as no object; False if there is a file."""
        try:
            (self.path / key).open("xb").close()
        except FileExistsError:
            return False
        return True

    def remove(self, key: str) -> None:
        self.check_fence()
        self._clear(key)
        (self.path / key).unlink(missing_ok=True)

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        for folder, _, files in os.walk(self.path / prefix):
            above = Path(folder).relative_to(self.path).as_posix()
            begin = "" if above == "." else f"{above}/"
            yield from (begin + name for name in files if not name.endswith(".partial"))  # of a killed write

    @contextmanager
    def _written(self, key: str, make: Callable[[Path], object]) -> Iterator[Path]:
        """A file made by ``make`` next to the place of an object; it is removed unless the block moves it."""
        target = self.path / key
        target.parent.mkdir(parents=True, exist_ok=True)
        written = target.with_name(f"{target.name}.{uuid.uuid4().hex}.partial")
        try:
            make(written)
            self.check_fence()
            self._clear(key)
            yield written
        finally:
            written.unlink(missing_ok=True)

    def _clear(self, key: str) -> None:
        """Remove an empty folder under the key of an object; OSError if it is not empty."""
        if (self.path / key).is_dir():
            (self.path / key).rmdir()


def _write_flushed(path: Path, data: bytes) -> None:
    """Write a file that is to be renamed; its content is on the disk before: else a crash may leave an empty file."""
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
