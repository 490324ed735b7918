"""The group ``curves`` of a store: its arrays, and the finished parts of a search that is still at work.

The group's attributes have the digest of its arrays. Each part is an object that begins with its checksum.
"""

import hashlib
from collections.abc import Iterator, Mapping
from typing import Any

from numpy.typing import NDArray

from atlas.errors import ChunkError
from atlas.store.groups import read_group, values_digest, write_group
from atlas.store.schema import StoredArray
from atlas.store.store import ROOT, Header

GROUP = "curves"
PARTS = "parts"
_VERSION = 1
"""Of the form of the group; one of another version counts as absent."""
_CHECKSUM_BYTES = 32


def write_arrays(header: Header, arrays: Mapping[str, StoredArray], attributes: Mapping[str, Any]) -> None:
    """Write the group, in place of any before it."""
    content = values_digest({name: each.values for name, each in arrays.items()})
    write_group(header, GROUP, arrays, {"version": _VERSION, "content": content, **attributes})


def read_arrays(header: Header) -> tuple[dict[str, NDArray[Any]], dict[str, Any]] | None:
    """The arrays of the group by name, and its attributes; None if there is no group. ChunkError if it is damaged."""
    found = read_group(header, GROUP)
    if found is None or found[1].get("version") != _VERSION:
        return None
    if values_digest(found[0]) != found[1].get("content"):
        raise ChunkError(header.place, {f"{GROUP}/{ROOT}": "is damaged or belongs to other arrays"})
    return found


def put_part(header: Header, name: str, data: bytes) -> None:
    """Keep a finished part of a search; it appears whole or not at all."""
    header.place.put(f"{GROUP}/{PARTS}/{name}", hashlib.sha256(data).digest() + data)


def get_part(header: Header, name: str) -> bytes | None:
    """A part; None if it does not exist or is damaged, and has to be found again."""
    stored = header.place.get(f"{GROUP}/{PARTS}/{name}") or b""
    checksum, data = stored[:_CHECKSUM_BYTES], stored[_CHECKSUM_BYTES:]
    return data if hashlib.sha256(data).digest() == checksum else None


def part_names(header: Header) -> Iterator[str]:
    """The names of all parts."""
    root = f"{GROUP}/{PARTS}/"
    return (key.removeprefix(root) for key in header.place.list_keys(root))


def damaged_parts(header: Header) -> list[str]:
    """The keys of parts that are damaged."""
    return [f"{GROUP}/{PARTS}/{name}" for name in sorted(part_names(header)) if get_part(header, name) is None]


def drop_parts(header: Header) -> None:
    """Remove all parts."""
    header.place.remove_all(list(header.place.list_keys(f"{GROUP}/{PARTS}/")))
