"""The store: an atlas on disk as Zarr, one tile one chunk of every array. The only file that writes it."""

import json
import os
import shutil
import tempfile
import uuid
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from atlas.errors import InputError, RunError
from atlas.spec import Slices, Spec
from workers import SOLVER_VERSION
from workers.results import REGIME, REGIMES, Variable, result_variables
from workers.system import Parameter

if TYPE_CHECKING:
    import xarray
    import zarr

FORMAT = "impact-atlas"
FORMAT_VERSION = 1
DIMENSIONS = {"state": "component"}
"""Dimensions that cannot keep their name: xarray takes a variable named like one of its dimensions for a coordinate."""

BUDGET = Variable("budget", "int32", 0, "forcing periods that the cell may cost; as in the spec unless retried", "1")
"""Only in stores where cells were solved again with more than the spec's ``max_periods``, which fills it."""


@dataclass(frozen=True)
class Header:
    """What a store says about itself: where it is, what it was made from and by which solver."""

    path: Path
    resolved: Mapping[str, Any]
    digest: str
    run_id: str
    solver_version: int
    tile: tuple[int, ...]

    @cached_property
    def spec(self) -> Spec:
        """The spec that the store was made from."""
        return Spec.from_resolved(self.resolved)


def create(path: Path, spec: Spec, tile: tuple[int, ...]) -> Header:
    """Make a whole store without a result: metadata, coordinates, attributes. It appears at once or not at all."""
    path = path.absolute()
    building = path.parent / f".{path.name}.{uuid.uuid4().hex}.partial"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _build(building, spec, tile)
        os.rename(building, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(building, ignore_errors=True)
    return read_header(path)


def read_header(path: Path) -> Header:
    """The header of a store; InputError where there is none, or it is not ours, or of a format yet unknown."""
    import zarr

    path = path.absolute()
    if not path.exists():
        raise InputError(f"{path}: no such store")
    foreign = InputError(f"{path}: not an atlas (no {FORMAT} attributes)")
    try:
        group = zarr.open_group(path, mode="r", use_consolidated=False)
        attrs: dict[str, Any] = dict(group.attrs)
        if attrs.get("format") != FORMAT:
            raise foreign
        found = attrs["format_version"]
        if found != FORMAT_VERSION:
            raise InputError(f"{path}: format version {found}, this program reads version {FORMAT_VERSION}")
        return Header(
            path=path,
            resolved=json.loads(attrs["spec"]),
            digest=attrs["digest"],
            run_id=attrs["run_id"],
            solver_version=attrs["solver_version"],
            tile=_array(group, REGIME.name).chunks,
        )
    except InputError:
        raise
    except (OSError, KeyError, TypeError, ValueError):
        raise foreign from None


def find(path: Path, spec: Spec) -> Header | None:
    """The header of a store that this spec may go on with, None where nothing is yet; InputError where it may not."""
    try:
        if not path.exists() or (path.is_dir() and not any(path.iterdir())):
            _check_writable(path)
            return None
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    header = read_header(path)
    if header.solver_version != SOLVER_VERSION:
        raise InputError(
            f"{path}: made by solver version {header.solver_version}, this is version {SOLVER_VERSION}; "
            "their numbers do not mix: choose another path"
        )
    if header.spec.digest != spec.digest:
        raise InputError(f"{path}: is of another spec: {'; '.join(differences(header.spec, spec))}")
    if not os.access(path, os.W_OK):
        raise InputError(f"{path}: cannot be written: Permission denied")
    return header


def differences(stored: Spec, given: Spec) -> list[str]:
    """In what two specs differ, each in a few words."""
    found = []
    if stored.system != given.system:
        found.append(f"system {stored.system} in the store, {given.system} in the spec")
    names, wanted = [axis.name for axis in stored.axes], [axis.name for axis in given.axes]
    if names != wanted:
        what = "axis order differs" if sorted(names) == sorted(wanted) else "axes differ"
        found.append(f"{what}: ({', '.join(names)}) in the store, ({', '.join(wanted)}) in the spec")
    else:
        pairs = zip(stored.axes, given.axes, strict=True)
        found += [f"axis {old} in the store, {new} in the spec" for old, new in pairs if old.values != new.values]
    for before, after in (
        (stored.parameters, given.parameters),
        (stored.resolved()["solve"], given.resolved()["solve"]),
    ):
        common = before.keys() & after.keys()
        found += [
            f"{name} = {before[name]!r} in the store, {after[name]!r} in the spec"
            for name in before
            if name in common and before[name] != after[name]
        ]
    return found


def done_tiles(header: Header) -> set[tuple[int, ...]]:
    """Indices of the tiles that are finished: those whose regime chunk exists."""
    root = header.path / REGIME.name / "c"
    found = set()
    for folder, _, files in os.walk(root):
        above = Path(folder).relative_to(root).parts
        # A name that is not a number is what a killed write left behind.
        found |= {tuple(map(int, (*above, name))) for name in files if name.isdigit()}
    return found


def write_tile(header: Header, index: tuple[int, ...], arrays: Mapping[str, np.ndarray]) -> None:
    """Write all arrays of one tile as whole chunks, ``regime`` last: with it the tile is done.

    A finished tile that is written again is unfinished meanwhile, so that a kill leaves no mixture of two solutions.
    """
    import zarr

    group = zarr.open_group(header.path, mode="r+", use_consolidated=False)
    if group.attrs.get("run_id") != header.run_id:
        raise RunError(f"{header.path}: not the store of run {header.run_id}; is the path the same on all hosts?")
    if is_done(header, index):
        regime = _array(group, REGIME.name)
        regime.with_config({"write_empty_chunks": False})[_block(regime, index)] = REGIME.fill  # removes the chunk
    if BUDGET.name in group:
        array = _array(group, BUDGET.name)
        array[_block(array, index)] = arrays.get(BUDGET.name, array.fill_value)
    for variable in result_variables(header.spec.settings):
        array = _array(group, variable.name)
        # A chunk of nothing but fill values is written too, so that a missing one is always a missing result.
        array.with_config({"write_empty_chunks": True})[_block(array, index)] = arrays[variable.name]


def is_done(header: Header, index: tuple[int, ...]) -> bool:
    """Whether one tile is finished; ``done_tiles`` tells it of all."""
    return header.path.joinpath(REGIME.name, "c", *map(str, index)).exists()


def read_tile(header: Header, index: tuple[int, ...], names: Iterable[str] | None = None) -> dict[str, np.ndarray]:
    """Arrays of one tile: those named, or all of them and ``budget``, the forcing periods that each cell may cost."""
    import zarr

    group = zarr.open_group(header.path, mode="r", use_consolidated=False)
    found = {}
    for name in names or [v.name for v in (*result_variables(header.spec.settings), BUDGET)]:
        if name == BUDGET.name and name not in group:
            regime = _array(group, REGIME.name)
            shape = tuple(part.stop - part.start for part in _block(regime, index))
            found[name] = np.full(shape, header.spec.settings.max_periods, BUDGET.dtype)
        else:
            array = _array(group, name)
            found[name] = np.asarray(array[_block(array, index)])
    return found


def add_budget(header: Header) -> None:
    """Make room for cells that are given more than the spec's ``max_periods``; all others read as that number."""
    import zarr

    group = zarr.open_group(header.path, mode="r+", use_consolidated=False)
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
        compressors=_codecs(),
        attributes=_variable_attributes(BUDGET, spec),
    )
    _consolidate(group)


