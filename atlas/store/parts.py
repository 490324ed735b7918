"""Finished parts of a search that is still at work on a store, by the group that the search will write.

They lie apart from the groups, whose readers expect arrays. Each begins with its checksum.
"""

import hashlib
from collections.abc import Iterator

from atlas.store.store import Header

PARTS = "parts"
DIGEST = "digest"
"""The part that says which search the others are of."""
_CHECKSUM_BYTES = 32


def put_part(header: Header, group: str, name: str, data: bytes) -> None:
    """Keep a finished part of a search; it appears whole or not at all."""
    header.place.put(f"{PARTS}/{group}/{name}", hashlib.sha256(data).digest() + data)


def get_part(header: Header, group: str, name: str) -> bytes | None:
    """A part; None if it does not exist or is damaged, and has to be found again."""
    stored = header.place.get(f"{PARTS}/{group}/{name}") or b""
    checksum, data = stored[:_CHECKSUM_BYTES], stored[_CHECKSUM_BYTES:]
    return data if hashlib.sha256(data).digest() == checksum else None


def part_names(header: Header, group: str) -> Iterator[str]:
    """The names of all parts."""
    root = f"{PARTS}/{group}/"
    return (key.removeprefix(root) for key in header.place.list_keys(root))


def damaged_parts(header: Header, group: str) -> list[str]:
    """The keys of parts that are damaged."""
    names = sorted(part_names(header, group))
    return [f"{PARTS}/{group}/{name}" for name in names if get_part(header, group, name) is None]


def drop_parts(header: Header, group: str) -> None:
    """Remove all parts."""
    header.place.remove_all(list(header.place.list_keys(f"{PARTS}/{group}/")))


def kept_parts(header: Header, group: str, digest: str) -> set[str]:
    """The names of the parts that a search with this digest has finished; those of any other search are removed."""
    if get_part(header, group, DIGEST) != digest.encode():
        drop_parts(header, group)
        put_part(header, group, DIGEST, digest.encode())
    return {name for name in part_names(header, group) if get_part(header, group, name) is not None}
