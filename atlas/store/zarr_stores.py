"""Zarr stores that read and write arrays through a backend.

At a URL they wait for the server. Damage of a zip file raises OSError. Behind a fence they call the fence before each
write and each removal, and at a URL before each attempt at one.
"""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Coroutine, Iterable
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

from zarr.abc.store import ByteRequest
from zarr.core.buffer import Buffer, BufferPrototype
from zarr.storage import LocalStore, ObjectStore, WrapperStore, ZipStore

from atlas.store.object_backend import ObjectBackend, StoreBackend
from atlas.store.outage import retry_call_async
from atlas.store.zarr_backend import ZarrBackend
from atlas.store.zip_backend import ZipBackend, zip_errors_as_os_errors

_T = TypeVar("_T")
_P = ParamSpec("_P")


def _again(
    once: Callable[Concatenate[ObjectStore[Any], _P], Awaitable[_T]], changes: bool = False
) -> Callable[Concatenate["RetryingObjectStore", _P], Coroutine[Any, Any, _T]]:
    """Return a method of Zarr's ObjectStore that is repeated while the server does not respond.

    If it ``changes`` the store, the fence of the backend is called before each attempt: a long outage may precede.
    """

    async def persisting(self: "RetryingObjectStore", /, *args: _P.args, **named: _P.kwargs) -> _T:
        async def attempt() -> _T:
            if changes:
                await _confirm(self.backend)
            return await once(self, *args, **named)

        return await self._persist(attempt)

    return persisting


async def _confirm(place: StoreBackend) -> None:
    if place.fence is not None:
        await asyncio.to_thread(place.check_fence)  # reads a sidecar file, perhaps from a server


class RetryingObjectStore(ObjectStore[Any]):
    """Zarr's ObjectStore of a backend. A failed call is simply repeated: all calls may take effect twice."""

    def __init__(self, place: ObjectBackend, read_only: bool) -> None:
        super().__init__(place.client, read_only=read_only)
        self.backend = place

    def with_read_only(self, read_only: bool = False) -> Self:
        return type(self)(self.backend, read_only)

    def __str__(self) -> str:
        return str(self.backend)

    get = _again(ObjectStore.get)
    exists = _again(ObjectStore.exists)
    set = _again(ObjectStore.set, changes=True)
    set_if_not_exists = _again(ObjectStore.set_if_not_exists, changes=True)
    delete = _again(ObjectStore.delete, changes=True)
    delete_dir = _again(ObjectStore.delete_dir)  # calls delete

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, ByteRequest | None]]
    ) -> list[Buffer | None]:
        once, wanted = super().get_partial_values, list(key_ranges)
        return await self._persist(lambda: once(prototype, wanted))

    def list(self) -> AsyncGenerator[str, None]:
        return self._listed(super().list)

    def list_prefix(self, prefix: str) -> AsyncGenerator[str, None]:
        once = super().list_prefix
        return self._listed(lambda: once(prefix))

    def list_dir(self, prefix: str) -> AsyncGenerator[str, None]:
        once = super().list_dir
        return self._listed(lambda: once(prefix))

    async def _listed(self, listing: Callable[[], AsyncIterator[str]]) -> AsyncGenerator[str, None]:
        async def whole() -> "list[str]":
            return [key async for key in listing()]

        for key in await self._persist(whole):
            yield key

    async def _persist(self, call: Callable[[], Awaitable[_T]]) -> _T:
        return await retry_call_async(call, self.backend.url, self.backend.patience)


class ZipReadStore(ZipStore):
    """Zarr's ZipStore of a backend, opened for reading: Zarr itself would open it only together with a group."""

    def __init__(self, place: ZipBackend) -> None:
        super().__init__(place.path, mode="r")
        self.file = place.path
        with zip_errors_as_os_errors(self.file):
            self._sync_open()

    async def get(self, key: str, prototype: BufferPrototype, byte_range: ByteRequest | None = None) -> Buffer | None:
        with zip_errors_as_os_errors(self.file):
            return await super().get(key, prototype, byte_range)

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, ByteRequest | None]]
    ) -> list[Buffer | None]:
        with zip_errors_as_os_errors(self.file):
            return await super().get_partial_values(prototype, key_ranges)


class FencedStore(WrapperStore[Any]):
    """Zarr's store of a folder, for writing; the backend writes and removes all objects."""

    def __init__(self, store: Any, place: StoreBackend) -> None:
        super().__init__(store)
        self._place = place

    def _with_store(self, store: Any) -> Self:
        return type(self)(store, self._place)

    async def set(self, key: str, value: Buffer) -> None:
        await asyncio.to_thread(self._place.put, key, value.to_bytes())

    async def set_if_not_exists(self, key: str, value: Buffer) -> None:
        await asyncio.to_thread(self._place.put_new, key, value.to_bytes())

    async def _set_many(self, values: Iterable[tuple[str, Buffer]]) -> None:
        await asyncio.gather(*(self.set(key, value) for key, value in values))

    async def delete(self, key: str) -> None:
        await asyncio.to_thread(self._place.remove, key)

    async def delete_dir(self, prefix: str) -> None:
        await _confirm(self._place)
        await self._store.delete_dir(prefix)

    async def clear(self) -> None:
        await _confirm(self._place)
        await self._store.clear()


class ReadOnlyStore(WrapperStore[Any]):
    """The Zarr store object of a user, for reading: some classes of stores cannot be made read-only."""

    def _with_store(self, store: Any) -> Self:
        return type(self)(store)

    @property
    def read_only(self) -> bool:
        return True

    def with_read_only(self, read_only: bool = False) -> Self:
        return self


def zarr_store(
    place: StoreBackend, read_only: bool
) -> "LocalStore | RetryingObjectStore | ZipReadStore | FencedStore | ReadOnlyStore":
    """Return Zarr's store of a backend. Raise OSError if a read-only backend, such as a zip file, is to be written."""
    if place.read_only_reason and not read_only:
        place.remove("")
    if isinstance(place, ZipBackend):
        return ZipReadStore(place)
    if isinstance(place, ZarrBackend):
        return ReadOnlyStore(place.store)
    if isinstance(place, ObjectBackend):
        return RetryingObjectStore(place, read_only)
    assert place.local is not None, "a backend is a folder or an object store"
    local = LocalStore(place.local, read_only=read_only)
    return local if read_only else FencedStore(local, place)
