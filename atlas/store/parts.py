"""Finished parts of a search in progress, kept in the store.

They lie apart from the groups, whose readers expect arrays. A part begins with its checksum.
"""

import hashlib
from collections.abc import Iterator

from atlas.store.store import AtlasStore

PARTS = "parts"
DIGEST = "digest"
"""The name of the part with the digest of the search."""
_CHECKSUM_BYTES = 32


def put_part(handle: AtlasStore, group: str, name: str, data: bytes) -> None:
    """Keep a finished part of a search; it appears whole or not at all."""
    handle.backend.put(f"{PARTS}/{group}/{name}", hashlib.sha256(data).digest() + data)


def get_part(handle: AtlasStore, group: str, name: str) -> bytes | None:
    """A part; None if it is missing or damaged, and has to be computed again."""
    stored = handle.backend.get(f"{PARTS}/{group}/{name}") or b""
    checksum, data = stored[:_CHECKSUM_BYTES], stored[_CHECKSUM_BYTES:]
    return data if hashlib.sha256(data).digest() == checksum else None


def part_names(handle: AtlasStore, group: str) -> Iterator[str]:
    """The names of all parts."""
    root = f"{PARTS}/{group}/"
    return (key.removeprefix(root) for key in handle.backend.list_keys(root))


def damaged_parts(handle: AtlasStore, group: str) -> list[str]:
    """The keys of parts that are damaged."""
    names = sorted(part_names(handle, group))
    return [f"{PARTS}/{group}/{name}" for name in names if get_part(handle, group, name) is None]


def drop_parts(handle: AtlasStore, group: str) -> None:
    """Remove all parts."""
    handle.backend.remove_all(list(handle.backend.list_keys(f"{PARTS}/{group}/")))


def finished_parts(handle: AtlasStore, group: str, digest: str) -> set[str]:
    """The names of the parts that a search with this digest has finished; parts of any other search are removed."""
    if get_part(handle, group, DIGEST) != digest.encode():
        drop_parts(handle, group)
        put_part(handle, group, DIGEST, digest.encode())
    return {name for name in part_names(handle, group) if get_part(handle, group, name) is not None}
