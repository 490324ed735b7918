"""Where a store lies, and what is done there with whole objects: a place in general, and a folder of this machine."""

import errno
import os
import uuid
from collections.abc import Hashable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path


class Place:
    """A root that keys such as ``regime/c/0/1`` lie under. Errors of any network are OSErrors. ``str`` is its name.

    What is not overridden is that of a place that is read only.
    """

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
        """All keys, or those under a prefix that ends in "/", by one listing."""
        raise NotImplementedError

    def exists(self, key: str) -> bool:
        """Whether there is such an object."""
        return self.version(key) is not None

    def get_all(self, keys: Iterable[str]) -> dict[str, bytes]:
        """The bytes of the objects among these that exist, by key; many at once if each takes a while."""
        return {key: data for key in keys if (data := self.get(key)) is not None}

    def put(self, key: str, data: bytes) -> None:
        """Write an object whole, in place of any before it."""
        raise self._read_only()

    def put_new(self, key: str, data: bytes) -> bool:
        """Write an object if there is none of that key; else write nothing and return False."""
        raise self._read_only()

    def remove(self, key: str) -> None:
        """Remove an object; nothing happens if there is none."""
        raise self._read_only()

    def remove_all(self, keys: Iterable[str]) -> None:
        """Remove objects, in no order, many by one request if the place has such requests."""
        for key in keys:
            self.remove(key)

    def _read_only(self) -> OSError:
        return OSError(errno.EROFS, "a zip file is read only", str(self))


@dataclass(frozen=True)
class LocalPlace(Place):
    """A folder."""

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    @property
    def local(self) -> Path:
        return self.path

    def get(self, key: str) -> bytes | None:
        try:
            return (self.path / key).read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None

    def exists(self, key: str) -> bool:
        return (self.path / key).is_file()

    def version(self, key: str) -> Hashable:
        try:
            found = (self.path / key).stat()
        except (FileNotFoundError, NotADirectoryError):
            return None
        return found.st_ino, found.st_mtime_ns, found.st_size  # a write puts another file in its place

    def put(self, key: str, data: bytes) -> None:
        with self._written(key, data) as written:
            os.replace(written, self.path / key)

    def put_new(self, key: str, data: bytes) -> bool:
        with self._written(key, data) as written:
            try:
                os.link(written, self.path / key)  # it appears whole or not at all, on network disks too
            except FileExistsError:
                return False
        return True

    def remove(self, key: str) -> None:
        (self.path / key).unlink(missing_ok=True)

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        for folder, _, files in os.walk(self.path / prefix):
            above = Path(folder).relative_to(self.path).as_posix()
            begin = "" if above == "." else f"{above}/"
            yield from (begin + name for name in files if not name.endswith(".partial"))  # of a killed write

    @contextmanager
    def _written(self, key: str, data: bytes) -> Iterator[Path]:
        target = self.path / key
        target.parent.mkdir(parents=True, exist_ok=True)
        written = target.with_name(f"{target.name}.{uuid.uuid4().hex}.partial")
        try:
            written.write_bytes(data)
            yield written
        finally:
            written.unlink(missing_ok=True)
