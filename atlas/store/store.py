"""A store: made whole and empty, found again, and what it says about itself."""

import errno
import json
import os
import shutil
import tempfile
import uuid
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from atlas.errors import ChunkError, InputError, NetworkError, RunError, message_of, shown
from atlas.spec.spec import Spec, differences
from atlas.store.archive import ZipPlace, refuse_packed
from atlas.store.build import build, consolidate, create_variable
from atlas.store.digests import DIGESTS, TILES
from atlas.store.location import LocalPlace, Place, place_of
from atlas.store.machine import MACHINES
from atlas.store.schema import (
    ALLOWANCES,
    FORMAT,
    FORMAT_VERSION,
    Allowance,
    Origin,
    StoredArray,
    coordinates,
    variable_attributes,
    variable_of,
)
from atlas.store.tiling import Tiling, chunk_index
from workers import SOLVER_VERSION
from workers.results import ATTRACTOR, REGIME, Variable, leading

if TYPE_CHECKING:
    import zarr

READERS = 8
"""Tiles read at once: a disk or a network answers several as soon as one."""
ROOT = "zarr.json"
"""The object that makes a store one: before it there is none."""
ZOOM = "zoom"
"""The group of what was explored, see ``store.zoom``."""
TRIAL = ".trial-"


@dataclass(frozen=True)
class Header:
    """What a store says about itself: where it is, what it was made from and by which solver, and what it holds.

    ``arrays`` are the metadata of its root's arrays, by name, as the root has them.
    """

    place: Place
    resolved: Mapping[str, Any]
    digest: str
    run_id: str
    solver_version: int
    arrays: Mapping[str, Mapping[str, Any]] = field(repr=False)
    origin: Origin | None = None

    @property
    def path(self) -> Path:
        """The store's folder; RunError where it lies at a URL."""
        if self.place.local is None:
            raise RunError(f"{self.place}: not a folder of this machine")
        return self.place.local

    @cached_property
    def spec(self) -> Spec:
        """The spec that the store was made from; what has been added to specs since is at its default.

        InputError where this version cannot read it, and where the store's cells are not those of the spec.
        """
        try:
            spec = Spec.from_resolved(self.resolved)
        except InputError as error:
            raise InputError(f"{self.place}: its spec cannot be read by this version: {error}") from None
        shape = self.arrays[REGIME.name].get("shape")
        if not isinstance(shape, list | tuple) or tuple(shape[: len(spec.shape)]) != spec.shape:
            found = f"{REGIME.name} has shape {shown(shape)}, must be {spec.shape}"
            raise InputError(f"{self.place}: its metadata are damaged: {found}")
        return spec

    @property
    def tile(self) -> tuple[int, ...]:
        """Cells of a tile along each dimension. ValueError where the metadata have no such numbers."""
        regime = self.arrays[REGIME.name]
        sizes = regime["chunk_grid"]["configuration"]["chunk_shape"]
        cells = zip(regime["dimension_names"], sizes, regime["shape"], strict=True)
        if not all(type(size) is int and 1 <= size <= max(1, count) for _, size, count in cells):
            raise ValueError(f"{REGIME.name} has chunks of {shown(sizes)} in a shape of {shown(regime['shape'])}")
        named = zip(regime["dimension_names"], sizes, strict=True)
        return tuple(size for name, size in named if name != ATTRACTOR)

    @cached_property
    def tiling(self) -> Tiling:
        """How the store's cells are cut into tiles."""
        return Tiling(self.spec.shape, self.tile)

    @cached_property
    def variables(self) -> tuple[Variable, ...]:
        """The results that the store holds, ``regime`` last; an older store may lack some that a new one has."""
        return tuple(variable for variable in self.spec.variables if variable.name in self.arrays)

    @property
    def regime(self) -> Variable:
        """The result that is written last, by which a tile is done."""
        return next(variable for variable in self.spec.variables if variable.name == REGIME.name)

    def leading(self, arrays: Mapping[str, Any]) -> dict[str, Any]:
        """Arrays of cells with one result each: where there are those of all attractors, that of the first."""
        return leading(self.spec.variables, arrays, len(self.spec.shape))

    @cached_property
    def unknown(self) -> tuple[Variable, ...]:
        """Values of cells that the store holds and this program does not know: it was made by a newer version."""
        dims = self.spec.dims
        known = {each.name for each in (*self.variables, *ALLOWANCES)} | {*self.coordinates}
        return tuple(
            variable_of(name, array, len(dims))
            for name, array in self.arrays.items()
            if name not in known and tuple(array.get("dimension_names") or ())[: len(dims)] == dims
        )

    @cached_property
    def coordinates(self) -> dict[str, StoredArray]:
        """The coordinates that the store holds; it has none for a parameter that the system got later."""
        added = self.spec.parameters.keys() - self.resolved["parameters"].keys()
        return {name: made for name, made in coordinates(self.spec).items() if name not in added}


