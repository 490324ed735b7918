"""A read-only backend from any Zarr store object: of a zip file, in memory, of obstore, or of an Icechunk session."""

import asyncio
import errno
import os
import sys
import zipfile
import zlib
from collections.abc import AsyncIterator, Coroutine, Hashable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from stat import S_ISREG
from typing import Any, TypeVar

from atlas.errors import InputError, message_of
from atlas.store.backend import StoreBackend

SUFFIX = ".zip"
_LARGEST_UNPACKED = 2**28
"""Maximum unpacked size, in bytes, of a compressed member of a zip file.

Packed atlases are not compressed; other files may be zip bombs, small files with huge contents.
"""
_DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError)
"""Exceptions of zipfile for damaged files: wrong checksums, unknown methods of compression, bits that mean encryption.
"""
_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class ZarrBackend(StoreBackend):
    """A read-only backend of a Zarr store object, or of a zip file, which Zarr's ZipStore reads.

    A damaged zip file raises OSErrors. Two backends are equal if they have the same store object, or zip files of the
    same path.
    """

    root: Any

    def __str__(self) -> str:
        return str(self.root).splitlines()[0]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ZarrBackend):
            return False
        return other.root is self.root or (self.file is not None and other.file == self.file)

    def __hash__(self) -> int:
        return id(self.root) if self.file is None else hash(self.file)

    @property
    def file(self) -> Path | None:
        """The path of the zip file; None for a Zarr store object."""
        return self.root if isinstance(self.root, Path) else None

    @property
    def read_only_reason(self) -> str:  # type: ignore[override]
        """The kind of a backend that cannot be written, for messages."""
        return "a Zarr store object" if self.file is None else "a zip file"

    def get(self, key: str, part: slice | None = None) -> bytes | None:
        data = self.get_all([key]).get(key)
        return data if part is None or data is None else data[part]

    def get_all(self, keys: Iterable[str]) -> dict[str, bytes]:
        from zarr.buffer import default_buffer_prototype

        key_list, prototype = list(keys), default_buffer_prototype()

        async def gather() -> list[Any]:
            return await asyncio.gather(*(self.read(key, prototype) for key in key_list))

        pairs = zip(key_list, run_in_zarr(gather()), strict=True)
        return {key: data.to_bytes() for key, data in pairs if data is not None}

    async def read(self, key: str, prototype: Any, byte_range: Any = None) -> Any:
        """Return an object, or a part of it, as a buffer of Zarr; None if it does not exist."""
        with self._damage_as_os_error():
            store = await self._open()
            return None if store is None else await store.get(key, prototype, byte_range)

    def exists(self, key: str) -> bool:
        async def is_stored() -> bool:
            store = await self._open()
            return store is not None and await store.exists(key)

        with self._damage_as_os_error():
            return run_in_zarr(is_stored())

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        async def listed() -> list[str]:
            store = await self._open()
            keys: AsyncIterator[str] | None = None if store is None else store.list_prefix(prefix)
            return [] if keys is None else [key async for key in keys if not key.endswith("/")]

        with self._damage_as_os_error():
            yield from run_in_zarr(listed())

    async def _open(self) -> Any:
        """Return the open Zarr store; None for a zip file that does not exist."""
        if self.file is None:
            return self.root
        try:
            stat = os.stat(self.file)
        except (FileNotFoundError, NotADirectoryError):
            return None
        if not S_ISREG(stat.st_mode):  # a pipe could block its reader forever
            raise OSError(errno.EINVAL, "not a regular file", str(self.file))
        state = self.file, stat.st_ino, stat.st_size, stat.st_mtime_ns, os.getpid()
        if state not in _opened:
            _opened[state] = await _open_zip(self.file, stat.st_size)
            for other in [*_opened][:-_MAX_OPEN]:
                del _opened[other]
        return _opened[state]

    @contextmanager
    def _damage_as_os_error(self) -> Iterator[None]:
        """Convert zipfile's exceptions for a damaged file into an OSError with EIO, as for a bad sector."""
        try:
            yield
        except _DAMAGE as error:
            if self.file is None:
                raise
            said = f"the zip file is damaged or incomplete: {error}"
            raise OSError(errno.EIO, said, str(self.file)) from None


_opened: dict[Hashable, Any] = {}
"""Open zip files by path, state and process, so that the table of contents is read once. Only Zarr's thread uses it."""
_MAX_OPEN = 8


async def _open_zip(path: Path, size: int) -> Any:
    """Return Zarr's store of a zip file of this size, open for reading."""
    from zarr.storage import ZipStore

    with zipfile.ZipFile(path) as file:
        for member in file.infolist():
            if member.compress_size > size or member.file_size > max(member.compress_size, _LARGEST_UNPACKED):
                raise zipfile.BadZipFile(f"{member.filename} states a size of {member.file_size} bytes")
    return await ZipStore.open(path, mode="r")


def is_zarr_store(store: object) -> bool:
    """Return True if ``store`` is a Zarr store, or of a derived class, without loading Zarr."""
    module = sys.modules.get("zarr.abc.store")
    return module is not None and isinstance(store, module.Store)


def open_zarr_backend(store: Any) -> ZarrBackend:
    """Return the backend of a Zarr store, opened by Zarr. Raise InputError if opening fails."""
    from zarr.storage import StorePath

    try:
        run_in_zarr(StorePath.open(store, ""))
    except Exception as error:  # a store of another package may raise anything
        raise InputError(f"{store}: cannot be opened: {message_of(error)}") from None
    return ZarrBackend(store)


def check_not_packed(backend: StoreBackend) -> None:
    """Raise InputError if a backend that is to be written is read-only, such as a zip file."""
    if backend.read_only_reason:
        file = backend.file if isinstance(backend, ZarrBackend) else None
        name = f"folder such as {file.with_suffix('.zarr')}" if file else "path or a URL"
        raise InputError(f"{backend}: {backend.read_only_reason} is read-only; give a {name}")


def run_in_zarr(work: Coroutine[Any, Any, _T]) -> _T:
    """Run a coroutine that uses Zarr stores in the event loop that Zarr keeps for them, and return its result."""
    return asyncio.run_coroutine_threadsafe(work, _zarr_loop(os.getpid())).result()


@lru_cache(maxsize=1)
def _zarr_loop(process: int) -> asyncio.AbstractEventLoop:
    """Return Zarr's event loop, which has no public name: a store that Zarr opens runs in it."""
    import zarr

    loops: list[asyncio.AbstractEventLoop] = []

    class LoopStore(zarr.storage.MemoryStore):
        async def get(self, *_: Any, **__: Any) -> None:
            loops.append(asyncio.get_running_loop())

    with suppress(FileNotFoundError):
        zarr.open_group(LoopStore(), mode="r", zarr_format=3, use_consolidated=False)
    return loops[0]
