"""Opening the store of an atlas as an xarray dataset, and finding the store of a dataset."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from atlas.errors import ChunkError, InputError, message_of
from atlas.store.groups import group_attributes, group_layout
from atlas.store.handle_cache import keep_handle, known_handle
from atlas.store.metadata import ROOT, describe_difference
from atlas.store.object_backend import Given
from atlas.store.schema import LABELS, STABILITY
from atlas.store.store import AtlasStore, open_store
from workers.results import LABEL

if TYPE_CHECKING:
    import xarray


SOURCE, _RUN_ID = "source", "run_id"
"""Keys, in a dataset's encoding, of the name of its store and of the identifier of the run that created the store."""
LAYERS = "layers"
"""Key, in a dataset's encoding, of the layers that each Dask array's graph had when the dataset was opened."""
Chunks = int | str | Mapping[Any, Any] | None
"""Dask chunks as ``xarray.open_dataset`` takes them; None for no Dask arrays."""


def open_atlas(
    store: "Given | AtlasStore", chunks: Chunks = None, storage_options: Mapping[str, Any] | None = None
) -> "xarray.Dataset":
    """Return an atlas as an xarray Dataset that reads its store on demand.

    store            path, URL or handle of the store
    chunks           chunks of Dask arrays, as ``xarray.open_dataset`` takes them; None for no Dask arrays
    storage_options  options for the storage behind a URL

    If the attractors are labelled, the dataset has the variable ``label``; if they are measured, it has their measures.
    Its attributes are those of the store. Raise InputError if the store is not an atlas. Reading a missing or damaged
    chunk of a finished tile raises ChunkError.
    """
    import xarray

    handle = open_store(store, storage_options)
    opened: Any = xarray.open_dataset(_guarded(handle), engine="zarr", chunks=chunks, consolidated=True, zarr_format=3)
    if handle.spec.coexistence and group_attributes(handle, LABELS) is not None:
        opened = opened.assign({LABEL.name: open_table(handle, LABELS)[LABEL.name]})
    if group_attributes(handle, STABILITY) is not None:
        opened = opened.assign(open_table(handle, STABILITY).data_vars)
    attach_store(opened, handle)
    if chunks is not None:
        arrays = {str(name): array.data for name, array in opened.data_vars.items() if array.chunks is not None}
        opened.encoding[LAYERS] = {name: sorted(array.dask.layers) for name, array in arrays.items()}
    return opened


def attach_store(ds: "xarray.Dataset", handle: AtlasStore) -> None:
    """Record in a dataset the name of the store that it shows, so that ``handle_of`` finds the store's handle."""
    keep_handle(handle)
    ds.encoding |= {SOURCE: str(handle.backend), _RUN_ID: handle.run_id}


def handle_of(ds: "xarray.Dataset") -> AtlasStore:
    """Return the handle of the store of a dataset, or of the dataset that it was selected from.

    It is the handle that ``atlas.open`` made, as long as the store is the same; otherwise the store is opened by its
    name. Raise InputError if the dataset has no reference to its store, and if the store is gone or was replaced.
    """
    name = ds.encoding.get(SOURCE)
    if not isinstance(name, str):
        raise InputError("this dataset has no reference to its store; use the dataset that atlas.open returns")
    run_id = ds.encoding.get(_RUN_ID, ds.attrs.get("run_id"))
    handle = known_handle(name)
    if run_id not in (None, handle.run_id):
        raise InputError(f"{handle.backend}: the store was replaced after this dataset was opened; open it again")
    attach_store(ds, handle)
    return handle


def open_table(handle: AtlasStore, table: str) -> "xarray.Dataset":
    """Return a table of the store, such as that of the labelled attractors, as a dataset that reads on demand.

    Raise ChunkError if its metadata are damaged. Reading a missing or damaged chunk raises ChunkError, too.
    """
    import xarray

    try:
        return xarray.open_dataset(
            _guarded(handle), engine="zarr", group=table, chunks=None, consolidated=False, zarr_format=3
        )
    except (OSError, ChunkError):
        raise
    except Exception as error:  # damaged metadata may raise anything
        right = group_layout(handle, table, handle.backend.get(f"{table}/{ROOT}") or b"")  # may raise the exact error
        stored = handle.backend.get_all(right)
        wrong = {
            key: describe_difference(stored.get(key), right[key]) for key in right if stored.get(key) != right[key]
        }
        raise (
            ChunkError(handle.backend, wrong)
            if wrong
            else ChunkError(handle.backend, {table: f"is damaged ({message_of(error)})"})
        ) from None


def _guarded(handle: AtlasStore) -> Any:
    from atlas.overview.verifying_store import VerifyingStore  # imports Zarr, which is slow

    return VerifyingStore(handle)
