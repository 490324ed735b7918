"""Checks of a store's metadata and coordinates against its spec, and of metadata against their copies."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from atlas.errors import ChunkError, message_of
from atlas.overview.pyramid import Pyramid
from atlas.spec.resolved import resolved_digest
from atlas.spec.spec import Spec
from atlas.store.groups import CURVES, TABLES
from atlas.store.host import HOSTS
from atlas.store.metadata_backup import form_fault, without_consolidated
from atlas.store.record_format import RECORD, TILES
from atlas.store.schema import OVERVIEWS
from atlas.store.store import ROOT, AtlasStore, arrays_by, open_arrays, read_array_nodes
from atlas.store.tiles import covered_variables, object_shape


def metadata_faults(handle: AtlasStore) -> list[str]:
    """Return contradictions between a store's metadata and its spec, or within its metadata, a short line each."""
    spec = handle.spec
    faults = []
    try:
        if resolved_digest(handle.resolved) != handle.digest:
            faults.append(f"{ROOT}: the digest does not match the spec")
    except ChunkError as error:
        return [_values_fault(key, fault) for key, fault in error.faults.items()]
    if handle.outline["axes"]:
        ends = [axis.outline() for axis in Spec.from_resolved(handle.resolved).axes]
        faults += [
            f"{ROOT}: axis {a['name']} differs from its coordinate" for a in handle.outline["axes"] if a not in ends
        ]
    try:
        own, copied = arrays_by(handle, read_array_nodes(handle, handle.array_names)), arrays_by(handle, handle.nodes)
    except ChunkError as error:
        return [*faults, *error.lines]
    sizes, variables = spec.extra_sizes, handle.variables
    shapes = {name: coordinate.values.shape for name, coordinate in handle.coordinates.items()}
    shapes |= {v.name: spec.shape + tuple(sizes[dim] for dim in v.extra_dims) for v in variables}
    for name in [*shapes, *(own.keys() | copied.keys()) - shapes.keys()]:
        where = f"{name}/{ROOT}"
        if name not in own:
            faults.append(f"{where} is missing")
        elif name in shapes and own[name].shape != shapes[name]:
            faults.append(f"{where}: shape {own[name].shape}, must be {shapes[name]}")
        elif name not in copied or str(copied[name].metadata.to_dict()) != str(own[name].metadata.to_dict()):
            faults.append(f"{ROOT}: its consolidated metadata differ from those of {where}")
    groups = (TILES, HOSTS, OVERVIEWS, CURVES, *TABLES)  # copies of dropped groups may remain
    tops = {name.partition("/")[0] for name in handle.nodes}.difference(handle.array_names, groups)
    lost = sorted(top for top in tops if not handle.backend.exists(f"{top}/{ROOT}"))
    faults += [f"{ROOT} has consolidated metadata of {top}, which is not in the store" for top in lost]
    try:
        covered_variables(handle, handle.record["attributes"])
    except KeyError as error:
        faults.append(f"{RECORD}/{ROOT}: covers {error}, which the store does not have")
    for variable in variables:
        array = own.get(variable.name)
        if array is None:
            continue
        where = f"{variable.name}/{ROOT}"
        stored = object_shape(array)
        if (array.dtype, stored[: len(handle.tile)]) != (np.dtype(variable.dtype), handle.tile):
            layout = f"{array.dtype} in chunks of {stored}"
            faults.append(f"{where}: {layout}, must be {variable.dtype} in tiles of {handle.tile}")
        if not np.array_equal(array.fill_value, variable.fill, equal_nan=np.dtype(variable.dtype).kind == "f"):
            faults.append(f"{where}: fill value {array.fill_value}, must be {variable.fill}")
    return faults


def _values_fault(key: str, fault: str) -> str:
    """Return the fault of values from which the spec is read: the values of an axis, or the root itself."""
    if key == ROOT:
        return f"{ROOT}: the digest does not match the spec"
    return f"coordinate {key} {fault}: it cannot be computed again"


