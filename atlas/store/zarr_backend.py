"""The backend of a Zarr store object, read-only: in memory, of obstore, of an Icechunk session."""

import asyncio
import sys
from collections.abc import Hashable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from atlas.errors import InputError, message_of
from atlas.store.backend import StoreBackend


def is_zarr_store(store: object) -> bool:
    """Return True if ``store`` is a Zarr store, or of a derived class, without loading Zarr."""
    module = sys.modules.get("zarr.abc.store")
    return module is not None and isinstance(store, module.Store)


def open_zarr_backend(store: Any) -> "ZarrBackend":
    """Return the backend of a Zarr store, opened by Zarr. Raise InputError if opening fails."""
    from zarr.core.sync import sync
    from zarr.storage import StorePath

    try:
        sync(StorePath.open(store, ""))
    except Exception as error:  # a store of another package may raise anything
        raise InputError(f"{store}: cannot be opened: {message_of(error)}") from None
    return ZarrBackend(store)


@dataclass(frozen=True, eq=False)
class ZarrBackend(StoreBackend):
    """The root of a Zarr store object. Two backends are equal if they have the same object."""

    store: Any

    read_only_reason = "a Zarr store object"

    def __str__(self) -> str:
        return str(self.store).splitlines()[0]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ZarrBackend) and other.store is self.store

    def __hash__(self) -> int:
        return id(self.store)

    def get(self, key: str) -> bytes | None:
        return self.get_all([key]).get(key)

    def get_all(self, keys: Iterable[str]) -> dict[str, bytes]:
        from zarr.core.buffer import default_buffer_prototype
        from zarr.core.sync import sync

        wanted, prototype = list(keys), default_buffer_prototype()

        async def gather() -> list[Any]:
            return await asyncio.gather(*(self.store.get(key, prototype) for key in wanted))

        pairs = zip(wanted, sync(gather()), strict=True)
        return {key: data.to_bytes() for key, data in pairs if data is not None}

    def version(self, key: str) -> Hashable:
        return self.get(key)  # a Zarr store has no cheaper token

    def exists(self, key: str) -> bool:
        from zarr.core.sync import sync

        return bool(sync(self.store.exists(key)))

    def list_keys(self, prefix: str = "") -> Iterator[str]:
        from zarr.core.sync import sync

        async def listed() -> list[str]:
            return [key async for key in self.store.list_prefix(prefix)]

        yield from sync(listed())
