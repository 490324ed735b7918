"""The handle of a store: it opens the store and describes its spec, its arrays and its finished tiles."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from atlas.errors import ChunkError, InputError, RunError, brief_repr, message_of
from atlas.spec.axis import Values
from atlas.spec.resolved import with_values
from atlas.spec.spec import Spec
from atlas.store.axes import ROOT as ROOT
from atlas.store.axes import copies, read_values
from atlas.store.metadata_backup import SPARE, copy_difference, decode_backup, form_fault, remedy, root_fault
from atlas.store.object_backend import Given, StoreBackend, open_backend, os_errors_as_input_errors
from atlas.store.origin import BudgetVariable, Origin, budget_variables
from atlas.store.record_format import RECORD
from atlas.store.schema import FORMAT, FORMAT_VERSION, StoredArray, coordinate_names, coordinates
from atlas.store.tiling import Tiling, chunk_index
from atlas.store.zip_backend import ZipBackend
from workers.results import ATTRACTOR, REGIME, Variable, leading

if TYPE_CHECKING:
    import zarr

_T = TypeVar("_T")
FIRST_RELEASED = 13
"""First solver version that was released; stores of earlier versions may have another layout."""
COPY_BY_XARRAY = (
    "a copy made by xarray's to_zarr, which is no store of an atlas: open it with xarray.open_zarr; "
    "ds.atlas answers queries and draws pictures; no run or repair can complete it"
)
READERS = 8
"""Number of tiles read at the same time: a disk or a network answers several requests as soon as one."""


class _SharedCache(dict[str, Any]):
    """What the views of a handle have read and opened, by name. ``lock`` is held while an entry is computed."""

    def __init__(self) -> None:
        super().__init__()
        self.lock = RLock()


class SharedCachedProperty(cached_property[_T]):
    """A property that is computed once for all views of a handle."""

    def __get__(self, instance: Any, owner: Any = None) -> _T:  # type: ignore[override]
        name, kept = str(self.attrname), instance.cache
        with kept.lock:  # the threads of a worker ask at the same time
            if name not in kept:
                kept[name] = self.func(instance)
            value: _T = kept[name]
        return value


@dataclass(frozen=True)
class AtlasStore:
    """The handle of a store: its backend, spec, solver version and contents.

    backend          backend of the store
    outline          outline of the spec, without the values of axes and points
    digest           digest of the resolved spec
    run_id           identifier of the run that created the store
    solver_version   solver version of its cells
    nodes            consolidated metadata of the root: those of its arrays and groups, by path
    origin           store whose cells it took over, None if there is none
    state            digest of the root's metadata when they were read
    cache            everything else, read or opened at its first use and kept in this process
    """

    backend: StoreBackend
    outline: Mapping[str, Any]
    digest: str
    run_id: str
    solver_version: int
    nodes: Mapping[str, Mapping[str, Any]] = field(repr=False)
    origin: Origin | None = None
    state: str = field(default="", repr=False, compare=False)
    cache: _SharedCache = field(default_factory=_SharedCache, init=False, repr=False, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        return {entry.name: getattr(self, entry.name) for entry in fields(self)} | {"cache": None}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        vars(self).update(state, cache=_SharedCache())

    def __deepcopy__(self, memo: object) -> "AtlasStore":
        return self  # a handle never changes

    def current(self) -> "AtlasStore":
        """Return this handle if the store's root is unchanged, else a new one. Raise errors like ``open_store``.

        This takes one request, fewer than opening the store.
        """
        with os_errors_as_input_errors(self.backend, "read"):
            same = self.state and _state(self.backend.get(ROOT)) == self.state
        return self if same else open_store(self.backend)

    def with_backend(self, place: StoreBackend) -> "AtlasStore":
        """Return the same handle for another view of its backend; both share everything that is read and opened."""
        other = object.__new__(AtlasStore)
        vars(other).update(vars(self), backend=place)
        return other

    @property
    def path(self) -> Path:
        """The store's folder. Raise RunError if the store is at a URL."""
        if self.backend.local is None:
            raise RunError(f"{self.backend}: not a local folder")
        return self.backend.local

    @SharedCachedProperty
    def arrays(self) -> Mapping[str, Mapping[str, Any]]:
        """Metadata of the root's arrays, by name."""
        return {name: node for name, node in self.nodes.items() if node["node_type"] == "array" and "/" not in name}

    @property
    def record(self) -> Mapping[str, Any]:
        """Metadata of the array of the tile records."""
        return self.nodes[RECORD]

    @property
    def groups(self) -> frozenset[str]:
        """Names of the root's groups."""
        return frozenset(name for name, node in self.nodes.items() if node["node_type"] == "group" and "/" not in name)

    @SharedCachedProperty
    def spec(self) -> Spec:
        """The spec of the store.

        The values of its axes are read at their first use, with ChunkError if they are damaged. Raise InputError if
        this version cannot read the spec, or if the store has other cells than the spec.
        """
        try:
            spec = Spec.from_outline(self.outline, lambda: self.values)
        except (InputError, KeyError, TypeError) as error:
            raise InputError(f"{self.backend}: its spec cannot be read by this version: {error}") from None
        shape = self.arrays[REGIME.name].get("shape")
        if not isinstance(shape, list | tuple) or tuple(shape[: len(spec.shape)]) != spec.shape:
            damage = f"{REGIME.name} has shape {brief_repr(shape)}, must be {spec.shape}"
            raise InputError(f"{self.backend}: its metadata are damaged: {damage}: {remedy(self.backend)}")
        return spec

    @SharedCachedProperty
    def values(self) -> Values:
        """Values of the axes, or of the columns of the points, by name. Raise ChunkError if they are damaged."""
        return read_values(self.backend, self.outline, self.digest)

    @property
    def copies(self) -> dict[str, bytes]:
        """Copies of coordinates in the store, by key; see ``store.axes``."""
        return copies(self.spec)

    @property
    def resolved(self) -> Mapping[str, Any]:
        """The resolved spec of the store. Raise ChunkError if its values are damaged."""
        return with_values(self.outline, self.values)

    @property
    def tile(self) -> tuple[int, ...]:
        """Cells of a tile along each dimension. Raise ValueError if the metadata have no valid numbers."""
        regime = self.arrays[REGIME.name]
        sizes = regime["chunk_grid"]["configuration"]["chunk_shape"]
        cells = zip(regime["dimension_names"], sizes, regime["shape"], strict=True)
        if not all(type(size) is int and 1 <= size <= max(1, count) for _, size, count in cells):
            raise ValueError(
                f"{REGIME.name} has chunks of {brief_repr(sizes)} in a shape of {brief_repr(regime['shape'])}"
            )
        named = zip(regime["dimension_names"], sizes, strict=True)
        return tuple(size for name, size in named if name != ATTRACTOR)

    @SharedCachedProperty
    def tiling(self) -> Tiling:
        """The tiles of the store."""
        return Tiling(self.spec.shape, self.tile)

    @property
    def variables(self) -> tuple[Variable, ...]:
        """Result variables of the store, ``regime`` last."""
        return self.spec.variables

    @SharedCachedProperty
    def allowances(self) -> tuple[BudgetVariable, ...]:
        """Variables of the budgets that a retry may have raised; empty unless a retry made the store."""
        return budget_variables(self.spec) if self.origin is not None and self.origin.retry is not None else ()

    @property
    def regime(self) -> Variable:
        """The variable that is written last; a tile is finished once its ``regime`` exists."""
        return next(variable for variable in self.spec.variables if variable.name == REGIME.name)

    def dominant_arrays(self, arrays: Mapping[str, Any]) -> dict[str, Any]:
        """Return arrays with one result per cell, that of the first attractor."""
        return leading(self.spec.variables, arrays, len(self.spec.shape))

    @SharedCachedProperty
    def readable(self) -> Mapping[str, Any]:
        """Zarr arrays of cells and coordinates by name, opened once. Raise errors like ``open_arrays``."""
        return open_arrays(self)

    @SharedCachedProperty
    def declared(self) -> Mapping[str, Any]:
        """The same arrays by the consolidated metadata of the root, without a request; they encode chunks to write."""
        return arrays_by(self, self.nodes)

    @property
    def array_names(self) -> list[str]:
        """Names of the root's arrays of cells and coordinates."""
        return [*(variable.name for variable in (*self.variables, *self.allowances)), *coordinate_names(self.spec)]

    @SharedCachedProperty
    def coordinates(self) -> dict[str, StoredArray]:
        """Coordinates, by name."""
        return coordinates(self.spec)