def create(
    store: str | os.PathLike[str] | Place,
    spec: Spec,
    tile: tuple[int, ...],
    origin: Origin | None = None,
    run_id: str = "",
) -> Header:
    """Make a whole store without a result: metadata, coordinates, attributes. It appears at once or not at all.

    On a disk a rename does that; at a URL the root's metadata do, which are put last and only if no other run has put
    them meanwhile. ``origin`` is the store that it is to copy cells from. Without a ``run_id`` one is drawn.
    """
    place = place_of(store)
    with _refused(place, "written"):
        if place.local is None:
            _create_remotely(place, spec, tile, origin, run_id)
        else:
            _create_locally(place.local, spec, tile, origin, run_id)
    return read_header(place)


def read_header(store: str | os.PathLike[str] | Place) -> Header:
    """The header of a store; InputError where there is none, or it is not ours, or of a unknown format.

    Where the disk or the server refused, its OSError is that InputError's cause. NetworkError where the server does
    not answer.
    """
    place = place_of(store)
    with _refused(place, "read"):
        return _read_header(place)


def _read_header(place: Place) -> Header:
    foreign = InputError(f"{place}: not an atlas (no {FORMAT} attributes)")
    content = place.get(ROOT)
    if content is None:
        path = place.path if isinstance(place, ZipPlace) else place.local
        raise foreign if path is not None and path.exists() else InputError(f"{place}: no such store")
    attrs: Any = {}
    try:
        root = json.loads(content)
        attrs = root["attributes"]
        if attrs.get("format") != FORMAT:
            raise foreign
        found = attrs["format_version"]
        if found != FORMAT_VERSION:
            raise InputError(f"{place}: format version {found}, this program reads version {FORMAT_VERSION}")
        regime = json.loads(place.get(f"{REGIME.name}/{ROOT}") or b"")  # its own: by it tiles are cut and done
        header = Header(
            place=place,
            resolved=json.loads(attrs["spec"]),
            digest=attrs["digest"],
            run_id=attrs["run_id"],
            solver_version=attrs["solver_version"],
            arrays={**_array_metadata(place, root.get("consolidated_metadata")), REGIME.name: regime},
            origin=Origin(attrs["origin"], attrs["origin_run_id"]) if "origin" in attrs else None,
        )
        _ = header.tile
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        if isinstance(attrs, dict) and attrs.get("format") == FORMAT:
            raise InputError(f"{place}: its metadata are damaged: {error}") from None
        raise foreign from None
    return header


def _array_metadata(place: Place, consolidated: Any) -> Mapping[str, Mapping[str, Any]]:
    """The metadata of the root's arrays, by name: the root's copy, or where it has none, each array's own."""
    if consolidated is None:
        group: Any = open_group(place, "r")
        return {name: array.metadata.to_dict() for name, array in group.arrays()}
    nodes = consolidated["metadata"].items()
    return {name: node for name, node in nodes if node["node_type"] == "array" and "/" not in name}


