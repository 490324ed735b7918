"""Tables that a finished store gets: groups of arrays beside its results, which xarray opens.

``attractors``: the attractors whose basins a store has, one entry each; ``labels``: labels of coexisting attractors.
"""

import warnings
from collections.abc import Mapping
from typing import Any

from atlas.store.build import consolidate
from atlas.store.groups import write_group
from atlas.store.schema import StoredArray, coordinates
from atlas.store.store import Header, open_group

ATTRACTORS, LABELS = "attractors", "labels"
"""The groups."""


def write_table(header: Header, table: str, columns: Mapping[str, StoredArray], attributes: Mapping[str, Any]) -> None:
    """Write a table, in the place of one that is there; coordinates of its dimensions come with it."""
    import zarr

    dims = {dim for column in columns.values() for dim in column.dims}
    known = {name: each for name, each in coordinates(header.spec).items() if name in dims and each.dims == (name,)}
    write_group(header, table, known | dict(columns), {**attributes, "digest": header.digest})
    root: Any = open_group(header.place, "r+")
    with warnings.catch_warnings():
        # Zarr warns that consolidated metadata are an extension; xarray warns where they are missing.
        warnings.filterwarnings("ignore", message="Consolidated metadata")
        zarr.consolidate_metadata(root.store, path=table)
    consolidate(root)  # by the root's copy xarray finds the group
