"""The group ``curves`` of a store. Its attributes have the digest of its arrays."""

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from atlas.errors import ChunkError
from atlas.store.groups import CURVES, read_group, values_digest, write_group
from atlas.store.schema import StoredArray
from atlas.store.store import ROOT, Atlas

_VERSION = 1
"""Of the form of the group; one of another version counts as absent."""


def write_arrays(handle: Atlas, arrays: Mapping[str, StoredArray], attributes: Mapping[str, Any]) -> None:
    """Write the group, in place of any before it."""
    content = values_digest({name: each.values for name, each in arrays.items()})
    write_group(handle, CURVES, arrays, {"version": _VERSION, "content": content, **attributes})


def read_arrays(handle: Atlas) -> tuple[dict[str, NDArray[Any]], dict[str, Any]] | None:
    """The arrays of the group by name, and its attributes; None if there is no group. ChunkError if it is damaged."""
    found = read_group(handle, CURVES)
    if found is None or found[1].get("version") != _VERSION:
        return None
    if values_digest(found[0]) != found[1].get("content"):
        raise ChunkError(handle.place, {f"{CURVES}/{ROOT}": "is damaged or belongs to other arrays"})
    return found