def open_store(store: "Given | AtlasStore", storage_options: Mapping[str, Any] | None = None) -> AtlasStore:
    """Return the handle of a store; a handle is returned unchanged.

    Raise InputError if the store does not exist, is no atlas, or has an unknown format. If the disk or the server
    refuses access, its OSError is the cause of the InputError. Raise NetworkError if the server does not respond.
    """
    if isinstance(store, AtlasStore):
        return store
    place = open_backend(store, storage_options=storage_options)
    with os_errors_as_input_errors(place, "read"):
        return _open_handle(place)


def _open_handle(place: StoreBackend) -> AtlasStore:
    regime = f"{REGIME.name}/{ROOT}"
    objects = place.get_all([ROOT, regime, SPARE])
    if SPARE not in objects:
        objects |= place.get_all([f"{RECORD}/{ROOT}"])
    content = objects.get(ROOT)
    spare = decode_backup(place, content, objects.get(SPARE))
    if spare is not None and (fault := root_fault(content, spare)):
        raise InputError(f"{place}: {ROOT} {fault}: {remedy(place)}")
    try:
        root = json.loads(content or b"")
        attrs = root["attributes"]
        ours = attrs.get("format") == FORMAT
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError):
        path = place.path if isinstance(place, ZipBackend) else place.local
        if content is None and not (path is not None and path.exists()):
            raise InputError(f"{place}: no such store") from None
        ours = False
    if not ours:
        raise InputError(f"{place}: not an atlas (no {FORMAT} attributes)")
    if attrs.get("format_version") != FORMAT_VERSION:
        layout = brief_repr(attrs.get("format_version"))
        raise InputError(f"{place}: format version {layout}, this program reads version {FORMAT_VERSION}")
    version = attrs.get("solver_version")
    if SPARE not in objects and f"{RECORD}/{ROOT}" not in objects:
        if type(version) is int and version < FIRST_RELEASED:
            old = (
                f"made by solver version {version}, before the first release, in a layout that this version cannot read"
            )
            raise InputError(f"{place}: {old}")
        raise InputError(f"{place}: {COPY_BY_XARRAY}")
    if spare is None and (fault := form_fault(root)):
        raise InputError(f"{place}: {ROOT} {fault}, and its backup, {SPARE}, is missing or damaged, too")
    if regime not in objects:
        raise InputError(f"{place}: {regime} is missing: {remedy(place)}")
    try:
        return replace(handle_by(place, root, json.loads(objects[regime])), state=_state(content))
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise InputError(f"{place}: its metadata are damaged: {message_of(error)}: {remedy(place)}") from None


