"""The group ``curves`` of a store: arrays written whole, and what is kept while they are still being found.

The group's attributes have the digest of its arrays. Finished parts of a search are objects of their own beside it.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import ChunkError, message_of
from atlas.store.groups import group_attributes, write_group
from atlas.store.schema import StoredArray
from atlas.store.store import Header, open_group

GROUP = "curves"
PARTS = "parts"
_VERSION = 1
"""Of the form of the group; one of another version counts as absent."""


def write_arrays(header: Header, arrays: Mapping[str, StoredArray], attributes: Mapping[str, Any]) -> None:
    """Write the group, in place of any before it."""
    content = digest_of({name: each.values for name, each in arrays.items()})
    own = {"version": _VERSION, "arrays": list(arrays), "content": content}
    write_group(header, GROUP, arrays, own | dict(attributes))


def read_arrays(header: Header) -> tuple[dict[str, NDArray[Any]], dict[str, Any]] | None:
    """The arrays of the group by name, and its attributes; None where there is none. ChunkError where it is damaged."""
    try:
        attributes = group_attributes(header, GROUP)
        if attributes is None or attributes["version"] != _VERSION:
            return None
        group: Any = open_group(header.place, "r")
        arrays = {name: np.asarray(group[f"{GROUP}/{name}"][...]) for name in attributes["arrays"]}
        if digest_of(arrays) == attributes["content"]:
            return arrays, attributes
        fault = "its arrays are not those written together"
    except OSError:
        raise
    except Exception as error:  # metadata or a codec that meet bytes nobody wrote may raise anything
        fault = message_of(error)
    raise ChunkError(header.place, {GROUP: f"is damaged ({fault}); make it anew by atlas curves"})


def put_part(header: Header, name: str, data: bytes) -> None:
    """Keep a finished part of a search; it appears whole or not at all."""
    header.place.put(f"{GROUP}/{PARTS}/{name}", data)


def get_part(header: Header, name: str) -> bytes | None:
    """A part, None where there is none."""
    return header.place.get(f"{GROUP}/{PARTS}/{name}")


def part_names(header: Header) -> Iterator[str]:
    """The names of all parts."""
    root = f"{GROUP}/{PARTS}/"
    return (key.removeprefix(root) for key in header.place.list_keys(root))


def drop_parts(header: Header) -> None:
    """Remove all parts."""
    for name in list(part_names(header)):
        header.place.remove(f"{GROUP}/{PARTS}/{name}")


def digest_of(arrays: Mapping[str, NDArray[Any]]) -> str:
    """A digest of arrays by name: of their shapes and values."""
    found = hashlib.sha256()
    for name in sorted(arrays):
        values = arrays[name]
        found.update(f"{name} {values.shape} ".encode())
        texts = values.dtype.kind not in "biuf"
        found.update(json.dumps(values.tolist()).encode() if texts else np.ascontiguousarray(values).tobytes())
    return found.hexdigest()
