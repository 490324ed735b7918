"""The backend of object stores, and the function that opens the right backend for a path or URL.

obstore is the client of all servers. Disks have a backend of their own, see ``LocalBackend``. An object store has
conditional writes in place of renames.
"""

import os
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeGuard, TypeVar
from urllib.parse import urlsplit
from urllib.request import url2pathname

from atlas.argument_checks import validate_path
from atlas.errors import InputError, NetworkError, UnlistedError, brief_repr, without_secrets
from atlas.store.access import BY_ENVIRONMENT, StorageAccess, access_by, access_of, is_obstore, local_folder, signed_in
from atlas.store.backend import LocalBackend as LocalBackend
from atlas.store.backend import StoreBackend as StoreBackend
from atlas.store.outage import SHORT_PATIENCE, first_line, retry_call
from atlas.store.zarr_backend import SUFFIX, ZarrBackend, is_zarr_store, open_zarr_backend

if TYPE_CHECKING:
    from obstore import GetOptions
    from obstore.store import ObjectStore
    from zarr.abc.store import Store

    Given: TypeAlias = str | os.PathLike[str] | StoreBackend | ObjectStore | Store
else:
    Given = Any  # type of a store given by a user; loading its members takes a while

SCHEMES = ("s3", "s3a", "gs", "az", "azure", "adl", "abfs", "abfss", "http", "https")
"""Schemes of URLs of stores that obstore supports, besides ``file``."""
_SETTINGS = ("AWS_", "GOOGLE_", "AZURE_", "OBJECT_STORE_")
"""Prefixes of the environment variables that configure the client of a server."""
AT_ONCE = 64
"""Number of simultaneous requests to a server, which answers all of them in the time of one."""
_T = TypeVar("_T")


def open_backend(
    store: Given, patience: float = SHORT_PATIENCE, storage_options: Mapping[str, Any] | None = None
) -> StoreBackend:
    """Return the backend of a store, given as a path, a URL, an obstore store or a Zarr store object.

    store             what the user gave; a path that ends in .zip is a packed atlas, unless it is a folder
    patience          seconds that each call waits for a server that does not respond
    storage_options   options of access to a URL, see ``access``

    Zarr stores, and obstore stores in memory, are read-only. Raise InputError for an object that cannot be a store.
    """
    if storage_options is not None and not is_url(store):
        raise InputError(f"storage_options: need a URL, found {brief_repr(store)}")
    if isinstance(store, StoreBackend):
        return store
    if is_obstore(store):
        return _place_of_object(store, patience)
    if is_zarr_store(store):
        return open_zarr_backend(store)
    if not isinstance(store, str | os.PathLike):
        raise InputError(f"found {brief_repr(store)}, must be a path, a URL, an obstore store or a Zarr store")
    if not is_url(store):
        return _place_at(validate_path(store, "store").absolute())
    scheme = store.partition("://")[0]
    if scheme == "file":
        if storage_options:
            raise InputError("storage_options: need a server, found file://")
        parts = urlsplit(store.rstrip("/"))
        begin = "" if parts.netloc == "localhost" else parts.netloc  # a relative path, as fsspec reads file://data/x
        return _place_at(validate_path(begin + url2pathname(parts.path), "store").absolute())
    if scheme not in SCHEMES:
        raise InputError(f"{store}: found {scheme}://, must be a path, file:// or one of {', '.join(SCHEMES)}://")
    access = access_by(storage_options, store) if storage_options else BY_ENVIRONMENT
    url, access = signed_in(store.rstrip("/"), access)
    return _checked(ObjectBackend(url, access, patience))


def _checked(backend: "ObjectBackend") -> "ObjectBackend":
    """Return the backend unchanged. Raise InputError if no obstore client can be created for it."""
    try:
        _ = backend.client
    except ImportError as error:
        raise InputError(f"{backend}: {first_line(error)}; needs obstore: pip install obstore") from None
    except Exception as error:
        raise InputError(f"{backend}: not a valid location for a store: {first_line(error)}") from None
    return backend


