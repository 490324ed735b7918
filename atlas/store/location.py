"""The place of a store by its path or URL, and whole objects at a URL.

Zarr reads and writes arrays in any place by stores of its own. This module lists, puts, removes and looks for objects,
and writes under a condition, which an object store has in place of a rename.
"""

import itertools
import os
import pickle
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeGuard, TypeVar
from urllib.parse import urlsplit
from urllib.request import url2pathname

from atlas.arguments import checked_path
from atlas.errors import InputError, NetworkError, UnlistedError, shown, without_secrets
from atlas.store.access import BY_ENVIRONMENT, Access, access_by, access_of, is_obstore, local_folder, signed_in
from atlas.store.archive import SUFFIX, ZipPlace
from atlas.store.outage import BRIEF, first_line, persist
from atlas.store.place import LocalPlace as LocalPlace
from atlas.store.place import Place as Place
from atlas.store.zarr_place import ZarrPlace, is_zarr_store, zarr_place

if TYPE_CHECKING:
    from obstore import PutMode, UpdateVersion
    from obstore.store import ObjectStore
    from zarr.abc.store import Store

    Given: TypeAlias = str | os.PathLike[str] | Place | ObjectStore | Store
else:
    Given = Any  # the type of a store given by a user; its members take a while to load

SCHEMES = ("s3", "s3a", "gs", "az", "azure", "adl", "abfs", "abfss", "http", "https")
"""Schemes of URLs that a store may have, besides ``file``: the ones that obstore supports."""
_SETTINGS = ("AWS_", "GOOGLE_", "AZURE_", "OBJECT_STORE_")
"""Prefixes of settings of a client in the environment."""
AT_ONCE = 64
"""Simultaneous requests when many objects of a server are read: it answers all as soon as one."""
_T = TypeVar("_T")
_beyond: Mapping[str, Any] = {}
"""Default storage options of URLs in this process."""


def place_of(store: Given, patience: float = BRIEF, storage_options: Mapping[str, Any] | None = None) -> Place:
    """The place that a user names by a path or a URL, or gives as an obstore store or as a Zarr store object.

    A path that ends in .zip is an atlas packed into one file, unless it is a folder. At a URL, each call waits
    ``patience`` seconds for a server that does not answer; for ``storage_options`` see ``access``. Zarr stores, and
    obstore stores in memory, are read-only. InputError for an object that cannot be a place.
    """
    if storage_options is not None and not is_url(store):
        raise InputError(f"storage_options: need a URL, found {shown(store)}")
    if isinstance(store, Place):
        return store
    if is_obstore(store):
        return _place_of_object(store, patience)
    if is_zarr_store(store):
        return zarr_place(store)
    if not isinstance(store, str | os.PathLike):
        raise InputError(f"found {shown(store)}, must be a path, a URL, an obstore store or a Zarr store")
    if not is_url(store):
        return _place_at(checked_path(store, "store").absolute())
    scheme = store.partition("://")[0]
    if scheme == "file":
        if storage_options:
            raise InputError("storage_options: need a server, found file://")
        parts = urlsplit(store.rstrip("/"))
        begin = "" if parts.netloc == "localhost" else parts.netloc  # a relative path, as fsspec reads file://data/x
        return _place_at(checked_path(begin + url2pathname(parts.path), "store").absolute())
    if scheme not in SCHEMES:
        raise InputError(f"{store}: found {scheme}://, must be a path, file:// or one of {', '.join(SCHEMES)}://")
    options = storage_options or _beyond
    access = access_by(options, store) if options else BY_ENVIRONMENT
    url, access = signed_in(store.rstrip("/"), access)
    return _checked(ObjectPlace(url, access, patience))


@contextmanager
def reached_by(storage_options: Mapping[str, Any]) -> Iterator[None]:
    """Within the block, also in threads that it starts, these are the storage options of URLs without their own."""
    global _beyond
    before, _beyond = _beyond, storage_options
    try:
        yield
    finally:
        _beyond = before


def _checked(place: "ObjectPlace") -> "ObjectPlace":
    """The place; InputError if it cannot have a client."""
    try:
        _ = place.client
    except ImportError as error:
        raise InputError(f"{place}: {first_line(error)}; needs obstore: pip install obstore") from None
    except Exception as error:
        raise InputError(f"{place}: not a place for a store: {first_line(error)}") from None
    return place


def _place_of_object(store: Any, patience: float) -> Place:
    """The place of an obstore store."""
    folder = local_folder(store)
    if folder is not None:
        return _place_at(folder)
    if type(store).__name__ == "MemoryStore":  # no other process sees it
        from zarr.storage import ObjectStore

        return ZarrPlace(ObjectStore(store, read_only=True))
    return _checked(ObjectPlace(*access_of(store), patience))


