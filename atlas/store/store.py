"""The handle of a store, which opens the store and gives access to its spec, its arrays and its finished tiles."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from threading import RLock
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError, RunError, brief_repr
from atlas.spec.resolved import unpack_axes
from atlas.spec.spec import Spec
from atlas.store.metadata import ROOT as ROOT
from atlas.store.metadata import Node, members_of, unsealed
from atlas.store.object_backend import Given, StoreBackend, open_backend, os_errors_as_input_errors
from atlas.store.origin import BudgetVariable, Origin, budget_variables
from atlas.store.record_format import TILES
from atlas.store.schema import (
    FORMAT,
    FORMAT_VERSION,
    SPEC_KEY,
    StoredArray,
    coordinate_names,
    coordinates,
    groups_of,
    layout,
    layout_nodes,
    remedy,
    root_with_groups,
)
from atlas.store.schema import OVERVIEWS as OVERVIEWS
from atlas.store.tiling import Tiling, chunk_mask
from workers.results import REGIME, Variable, leading

_T = TypeVar("_T")
COPY_BY_XARRAY = (
    "a copy made by xarray's to_zarr, which is no store of an atlas: open it with xarray.open_zarr; "
    "ds.atlas answers queries and draws pictures; no run or repair can complete it"
)
READERS = 8
"""Number of tiles read at the same time: a disk or a network answers several requests in the time of one."""


class _SharedCache(dict[str, Any]):
    """All that was read or opened so far through a handle of a store, by name.

    Copies of the handle with other backends share it. ``lock`` is held while a value is computed.
    """

    def __init__(self) -> None:
        super().__init__()
        self.lock = RLock()


class SharedCachedProperty(cached_property[_T]):
    """A property that is computed once for a handle and all its copies with other backends."""

    def __get__(self, instance: Any, owner: Any = None) -> _T:  # type: ignore[override]
        return instance.cached(str(self.attrname), lambda: self.func(instance))


@dataclass(frozen=True)
class AtlasStore:
    """The handle of a store: its backend, spec, solver version and contents.

    The handle derives all metadata of arrays from the ``attributes``. The metadata in the store are for other programs.

    backend          backend of the store
    attributes       attributes of the root, without their checksum
    digest           digest of the resolved spec
    run_id           identifier of the run that created the store
    solver_version   solver version of its cells
    tile             cells of a tile along each dimension
    origin           store whose cells it took over, None if there is none
    cache            everything else, read or opened at its first use and kept in this process
    """

    backend: StoreBackend
    attributes: Mapping[str, Any] = field(repr=False)
    digest: str
    run_id: str
    solver_version: int
    tile: tuple[int, ...]
    origin: Origin | None = None
    cache: _SharedCache = field(default_factory=_SharedCache, init=False, repr=False, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        return {entry.name: getattr(self, entry.name) for entry in fields(self)} | {"cache": None}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        vars(self).update(state, cache=_SharedCache())

    def __deepcopy__(self, memo: object) -> "AtlasStore":
        return self  # a handle never changes

    def cached(self, name: str, make: Callable[[], _T]) -> _T:
        """Return what ``make`` has returned for this handle under this name; it is called once, and reads no chunk."""
        with self.cache.lock:  # the threads of a worker ask at the same time
            if name not in self.cache:
                self.cache[name] = make()
            value: _T = self.cache[name]
        return value

    def current(self) -> "AtlasStore":
        """Return this handle if the store has not been replaced since; else a new handle.

        Raise errors like ``open_store``. The second copy of the root's attributes is read, which is small.
        """
        with os_errors_as_input_errors(self.backend, "read"):
            same = unsealed(self.backend.get(SPEC_KEY)) == self.attributes
        return self if same else open_store(self.backend)

    def with_backend(self, backend: StoreBackend) -> "AtlasStore":
        """Return a copy of the handle with another backend of the same store; both share everything that is read and
        opened.
        """
        other = object.__new__(AtlasStore)
        vars(other).update(vars(self), backend=backend)
        return other

    @property
    def path(self) -> Path:
        """The store's folder. Raise RunError if the store is at a URL."""
        if self.backend.local is None:
            raise RunError(f"{self.backend}: not a local folder")
        return self.backend.local

    @property
    def resolved(self) -> dict[str, Any]:
        """The spec of the store as it was written, with all defaults filled in."""
        return unpack_axes(json.loads(self.attributes["spec"]))

    @SharedCachedProperty
    def spec(self) -> Spec:
        """The spec of the store. Raise InputError if this version cannot read it."""
        try:
            return Spec.from_resolved(self.resolved)
        except (InputError, KeyError, TypeError) as error:
            raise InputError(f"{self.backend}: its spec cannot be read by this version: {error}") from None

    @SharedCachedProperty
    def nodes(self) -> Mapping[str, Node]:
        """Zarr metadata of the arrays and groups that every store of the spec has, by path."""
        return layout_nodes(self.spec, self.tile, "origin_retry" in self.attributes)

    @SharedCachedProperty
    def layout(self) -> Mapping[str, bytes]:
        """The metadata and coordinates that the store had at its creation, by key."""
        return layout(self.attributes, self.spec)

    @SharedCachedProperty
    def tiling(self) -> Tiling:
        """The division of the store's cells into tiles."""
        return Tiling(self.spec.shape, self.tile)

    @property
    def variables(self) -> tuple[Variable, ...]:
        """Result variables of the store, ``regime`` last."""
        return self.spec.variables

    @SharedCachedProperty
    def allowances(self) -> tuple[BudgetVariable, ...]:
        """Variables with the budgets of cells that a retry may have raised; empty unless a retry made the store."""
        return budget_variables(self.spec) if self.origin is not None and self.origin.retry is not None else ()

    @property
    def regime(self) -> Variable:
        """The variable that is written last; a tile is finished once its ``regime`` exists."""
        return next(variable for variable in self.spec.variables if variable.name == REGIME.name)

    def dominant_arrays(self, arrays: Mapping[str, Any]) -> dict[str, Any]:
        """Return the given arrays of cells with one result per cell: that of the first attractor, if there are
        several.
        """
        return leading(self.spec.variables, arrays, len(self.spec.shape))

    @SharedCachedProperty
    def arrays(self) -> Mapping[str, Any]:
        """Zarr arrays of cells and coordinates by name, opened without a request; for reading, and to encode chunks to
        write.
        """
        return {name: array_by(self.backend, name, self.nodes[name]) for name in self.array_names}

    @property
    def array_names(self) -> list[str]:
        """Names of the root's arrays of cells and coordinates."""
        return [*(variable.name for variable in (*self.variables, *self.allowances)), *coordinate_names(self.spec)]

    @SharedCachedProperty
    def coordinates(self) -> dict[str, StoredArray]:
        """Coordinate arrays of the store by name, made from the spec."""
        return coordinates(self.spec)