def find(store: str | os.PathLike[str] | Place, spec: Spec) -> Header | None:
    """The header of a store that a run of this spec may resume, None where there is none yet; else InputError."""
    place = place_of(store)
    refuse_packed(place)
    with _refused(place, "written"):
        if _is_free(place, spec):
            _check_writable(place)
            return None
    header = read_header(place)
    if header.solver_version != SOLVER_VERSION:
        raise InputError(
            f"{place}: made by solver version {header.solver_version}, this is version {SOLVER_VERSION}; "
            "their numbers do not mix: choose another path"
        )
    if header.spec.digest != spec.digest:
        raise InputError(f"{place}: is of another spec: {'; '.join(differences(header.spec, spec))}")
    if header.unknown:
        names = ", ".join(variable.name for variable in header.unknown)
        raise InputError(f"{place}: has {names}, unknown to this version: resume it with the version that made it")
    with _refused(place, "written"):
        if place.local is None:
            _check_replaceable(place)
        elif not os.access(place.local, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    return header


@contextmanager
def _refused(place: Place, what: str) -> Iterator[None]:
    """An OSError within it as an InputError, whose cause it is; a server that does not answer stays a NetworkError."""
    try:
        yield
    except NetworkError:
        raise
    except OSError as error:
        raise InputError(f"{place}: cannot be {what}: {error.strerror or error}") from error


def done_tiles(header: Header) -> set[tuple[int, ...]]:
    """Indices of the tiles that are finished: those whose regime chunk exists. It takes one listing."""
    root, grid = f"{REGIME.name}/c/", header.tiling.grid
    end = "/0" * len(header.regime.extra)
    keys = (key.removeprefix(root) for key in header.place.list_keys(root) if key.endswith(end))
    found = (chunk_index(key.removesuffix(end), grid) for key in keys)
    return {index for index in found if index is not None}


def is_done(header: Header, index: tuple[int, ...]) -> bool:
    """Whether one tile is finished; see ``done_tiles`` for all of them."""
    return header.place.exists(chunk_key(header.regime, index))


def chunk_key(variable: Variable, index: tuple[int, ...]) -> str:
    """The key of a tile's chunk in a variable's array."""
    return "/".join([variable.name, "c", *map(str, index), *("0" for _ in variable.extra)])


def open_arrays(header: Header, consolidated: bool = False) -> dict[str, Any]:
    """All Zarr arrays of the store's root by name, results and coordinates, for reading.

    Each as its own metadata describe it, or as the root's consolidated copy does, which xarray goes by.
    ChunkError where they are damaged.
    """
    group = open_group(header.place, "r", consolidated)
    results = (*header.spec.variables, *header.unknown, *ALLOWANCES)
    found = {}
    for name in (*(v.name for v in results), *coordinates(header.spec)):
        try:
            if name in group:
                found[name] = group[name]
        except (OSError, MemoryError):
            raise
        except Exception as error:  # what is no JSON, or no metadata, may raise anything
            raise ChunkError(header.place, {f"{name}/{ROOT}": f"is damaged ({message_of(error)})"}) from None
    return found


def open_digests(header: Header, consolidated: bool = False) -> Any | None:
    """The Zarr array of the digests of the tiles, None in a store made before there were any."""
    group = open_group(header.place, "r", consolidated)
    return group.get(DIGESTS, None)


def restore_coordinates(header: Header) -> None:
    """Write the coordinates again, from the spec."""
    group: Any = open_group(header.place, "r+")
    for name, coordinate in header.coordinates.items():
        group[name][...] = coordinate.values


def add_allowances(header: Header, raised: Iterable[Allowance]) -> None:
    """Make room for cells that are given more than the spec's settings say; all others read as what these say."""
    group = open_group(header.place, "r+")
    wanted = list(raised)
    for each in wanted:
        if each.name not in group:
            spec = header.spec
            fixed = [name for name in (*spec.parameters, *spec.points) if name in header.coordinates]
            variable = replace(each, fill=each.of_spec(header.spec))
            create_variable(group, variable, header.spec, header.tiling, variable_attributes(variable, fixed))
    if any(each.name not in header.arrays for each in wanted):  # not even where a run made it and was killed at once
        consolidate(group)
        _leave_out(header.place, f"{ZOOM}/")


def _leave_out(place: Place, prefix: str) -> None:
    """Take what lies under a prefix out of the root's copy of the metadata: it comes and goes without it."""
    root = json.loads(place.get(ROOT) or b"{}")
    nodes = root.get("consolidated_metadata", {}).get("metadata", {})
    foreign = [name for name in nodes if f"{name}/".startswith(prefix)]
    for name in foreign:
        del nodes[name]
    if foreign:
        place.put(ROOT, json.dumps(root).encode())


def _zarr_store(place: Place, mode: str) -> Any:
    from atlas.store.remote import zarr_store  # with it Zarr, which takes a while to load

    return zarr_store(place, read_only=mode == "r")


def open_group(place: Place, mode: Literal["r", "r+"], consolidated: bool = False) -> "zarr.Group":
    """The root group of a store, its metadata read anew: of each array its own, or the root's copy of them."""
    import zarr

    return zarr.open_group(_zarr_store(place, mode), mode=mode, use_consolidated=consolidated)


def _is_free(place: Place, spec: Spec) -> bool:
    """Whether a store of this spec may be made here: nothing is there, or only what a creation cut short left."""
    path = place.local
    if path is not None:
        return not path.exists() or (path.is_dir() and not any(path.iterdir()))
    if place.exists(ROOT):
        return False
    ours = {MACHINES, TILES, *coordinates(spec)} | {variable.name for variable in spec.variables}
    for key in place.list_keys():
        if key.partition("/")[0] not in ours and not key.startswith(TRIAL):
            raise InputError(f"{place}: holds {key}, and is no atlas; choose another place or remove what is there")
    return True


def _create_locally(path: Path, spec: Spec, tile: tuple[int, ...], origin: Origin | None, run_id: str) -> None:
    building = path.parent / f".{path.name}.{uuid.uuid4().hex}.partial"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        build(building, spec, tile, origin, run_id)
        os.rename(building, path)
    finally:
        shutil.rmtree(building, ignore_errors=True)


def _create_remotely(place: Place, spec: Spec, tile: tuple[int, ...], origin: Origin | None, run_id: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        built = LocalPlace(Path(folder) / "store")
        build(built.path, spec, tile, origin, run_id)
        for key in built.list_keys():
            if key != ROOT:
                place.put(key, (built.path / key).read_bytes())
        if not place.put_new(ROOT, (built.path / ROOT).read_bytes()):
            raise InputError(f"{place}: another run has just made a store here; start this one again to join it")


def _check_replaceable(place: Place) -> None:
    """Try to put the root there is, if there is none: for want of a permission that is refused another way."""
    root = place.get(ROOT)
    if root:
        place.put_new(ROOT, root)


def _check_writable(place: Place) -> None:
    """Try it: permission bits do not say all. On a disk, in the nearest folder there is."""
    if place.local is None:
        trial = f"{TRIAL}{uuid.uuid4().hex}"
        place.put(trial, b"")
        place.remove(trial)
        return
    home = next(folder for folder in place.local.parents if folder.exists())
    with tempfile.TemporaryDirectory(prefix=f".{place.local.name}.", dir=home):
        pass