def copy_faults(handle: AtlasStore) -> dict[str, dict[str, Any]]:
    """Return copies of metadata that differ from their originals, by the keys of the originals.

    The root, every level of an overview and every table hold copies of the metadata of their members. Among the copies
    of the root, those of arrays are left to ``metadata_faults``, and those of groups that no longer exist are ignored.
    A level or a table also counts as different if its copies and those of the root are of different arrays.
    """
    different: dict[str, dict[str, Any]] = {}
    for where in ("", *(key.removesuffix(ROOT) for key in _groups_with_copies(handle))):
        group = _json(handle, f"{where}{ROOT}")
        copies = _copies_in(group)
        known = {name.removeprefix(where) for name in handle.nodes if where and name.startswith(where)}
        if group is not None and ((known and known != copies.keys()) or form_fault(group)):
            different[f"{where}{ROOT}"] = group
            continue
        for name, copy in copies.items():
            top = f"{where}{name}".partition("/")[0]
            if not where and "/" not in name and copy.get("node_type") == "array":
                continue
            if not handle.backend.exists(f"{top}/{ROOT}") and top not in (TILES, HOSTS):
                continue
            own = _json(handle, f"{where}{name}/{ROOT}")
            if not _same(own, copy, late="complete" if name == OVERVIEWS else ""):
                different[f"{where}{name}/{ROOT}"] = copy
    return different


def _copies_in(group: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """Return the copies of metadata within the metadata of a group, by path; empty if they cannot be read."""
    copies = (group or {}).get("consolidated_metadata")
    nodes = copies.get("metadata") if isinstance(copies, dict) else None
    return nodes if isinstance(nodes, dict) and all(isinstance(node, dict) for node in nodes.values()) else {}


def _groups_with_copies(handle: AtlasStore) -> list[str]:
    """Return the keys of the metadata of tables and of levels of overviews."""
    levels = [f"{OVERVIEWS}/{level}/{ROOT}" for level in range(1, Pyramid(handle).levels.count + 1)]
    tables = (f"{table}/{ROOT}" for table in TABLES if table not in handle.array_names)  # ``attractors`` is both
    return [key for key in (*tables, *levels) if handle.backend.exists(key)]


def _json(handle: AtlasStore, key: str) -> dict[str, Any] | None:
    """Return stored metadata; None if they are missing or cannot be read."""
    try:
        metadata = json.loads(handle.backend.get(key) or b"")
    except (ValueError, RecursionError):
        return None
    return metadata if isinstance(metadata, dict) else None


def _same(own: Mapping[str, Any] | None, copy: Mapping[str, Any], late: str) -> bool:
    """Return True if metadata equal their copy; the attribute ``late`` may have been written after the copy."""
    if own is None or not isinstance(own.get("attributes", {}), dict):
        return False
    one, other = without_consolidated(own), without_consolidated(copy)
    attributes = [dict(metadata.get("attributes", {})) for metadata in (one, other)]
    if late not in attributes[1]:
        attributes[0].pop(late, None)
    return one | {"attributes": attributes[0]} == other | {"attributes": attributes[1]}


def coordinate_faults(handle: AtlasStore) -> list[str]:
    """Return a line for each coordinate, or copy of one, that cannot be read or differs from the spec in any bit."""
    arrays = open_arrays(handle)
    faults = [f"{key} is damaged or missing" for key, data in handle.copies.items() if handle.backend.get(key) != data]
    for name, coordinate in handle.coordinates.items():
        try:
            values = np.asarray(arrays[name][...])
        except OSError:
            raise
        except Exception as error:  # a codec that meets bytes it never wrote may raise anything
            faults.append(f"coordinate {name} is damaged ({message_of(error)})")
            continue
        if not np.array_equal(values, coordinate.values):
            faults.append(f"coordinate {name} is not the spec's, or missing")
    return faults