def open_store(store: "Given | AtlasStore", storage_options: Mapping[str, Any] | None = None) -> AtlasStore:
    """Return the handle of a store; a handle is returned unchanged.

    Raise InputError if the store does not exist, is no atlas, or has an unknown format. If the disk or the server
    refuses access, its OSError is the cause of the InputError. Raise NetworkError if the server does not respond.
    """
    if isinstance(store, AtlasStore):
        return store
    backend = open_backend(store, storage_options=storage_options)
    with os_errors_as_input_errors(backend, "read"):
        return _open_handle(backend)


def _open_handle(backend: StoreBackend) -> AtlasStore:
    content = backend.get(ROOT)
    attributes = unsealed(content)
    is_intact = attributes is not None and TILES in members_of(content)
    other = None if is_intact else unsealed(backend.get(SPEC_KEY))
    if attributes is None and other is not None and other.get("format") == FORMAT:
        damage = "is missing" if content is None else "is damaged (its checksum is wrong)"
        raise InputError(f"{backend}: {ROOT} {damage}: {remedy(backend)}")
    if not is_intact and other is None and _is_copy(backend, content):
        raise InputError(f"{backend}: {COPY_BY_XARRAY}")
    return handle_by(backend, attributes or _attributes(backend, content))


def _attributes(backend: StoreBackend, content: bytes | None) -> dict[str, Any]:
    """Return the attributes in the metadata of a root whose checksum is wrong; empty if they cannot be read.

    backend  backend of the store
    content  bytes of the metadata, None if they are missing

    Raise InputError if there is no store, or if the attributes are those of an atlas and therefore damaged.
    """
    path = backend.local or getattr(backend, "file", None)
    if content is None and not (path is not None and path.exists()):
        raise InputError(f"{backend}: no such store")
    try:
        attributes = dict(json.loads(content or b"")["attributes"])
    except (KeyError, TypeError, ValueError, RecursionError):
        attributes = {}
    if attributes.get("format") == FORMAT and attributes.get("format_version") == FORMAT_VERSION:
        raise InputError(f"{backend}: {ROOT} is damaged, and its copy {SPEC_KEY} is missing or damaged, too")
    return attributes


