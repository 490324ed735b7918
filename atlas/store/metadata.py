"""The metadata of Zarr arrays and groups as JSON, and the checksum that protects a group's attributes.

All metadata of a store are written here, byte for byte, so that a verification compares bytes. They do not depend on
the installed version of Zarr.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from typing import Any

import google_crc32c
import numpy as np
from numpy.typing import NDArray

from atlas.errors import brief_repr, message_of

ROOT = "zarr.json"
"""Name of the object with the metadata of a group or an array. A store exists once its root group has this object."""
CHECKSUM = "checksum"
"""Name of the attribute of a group with the checksum of all its other attributes."""
CRC32C = {"name": "crc32c"}
COMPRESSED = ({"name": "zstd", "configuration": {"level": 0, "checksum": False}}, CRC32C)
"""Codecs of every chunk after its encoding as bytes: compression, and a checksum that reveals damage by a disk."""
_CONSOLIDATED = "consolidated_metadata"

Node = Mapping[str, Any]
"""The Zarr metadata of one array or group, without copies of other metadata."""


def seal(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return attributes with a checksum of them as one more attribute. They are as they will be read back from JSON."""
    plain = json.loads(json.dumps(dict(attributes)))
    return {**plain, CHECKSUM: _checksum(plain)}


def sealed(attributes: Mapping[str, Any], members: Mapping[str, Node] | None = None) -> bytes:
    """Return the metadata of a group as bytes, with a checksum by which ``unsealed`` finds later changes of the
    attributes.

    ``members`` are the metadata of the group's arrays and groups by path, of which copies are included; None for no
    copies.
    """
    return encode_node(group_node(seal(attributes)), members)


def unsealed(data: bytes | None) -> dict[str, Any] | None:
    """Return the attributes in a group's metadata without their checksum; None if the checksum is missing or wrong."""
    try:
        attributes = dict(json.loads(data or b"")["attributes"])
        checksum = attributes.pop(CHECKSUM)
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return attributes if checksum == _checksum(attributes) else None


def members_of(data: bytes | None) -> dict[str, Any]:
    """Return the copies of other metadata in the metadata of a group, by path; empty if they cannot be read."""
    try:
        return dict(json.loads(data or b"")[_CONSOLIDATED]["metadata"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return {}


def group_node(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the Zarr metadata of a group with these attributes."""
    return {"zarr_format": 3, "node_type": "group", "attributes": dict(attributes)}


def array_node(
    shape: Iterable[int],
    dtype: str,
    dims: Iterable[str],
    attributes: Mapping[str, Any],
    *,
    fill: Any = 0,
    block: Iterable[int] | None = None,
    chunk: Iterable[int] | None = None,
    codecs: Iterable[Node] = COMPRESSED,
    separator: str = "/",
) -> dict[str, Any]:
    """Return the Zarr metadata of an array.

    shape       number of values along each dimension
    dtype       name of the type; "string" for texts
    dims        names of the dimensions
    attributes  attributes of the array
    fill        value of missing chunks
    block       shape of an object, None for a single object
    chunk       shape of the chunks within an object, None for one chunk
    codecs      codecs of a chunk after its encoding as bytes
    separator   separator of the indices in the key of an object
    """
    shape = list(shape)
    block = [max(1, size) for size in shape] if block is None else list(block)
    return {
        "zarr_format": 3,
        "node_type": "array",
        "shape": shape,
        "data_type": dtype,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": block}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": separator}},
        "fill_value": _fill_value(dtype, fill),
        "codecs": [*_codecs(dtype, block, None if chunk is None else list(chunk), codecs)],
        "attributes": dict(attributes),
        "dimension_names": list(dims),
        "storage_transformers": [],
    }


def encode_node(node: Node, members: Mapping[str, Node] | None = None) -> bytes:
    """Return the Zarr metadata of an array or group as bytes, with copies of the metadata ``members`` of a group."""
    if members is None:
        return json.dumps(node).encode()
    nodes = {path: _member(members[path]) for path in sorted(members, key=lambda path: (path.count("/"), path))}
    return json.dumps({**node, _CONSOLIDATED: _consolidated(nodes)}).encode()


def encode_whole(values: NDArray[Any]) -> bytes:
    """Encode an array as the bytes of a single chunk, which is not compressed: every version of every library gives
    these bytes.
    """
    if values.dtype.kind in "TO":
        texts = [str(text).encode() for text in values.ravel()]
        data = b"".join(len(text).to_bytes(4, "little") + text for text in texts)
        data = len(texts).to_bytes(4, "little") + data
    else:
        data = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).tobytes()
    return data + google_crc32c.value(data).to_bytes(4, "little")


def describe_difference(stored: bytes | None, right: bytes) -> str:
    """Return a text about the first difference of stored metadata, or of a stored chunk, from the right bytes."""
    if stored is None:
        return "is missing"
    if not right.startswith(b"{"):
        return "is damaged or another chunk"
    try:
        stored_value, must, where = json.loads(stored), json.loads(right), ""
    except (ValueError, RecursionError) as error:
        return f"is damaged ({message_of(error)})"
    while isinstance(stored_value, dict) and isinstance(must, dict) and stored_value != must:
        key = next(
            key
            for key in {**must, **stored_value}
            if key not in stored_value or key not in must or stored_value[key] != must[key]
        )
        where += f".{key}" if where else key
        if key not in must:
            return f"has an unknown key {where}"
        stored_value, must = stored_value.get(key), must[key]
    return (
        f"has {where} {brief_repr(stored_value)}, must be {brief_repr(must)}"
        if stored_value != must
        else "is written differently"
    )


def _checksum(plain: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def _consolidated(nodes: Mapping[str, Node]) -> dict[str, Any]:
    return {"kind": "inline", "must_understand": False, "metadata": nodes}


def _member(node: Node) -> Node:
    return {**node, _CONSOLIDATED: _consolidated({})} if node["node_type"] == "group" else node


def _fill_value(dtype: str, fill: Any) -> Any:
    if dtype == "string":
        return ""
    kind = np.dtype(dtype).kind
    if kind == "f":
        return "NaN" if fill != fill else float(fill)
    return bool(fill) if kind == "b" else int(fill)


def _codecs(dtype: str, block: list[int], chunk: list[int] | None, after: Iterable[Node]) -> list[Node]:
    if dtype == "string":
        return [{"name": "vlen-utf8", "configuration": {}}, *after]
    little = {"name": "bytes", "configuration": {"endian": "little"}}
    encoded = [{"name": "bytes"} if np.dtype(dtype).itemsize == 1 else little, *after]
    if chunk is None or chunk == block:
        return encoded
    sharding = {"chunk_shape": chunk, "codecs": encoded, "index_codecs": [little, CRC32C], "index_location": "end"}
    return [{"name": "sharding_indexed", "configuration": sharding}]
