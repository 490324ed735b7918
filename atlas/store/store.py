"""The store: an atlas as Zarr, on disk or at a URL, one tile one chunk of every array. The only file that writes it."""

import errno
import json
import os
import shutil
import tempfile
import uuid
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from atlas.errors import InputError, NetworkError, RunError
from atlas.spec.spec import Slices, Spec, differences
from atlas.store.digests import GROUP as TILES
from atlas.store.digests import PATH as DIGESTS
from atlas.store.digests import create_digests, write_digest
from atlas.store.location import LocalPlace, Place, place_of
from atlas.store.machine import Machine, this_machine
from atlas.store.schema import (
    BUDGET,
    DIMENSIONS,
    FORMAT,
    FORMAT_VERSION,
    Origin,
    coordinates,
    extra_sizes,
    root_attributes,
    variable_attributes,
)
from workers import SOLVER_VERSION
from workers.results import REGIME, Variable, result_variables

if TYPE_CHECKING:
    import xarray
    import zarr

READERS = 8
"""Tiles read at once: a disk or a network answers several as soon as one."""
ROOT = "zarr.json"
"""The object that makes a store one: before it there is none."""
TRIAL = ".trial-"
MACHINES = "machines"
"""The group of the machines that solved tiles, each an empty group with attributes."""


@dataclass(frozen=True)
class Header:
    """What a store says about itself: where it is, what it was made from and by which solver."""

    place: Place
    resolved: Mapping[str, Any]
    digest: str
    run_id: str
    solver_version: int
    tile: tuple[int, ...]
    origin: Origin | None = None

    @property
    def path(self) -> Path:
        """The store's folder; RunError where it lies at a URL."""
        if self.place.local is None:
            raise RunError(f"{self.place}: not a folder of this machine")
        return self.place.local

    @cached_property
    def spec(self) -> Spec:
        """The spec that the store was made from."""
        return Spec.from_resolved(self.resolved)


def create(
    store: str | os.PathLike[str] | Place,
    spec: Spec,
    tile: tuple[int, ...],
    origin: Origin | None = None,
    run_id: str = "",
) -> Header:
    """Make a whole store without a result: metadata, coordinates, attributes. It appears at once or not at all.

    On a disk a rename does that; at a URL the root's metadata do, which are put last and only if no other run has put
    them meanwhile. ``origin`` is the store that it is to take cells over from. Without a ``run_id`` one is drawn.
    """
    place = place_of(store)
    with _refused(place, "written"):
        if place.local is None:
            _create_remotely(place, spec, tile, origin, run_id)
        else:
            _create_locally(place.local, spec, tile, origin, run_id)
    return read_header(place)


def read_header(store: str | os.PathLike[str] | Place) -> Header:
    """The header of a store; InputError where there is none, or it is not ours, or of a format yet unknown.

    Where the disk or the server refused, its OSError is that InputError's cause. NetworkError where the server does
    not answer.
    """
    place = place_of(store)
    with _refused(place, "read"):
        return _read_header(place)


def _read_header(place: Place) -> Header:
    foreign = InputError(f"{place}: not an atlas (no {FORMAT} attributes)")
    if not (place.exists(ROOT) if place.local is None else place.local.exists()):
        raise InputError(f"{place}: no such store")
    attrs: dict[str, Any] = {}
    try:
        group = open_group(place, "r")
        attrs = dict(group.attrs)
        if attrs.get("format") != FORMAT:
            raise foreign
        found = attrs["format_version"]
        if found != FORMAT_VERSION:
            raise InputError(f"{place}: format version {found}, this program reads version {FORMAT_VERSION}")
        return Header(
            place=place,
            resolved=json.loads(attrs["spec"]),
            digest=attrs["digest"],
            run_id=attrs["run_id"],
            solver_version=attrs["solver_version"],
            tile=_array(group, REGIME.name).chunks,
            origin=Origin(attrs["origin"], attrs["origin_run_id"]) if "origin" in attrs else None,
        )
    except InputError:
        raise
    except (FileNotFoundError, NotADirectoryError, KeyError, TypeError, ValueError) as error:
        if attrs.get("format") == FORMAT:
            raise InputError(f"{place}: its metadata are damaged: {error}") from None
        raise foreign from None


