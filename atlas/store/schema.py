"""The schema of a store: the attributes and arrays that follow from the spec of an atlas, as objects with keys and
bytes.

``layout`` gives all metadata and coordinates of a store as bytes. Creation writes them, a verification compares them,
and a repair writes the different ones. They all follow from the attributes of the root, among them the spec. The
attributes are stored twice, with the root and with the group ``spec``, so that either copy restores the other.
"""

import json
import uuid
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from atlas.errors import REPACK_HINT
from atlas.spec.points import POINT
from atlas.spec.resolved import pack_axes
from atlas.spec.spec import Spec
from atlas.store.backend import StoreBackend
from atlas.store.host import HOSTS, package_version
from atlas.store.metadata import (
    CRC32C,
    ROOT,
    Node,
    array_node,
    encode_node,
    encode_whole,
    group_node,
    members_of,
    sealed,
)
from atlas.store.origin import Origin, budget_variables
from atlas.store.record_format import RECORDS, TILES, record_node
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
    REGULAR,
    UNDETERMINED,
    Variable,
)

FORMAT = "impact-atlas"
FORMAT_VERSION = 3
"""The only version of the store's format that this program reads. It rises whenever ``layout`` gives other bytes."""
SPEC_KEY = f"spec/{ROOT}"
"""Key of the object with a second copy of the root's attributes, the metadata of the group ``spec``."""
OVERVIEWS = "overviews"
"""Name of the group of the overviews, coarser copies of the atlas."""
CURVES, ATTRACTORS, LABELS, STABILITY = "curves", "attractors", "labels", "stability"
"""Names of the groups: curves of a plane; the attractors of an atlas of basins; labels of coexisting attractors;
stability measures of cells. All but the first are tables.
"""
PARTS = "searches/parts"
"""Path in the store under which intermediate results of searches in progress are kept; an array without values."""
TABLES = (ATTRACTORS, LABELS, STABILITY)
LARGEST_CHUNK = 2**31 - 1
"""Maximum size of a chunk, in bytes, that the codecs of a store accept."""
COMPONENT = "component"
REGIME_COLORS = {
    PENDING: "#ffffff", NO_IMPACT: "#dddddd", PERIODIC: "#4477aa", QUASIPERIODIC: "#228833", CHAOTIC: "#cc3311",
    UNDETERMINED: "#b2aa62", INVALID: "#777777", FAILED: "#000000", APERIODIC: "#f8f0d0", LOCKING: "#72829a",
    REGULAR: "#f5e63c",
}  # fmt: skip
"""Colour of each regime code in pictures."""
DIMENSIONS = {"state": COMPONENT}
"""New names of dimensions that would have the name of a variable, which xarray would treat as a coordinate."""


class StoredArray(NamedTuple):
    """An array that is stored in one chunk: a coordinate, or a column of a table.

    values      its values
    dims        names of its dimensions
    attributes  its attributes in the store
    """

    values: Any
    dims: tuple[str, ...]
    attributes: dict[str, Any]


def coordinate_names(spec: Spec) -> list[str]:
    """Return the names of the coordinates of an atlas, see ``coordinates``."""
    cells = [POINT, *spec.points] if spec.points else [axis.name for axis in spec.axes]
    return [*cells, *spec.parameters, COMPONENT]


def coordinates(spec: Spec) -> dict[str, StoredArray]:
    """Return the coordinate arrays of an atlas by name.

    They are the axes, or the rows and columns of a table of points; the fixed parameters; and the names of the states.
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


def root_attributes(spec: Spec, tile: tuple[int, ...], origin: Origin | None, run_id: str = "") -> dict[str, Any]:
    """Return the attributes of a new store's root. If ``run_id`` is empty, a new identifier of the run is drawn.

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
        "spec": json.dumps(pack_axes(spec.to_resolved())),
        "tile": json.dumps(list(map(min, tile, spec.shape))),
        "software": "; ".join(f"{package} {package_version(package)}" for package in packages),
        **references,
        **(origin.attributes() if origin else {}),
    }


