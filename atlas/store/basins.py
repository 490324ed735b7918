"""The table of the attractors whose basins a store has: the group ``attractors``, one entry an attractor."""

import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from atlas.store.build import codecs, consolidate
from atlas.store.schema import coordinates
from atlas.store.store import Header, open_group

TABLE = "attractors"


class Column(NamedTuple):
    """A variable of the table: its dimensions, the first of them ``attractor``, its values and its attributes."""

    dims: tuple[str, ...]
    values: np.ndarray
    attributes: dict[str, Any]


def write_table(header: Header, columns: Mapping[str, Column]) -> None:
    """Write the table, in the place of one that is there."""
    import zarr

    root = open_group(header.place, "r+")
    described = {"title": "attractors by their labels", "digest": header.digest}
    group = root.create_group(TABLE, overwrite=True, attributes=described)
    states = coordinates(header.spec)["component"]
    named = group.create_array(
        "component",
        shape=states.values.shape,
        chunks=states.values.shape,
        dtype="str",
        dimension_names=states.dims,
        compressors=codecs(),
        attributes=states.attributes,
    )
    named[...] = states.values
    for name, column in columns.items():
        array = group.create_array(
            name,
            shape=column.values.shape,
            chunks=tuple(max(1, n) for n in column.values.shape),
            dtype=column.values.dtype,
            dimension_names=column.dims,
            compressors=codecs(),
            attributes=column.attributes,
        )
        array.with_config({"write_empty_chunks": True})[...] = column.values
    with warnings.catch_warnings():
        # Zarr warns that consolidated metadata are an extension; xarray warns where they are missing.
        warnings.filterwarnings("ignore", message="Consolidated metadata")
        zarr.consolidate_metadata(root.store, path=TABLE)
    consolidate(root)


def has_table(header: Header) -> bool:
    """Whether the table is there."""
    return TABLE in open_group(header.place, "r")
