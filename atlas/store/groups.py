"""Groups of arrays beside the results of a store, each written whole.

A group's own metadata are written last: before them there is none, and a kill at any moment leaves the group whole or
absent.
"""

import json
from collections.abc import Mapping
from typing import Any

from atlas.store.build import codecs
from atlas.store.schema import StoredArray
from atlas.store.store import ROOT, Header, open_group


def write_group(header: Header, group: str, arrays: Mapping[str, StoredArray], attributes: Mapping[str, Any]) -> None:
    """Write a group, in the place of one that is there."""
    header.place.remove(f"{group}/{ROOT}")
    root: Any = open_group(header.place, "r+")
    for name, (values, dims, described) in arrays.items():
        array = root.create_array(
            f"{group}/{name}",
            shape=values.shape,
            chunks=tuple(max(1, size) for size in values.shape),
            dtype="str" if values.dtype.kind == "T" else values.dtype,
            dimension_names=dims,
            compressors=codecs(),
            attributes=described,
            overwrite=True,
        )
        if values.size:
            array.with_config({"write_empty_chunks": True})[...] = values
    own = {"zarr_format": 3, "node_type": "group", "attributes": dict(attributes)}
    header.place.put(f"{group}/{ROOT}", json.dumps(own).encode())


def group_attributes(header: Header, group: str) -> dict[str, Any] | None:
    """The attributes of a group, None where it is not there. ValueError where they cannot be read."""
    stored = header.place.get(f"{group}/{ROOT}")
    return None if stored is None else dict(json.loads(stored).get("attributes", {}))