def _state(content: bytes | None) -> str:
    return hashlib.sha256(content or b"").hexdigest()


def handle_by(place: StoreBackend, root: Mapping[str, Any], regime: Mapping[str, Any]) -> AtlasStore:
    """Return the handle of a store from the metadata of its root and of its regimes."""
    attrs, nodes = root["attributes"], (root.get("consolidated_metadata") or {"metadata": {}})["metadata"]
    if fault := copy_difference(regime, nodes[REGIME.name]):
        raise ValueError(f"{REGIME.name}/{ROOT} {fault}")
    handle = AtlasStore(
        backend=place,
        outline=json.loads(attrs["spec"]),
        digest=attrs["digest"],
        run_id=attrs["run_id"],
        solver_version=attrs["solver_version"],
        nodes=nodes,
        origin=Origin.from_attributes(attrs),
    )
    _ = handle.tile, handle.record
    return handle


def find_store(store: Given) -> AtlasStore | None:
    """Return the handle of a store; None if it does not exist yet. Raise InputError if something else exists there."""
    place = open_backend(store)
    with os_errors_as_input_errors(place, "written"):
        free = is_free(place)
    return None if free else open_store(place)


def is_free(place: StoreBackend) -> bool:
    """Return True if a backend has no store, and on a disk no other content."""
    path = place.local
    if path is None:
        return not place.exists(ROOT)
    return not path.exists() or (path.is_dir() and not any(path.iterdir()))


