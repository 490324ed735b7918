"""The schema of a store: how its coordinates, attributes and arrays are created."""

import json
import uuid
import warnings
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from atlas.spec.points import POINT
from atlas.spec.spec import Spec
from atlas.store.host import package_version
from atlas.store.origin import Origin
from atlas.store.tiling import Tiling, part_side
from workers import SOLVER_VERSION
from workers.model.parameter import Parameter
from workers.results import (
    APERIODIC,
    CHAOTIC,
    FAILED,
    INVALID,
    LOCKING,
    NO_IMPACT,
    PENDING,
    PERIODIC,
    QUASIPERIODIC,
    REGIME,
    UNDETERMINED,
    Variable,
)

if TYPE_CHECKING:
    import zarr

FORMAT = "impact-atlas"
FORMAT_VERSION = 2
"""The only version of the format that this program reads."""
OVERVIEWS = "overviews"
"""Name of the group of the overview levels."""
LARGEST_CHUNK = 2**31 - 1
"""Maximum size of a chunk, in bytes, that the codecs of a store accept."""
ZOOM = "zoom"
"""Name of the group of explored cells, see ``store.zoom``."""
COMPONENT = "component"
REGIME_COLORS = {
    PENDING: "#ffffff", NO_IMPACT: "#dddddd", PERIODIC: "#4477aa", QUASIPERIODIC: "#228833", CHAOTIC: "#cc3311",
    UNDETERMINED: "#b2aa62", INVALID: "#777777", FAILED: "#000000", APERIODIC: "#f8f0d0", LOCKING: "#72829a",
}  # fmt: skip
"""Colour of each regime code in pictures."""
DIMENSIONS = {"state": COMPONENT}
"""New names of dimensions: xarray treats a variable with the name of one of its dimensions as a coordinate."""


class StoredArray(NamedTuple):
    """An array that is stored in one chunk: a coordinate, or a column of a table."""

    values: Any
    dims: tuple[str, ...]
    attributes: dict[str, Any]


def coordinate_names(spec: Spec) -> list[str]:
    """Return the names of ``coordinates``."""
    cells = [POINT, *spec.points] if spec.points else [axis.name for axis in spec.axes]
    return [*cells, *spec.parameters, COMPONENT]


def coordinates(spec: Spec) -> dict[str, StoredArray]:
    """Return the coordinates by name.

    They are the axes, or the rows and columns of a table of points; the fixed parameters; the names of the states.
    """
    record = spec.system_def
    names: dict[str, Any] = {"long_name": "component of the physical section state"}
    if spec.points:
        rows: dict[str, Any] = {"long_name": "row of the table of points, from 0 on", "units": "1"}
        cells = {POINT: StoredArray(np.arange(spec.shape[0]), (POINT,), rows)}
        columns = {name: np.array(values) for name, values in spec.points.items()}
        cells |= {n: StoredArray(v, (POINT,), _described(record.parameter(n))) for n, v in columns.items()}
    else:
        cells = {
            axis.name: StoredArray(np.array(axis.values), (axis.name,), _described(record.parameter(axis.name)))
            for axis in spec.axes
        }
    fixed = {
        name: StoredArray(np.float64(value), (), _described(record.parameter(name)))
        for name, value in spec.parameters.items()
    }
    return cells | fixed | {COMPONENT: StoredArray(np.array(record.states, dtype="T"), (COMPONENT,), names)}


def root_attributes(spec: Spec, origin: Origin | None, run_id: str = "") -> dict[str, Any]:
    """Return the attributes of a store's root; a run identifier is drawn if ``run_id`` is empty.

    There are at least ten attributes, so a notebook shows them folded, and the spec does not fill the screen.
    """
    packages = ("impact-atlas", "numpy", "scipy", "numba", "zarr", "xarray", "dask")
    references = {"references": spec.system_def.source} if spec.system_def.source else {}
    return {
        "Conventions": "CF-1.11",
        "title": f"Impact atlas: {spec.system_def.title}",
        "source": f"impact-atlas {package_version('impact-atlas')}, solver version {SOLVER_VERSION}",
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "solver_version": SOLVER_VERSION,
        "run_id": run_id or uuid.uuid4().hex,
        "digest": spec.digest,
        # As text, since netCDF attributes cannot nest.
        "spec": json.dumps(spec.outline()),
        "software": "; ".join(f"{package} {package_version(package)}" for package in packages),
        **references,
        **(origin.attributes() if origin else {}),
    }


def variable_attributes(variable: Variable, fixed: Iterable[str] = ()) -> dict[str, Any]:
    """Return the CF attributes of a result variable; ``fixed`` names the coordinates that are not axes."""
    attributes: dict[str, Any] = {"long_name": variable.long_name, "units": variable.units}
    if variable.codes:
        attributes["flag_values"] = [code.code for code in variable.codes]
        attributes["flag_meanings"] = " ".join(code.name for code in variable.codes)
    if variable.name == REGIME.name:
        attributes["flag_colors"] = " ".join(REGIME_COLORS[code.code] for code in variable.codes)
    if named := " ".join(fixed):
        attributes["coordinates"] = named
    return attributes


def create_whole(group: "zarr.Group", name: str, stored: StoredArray) -> None:
    """Create an array of one chunk with its values, replacing an existing one."""
    values, dims, attributes = stored
    array: Any = group.create_array(
        name,
        shape=values.shape,
        chunks=tuple(max(1, size) for size in values.shape),
        dtype="str" if values.dtype.kind == "T" else values.dtype,
        dimension_names=dims,
        compressors=codecs(),
        attributes=attributes,
        overwrite=True,
    )
    if values.size:
        array.with_config({"write_empty_chunks": True})[...] = values


def create_variable(group: "zarr.Group", variable: Variable, spec: Spec, tiling: Tiling) -> None:
    """Create the array of a result with one object per tile: a chunk, or for a large tile a shard of smaller chunks."""
    extra = tuple(spec.extra_sizes[dim] for dim in variable.extra_dims)
    part = tuple(map(part_side, tiling.tile))
    group.create_array(
        variable.name,
        shape=tiling.shape + extra,
        chunks=part + extra,
        shards=tiling.tile + extra if part != tiling.tile else None,
        dtype=variable.dtype,
        fill_value=variable.fill,
        dimension_names=spec.dims + tuple(DIMENSIONS.get(dim, dim) for dim in variable.extra_dims),
        compressors=codecs(),
        attributes=variable_attributes(variable, [*spec.parameters, *spec.points]),
    )


def consolidate(group: "zarr.Group", path: str = "") -> None:
    """Copy the metadata of all arrays below a group into the metadata of the group: xarray reads no others."""
    import zarr

    with warnings.catch_warnings():
        # Zarr warns that consolidated metadata are an extension; xarray warns where they are missing.
        warnings.filterwarnings("ignore", message="Consolidated metadata")
        warnings.filterwarnings("ignore", message="Object at parts is not")  # parts of an unfinished search
        zarr.consolidate_metadata(group.store, path=path or None)


def codecs() -> list[Any]:
    """Return the codecs of every chunk."""
    from zarr.codecs import Crc32cCodec, ZstdCodec

    return [ZstdCodec(), Crc32cCodec()]  # the checksum finds a chunk that a disk has damaged


def _described(parameter: Parameter) -> dict[str, Any]:
    return {"long_name": parameter.meaning, "units": parameter.unit, "symbol": parameter.symbol}