def _is_copy(backend: StoreBackend, content: bytes | None) -> bool:
    """Return True if only the root of a store was copied: the root is intact, but the group of tiles is missing."""
    return unsealed(content) is not None and not backend.exists(f"{TILES}/{ROOT}")


def handle_by(backend: StoreBackend, attributes: Mapping[str, Any]) -> AtlasStore:
    """Return the handle of a store whose root has the given attributes.

    Raise InputError if they are not those of an atlas, or have an unknown format.
    """
    if attributes.get("format") != FORMAT:
        raise InputError(f"{backend}: not an atlas (no {FORMAT} attributes)")
    if attributes.get("format_version") != FORMAT_VERSION:
        version = brief_repr(attributes.get("format_version"))
        raise InputError(f"{backend}: format version {version}, this program reads version {FORMAT_VERSION}")
    return AtlasStore(
        backend=backend,
        attributes=attributes,
        digest=attributes["digest"],
        run_id=attributes["run_id"],
        solver_version=attributes["solver_version"],
        tile=tuple(json.loads(attributes["tile"])),
        origin=Origin.from_attributes(attributes),
    )


def read_groups(handle: AtlasStore) -> dict[str, bytes]:
    """Return the stored metadata of the undamaged groups of a store by name: overviews, tables, curves."""
    names = (OVERVIEWS, *groups_of(handle.spec))
    stored = handle.backend.get_all(f"{name}/{ROOT}" for name in names)
    return {key.partition("/")[0]: data for key, data in stored.items() if unsealed(data) is not None}


def write_root(handle: AtlasStore, without: str = "") -> None:
    """Write the metadata of the root, with copies of the metadata of all undamaged groups but ``without``."""
    groups = {name: data for name, data in read_groups(handle).items() if name != without}
    handle.backend.put(ROOT, root_with_groups(handle.attributes, handle.nodes, groups))


def find_store(store: Given) -> AtlasStore | None:
    """Return the handle of a store; None if it does not exist yet. Raise InputError if something else exists there."""
    backend = open_backend(store)
    with os_errors_as_input_errors(backend, "written"):
        free = is_free(backend)
    return None if free else open_store(backend)


def is_free(backend: StoreBackend) -> bool:
    """Return True if a new store may be created at a backend: no store is there, and on a disk nothing else."""
    path = backend.local
    if path is None:
        return not backend.exists(ROOT)
    return not path.exists() or (path.is_dir() and not any(path.iterdir()))


def done_mask(handle: AtlasStore, sized: bool = True) -> NDArray[np.bool_]:
    """Return the mask (grid) of the finished tiles, from one listing of the store.

    A tile is finished if the chunk with its regimes exists and is not empty. A crash may have emptied files. On a disk,
    looking at their sizes takes most of the time; it is left out unless ``sized``.
    """
    grid, backend, folder = handle.tiling.grid, handle.backend, f"{REGIME.name}/c"
    keys = backend.list_keys(f"{folder}/")
    keys = backend.whole_keys(keys) if sized else keys
    return chunk_mask(keys, folder, (*grid, *(1 for _ in handle.regime.extra_dims))).reshape(grid)


def done_tiles(handle: AtlasStore) -> set[tuple[int, ...]]:
    """Return the indices of the finished tiles; see ``done_mask``."""
    return set(map(tuple, np.argwhere(done_mask(handle)).tolist()))


def is_done(handle: AtlasStore, index: tuple[int, ...]) -> bool:
    """Return True if the tile with this index is finished; see ``done_tiles`` for all tiles."""
    return handle.backend.exists(chunk_key(handle.regime, index))


def chunk_key(variable: Variable, index: tuple[int, ...]) -> str:
    """Return the key of a tile's chunk in the array of a variable."""
    return "/".join([variable.name, "c", *map(str, index), *("0" for _ in variable.extra_dims)])


def array_by(backend: StoreBackend, path: str, node: Node) -> Any:
    """Return a Zarr array, for reading, from a store's backend, its path and its metadata ``node``."""
    from atlas.store.zarr_store import BackendStore  # with it Zarr, which takes a while to load

    return array_in(BackendStore(backend), path, node)


def array_in(store: Any, path: str, node: Node) -> Any:
    """Return a Zarr array from a Zarr store object, its path and its metadata ``node``. Wrong metadata may raise
    anything.
    """
    from zarr import Array, AsyncArray
    from zarr.storage import StorePath

    metadata: Any = dict(node)
    return Array(AsyncArray(metadata, StorePath(store, path)))