def done_tiles(handle: AtlasStore, listed: Iterable[str] | None = None) -> set[tuple[int, ...]]:
    """Return the indices of the finished tiles, whose regime chunk exists, from ``listed`` keys or from one listing."""
    root, end = f"{REGIME.name}/c/", "/0" * len(handle.regime.extra_dims)
    keys = handle.backend.list_keys(root) if listed is None else (key for key in listed if key.startswith(root))
    keys = handle.backend.whole_keys(keys)
    ours = (key.removeprefix(root).removesuffix(end) for key in keys if key.endswith(end))
    indices = (chunk_index(key, handle.tiling.grid) for key in ours)
    return {index for index in indices if index is not None}


def is_done(handle: AtlasStore, index: tuple[int, ...]) -> bool:
    """Return True if one tile is finished; see ``done_tiles`` for all tiles."""
    return handle.backend.exists(chunk_key(handle.regime, index))


def chunk_key(variable: Variable, index: tuple[int, ...]) -> str:
    """Return the key of a tile's chunk in the array of a variable."""
    return "/".join([variable.name, "c", *map(str, index), *("0" for _ in variable.extra_dims)])


def open_arrays(handle: AtlasStore, names: Iterable[str] | None = None) -> dict[str, Any]:
    """Return Zarr arrays of the root for reading, results and coordinates, by name: all, or those named.

    Raise ChunkError if their metadata are missing or damaged, or differ from the root's copy.
    """
    asked = handle.array_names if names is None else [name for name in handle.array_names if name in {*names}]
    own, faults = read_array_nodes(handle, asked), dict[str, str]()
    for name in asked:
        if fault := copy_difference(own.get(name), handle.nodes.get(name)):
            faults[f"{name}/{ROOT}"] = fault if name in own else "is missing"
    if faults:
        raise ChunkError(handle.backend, faults)
    return arrays_by(handle, own)


def arrays_by(handle: AtlasStore, nodes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the Zarr arrays of the root that these metadata describe, by name.

    Raise ChunkError for damaged metadata.
    """
    arrays = {}
    for name in handle.array_names:
        try:
            if name in nodes:
                arrays[name] = array_by(handle.backend, name, nodes[name])
        except Exception as error:  # Zarr may raise anything for damaged metadata
            raise ChunkError(handle.backend, {f"{name}/{ROOT}": f"is damaged ({message_of(error)})"}) from None
    return arrays


def array_by(place: StoreBackend, path: str, node: Any) -> Any:
    """Return a Zarr array of a store, for reading, that the metadata ``node`` describe.

    Damaged metadata may raise anything.
    """
    from zarr import Array, AsyncArray
    from zarr.storage import StorePath

    from atlas.store.zarr_stores import zarr_store  # with it Zarr, which takes a while to load

    return Array(AsyncArray(node, StorePath(zarr_store(place, read_only=True), path)))


def read_array_nodes(handle: AtlasStore, names: Iterable[str]) -> dict[str, Any]:
    """Return the own metadata of arrays of the root, by name. Raise ChunkError if they are damaged."""
    nodes = {}
    for key, data in handle.backend.get_all(f"{name}/{ROOT}" for name in names).items():
        try:
            nodes[key.removesuffix(f"/{ROOT}")] = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise ChunkError(handle.backend, {key: f"is damaged ({message_of(error)})"}) from None
    return nodes


def open_group(place: StoreBackend, mode: Literal["r", "r+"]) -> "zarr.Group":
    """Return the root group of a store, with the present metadata of each array instead of the root's copies."""
    import zarr

    from atlas.store.zarr_stores import zarr_store  # with it Zarr, which takes a while to load

    return zarr.open_group(zarr_store(place, mode == "r"), mode=mode, use_consolidated=False, zarr_format=3)
