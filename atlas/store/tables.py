"""Tables that a finished store gets: groups of arrays beside its results, which xarray opens.

``attractors`` are those whose basins a store has, one entry an attractor; ``labels`` those of coexisting attractors. A
group's own metadata are written last: a kill at any moment leaves it whole or absent.
"""

import json
import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from atlas.store.build import codecs, consolidate
from atlas.store.schema import coordinates
from atlas.store.store import ROOT, Header, open_group

ATTRACTORS, LABELS = "attractors", "labels"
"""The groups."""


class Column(NamedTuple):
    """A variable of a table: its dimensions, its values and its attributes."""

    dims: tuple[str, ...]
    values: np.ndarray
    attributes: dict[str, Any]


def write_table(header: Header, table: str, columns: Mapping[str, Column], attributes: Mapping[str, Any]) -> None:
    """Write a table, in the place of one that is there; coordinates of its dimensions come with it."""
    import zarr

    header.place.remove(f"{table}/{ROOT}")
    root: Any = open_group(header.place, "r+")
    dims = {dim for column in columns.values() for dim in column.dims}
    known = {name: each for name, each in coordinates(header.spec).items() if name in dims and each.dims == (name,)}
    described = {name: Column(each.dims, each.values, each.attributes) for name, each in known.items()}
    for name, (own, values, attrs) in (described | dict(columns)).items():
        array = root.create_array(
            f"{table}/{name}",
            shape=values.shape,
            chunks=tuple(max(1, n) for n in values.shape),
            dtype="str" if values.dtype.kind == "T" else values.dtype,
            dimension_names=own,
            compressors=codecs(),
            attributes=attrs,
            overwrite=True,
        )
        array.with_config({"write_empty_chunks": True})[...] = values
    own_metadata = {"zarr_format": 3, "node_type": "group", "attributes": {**attributes, "digest": header.digest}}
    header.place.put(f"{table}/{ROOT}", json.dumps(own_metadata).encode())
    with warnings.catch_warnings():
        # Zarr warns that consolidated metadata are an extension; xarray warns where they are missing.
        warnings.filterwarnings("ignore", message="Consolidated metadata")
        zarr.consolidate_metadata(root.store, path=table)
    consolidate(root)  # by the root's copy xarray finds the group


def table_attributes(header: Header, table: str) -> dict[str, Any] | None:
    """The attributes of a table, None where it is not there."""
    stored = header.place.get(f"{table}/{ROOT}")
    return None if stored is None else dict(json.loads(stored).get("attributes", {}))
