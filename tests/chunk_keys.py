"""The keys of chunks that Zarr gets from disk, as counts of what was read."""

from collections.abc import Callable

import pytest
import zarr


def noted_keys(monkeypatch: pytest.MonkeyPatch, wanted: Callable[[str], bool]) -> list[str]:
    """A list to which every wanted key that Zarr finds in a folder from now on is added, whoever asks."""
    found: list[str] = []
    whole = zarr.storage.LocalStore.get

    async def get(self: object, key: str, *args: object, **named: object) -> object:
        value = await whole(self, key, *args, **named)  # type: ignore[arg-type]
        if value is not None and wanted(key):
            found.append(key)
        return value

    monkeypatch.setattr(zarr.storage.LocalStore, "get", get)
    return found
