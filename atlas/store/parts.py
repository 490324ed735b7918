"""Parts of a search in progress: intermediate results kept in the store, each with a checksum.

Parts lie in the folder of an array without values, which readers of Zarr groups do not list.
"""

import base64
from collections.abc import Iterator

from atlas.store.metadata import sealed, unsealed
from atlas.store.schema import PARTS
from atlas.store.store import AtlasStore

DIGEST = "digest"
"""Name of the part that holds the digest of the search, by which a later search recognises its own parts."""


def put_part(handle: AtlasStore, group: str, name: str, data: bytes) -> None:
    """Store an intermediate result of a search, as a part of a group; the part appears whole or not at all."""
    handle.backend.commit(f"{PARTS}/{group}/{name}", sealed({"data": base64.b64encode(data).decode()}))


def get_part(handle: AtlasStore, group: str, name: str) -> bytes | None:
    """Return the bytes of a search's stored part; None if it is missing or damaged and has to be computed again."""
    stored = handle.backend.get(f"{PARTS}/{group}/{name}")
    part = unsealed(stored)
    return base64.b64decode(part["data"]) if part is not None and sealed(part) == stored else None


def part_names(handle: AtlasStore, group: str) -> Iterator[str]:
    """Return the names of all stored parts of a group."""
    root = f"{PARTS}/{group}/"
    return (key.removeprefix(root) for key in handle.backend.list_keys(root))


def damaged_parts(handle: AtlasStore, group: str) -> list[str]:
    """Return the keys of the damaged parts of a group, each the intermediate result of a search."""
    names = sorted(part_names(handle, group))
    return [f"{PARTS}/{group}/{name}" for name in names if get_part(handle, group, name) is None]


def drop_parts(handle: AtlasStore, group: str) -> None:
    """Remove all stored parts of a group, the intermediate results of a search."""
    handle.backend.remove_all(list(handle.backend.list_keys(f"{PARTS}/{group}/")))


def finished_parts(handle: AtlasStore, group: str, digest: str) -> set[str]:
    """Return the names of the parts of a group that a search with this digest has finished and stored.

    Parts of a search with another digest are removed.
    """
    if get_part(handle, group, DIGEST) != digest.encode():
        drop_parts(handle, group)
        put_part(handle, group, DIGEST, digest.encode())
    return {name for name in part_names(handle, group) if get_part(handle, group, name) is not None}