def regime_counts(header: Header, tiles: Iterable[tuple[int, ...]]) -> dict[str, int]:
    """Cells of each regime in these tiles, as stored; regimes that do not occur are left out."""
    import zarr

    array = _array(zarr.open_group(header.path, mode="r", use_consolidated=False), REGIME.name)
    totals = {regime.code: 0 for regime in REGIMES}
    for index in tiles:
        codes, counts = np.unique(array[_block(array, index)], return_counts=True)
        for code, count in zip(codes.tolist(), counts.tolist(), strict=True):
            totals[code] += count
    return {regime.name: totals[regime.code] for regime in REGIMES if totals[regime.code]}


def open_atlas(store: str | os.PathLike[str]) -> "xarray.Dataset":
    """The atlas as an xarray Dataset, read from disk as it is used; InputError where the store is not an atlas."""
    import xarray

    header = read_header(Path(store))
    return xarray.open_dataset(header.path, engine="zarr", chunks=None, consolidated=True)


def _build(path: Path, spec: Spec, tile: tuple[int, ...]) -> None:
    import zarr

    group = zarr.create_group(path, zarr_format=3, attributes=_root_attributes(spec))
    record = spec.record
    for axis in spec.axes:
        _put(group, axis.name, np.array(axis.values), (axis.name,), _described(record.parameter(axis.name)))
    for name, value in spec.parameters.items():
        _put(group, name, np.float64(value), (), _described(record.parameter(name)))
    names: dict[str, Any] = {"long_name": "component of the physical section state"}
    _put(group, "component", np.array(record.states, dtype="T"), ("component",), names)

    sizes = {"exponent": len(record.states), "state": len(record.states), "sample": spec.settings.section_samples}
    for variable in result_variables(spec.settings):
        extra = tuple(sizes[dim] for dim in variable.extra)
        group.create_array(
            variable.name,
            shape=spec.shape + extra,
            chunks=tuple(min(t, n) for t, n in zip(tile, spec.shape, strict=True)) + extra,
            dtype=variable.dtype,
            fill_value=variable.fill,
            dimension_names=spec.dims + tuple(DIMENSIONS.get(dim, dim) for dim in variable.extra),
            compressors=_codecs(),
            attributes=_variable_attributes(variable, spec),
        )
    _consolidate(group)