def find(store: str | os.PathLike[str] | Place, spec: Spec) -> Header | None:
    """The header of a store that this spec may go on with, None where nothing is yet; InputError where it may not."""
    place = place_of(store)
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
    """Indices of the tiles that are finished: those whose regime chunk exists. One listing tells them."""
    root, grid = f"{REGIME.name}/c/", grid_of(header)
    found = (index_of(key.removeprefix(root), grid) for key in header.place.list_keys(root))
    return {index for index in found if index is not None}


def grid_of(header: Header) -> tuple[int, ...]:
    """Tiles along each dimension."""
    return tuple(-(-cells // tile) for cells, tile in zip(header.spec.shape, header.tile, strict=True))


def index_of(name: str, grid: tuple[int, ...]) -> tuple[int, ...] | None:
    """The index that a chunk's name, ``3/14``, stands for; None for one that a grid does not have, such as ``03/14``.

    Such names are what a killed write left behind, or nothing of ours.
    """
    parts = name.split("/")
    if len(parts) != len(grid) or not all(part.isascii() and part.isdigit() for part in parts):
        return None
    index = tuple(map(int, parts))
    canonical = list(map(str, index)) == parts
    return index if canonical and all(i < n for i, n in zip(index, grid, strict=True)) else None


def is_done(header: Header, index: tuple[int, ...]) -> bool:
    """Whether one tile is finished; ``done_tiles`` tells it of all."""
    return header.place.exists(chunk_key(REGIME, index))


def chunk_key(variable: Variable, index: tuple[int, ...]) -> str:
    """The key of a tile's chunk in a variable's array."""
    return "/".join([variable.name, "c", *map(str, index), *("0" for _ in variable.extra)])


def drop_tile(header: Header, index: tuple[int, ...]) -> None:
    """Make a tile unfinished, so that the next run solves it again. Its other chunks stay until they are rewritten."""
    header.place.remove(chunk_key(REGIME, index))


def write_tile(header: Header, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> None:
    """Write all arrays of one tile as whole chunks, ``regime`` last: with it the tile is done.

    A finished tile that is written again is unfinished meanwhile, so that a kill leaves no mixture of two solutions.
    """
    group = open_group(header.place, "r+")
    if group.attrs.get("run_id") != header.run_id:
        raise RunError(f"{header.place}: not the store of run {header.run_id}; is the path the same on all hosts?")
    record_machine(header, this_machine())
    if is_done(header, index):
        drop_tile(header, index)
    if BUDGET.name in group:
        array = _array(group, BUDGET.name)
        array[block(array, index)] = arrays.get(BUDGET.name, array.fill_value)
    write_digest(group, header.spec, index, arrays)
    for variable in result_variables(header.spec.settings):
        if variable.sparse and variable.name not in group:
            continue  # made before there was such a variable
        array = _array(group, variable.name)
        # A chunk of nothing but fill values is written too, so that a missing one is always a missing result.
        config = {"write_empty_chunks": not variable.sparse}
        array.with_config(config)[block(array, index)] = arrays[variable.name]


def record_machine(header: Header, machine: Machine) -> None:
    """Put a machine on the list of those that solved this store's tiles."""
    _recorded(header.place, header.run_id, machine)


@lru_cache(maxsize=64)  # once a process and store is enough
def _recorded(place: Place, run_id: str, machine: Machine) -> None:
    import zarr
    from zarr.errors import ContainsGroupError

    path = f"{MACHINES}/{machine.name}"
    if place.exists(f"{path}/{ROOT}"):
        return
    with suppress(ContainsGroupError):  # another worker of this kind of machine was faster
        zarr.create_group(_zarr_store(place, "r+"), path=path, zarr_format=3, attributes=dict(machine.facts))


def machines(header: Header) -> tuple[Machine, ...]:
    """The machines that solved tiles of this store, in no order; empty where no tile is written yet."""
    group: Any = open_group(header.place, "r")
    if MACHINES not in group:
        return ()
    return tuple(Machine(name, dict(entry.attrs)) for name, entry in group[MACHINES].groups())


def open_arrays(header: Header, consolidated: bool = False) -> dict[str, Any]:
    """All Zarr arrays of the store's root by name, results and coordinates, for reading.

    Each as its own metadata describe it, or as the root's consolidated copy does, which xarray goes by.
    """
    import zarr

    group = zarr.open_group(_zarr_store(header.place, "r"), mode="r", use_consolidated=consolidated)
    names = [variable.name for variable in (*result_variables(header.spec.settings), BUDGET)]
    return {name: group[name] for name in (*names, *coordinates(header.spec)) if name in group}


def open_digests(header: Header, consolidated: bool = False) -> Any | None:
    """The Zarr array of the digests of the tiles, None in a store made before there were any."""
    import zarr

    group = zarr.open_group(_zarr_store(header.place, "r"), mode="r", use_consolidated=consolidated)
    return _array(group, DIGESTS) if DIGESTS in group else None


def restore_coordinates(header: Header) -> None:
    """Write the coordinates again, from the spec."""
    group = open_group(header.place, "r+")
    for name, coordinate in coordinates(header.spec).items():
        _array(group, name)[...] = coordinate.values


def add_budget(header: Header) -> None:
    """Make room for cells that are given more than the spec's ``max_periods``; all others read as that number."""
    group = open_group(header.place, "r+")
    if BUDGET.name in group:
        return
    spec = header.spec
    group.create_array(
        BUDGET.name,
        shape=spec.shape,
        chunks=header.tile,
        dtype=BUDGET.dtype,
        fill_value=spec.settings.max_periods,
        dimension_names=spec.dims,
        compressors=codecs(),
        attributes=variable_attributes(BUDGET, spec),
    )
    _consolidate(group)


def open_atlas(store: str | os.PathLike[str]) -> "xarray.Dataset":
    """The atlas as an xarray Dataset, read from disk as it is used; InputError where the store is not an atlas.

    Reading a chunk of a finished tile that is missing or damaged raises ChunkError.
    """
    import xarray

    from atlas.overview.guard import GuardedStore

    header = read_header(store)
    place = header.place
    guarded: Any = GuardedStore(place, header.spec)
    opened = xarray.open_dataset(guarded, engine="zarr", chunks=None, consolidated=True)
    opened.encoding["source"] = str(place)  # by which a view finds the overviews
    return opened


def _zarr_store(place: Place, mode: str) -> Any:
    from atlas.store.remote import zarr_store  # with it Zarr, which takes a while to load

    return zarr_store(place, read_only=mode == "r")


def open_group(place: Place, mode: Literal["r", "r+"]) -> "zarr.Group":
    """The root group of a store, its metadata read anew."""
    import zarr

    return zarr.open_group(_zarr_store(place, mode), mode=mode, use_consolidated=False)


def _is_free(place: Place, spec: Spec) -> bool:
    """Whether a store of this spec may be made here: nothing is there, or only what a creation cut short left."""
    path = place.local
    if path is not None:
        return not path.exists() or (path.is_dir() and not any(path.iterdir()))
    if place.exists(ROOT):
        return False
    ours = {MACHINES, TILES, *coordinates(spec)} | {variable.name for variable in result_variables(spec.settings)}
    for key in place.list_keys():
        if key.partition("/")[0] not in ours and not key.startswith(TRIAL):
            raise InputError(f"{place}: holds {key}, and is no atlas; choose another place or remove what is there")
    return True


def _create_locally(path: Path, spec: Spec, tile: tuple[int, ...], origin: Origin | None, run_id: str) -> None:
    building = path.parent / f".{path.name}.{uuid.uuid4().hex}.partial"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _build(building, spec, tile, origin, run_id)
        os.rename(building, path)
    finally:
        shutil.rmtree(building, ignore_errors=True)


def _create_remotely(place: Place, spec: Spec, tile: tuple[int, ...], origin: Origin | None, run_id: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        built = LocalPlace(Path(folder) / "store")
        _build(built.path, spec, tile, origin, run_id)
        for key in built.list_keys():
            if key != ROOT:
                place.put(key, (built.path / key).read_bytes())
        if not place.put_new(ROOT, (built.path / ROOT).read_bytes()):
            raise InputError(f"{place}: another run has just made a store here; start this one again to join it")


def _build(path: Path, spec: Spec, tile: tuple[int, ...], origin: Origin | None, run_id: str) -> None:
    import zarr

    group = zarr.create_group(path, zarr_format=3, attributes=root_attributes(spec, origin, run_id))
    described = {"long_name": "processors and software that solved this atlas"}
    group.create_group(MACHINES, attributes=described)
    for name, coordinate in coordinates(spec).items():
        array = group.create_array(
            name,
            shape=coordinate.values.shape,
            chunks=coordinate.values.shape,
            dtype="str" if coordinate.values.dtype.kind == "T" else "float64",
            dimension_names=coordinate.dims,
            compressors=codecs(),
            attributes=coordinate.attributes,
        )
        array[...] = coordinate.values

    sizes = extra_sizes(spec)
    for variable in result_variables(spec.settings):
        extra = tuple(sizes[dim] for dim in variable.extra)
        group.create_array(
            variable.name,
            shape=spec.shape + extra,
            chunks=tuple(min(t, n) for t, n in zip(tile, spec.shape, strict=True)) + extra,
            dtype=variable.dtype,
            fill_value=variable.fill,
            dimension_names=spec.dims + tuple(DIMENSIONS.get(dim, dim) for dim in variable.extra),
            compressors=codecs(),
            attributes=variable_attributes(variable, spec),
        )
    create_digests(group, spec, tuple(-(-n // t) for n, t in zip(spec.shape, tile, strict=True)), codecs())
    _consolidate(group)


def _consolidate(group: "zarr.Group") -> None:
    import zarr

    with warnings.catch_warnings():
        # Zarr warns that consolidated metadata are an extension; xarray warns where they are missing.
        warnings.filterwarnings("ignore", message="Consolidated metadata")
        zarr.consolidate_metadata(group.store)


def codecs() -> list[Any]:
    """How every chunk is packed."""
    from zarr.codecs import Crc32cCodec, ZstdCodec

    return [ZstdCodec(), Crc32cCodec()]  # writes are atomic but not synced: the checksum finds a torn chunk


def _array(group: "zarr.Group", name: str) -> Any:
    return group[name]


def block(array: Any, index: tuple[int, ...]) -> Slices:
    """The cells of a tile in an array, from the array's own chunks, so that no write can be misaligned."""
    return tuple(slice(i * c, min((i + 1) * c, n)) for i, c, n in zip(index, array.chunks, array.shape, strict=False))


def _check_replaceable(place: Place) -> None:
    """Try to put the root there is, if there is none: for want of a permission that is refused another way."""
    root = place.get(ROOT)
    if root:
        place.put_new(ROOT, root)


def _check_writable(place: Place) -> None:
    """Try it: a trial tells more than permission bits do. On a disk, in the nearest folder there is."""
    if place.local is None:
        trial = f"{TRIAL}{uuid.uuid4().hex}"
        place.put(trial, b"")
        place.remove(trial)
        return
    home = next(folder for folder in place.local.parents if folder.exists())
    with tempfile.TemporaryDirectory(prefix=f".{place.local.name}.", dir=home):
        pass
