"""Where a store lies: a folder of this machine or a URL, and what is done there with whole objects.

Zarr reads and writes arrays in any of these places by stores of its own. This is the rest: one listing, one object
put, removed or looked for, and a write under a condition, which an object store has in place of a rename.
"""

import os
import uuid
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeGuard, TypeVar
from urllib.parse import urlsplit
from urllib.request import url2pathname

from atlas.errors import InputError
from atlas.store.archive import SUFFIX, ZipPlace
from atlas.store.outage import BRIEF, first_line, persist

if TYPE_CHECKING:
    from obstore import PutMode, UpdateVersion
    from obstore.store import ObjectStore

SCHEMES = ("s3", "s3a", "gs", "az", "azure", "adl", "abfs", "abfss", "http", "https")
"""Schemes of URLs that a store may have, besides ``file``: the ones that obstore supports."""
_ENDPOINTS = ("AWS_ENDPOINT_URL", "AWS_ENDPOINT", "GOOGLE_BASE_URL", "AZURE_STORAGE_ENDPOINT", "AZURE_ENDPOINT")
AT_ONCE = 64
"""Requests under way together where many objects of a server are read: it answers all as soon as one."""
_T = TypeVar("_T")


class Place(Hashable, Protocol):
    """A root that keys such as ``regime/c/0/1`` lie under. Errors of any network are OSErrors. ``str`` is its name."""

    @property
    def local(self) -> Path | None:
        """The folder, None where it is not one of this machine's disks."""

    def get(self, key: str) -> bytes | None:
        """An object's bytes, None where there is none."""

    def exists(self, key: str) -> bool:
        """Whether there is such an object."""

    def version(self, key: str) -> Hashable:
        """A token of an object's present state, without its bytes; None where there is no object."""

    def put(self, key: str, data: bytes) -> None:
        """Write an object whole, in place of any before it."""

    def put_new(self, key: str, data: bytes) -> bool:
        """Write an object if there is none of that key; False, and nothing is written, where there is."""

    def remove(self, key: str) -> None:
        """Remove an object; nothing happens where there is none."""

    def get_all(self, keys: Iterable[str]) -> dict[str, bytes]:
        """The bytes of the objects among these that exist, by key: many at once where each takes a while."""

    def remove_all(self, keys: Iterable[str]) -> None:
        """Remove objects, in no order, many by one request where the place has such requests."""

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        """All keys, those under a prefix that ends in "/", or all, by one listing."""


def place_of(store: "str | os.PathLike[str] | Place", patience: float = BRIEF) -> Place:
    """The place that a user named by a path or a URL; InputError for a URL that cannot be one.

    A path that ends in .zip is an atlas packed into one file, unless it is a folder.

    A server at a URL that does not answer is waited for ``patience`` seconds.
    """
    if isinstance(store, LocalPlace | ObjectPlace | ZipPlace):
        return store
    if not is_url(store):
        return _place_at(Path(store).absolute())  # type: ignore[arg-type]
    scheme = store.partition("://")[0]
    if scheme == "file":
        return _place_at(Path(url2pathname(urlsplit(store.rstrip("/")).path)).absolute())
    if scheme not in SCHEMES:
        raise InputError(f"{store}: found {scheme}://, must be a path, file:// or one of {', '.join(SCHEMES)}://")
    place = ObjectPlace(store.rstrip("/"), patience)
    try:
        _ = place.client  # a URL that cannot work is refused here
    except ImportError as error:
        raise InputError(f"{place}: {first_line(error)}; needs obstore: pip install obstore") from None
    except Exception as error:
        raise InputError(f"{place}: not a place for a store: {first_line(error)}") from None
    return place


def is_url(store: object) -> TypeGuard[str]:
    """Whether a name of a store is a URL; a scheme has two letters or more: C: is a disk of Windows."""
    return isinstance(store, str) and len(store.partition("://")[0]) > 1 and "://" in store


def _place_at(path: Path) -> Place:
    return ZipPlace(path) if path.suffix.lower() == SUFFIX and not path.is_dir() else LocalPlace(path)


def waiting(place: Place, patience: float) -> Place:
    """The same place, with another patience where it is at a URL."""
    return replace(place, patience=patience) if isinstance(place, ObjectPlace) else place


@dataclass(frozen=True)
class LocalPlace:
    """A folder."""

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    @property
    def local(self) -> Path:
        """See Place."""
        return self.path

    def get(self, key: str) -> bytes | None:
        """See Place."""
        try:
            return (self.path / key).read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None

    def exists(self, key: str) -> bool:
        """See Place."""
        return (self.path / key).is_file()

    def version(self, key: str) -> Hashable:
        """See Place. A write puts another file in its place."""
        try:
            found = (self.path / key).stat()
        except (FileNotFoundError, NotADirectoryError):
            return None
        return found.st_ino, found.st_mtime_ns, found.st_size

    def put(self, key: str, data: bytes) -> None:
        """See Place."""
        with self._written(key, data) as written:
            os.replace(written, self.path / key)

    def put_new(self, key: str, data: bytes) -> bool:
        """See Place. A link appears with its whole content or not at all, on network disks too."""
        with self._written(key, data) as written:
            try:
                os.link(written, self.path / key)
            except FileExistsError:
                return False
        return True

    def remove(self, key: str) -> None:
        """See Place."""
        (self.path / key).unlink(missing_ok=True)

    def get_all(self, keys: Iterable[str]) -> dict[str, bytes]:
        """See Place."""
        return {key: data for key in keys if (data := self.get(key)) is not None}

    def remove_all(self, keys: Iterable[str]) -> None:
        """See Place."""
        for key in keys:
            self.remove(key)

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        """See Place. What a killed write left behind is none."""
        for folder, _, files in os.walk(self.path / prefix):
            above = Path(folder).relative_to(self.path).as_posix()
            begin = "" if above == "." else f"{above}/"
            yield from (begin + name for name in files if not name.endswith(".partial"))

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