def _place_of_object(store: Any, patience: float) -> StoreBackend:
    """Return the backend of an obstore store object, with ``patience`` in seconds."""
    folder = local_folder(store)
    if folder is not None:
        return _place_at(folder)
    if type(store).__name__ == "MemoryStore":  # no other process can read it
        from zarr.storage import ObjectStore

        return ZarrBackend(ObjectStore(store, read_only=True))
    return _checked(ObjectBackend(*access_of(store), patience))


def sibling_name(backend: StoreBackend, other: StoreBackend) -> str:
    """Return the name under which one store records another: a path relative to ``backend``, or a URL.

    ``sibling_backend`` finds the other store by this name. Two folders that are moved together still find each other.
    """
    if is_url(str(other)) or is_url(str(backend)):
        return str(other)
    name, base_path = Path(os.path.realpath(str(other))), Path(os.path.realpath(str(backend)))
    return (name if name.anchor != base_path.anchor else Path(os.path.relpath(name, base_path))).as_posix()


def sibling_backend(backend: StoreBackend, store: str) -> StoreBackend:
    """Return the backend of another store by the name that ``sibling_name`` gives.

    A relative path begins in the folder of ``backend``. At URLs, the access options of ``backend`` apply.
    """
    is_relative = not (is_url(store) or os.path.isabs(store) or is_url(str(backend)))
    other = open_backend(
        os.path.normpath(os.path.join(os.path.realpath(str(backend)), store)) if is_relative else store
    )
    if isinstance(other, ObjectBackend) and isinstance(backend, ObjectBackend):
        return replace(other, access=backend.access)
    return other


def picklable_backend(backend: StoreBackend) -> StoreBackend:
    """Return a copy of the backend that can be sent to workers: without the lease of this process.

    Raise InputError if its credential provider cannot be sent.
    """
    bare = backend.with_lease(None)
    try:
        pickle.dumps(bare)
    except Exception as error:
        raise InputError(f"{backend}: its credential_provider cannot be sent to workers: {first_line(error)}") from None
    return bare


def is_url(store: object) -> TypeGuard[str]:
    """Return True if a store is given by a URL. A scheme has at least two letters, since C: is a disk of Windows."""
    return isinstance(store, str) and len(store.partition("://")[0]) > 1 and "://" in store


def _place_at(path: Path) -> StoreBackend:
    for part in (path, *path.parents):
        if os.path.islink(part) and not os.path.exists(part):  # also for names that are too long
            raise InputError(f"{path}: found a link to {part.readlink()}, which does not exist")
    return ZarrBackend(path) if path.suffix.lower() == SUFFIX and not path.is_dir() else LocalBackend(path)


def with_patience(backend: StoreBackend, patience: float) -> StoreBackend:
    """Return the backend with another patience, the seconds to wait for a server; unchanged if it is not at a URL."""
    return (
        replace(backend, patience=patience).with_lease(backend.confirmation)
        if isinstance(backend, ObjectBackend)
        else backend
    )


@lru_cache(maxsize=16)
def _client(url: str, access: StorageAccess, settings: tuple[tuple[str, str], ...], process: int) -> "ObjectStore":
    """Return an obstore client of a URL. ``settings`` are environment variables; ``process`` tells processes apart."""
    return access.open_client(url, dict(settings))


