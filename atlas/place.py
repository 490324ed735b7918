"""Where a store lies: a folder of this machine or a URL, and what is done there with whole objects.

Zarr reads and writes arrays in any of these places by stores of its own. This is the rest: one listing, one object
put, removed or looked for, and a write under a condition, which an object store has in place of a rename.
"""

import errno
import hashlib
import os
import uuid
from collections.abc import Hashable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from datetime import timedelta
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol
from urllib.parse import unquote, urlsplit

from atlas.errors import InputError

if TYPE_CHECKING:
    from obstore.store import ObjectStore

OBJECT_SCHEMES = ("s3", "s3a", "gs", "az", "azure", "adl", "abfs", "abfss", "http", "https")
"""Schemes that obstore speaks, where it is installed; all others, and these without it, are fsspec's."""
_RETRIES = {"max_retries": 6, "retry_timeout": timedelta(seconds=60)}
"""A network that blinks is waited for; one that is not there is told within half a minute."""


class Place(Hashable, Protocol):
    """A root that keys such as ``regime/c/0/1`` lie under. Errors of any network are OSErrors. ``str`` is its name."""

    @property
    def local(self) -> Path | None:
        """The folder, None where it is not on this machine's disks."""

    def get(self, key: str) -> bytes | None:
        """An object's bytes, None where there is none."""

    def exists(self, key: str) -> bool:
        """Whether there is such an object."""

    def put(self, key: str, data: bytes) -> None:
        """Write an object whole, in place of any before it."""

    def put_new(self, key: str, data: bytes) -> bool:
        """Write an object if there is none of that key; False, and nothing is written, where there is."""

    def remove(self, key: str) -> None:
        """Remove an object; nothing happens where there is none."""

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        """All keys, those under a prefix that ends in "/", or all, by one listing."""

    def told(self) -> AbstractContextManager[None]:
        """Within it, what a network's library raises becomes an OSError in one line."""


def place_of(store: "str | os.PathLike[str] | Place") -> Place:
    """The place that a user named by a path or a URL; InputError for a URL that nothing here speaks."""
    if isinstance(store, LocalPlace | ObjectPlace | FsspecPlace):
        return store
    if not isinstance(store, str) or "://" not in store:
        return LocalPlace(Path(store).absolute())  # type: ignore[arg-type]
    url = store.rstrip("/")
    scheme = url.partition("://")[0].rpartition(":")[2]
    if scheme == "file" and url.startswith("file:"):
        return LocalPlace(Path(unquote(urlsplit(url).path)).absolute())
    place: Place = FsspecPlace(url)
    if url.startswith(f"{scheme}:") and scheme in OBJECT_SCHEMES and _has_obstore():
        place = ObjectPlace(url)
    with _named(url, scheme):
        place.told()  # builds its client, so that a URL that cannot work is told here
    return place


@contextmanager
def _named(url: str, scheme: str) -> Iterator[None]:
    try:
        yield
    except ImportError as error:
        remedy = "pip install 'impact-atlas[cloud]'" if scheme in OBJECT_SCHEMES else f"fsspec's driver of {scheme}://"
        raise InputError(f"{url}: {_line(error)}; needs {remedy}") from None
    except Exception as error:
        raise InputError(f"{url}: not a place for a store: {_line(error)}") from None


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

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        """See Place. What a killed write left behind is none."""
        for folder, _, files in os.walk(self.path / prefix):
            above = Path(folder).relative_to(self.path).as_posix()
            begin = "" if above == "." else f"{above}/"
            yield from (begin + name for name in files if not name.endswith(".partial"))

    def told(self) -> AbstractContextManager[None]:
        """See Place."""
        return nullcontext()

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
class _Remote:
    """A place named by a URL, which is no folder of this machine."""

    url: str

    def __str__(self) -> str:
        return self.url

    @property
    def local(self) -> None:
        """See Place."""


