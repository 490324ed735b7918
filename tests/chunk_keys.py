"""The keys of chunks that Zarr gets from disk, as counts of what was read."""

from collections.abc import Callable

import pytest
import zarr

from atlas.store.zarr_store import BackendStore


def noted_keys(monkeypatch: pytest.MonkeyPatch, wanted: Callable[[str], bool]) -> list[str]:
    """A list to which every wanted key that Zarr finds in a folder from now on is added, whoever asks.

    Those of handles come through their backends, those of plain xarray through Zarr's own store of a folder.
    """
    found: list[str] = []

    def note(store: type) -> None:
        whole = store.get  # type: ignore[attr-defined]

        async def get(self: object, key: str, *args: object, **named: object) -> object:
            value = await whole(self, key, *args, **named)
            if value is not None and wanted(key):
                found.append(key)
            return value

        monkeypatch.setattr(store, "get", get)

    note(zarr.storage.LocalStore)
    note(BackendStore)
    return found