@dataclass(frozen=True)
class ObjectBackend(StoreBackend):
    """A backend of an object store: all objects under a URL, by obstore.

    Credentials and endpoint are those of ``access``, else of the environment. Each call waits ``patience`` seconds for
    a server that does not respond, and then raises NetworkError.
    """

    url: str
    access: StorageAccess = BY_ENVIRONMENT
    patience: float = field(default=SHORT_PATIENCE, compare=False)

    def __str__(self) -> str:
        return without_secrets(self.url)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self)!r})"

    @property
    def client(self) -> "ObjectStore":
        """The obstore client, one per backend and process."""
        settings = {name: value for name, value in os.environ.items() if name.upper().startswith(_SETTINGS)}
        return _client(self.url, self.access, tuple(sorted(settings.items())), os.getpid())

    def get(self, key: str, part: slice | None = None) -> bytes | None:
        import obstore

        options: GetOptions = {} if part is None else {"range": _range_of(part)}
        try:
            return self._persist(lambda: bytes(obstore.get(self.client, key, options=options).bytes()))
        except FileNotFoundError:
            return None

    def exists(self, key: str) -> bool:
        import obstore

        try:
            self._persist(lambda: obstore.head(self.client, key))
        except FileNotFoundError:
            return False
        return True

    def put(self, key: str, data: bytes) -> None:
        import obstore

        self._persist(lambda: obstore.put(self.client, key, data))

    def commit(self, key: str, data: bytes) -> None:
        """Write as in ``StoreBackend``. The lease is confirmed at each attempt, since an outage may come between
        them.
        """
        import obstore

        def once() -> None:
            self.confirm_lease()
            obstore.put(self.client, key, data)

        self._persist(once)

    def put_all(self, objects: Mapping[str, bytes]) -> None:
        with ThreadPoolExecutor(AT_ONCE) as pool:
            list(pool.map(self.put, objects, objects.values()))

    def copy_all(self, other: StoreBackend, keys: Iterable[str]) -> None:
        """Copy objects as in ``StoreBackend``. Within a bucket the server copies objects itself."""
        bucket, mine, theirs = self._in_bucket_of(other)
        if bucket is None:
            return super().copy_all(other, keys)
        import obstore

        def take(key: str) -> None:
            with suppress(FileNotFoundError):
                self._persist(lambda: obstore.copy(bucket, theirs + key, mine + key))

        with ThreadPoolExecutor(AT_ONCE) as pool:
            list(pool.map(take, keys))

    def _in_bucket_of(self, other: StoreBackend) -> "tuple[ObjectStore | None, str, str]":
        """Return a client of the bucket that both backends share, and the prefixes of their keys in it.

        The client is None if they do not share a bucket.
        """
        if not isinstance(other, ObjectBackend):
            return None, "", ""
        ours, others = urlsplit(self.url), urlsplit(other.url)
        if self.access != other.access or ours[:2] != others[:2]:
            return None, "", ""
        if ours.scheme in ("http", "https"):  # the path may name the bucket
            return None, "", ""
        bucket = replace(self, url=f"{ours.scheme}://{ours.netloc}").client
        return bucket, f"{ours.path.lstrip('/')}/", f"{others.path.lstrip('/')}/"

    def put_new(self, key: str, data: bytes) -> bool:
        """Write as in ``StoreBackend``. HTTP's If-None-Match: * lets one of two simultaneous requests succeed."""
        import obstore
        from obstore.exceptions import AlreadyExistsError, BaseError

        failed = False

        def once() -> bool:
            nonlocal failed
            try:
                obstore.put(self.client, key, data, mode="create", use_multipart=False)
            except AlreadyExistsError:
                # An earlier attempt may have written the object without its response arriving; then this is no failure.
                return failed and self.get(key) == data
            except BaseError:
                failed = True
                raise
            return True

        return self._persist(once)

    def remove(self, key: str) -> None:
        import obstore

        with suppress(FileNotFoundError):
            self._persist(lambda: obstore.delete(self.client, key))

    def get_all(self, keys: Iterable[str]) -> dict[str, bytes]:
        key_list = list(keys)
        with ThreadPoolExecutor(AT_ONCE) as pool:
            pairs = zip(key_list, pool.map(self.get, key_list), strict=True)
            return {key: data for key, data in pairs if data is not None}

    def remove_all(self, keys: Iterable[str]) -> None:
        import obstore

        unwanted = list(keys)
        try:
            self._persist(lambda: obstore.delete(self.client, unwanted))
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

    def _persist(self, call: Callable[[], _T]) -> _T:
        return retry_call(call, self.url, self.patience)


def _range_of(part: slice) -> Any:
    """Convert a slice of an object's bytes to obstore's range."""
    if part.start < 0:
        return {"suffix": -part.start}
    return {"offset": part.start} if part.stop is None else (part.start, part.stop)


@contextmanager
def os_errors_as_input_errors(backend: StoreBackend, what: str) -> Iterator[None]:
    """Convert an OSError within the block into an InputError, of which it is the cause.

    ``what`` says what the backend was to be, such as "written". A server that does not respond remains a NetworkError.
    """
    try:
        yield
    except NetworkError:
        raise
    except OSError as error:
        raise InputError(f"{backend}: cannot be {what}: {error.strerror or error}") from error
