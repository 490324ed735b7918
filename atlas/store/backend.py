"""The interface to the storage behind a store, which reads and writes whole objects, and its version for local
folders.
"""

import errno
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from stat import S_ISDIR
from typing import Self

from atlas.platform import flush, move_whole, temporary_beside

_ABSENT = (FileNotFoundError, NotADirectoryError, IsADirectoryError)
"""Exceptions by which the operating system says that an object does not exist."""
Confirmation = Callable[[], None]
"""A function that raises an error unless the run of this process still leases the store."""


class StoreBackend:
    """Base class of the storage behind a store: objects by keys such as ``regime/c/0/1``.

    ``commit`` first confirms that the run of this process still leases the store, so that a process that has lost its
    lease finishes nothing more. The methods of this class are those of a read-only backend. Network errors are
    OSErrors. ``str`` is the name of the backend.
    """

    confirmation: Confirmation | None = None
    read_only_reason = ""
    """The kind of backend, for messages, if it is read-only; else empty."""

    def with_lease(self, confirmation: Confirmation | None) -> Self:
        """Return the same backend with a function that confirms the lease of the store; None if no lease is needed."""
        leased = copy(self)
        vars(leased).update(confirmation=confirmation)  # no field: two views of one backend are equal
        return leased

    def __deepcopy__(self, memo: object) -> Self:
        return self  # a backend is only a name

    def confirm_lease(self) -> None:
        """Raise an error if the run of this process has lost the lease of the store; this takes one read."""
        if self.confirmation is not None:
            self.confirmation()

    @property
    def local(self) -> Path | None:
        """The folder of the store on this host; None for any other storage."""
        return None

    def get(self, key: str, part: slice | None = None) -> bytes | None:
        """Return the bytes of an object, or a part of them; None if the object does not exist."""
        raise NotImplementedError

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        """Yield all keys, or the keys under a prefix that ends in "/", from one listing."""
        raise NotImplementedError

    def exists(self, key: str) -> bool:
        """Return True if the object exists; its bytes are not read."""
        raise NotImplementedError

    def whole_keys(self, keys: Iterable[str]) -> Iterator[str]:
        """Yield those of the keys whose objects are not empty: a crash of the system may leave empty files."""
        yield from keys

    def get_all(self, keys: Iterable[str]) -> dict[str, bytes]:
        """Return the bytes of the existing objects among ``keys``, by key; slow backends read many at the same time."""
        return {key: data for key in keys if (data := self.get(key)) is not None}

    def put(self, key: str, data: bytes) -> None:
        """Write a whole object, replacing an existing one."""
        raise self._read_only()

    def commit(self, key: str, data: bytes) -> None:
        """Write an object that marks others as finished, such as the regime of a tile, once the lease of the store is
        confirmed.
        """
        self.confirm_lease()
        self.put(key, data)

    def put_all(self, objects: Mapping[str, bytes]) -> None:
        """Write objects in any order; slow backends write many at the same time."""
        for key, data in objects.items():
            self.put(key, data)

    def put_new(self, key: str, data: bytes) -> bool:
        """Write an object if none of that key exists; else write nothing and return False."""
        raise self._read_only()

    def copy_all(self, other: "StoreBackend", keys: Iterable[str]) -> None:
        """Copy objects from another backend, by links or on the server if possible; missing objects are skipped."""
        self.put_all(other.get_all(keys))

    def remove(self, key: str) -> None:
        """Remove an object; do nothing if it does not exist."""
        raise self._read_only()

    def remove_all(self, keys: Iterable[str]) -> None:
        """Remove objects in any order, many by one request if the backend has such requests."""
        for key in keys:
            self.remove(key)

    def _read_only(self) -> OSError:
        return OSError(errno.EROFS, f"{self.read_only_reason} is read-only", str(self))


@dataclass(frozen=True)
class LocalBackend(StoreBackend):
    """A local folder as a backend.

    An empty folder or file at the key of an object counts as absent, and an object may replace it. obstore's LocalStore
    is not used: it does not flush files, hangs in a forked process, and takes 15 times as long to list a folder.
    """

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    @property
    def local(self) -> Path:
        return self.path

    def get(self, key: str, part: slice | None = None) -> bytes | None:
        path = self.path / key
        try:
            with path.open("rb", buffering=0) as file:
                begin, end, _ = (part or slice(None)).indices(os.fstat(file.fileno()).st_size)
                file.seek(begin)
                return file.read(end - begin)
        except _ABSENT:
            return None
        except PermissionError:
            if path.is_dir():  # Windows raises it for a folder
                return None
            raise

    def exists(self, key: str) -> bool:
        try:
            stat = os.stat(f"{self.path}/{key}")  # the time of a path would double that of a listing
        except _ABSENT:
            return False
        return not S_ISDIR(stat.st_mode) and stat.st_size > 0

    def whole_keys(self, keys: Iterable[str]) -> Iterator[str]:
        yield from filter(self.exists, keys)

    def put(self, key: str, data: bytes) -> None:
        with self._written(key, lambda written: written.write_bytes(data)) as written:
            move_whole(written, self.path / key)

    def copy_all(self, other: StoreBackend, keys: Iterable[str]) -> None:
        """Copy objects as in ``StoreBackend``, by links on one file system: objects are replaced, never changed."""
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
        target = self.path / key
        with self._written(key, lambda written: written.write_bytes(data)) as written:
            flush(written)
            try:
                os.link(written, target)  # appears whole or not at all, on network disks too
            except FileExistsError:
                return False
            except OSError:  # a file system without links: an empty file, which counts as no object, reserves the key
                try:
                    target.open("xb").close()
                except FileExistsError:
                    return False
                os.replace(written, target)
        return True

    def remove(self, key: str) -> None:
        self._clear(key)
        (self.path / key).unlink(missing_ok=True)

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        for folder, _, files in os.walk(self.path / prefix):
            above = Path(folder).relative_to(self.path).as_posix()
            begin = "" if above == "." else f"{above}/"
            yield from [begin + name for name in files if not name.endswith(".partial")]  # left by killed writes

    @contextmanager
    def _written(self, key: str, make: Callable[[Path], object]) -> Iterator[Path]:
        """Yield the path of a temporary file that ``make`` has written, in the folder where the object of this key
        belongs.

        The file is removed unless the block moves it.
        """
        target = self.path / key
        with temporary_beside(target) as written:
            for last in (False, True):
                target.parent.mkdir(parents=True, exist_ok=True)
                with suppress(*() if last else (FileNotFoundError,)):  # another process may just remove the folder
                    make(written)
                    break
            self._clear(key)
            yield written

    def _clear(self, key: str) -> None:
        """Remove an empty folder at the key of an object; raise OSError if it is not empty."""
        if (self.path / key).is_dir():
            (self.path / key).rmdir()