def beside(place: Place, store: str) -> Place:
    """The place of another store, with the access of this one if both are at URLs."""
    other = place_of(store)
    if isinstance(other, ObjectPlace) and isinstance(place, ObjectPlace):
        return replace(other, access=place.access)
    return other


def sendable(place: Place) -> Place:
    """The place as it is sent to workers, without its fence; InputError if its credential provider cannot be sent."""
    bare = place.behind(None)
    try:
        pickle.dumps(bare)
    except Exception as error:
        raise InputError(f"{place}: its credential_provider cannot be sent to workers: {first_line(error)}") from None
    return bare


def is_url(store: object) -> TypeGuard[str]:
    """Whether a name of a store is a URL. A scheme has two letters or more, since C: is a disk of Windows."""
    return isinstance(store, str) and len(store.partition("://")[0]) > 1 and "://" in store


def url_below(url: str, folder: str) -> str:
    """The URL of a folder of a URL, with the same query."""
    parts = urlsplit(url)
    return parts._replace(path=f"{parts.path}/{folder}").geturl()


def _place_at(path: Path) -> Place:
    for part in (path, *path.parents):
        if os.path.islink(part) and not os.path.exists(part):  # of names that are too long, too
            raise InputError(f"{path}: found a link to {part.readlink()}, which does not exist")
    return ZipPlace(path) if path.suffix.lower() == SUFFIX and not path.is_dir() else LocalPlace(path)


def waiting(place: Place, patience: float) -> Place:
    """The same place, with another patience if it is at a URL."""
    return replace(place, patience=patience).behind(place.fence) if isinstance(place, ObjectPlace) else place


@lru_cache(maxsize=16)
def _client(url: str, access: Access, settings: tuple[tuple[str, str], ...], process: int) -> "ObjectStore":
    """The client of a URL under these settings."""
    return access.make(url, dict(settings))


