"""Opening a store as a dataset."""

import os
from typing import TYPE_CHECKING, Any

from atlas.store.store import read_header
from atlas.store.tables import LABELS, table_attributes
from workers.results import LABEL

if TYPE_CHECKING:
    import xarray


def open_atlas(store: str | os.PathLike[str]) -> "xarray.Dataset":
    """The atlas as an xarray Dataset, read from disk as it is used; InputError where the store is not an atlas.

    Where its attractors are labelled it has their ``label`` too. Reading a chunk of a finished tile that is missing or
    damaged raises ChunkError.
    """
    import xarray

    from atlas.overview.guard import GuardedStore  # with it Zarr, which takes a while to load

    header = read_header(store)
    guarded: Any = GuardedStore(header)
    opened = xarray.open_dataset(guarded, engine="zarr", chunks=None, consolidated=True)
    if header.spec.coexistence and table_attributes(header, LABELS) is not None:
        labels = xarray.open_dataset(guarded, engine="zarr", group=LABELS, chunks=None, consolidated=False)
        opened = opened.assign({LABEL.name: labels[LABEL.name]})
    opened.encoding["source"] = str(header.place)  # by which a view finds the overviews
    return opened