def _consolidate(group: "zarr.Group") -> None:
    import zarr

    with warnings.catch_warnings():
        # Zarr warns that consolidated metadata are an extension; xarray warns where they are missing.
        warnings.filterwarnings("ignore", message="Consolidated metadata")
        zarr.consolidate_metadata(group.store)


def _put(group: "zarr.Group", name: str, value: Any, dims: tuple[str, ...], attributes: dict[str, Any]) -> None:
    """Write a coordinate whole, in one chunk."""
    array = group.create_array(
        name,
        shape=value.shape,
        chunks=value.shape,
        dtype="str" if value.dtype.kind == "T" else "float64",
        dimension_names=dims,
        compressors=_codecs(),
        attributes=attributes,
    )
    array[...] = value


def _codecs() -> list[Any]:
    from zarr.codecs import Crc32cCodec, ZstdCodec

    return [ZstdCodec(), Crc32cCodec()]  # writes are atomic but not synced: the checksum finds a torn chunk


def _root_attributes(spec: Spec) -> dict[str, Any]:
    packages = ("impact-atlas", "numpy", "scipy", "numba", "zarr", "xarray", "dask")
    return {
        "Conventions": "CF-1.11",
        "title": f"Impact atlas: {spec.record.title}",
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "solver_version": SOLVER_VERSION,
        "run_id": uuid.uuid4().hex,
        "digest": spec.digest,
        # As text, since netCDF attributes cannot nest.
        "spec": json.dumps(spec.resolved()),
        "software": "; ".join(f"{package} {_version(package)}" for package in packages),
    }


def _variable_attributes(variable: Variable, spec: Spec) -> dict[str, Any]:
    attributes: dict[str, Any] = {"long_name": variable.long_name, "units": variable.units}
    if variable.name == REGIME.name:
        attributes["flag_values"] = [regime.code for regime in REGIMES]
        attributes["flag_meanings"] = " ".join(regime.name for regime in REGIMES)
        attributes["flag_colors"] = " ".join(regime.color for regime in REGIMES)
    if spec.parameters:
        attributes["coordinates"] = " ".join(spec.parameters)
    return attributes


def _described(parameter: Parameter) -> dict[str, Any]:
    return {"long_name": parameter.meaning, "units": parameter.unit, "symbol": parameter.symbol}


def _array(group: "zarr.Group", name: str) -> Any:
    return group[name]


def _block(array: Any, index: tuple[int, ...]) -> Slices:
    """The cells of a tile in an array, from the array's own chunks, so that no write can be misaligned."""
    return tuple(slice(i * c, min((i + 1) * c, n)) for i, c, n in zip(index, array.chunks, array.shape, strict=False))


def _check_writable(path: Path) -> None:
    """Try the nearest folder there is: a trial tells more than permission bits do."""
    home = next(folder for folder in path.absolute().parents if folder.exists())
    with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=home):
        pass


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
