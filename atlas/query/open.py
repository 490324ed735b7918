"""Opening a store as a dataset."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from atlas.errors import ChunkError, InputError, message_of
from atlas.spec.resolved import outlined
from atlas.store.axes import changed_values
from atlas.store.groups import LABELS, STABILITY, group_attributes, read_group
from atlas.store.location import Given
from atlas.store.store import ROOT, Atlas, open_handle
from workers.results import LABEL

if TYPE_CHECKING:
    import xarray


SOURCE, _HANDLE = "source", "atlas"
"""The keys of a dataset's encoding that have the name of its store, and what was read of it when it was opened."""
LAYERS = "layers"
"""The key of the layers of each Dask array's graph, by variable, as they are when a dataset is opened."""
Chunks = int | str | Mapping[Any, Any] | None
"""Of Dask arrays, as ``xarray.open_dataset`` takes them; None for none."""


def open_atlas(
    store: "Given | Atlas", chunks: Chunks = None, storage_options: Mapping[str, Any] | None = None
) -> "xarray.Dataset":
    """The atlas as an xarray Dataset, read from disk as it is used; InputError where the store is not an atlas.

    ``chunks`` makes Dask arrays of its variables. Where its attractors are labelled it has their ``label`` too, and
    where they are measured their measures. Attributes are those of the store. Reading a chunk of a finished tile
    that is missing or damaged raises ChunkError.
    """
    import xarray

    handle = open_handle(store, storage_options)
    try:
        opened: Any = xarray.open_dataset(
            _guarded(handle),
            engine="zarr",
            chunks=chunks,
            consolidated=True,
            zarr_format=3,
        )
    except (OSError, MemoryError, ChunkError):
        raise
    except Exception as error:  # metadata that meet bytes nobody wrote may raise anything
        raise ChunkError(handle.place, {ROOT: f"is damaged ({message_of(error)})"}) from None
    stored = {name: tuple(opened[name].values.tolist()) for name in outlined(handle.outline)}
    if changed := changed_values(handle.place, handle.outline, stored, lambda: handle.values):
        raise ChunkError(handle.place, {f"coordinate {name}": "is not the spec's" for name in changed})
    if handle.spec.coexistence and group_attributes(handle, LABELS) is not None:
        opened = opened.assign({LABEL.name: open_table(handle, LABELS)[LABEL.name]})
    if STABILITY in handle.groups and group_attributes(handle, STABILITY) is not None:
        opened = opened.assign(open_table(handle, STABILITY).data_vars)
    note_store(opened, handle)
    if chunks is not None:
        arrays = {str(name): array.data for name, array in opened.data_vars.items() if array.chunks is not None}
        opened.encoding[LAYERS] = {name: frozenset(array.dask.layers) for name, array in arrays.items()}
    return opened


def note_store(ds: "xarray.Dataset", handle: Atlas) -> None:
    """Say of which store a dataset is."""
    ds.encoding |= {SOURCE: str(handle.place), _HANDLE: handle}


def handle_of(ds: "xarray.Dataset") -> Atlas:
    """The handle of the store that a dataset, or the one that it was selected from, is of.

    What was read when ``atlas.open`` opened it, while the store is the same; else it is read by its name.
    InputError where the dataset does not name its store, and where that is gone or is another one by now.
    """
    kept, source = ds.encoding.get(_HANDLE), ds.encoding.get(SOURCE)
    if isinstance(kept, Atlas):
        handle = kept.current()
        if handle is not kept:
            note_store(ds, handle)
    elif isinstance(source, str):
        handle = open_handle(source)
    else:
        raise InputError("this dataset does not name its store: use the one that atlas.open returns")
    if ds.attrs.get("run_id", handle.run_id) != handle.run_id:
        raise InputError(f"{handle.place}: another store than the one that this dataset is of; open it again")
    return handle


def open_table(handle: Atlas, table: str) -> "xarray.Dataset":
    """A table that the store has beside its results, read from disk as it is used.

    ChunkError where its metadata are damaged, and at reading where a chunk of it is missing or damaged.
    """
    import xarray

    try:
        return xarray.open_dataset(
            _guarded(handle), engine="zarr", group=table, chunks=None, consolidated=False, zarr_format=3
        )
    except (OSError, ChunkError):
        raise
    except Exception as error:  # metadata that meet bytes nobody wrote may raise anything
        read_group(handle, table)  # names what it is
        raise ChunkError(handle.place, {table: f"is damaged ({message_of(error)})"}) from None


def _guarded(handle: Atlas) -> Any:
    from atlas.overview.guard import GuardedStore  # with it Zarr, which takes a while to load

    return GuardedStore(handle)