@dataclass(frozen=True)
class ObjectPlace(Place):
    """A prefix of an object store, by obstore, with credentials and endpoint from ``access``, else the environment.

    Each call waits ``patience`` seconds for a server that does not answer, and then raises NetworkError.
    """

    url: str
    access: Access = BY_ENVIRONMENT
    patience: float = field(default=BRIEF, compare=False)

    def __str__(self) -> str:
        return without_secrets(self.url)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self)!r})"

    @property
    def client(self) -> "ObjectStore":
        """The obstore client, which Zarr uses too: one for each place in a process."""
        settings = {name: value for name, value in os.environ.items() if name.upper().startswith(_SETTINGS)}
        return _client(self.url, self.access, tuple(sorted(settings.items())), os.getpid())

    def inner(self, folder: str) -> "ObjectPlace":
        return replace(self, url=url_below(self.url, folder)).behind(self.fence)

    def get(self, key: str) -> bytes | None:
        tagged = self.get_tagged(key)
        return None if tagged is None else tagged[0]

    def get_tagged(self, key: str) -> "tuple[bytes, UpdateVersion] | None":
        """An object's bytes, and a version that identifies this state for ``put_if``."""
        import obstore

        def once() -> "tuple[bytes, UpdateVersion]":
            answer = obstore.get(self.client, key)
            # S3 and Azure compare the tag, Google's store its generation, which is the version.
            tags = {"e_tag": answer.meta["e_tag"], "version": answer.meta["version"]}
            version: Any = {name: tag for name, tag in tags.items() if tag is not None}
            return bytes(answer.bytes()), version

        try:
            return self._persist(once)
        except FileNotFoundError:
            return None

    def version(self, key: str) -> Hashable:
        import obstore

        try:
            meta = self._persist(lambda: obstore.head(self.client, key))
        except FileNotFoundError:
            return None
        return meta["e_tag"], meta["version"], meta["last_modified"], meta["size"]

    def put(self, key: str, data: bytes) -> None:
        import obstore

        def once() -> None:
            self.confirm()  # at each attempt: there may have been a long outage
            obstore.put(self.client, key, data)

        self._persist(once)

    def put_all(self, objects: Mapping[str, bytes]) -> None:
        """See Place. The fence is called once for requests that begin together, and again before each repetition."""
        self._change_together(objects, lambda place, key: place.put(key, objects[key]))

    def take_all(self, other: Place, keys: Iterable[str]) -> None:
        """See Place. Within a bucket the server copies objects itself."""
        bucket, mine, theirs = self._in_bucket_of(other)
        if bucket is None:
            return super().take_all(other, keys)
        import obstore

        def take(place: ObjectPlace, key: str) -> None:
            def once() -> None:
                place.confirm()
                obstore.copy(bucket, theirs + key, mine + key)

            with suppress(FileNotFoundError):
                place._persist(once)

        self._change_together(keys, take)

    def _change_together(self, keys: Iterable[str], change: "Callable[[ObjectPlace, str], None]") -> None:
        """Change objects, AT_ONCE at a time: there may be an outage before the next ones, or before a repetition."""

        def change_one(key: str) -> None:
            looks = itertools.count()
            change(self.behind(lambda: self.confirm() if next(looks) else None), key)

        rest = iter(keys)
        with ThreadPoolExecutor(AT_ONCE) as pool:
            while together := list(itertools.islice(rest, AT_ONCE)):
                self.confirm()
                list(pool.map(change_one, together))

    def _in_bucket_of(self, other: Place) -> "tuple[ObjectStore | None, str, str]":
        """The client of the bucket of both places, and the prefixes of their keys; None without a common bucket."""
        if not isinstance(other, ObjectPlace):
            return None, "", ""
        ours, others = urlsplit(self.url), urlsplit(other.url)
        if self.access != other.access or ours[:2] != others[:2]:
            return None, "", ""
        if ours.scheme in ("http", "https"):  # the path may name the bucket
            return None, "", ""
        bucket = replace(self, url=f"{ours.scheme}://{ours.netloc}").client
        return bucket, f"{ours.path.lstrip('/')}/", f"{others.path.lstrip('/')}/"

    def put_new(self, key: str, data: bytes) -> bool:
        from obstore.exceptions import AlreadyExistsError

        # HTTP's If-None-Match: * lets one of two simultaneous requests succeed.
        return self._put_under(key, data, "create", (AlreadyExistsError,))

    def put_if(self, key: str, data: bytes, version: "UpdateVersion") -> bool:
        """Replace an object that still has this version, from ``get_tagged`` (If-Match); else return False."""
        from obstore.exceptions import PreconditionError

        return self._put_under(key, data, version, (PreconditionError, FileNotFoundError))

    def remove(self, key: str) -> None:
        import obstore

        def once() -> None:
            self.confirm()
            obstore.delete(self.client, key)

        with suppress(FileNotFoundError):
            self._persist(once)

    def remove_once(self, key: str) -> bool:
        """Remove an object by one request; False unless the server confirms it.

        The request is not repeated: after a lost answer another process may have put a new object of that key.
        """
        import obstore
        from obstore.exceptions import BaseError

        try:
            obstore.delete(self.client, key)
        except FileNotFoundError:
            return True
        except (BaseError, OSError):
            return False
        return True

    def get_all(self, keys: Iterable[str]) -> dict[str, bytes]:
        wanted = list(keys)
        with ThreadPoolExecutor(AT_ONCE) as pool:
            pairs = zip(wanted, pool.map(self.get, wanted), strict=True)
            return {key: data for key, data in pairs if data is not None}

    def remove_all(self, keys: Iterable[str]) -> None:
        import obstore

        unwanted = list(keys)

        def once() -> None:
            self.confirm()
            obstore.delete(self.client, unwanted)

        try:
            self._persist(once)
        except FileNotFoundError:  # Google's and Azure's stores stop at a missing object, even if a retry removed it
            with ThreadPoolExecutor(AT_ONCE) as pool:
                list(pool.map(self.remove, unwanted))

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        import obstore

        def once() -> list[str]:
            return [entry["path"] for page in obstore.list(self.client, prefix or None) for entry in page]

        try:
            yield from self._persist(once)
        except NetworkError:
            raise
        except OSError:
            if not self.url.startswith("http"):
                raise
            said = f"{self}: this web server does not list the objects of the store; copy the store to a disk"
            raise UnlistedError(said) from None

    def _put_under(self, key: str, data: bytes, mode: "PutMode", refusals: tuple[type[Exception], ...]) -> bool:
        """Put an object under a condition; False if one of the errors ``refusals`` shows that it does not hold."""
        import obstore
        from obstore.exceptions import BaseError

        failed = False

        def once() -> bool:
            nonlocal failed
            self.confirm()
            try:
                obstore.put(self.client, key, data, mode=mode, use_multipart=False)
            except refusals:
                # An earlier attempt may have written the object, its answer lost: then the refusal is no failure.
                return failed and self.get(key) == data
            except BaseError:
                failed = True
                raise
            return True

        return self._persist(once)

    def _persist(self, call: Callable[[], _T]) -> _T:
        return persist(call, self.url, self.patience)


@contextmanager
def refused(place: Place, what: str) -> Iterator[None]:
    """Turn an OSError into an InputError with this cause; a server that does not answer stays a NetworkError."""
    try:
        yield
    except NetworkError:
        raise
    except OSError as error:
        raise InputError(f"{place}: cannot be {what}: {error.strerror or error}") from error