@dataclass(frozen=True)
class ObjectPlace:
    """A prefix of an object store, by obstore. Credentials and endpoint come from the environment (AWS_*, ...).

    A server that does not answer is waited for ``patience`` seconds in each call, which then raises NetworkError.
    """

    url: str
    patience: float = field(default=BRIEF, compare=False)

    def __str__(self) -> str:
        return self.url

    @property
    def local(self) -> None:
        """See Place."""

    @cached_property
    def client(self) -> "ObjectStore":
        """obstore's own object, which Zarr takes too. It tries everything once: ``persist`` knows when to try again."""
        from obstore.store import from_url

        options: dict[str, Any] = {"retry_config": {"max_retries": 0}}
        if any(text.startswith("http://") for text in (self.url, *(os.environ.get(name, "") for name in _ENDPOINTS))):
            options["client_options"] = {"allow_http": True}  # the URL says http explicitly
        return from_url(self.url, **options)

    def get(self, key: str) -> bytes | None:
        """See Place."""
        found = self.get_tagged(key)
        return None if found is None else found[0]

    def get_tagged(self, key: str) -> "tuple[bytes, UpdateVersion] | None":
        """An object's bytes, and the version that ``put_if`` knows this state of it by."""
        import obstore

        def once() -> "tuple[bytes, UpdateVersion] | None":
            try:
                found = obstore.get(self.client, key)
            except FileNotFoundError:
                return None
            # S3 and Azure compare the tag, Google's store its generation, which is the version.
            version: UpdateVersion = {}
            if found.meta["e_tag"] is not None:
                version["e_tag"] = found.meta["e_tag"]
            if found.meta["version"] is not None:
                version["version"] = found.meta["version"]
            return bytes(found.bytes()), version

        return self._persist(once)

    def exists(self, key: str) -> bool:
        """See Place."""
        return self.version(key) is not None

    def version(self, key: str) -> Hashable:
        """See Place."""
        import obstore

        def once() -> Hashable:
            try:
                found = obstore.head(self.client, key)
            except FileNotFoundError:
                return None
            return found["e_tag"], found["version"], found["last_modified"], found["size"]

        return self._persist(once)

    def put(self, key: str, data: bytes) -> None:
        """See Place."""
        import obstore

        self._persist(lambda: obstore.put(self.client, key, data))

    def put_new(self, key: str, data: bytes) -> bool:
        """See Place. HTTP's If-None-Match: * does it: of two at once one succeeds."""
        from obstore.exceptions import AlreadyExistsError

        return self._put_under(key, data, "create", (AlreadyExistsError,))

    def put_if(self, key: str, data: bytes, version: "UpdateVersion") -> bool:
        """Replace an object that is still the one that ``get_tagged`` gave this version of (If-Match); else False."""
        from obstore.exceptions import PreconditionError

        return self._put_under(key, data, version, (PreconditionError, FileNotFoundError))

    def remove(self, key: str) -> None:
        """See Place."""
        import obstore

        def once() -> None:
            with suppress(FileNotFoundError):
                obstore.delete(self.client, key)

        self._persist(once)

    def get_all(self, keys: Iterable[str]) -> dict[str, bytes]:
        """See Place."""
        wanted = list(keys)
        with ThreadPoolExecutor(AT_ONCE) as pool:
            found = zip(wanted, pool.map(self.get, wanted), strict=True)
            return {key: data for key, data in found if data is not None}

    def remove_all(self, keys: Iterable[str]) -> None:
        """See Place."""
        import obstore

        unwanted = list(keys)
        try:
            self._persist(lambda: obstore.delete(self.client, unwanted))
        except FileNotFoundError:  # Google's and Azure's stores stop there, even where a lost answer removed it
            with ThreadPoolExecutor(AT_ONCE) as pool:
                list(pool.map(self.remove, unwanted))

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        """See Place."""
        import obstore

        def once() -> list[str]:
            return [entry["path"] for page in obstore.list(self.client, prefix or None) for entry in page]

        yield from self._persist(once)

    def _put_under(self, key: str, data: bytes, mode: "PutMode", refusals: tuple[type[Exception], ...]) -> bool:
        """Put under a condition; False where one of these errors says that it does not hold."""
        import obstore
        from obstore.exceptions import BaseError

        failed = False

        def once() -> bool:
            nonlocal failed
            try:
                obstore.put(self.client, key, data, mode=mode, use_multipart=False)
            except refusals:
                # An attempt whose answer was lost may have written it, and so be what this one is refused for.
                return failed and self.get(key) == data
            except BaseError:
                failed = True
                raise
            return True

        return self._persist(once)

    def _persist(self, call: Callable[[], _T]) -> _T:
        return persist(call, self.url, self.patience)