@dataclass(frozen=True)
class ObjectPlace(_Remote):
    """A prefix of an object store, by obstore. Credentials and endpoint come from the environment (AWS_*, ...)."""

    @cached_property
    def client(self) -> "ObjectStore":
        """obstore's own object, which Zarr takes too."""
        from obstore.store import from_url

        options: dict[str, Any] = {"retry_config": _RETRIES}
        if any(text.startswith("http://") for text in (self.url, os.environ.get("AWS_ENDPOINT_URL", ""))):
            options["client_options"] = {"allow_http": True}  # as it was asked for in so many words
        return from_url(self.url, **options)

    def get(self, key: str) -> bytes | None:
        """See Place."""
        found = self.get_tagged(key)
        return None if found is None else found[0]

    def get_tagged(self, key: str) -> tuple[bytes, str] | None:
        """An object's bytes, and the tag that ``put_if`` knows this state of it by."""
        import obstore

        with self.told():
            try:
                found = obstore.get(self.client, key)
                return bytes(found.bytes()), str(found.meta["e_tag"])
            except FileNotFoundError:
                return None

    def exists(self, key: str) -> bool:
        """See Place."""
        import obstore

        with self.told():
            try:
                obstore.head(self.client, key)
            except FileNotFoundError:
                return False
            return True

    def put(self, key: str, data: bytes) -> None:
        """See Place."""
        import obstore

        with self.told():
            obstore.put(self.client, key, data)

    def put_new(self, key: str, data: bytes) -> bool:
        """See Place. HTTP's If-None-Match: * does it: of two at once one succeeds."""
        import obstore
        from obstore.exceptions import AlreadyExistsError

        with self.told():
            try:
                obstore.put(self.client, key, data, mode="create", use_multipart=False)
            except AlreadyExistsError:
                return False
            return True

    def put_if(self, key: str, data: bytes, tag: str) -> bool:
        """Replace an object that is still the one that ``get_tagged`` gave this tag of (If-Match); else False."""
        import obstore
        from obstore.exceptions import PreconditionError

        with self.told():
            try:
                obstore.put(self.client, key, data, mode={"e_tag": tag}, use_multipart=False)
            except (PreconditionError, FileNotFoundError):
                return False
            return True

    def remove(self, key: str) -> None:
        """See Place."""
        import obstore

        with self.told(), suppress(FileNotFoundError):
            obstore.delete(self.client, key)

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        """See Place."""
        import obstore

        with self.told():
            for page in obstore.list(self.client, prefix or None):
                yield from (entry["path"] for entry in page)

    def told(self) -> AbstractContextManager[None]:
        """See Place."""
        _ = self.client
        return self._told()

    @contextmanager
    def _told(self) -> Iterator[None]:
        from obstore.exceptions import BaseError, PermissionDeniedError, UnauthenticatedError

        try:
            yield
        except (PermissionDeniedError, UnauthenticatedError) as error:
            raise PermissionError(errno.EACCES, _line(error)) from None
        except BaseError as error:
            raise OSError(_line(error)) from None


@dataclass(frozen=True)
class FsspecPlace(_Remote):
    """A root of any file system that fsspec knows; its options come from fsspec's own configuration files."""

    @cached_property
    def _opened(self) -> tuple[Any, str]:
        from fsspec.core import url_to_fs

        files, root = url_to_fs(self.url)
        return files, root.rstrip("/")

    def _path(self, key: str) -> str:
        return f"{self._opened[1]}/{key}"

    def get(self, key: str) -> bytes | None:
        """See Place."""
        with self.told():
            try:
                return bytes(self._opened[0].cat_file(self._path(key)))
            except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
                return None

    def get_tagged(self, key: str) -> tuple[bytes, str] | None:
        """As ObjectPlace's; the tag is a hash of the bytes."""
        data = self.get(key)
        return None if data is None else (data, hashlib.sha256(data).hexdigest())

    def exists(self, key: str) -> bool:
        """See Place."""
        with self.told():
            return bool(self._opened[0].isfile(self._path(key)))

    def put(self, key: str, data: bytes) -> None:
        """See Place."""
        with self.told():
            self._make_room(key)
            self._opened[0].pipe_file(self._path(key), data)

    def put_new(self, key: str, data: bytes) -> bool:
        """See Place. Only as certain as the file system's own mode "create"."""
        with self.told():
            self._make_room(key)
            try:
                self._opened[0].pipe_file(self._path(key), data, mode="create")
            except FileExistsError:
                return False
            return True

    def put_if(self, key: str, data: bytes, tag: str) -> bool:
        """As ObjectPlace's, but in two steps: fsspec has no one, which leaves a race of a round trip."""
        found = self.get_tagged(key)
        if found is None or found[1] != tag:
            return False
        self.put(key, data)
        return True

    def remove(self, key: str) -> None:
        """See Place."""
        with self.told(), suppress(FileNotFoundError):
            self._opened[0].rm_file(self._path(key))

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        """See Place."""
        files, root = self._opened
        with self.told():
            files.invalidate_cache()  # another process may have written since the last listing
            found = files.find(self._path(prefix))
        yield from (path[path.index(root) + len(root) + 1 :] for path in found)

    def told(self) -> AbstractContextManager[None]:
        """See Place."""
        _ = self._opened
        return self._told()

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError, TypeError, LookupError, RuntimeError):
            raise
        except Exception as error:  # every driver has exceptions of its own
            raise OSError(_line(error)) from None

    def _make_room(self, key: str) -> None:
        files, path = self._opened[0], self._path(key)
        files.makedirs(path.rpartition("/")[0], exist_ok=True)


def _has_obstore() -> bool:
    try:
        import obstore  # noqa: F401
    except ImportError:
        return False
    return True


def _line(error: Exception) -> str:
    """The first line of an error, without the server's XML and the library's own account of it."""
    lines = str(error).splitlines()
    text = lines[0].partition("<?xml")[0].rstrip(": ") if lines else ""
    return text or type(error).__name__