def layout_nodes(spec: Spec, tile: tuple[int, ...], retried: bool) -> dict[str, Node]:
    """Return the Zarr metadata of all arrays and groups of a new store, by path, except the root and ``spec``.

    spec     spec of the atlas
    tile     cells of a tile along each dimension
    retried  True if a retry makes the store, which then has budgets of cells
    """
    tiling = Tiling(spec.shape, tile)
    nodes: dict[str, Node] = {name: whole_node(array, (CRC32C,)) for name, array in coordinates(spec).items()}
    nodes |= {v.name: _variable_node(v, spec, tiling) for v in (*spec.variables, *retried * budget_variables(spec))}
    nodes[HOSTS] = group_node({"long_name": "processors and software that solved this atlas"})
    nodes[TILES] = group_node({})
    nodes[PARTS.partition("/")[0]] = group_node({"long_name": "searches in progress"})
    nodes[PARTS] = array_node(
        (0,), "uint8", ("byte",), {"long_name": "finished parts, which lie in this folder", "units": "1"}
    )
    return nodes | {RECORDS: record_node(spec.variables, spec.dims, tiling.grid)}


def layout(attributes: Mapping[str, Any], spec: Spec) -> dict[str, bytes]:
    """Return all metadata and coordinates of a new store, by key, from the attributes of its root.

    ``spec`` is the spec in these attributes.
    """
    nodes = layout_nodes(spec, tuple(json.loads(attributes["tile"])), "origin_retry" in attributes)
    objects = {f"{path}/{ROOT}": encode_node(node) for path, node in nodes.items()}
    chunks = {chunk_of_whole(name, array): encode_whole(array.values) for name, array in coordinates(spec).items()}
    return {ROOT: sealed(attributes, nodes), SPEC_KEY: sealed(attributes), **objects, **chunks}


def root_with_groups(attributes: Mapping[str, Any], nodes: Mapping[str, Node], groups: Mapping[str, bytes]) -> bytes:
    """Return the metadata of a root, as bytes, with copies of the metadata of the arrays and groups of a store.

    attributes  attributes of the root
    nodes       metadata of the arrays and groups that every store has, by path
    groups      stored metadata of further groups by name, such as tables; xarray opens a group by its copy in the root
    """
    members = dict(nodes)
    for name, data in groups.items():
        metadata = json.loads(data)
        members[name] = {key: metadata[key] for key in ("zarr_format", "node_type", "attributes")}
        members |= {f"{name}/{path}": node for path, node in members_of(data).items()}
    return sealed(attributes, members)


def groups_of(spec: Spec) -> tuple[str, ...]:
    """Return the names of the groups that a store with this spec may have besides overviews."""
    return (CURVES, STABILITY, *[ATTRACTORS] * spec.basins, *[LABELS] * spec.coexistence)


def whole_node(stored: StoredArray, codecs: Iterable[Node]) -> dict[str, Any]:
    """Return the Zarr metadata of an array that is stored in one chunk; ``codecs`` apply after its encoding as
    bytes.
    """
    values, dims, attributes = stored
    dtype = "string" if values.dtype.kind == "T" else values.dtype.name
    return array_node(values.shape, dtype, dims, attributes, codecs=codecs)


def chunk_of_whole(path: str, stored: StoredArray) -> str:
    """Return the key of the only chunk of an array that is stored in one chunk."""
    return "/".join([path, "c", *("0" for _ in stored.values.shape)])


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


def remedy(backend: StoreBackend) -> str:
    """Return text for a message: how to restore missing, damaged or wrong metadata of a store."""
    return REPACK_HINT if str(backend).lower().endswith(".zip") else f"atlas verify --repair {backend} restores them"


def _variable_node(variable: Variable, spec: Spec, tiling: Tiling) -> dict[str, Any]:
    """Return the Zarr metadata of a result variable, which has one object per tile.

    The object is a chunk, or for a large tile a shard with several chunks.
    """
    extra = tuple(spec.extra_sizes[dim] for dim in variable.extra_dims)
    return array_node(
        tiling.shape + extra,
        variable.dtype,
        spec.dims + tuple(DIMENSIONS.get(dim, dim) for dim in variable.extra_dims),
        variable_attributes(variable, [*spec.parameters, *spec.points]),
        fill=variable.fill,
        block=tiling.tile + extra,
        chunk=tuple(map(part_side, tiling.tile)) + extra,
    )


def _described(parameter: Parameter) -> dict[str, Any]:
    return {"long_name": parameter.meaning, "units": parameter.unit, "symbol": parameter.symbol}
