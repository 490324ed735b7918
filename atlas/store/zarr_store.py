"""An adapter that lets Zarr read the arrays of any backend."""

import asyncio
import os
from collections.abc import AsyncIterator, Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from typing import Any, Self, TypeVar

from zarr.abc.buffer import Buffer, BufferPrototype
from zarr.abc.store import ByteRequest, OffsetByteRequest, RangeByteRequest, Store

from atlas.store.backend import StoreBackend
from atlas.store.object_backend import AT_ONCE
from atlas.store.zarr_backend import ZarrBackend

_T = TypeVar("_T")


class BackendStore(Store):
    """A backend as a Zarr store for reading. Each call runs in a thread, where it may wait for a server."""

    supports_writes = supports_deletes = False
    supports_listing = True

    def __init__(self, backend: StoreBackend) -> None:
        super().__init__(read_only=True)
        self.backend = backend

    def with_read_only(self, read_only: bool = False) -> Self:
        return self

    def __eq__(self, other: object) -> bool:
        return isinstance(other, BackendStore) and other.backend == self.backend

    def __str__(self) -> str:
        return str(self.backend)

    async def get(self, key: str, prototype: BufferPrototype, byte_range: ByteRequest | None = None) -> Buffer | None:
        if isinstance(self.backend, ZarrBackend):
            buffer: Buffer | None = await self.backend.read(key, prototype, byte_range)
            return buffer
        data = await _in_thread(self.backend.get, key, _slice_of(byte_range))
        return None if data is None else prototype.buffer.from_bytes(data)

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, ByteRequest | None]]
    ) -> list[Buffer | None]:
        return await asyncio.gather(*(self.get(key, prototype, part) for key, part in key_ranges))

    async def exists(self, key: str) -> bool:
        return await _in_thread(self.backend.exists, key)

    async def set(self, key: str, value: Buffer) -> None:
        self._check_writable()

    async def delete(self, key: str) -> None:
        self._check_writable()

    def list(self) -> AsyncIterator[str]:
        return self.list_prefix("")

    async def list_prefix(self, prefix: str) -> AsyncIterator[str]:
        folder = prefix.rpartition("/")[0]
        for key in await _in_thread(lambda: [*self.backend.list_keys(f"{folder}/" if folder else "")]):
            if key.startswith(prefix):
                yield key

    async def list_dir(self, prefix: str) -> AsyncIterator[str]:
        folder = f"{prefix.rstrip('/')}/".lstrip("/")
        keys = await _in_thread(lambda: [*self.backend.list_keys(folder)])
        for name in sorted({key.removeprefix(folder).partition("/")[0] for key in keys}):
            yield name


def _slice_of(request: ByteRequest | None) -> slice | None:
    if request is None:
        return None
    if isinstance(request, RangeByteRequest):
        return slice(request.start, request.end)
    return slice(request.offset, None) if isinstance(request, OffsetByteRequest) else slice(-request.suffix, None)


async def _in_thread(call: Callable[..., _T], *arguments: Any) -> _T:
    return await asyncio.get_running_loop().run_in_executor(_threads(os.getpid()), partial(call, *arguments))


@lru_cache(maxsize=1)
def _threads(process: int) -> ThreadPoolExecutor:
    """Return the pool of threads that wait for servers. It is larger than asyncio's own, which depends on the
    processors.
    """
    return ThreadPoolExecutor(AT_ONCE, "atlas-store")
