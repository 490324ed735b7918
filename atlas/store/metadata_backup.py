"""The backup of a store's metadata: a second object with the original metadata of the root.

Either object can be restored from the other. The backup lies in the folder of an array, which readers of Zarr groups do
not list.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Any

from atlas.errors import REPACK_HINT, brief_repr, message_of
from atlas.store.axes import ROOT, matches_coordinates
from atlas.store.backend import StoreBackend
from atlas.store.schema import COMPONENT
from atlas.store.zip_backend import ZipBackend

SPARE = f"{COMPONENT}/spare"
"""Key of the backup: its first line is a checksum, then follow the metadata of the root."""
FORM = {"zarr_format": 3, "node_type": "group"}
"""Metadata of every group, besides its attributes and consolidated metadata."""
Json = Mapping[str, Any]


def encode_backup(root: bytes) -> bytes:
    """Return the backup of a root's metadata."""
    return hashlib.sha256(root).hexdigest().encode() + b"\n" + root


def read_backup(place: StoreBackend) -> dict[str, Any] | None:
    """Return the metadata of the root from the backup of a store.

    Return None if the backup is missing, damaged, or that of another store.
    """
    return decode_backup(place, place.get(ROOT), place.get(SPARE))


def decode_backup(place: StoreBackend, root: bytes | None, data: bytes | None) -> dict[str, Any] | None:
    """``read_backup`` for given bytes of both objects: ``root``, the metadata of the root, and ``data``, their backup.

    A backup with another spec than the root belongs to another store if the coordinates in the backend match the root.
    """
    checksum, _, content = (data or b"").partition(b"\n")
    if hashlib.sha256(content).hexdigest().encode() != checksum:
        return None
    spare = dict(json.loads(content))
    try:
        own = json.loads(root or b"")["attributes"]
        other = own["digest"] != spare["attributes"]["digest"]
        return None if other and matches_coordinates(place, json.loads(own["spec"]), own["digest"]) else spare
    except (ValueError, AttributeError, KeyError, TypeError, RecursionError):  # the root's are damaged
        return spare


def remedy(place: StoreBackend) -> str:
    """Return the remedy for missing, damaged or wrong metadata, for a message."""
    return REPACK_HINT if isinstance(place, ZipBackend) else f"atlas verify --repair {place} restores them"


def nodes_of(root: Json) -> dict[str, dict[str, Any]]:
    """Return the consolidated metadata in the metadata of a root: those of arrays and groups, by key."""
    nodes = (root.get("consolidated_metadata") or {}).get("metadata", {})
    return {f"{name}/{ROOT}": node for name, node in nodes.items()}


def find_backup_faults(place: StoreBackend, spare: Json) -> dict[str, str]:
    """Return the faults of a store's metadata, as text by key: missing, damaged, or different from the backup."""
    faults = {}
    for key, right in {ROOT: spare, **nodes_of(spare)}.items():
        if fault := next(_faults(place.get(key), right, whole=key != ROOT), ""):
            faults[key] = fault
    return faults


def restore_from_backup(place: StoreBackend, spare: Json, keys: Mapping[str, str]) -> None:
    """Write the metadata of these keys from the backup, then those of the root.

    The metadata of the root get copies of all present metadata.
    """
    nodes = nodes_of(spare)
    for key in keys:
        if key != ROOT:
            place.put(key, json.dumps(without_consolidated(nodes[key])).encode())
    copy_metadata(place, spare)


def copy_metadata(place: StoreBackend, root: Json) -> None:
    """Write the metadata of a root, with copies of the present metadata of its arrays and groups.

    Copied are the metadata consolidated in ``root``, and all others: a backup lacks groups that a search or a run has
    added since.
    """
    present = {key for key in place.list_keys() if key.endswith(f"/{ROOT}")}
    keys = sorted({*nodes_of(root), *(key for key in present if _parents(key) <= present)})
    copies = {}
    for key, data in sorted(place.get_all(keys).items()):
        try:
            node = without_consolidated(json.loads(data))
            copies[key.removesuffix(f"/{ROOT}")] = node | (_copies({}) if node.get("node_type") == "group" else {})
        except (ValueError, AttributeError, RecursionError):
            continue  # damaged, as a verification reports
    place.put(ROOT, json.dumps({**FORM, "attributes": root["attributes"]} | _copies(copies)).encode())


def copy_members(place: StoreBackend, group: str, names: Iterable[str]) -> None:
    """Update the consolidated metadata of a group, if it has any, and those of the root.

    They are copied from the present metadata of the arrays.
    """
    own = json.loads(place.get(f"{group}/{ROOT}") or b"{}")
    if "consolidated_metadata" in own:
        nodes = {name: json.loads(place.get(f"{group}/{name}/{ROOT}") or b"{}") for name in names}
        place.put(f"{group}/{ROOT}", json.dumps(without_consolidated(own) | _copies(nodes)).encode())
    copy_metadata(place, json.loads(place.get(ROOT) or b"{}"))


def _parents(key: str) -> set[str]:
    """Return the keys of the metadata of all groups above an array or a group, without the root."""
    parts = key.split("/")[:-1]
    return {"/".join([*parts[:n], ROOT]) for n in range(1, len(parts))}


def _copies(nodes: Json) -> dict[str, Any]:
    return {"consolidated_metadata": {"kind": "inline", "must_understand": False, "metadata": nodes}}


def without_consolidated(metadata: Json) -> dict[str, Any]:
    """Return metadata without consolidated metadata."""
    return {name: value for name, value in metadata.items() if name != "consolidated_metadata"}


def form_fault(group: Any) -> str:
    """Return the fault of the form of a group's metadata, as text; empty if Zarr can read them.

    Zarr rejects metadata with an unknown key.
    """
    if not isinstance(group, dict) or not isinstance(group.get("attributes"), dict):
        return "has no attributes"
    for name, must in FORM.items():
        if group.get(name) != must:
            return f"has {name} {brief_repr(group.get(name))}, must be {brief_repr(must)}"
    for name in group:
        if name not in (*FORM, "attributes", "consolidated_metadata"):
            return f"has an unknown key {brief_repr(name)}"
    copies = group.get("consolidated_metadata")
    if copies is None:
        return ""
    nodes = copies.get("metadata") if isinstance(copies, dict) else None
    if not isinstance(nodes, dict) or {"consolidated_metadata": {**copies, "metadata": {}}} != _copies({}):
        return "has consolidated metadata of an unknown form"
    damaged = (name for name, node in nodes.items() if not _is_node(node))
    return next((f"has consolidated metadata that differ from those of {name}/{ROOT}" for name in damaged), "")


def _is_node(copy: Any) -> bool:
    """Return True if copied metadata have the form of those of an array or of a group."""
    if not isinstance(copy, dict) or copy.get("zarr_format") != FORM["zarr_format"]:
        return False
    return copy.get("node_type") == "array" or not form_fault(copy)


def root_fault(data: bytes | None, spare: Json) -> str:
    """Return the first fault of the object with a root's metadata, as text; empty if it equals its backup."""
    return next(_faults(data, spare, whole=False), "")


def copy_difference(own: Any, copy: Json | None) -> str:
    """Return the fault of metadata that differ from the root's copy, as text; empty if they are equal."""
    alike = isinstance(own, dict) and copy is not None and without_consolidated(own) == without_consolidated(copy)
    return "" if alike else f"differs from its copy in {ROOT}"


def _faults(data: bytes | None, right: Json, whole: bool) -> Iterator[str]:
    """Yield the faults of an object of metadata.

    It is compared in all keys with ``whole``, otherwise, for a root, in its attributes and consolidated metadata.
    """
    if data is None:
        yield "is missing"
        return
    try:
        stored = json.loads(data)
    except (ValueError, RecursionError) as error:
        yield f"is damaged ({message_of(error)})"
        return
    if not isinstance(stored, dict) or not isinstance(stored.get("attributes"), dict):
        yield "is damaged (it has no attributes)"
        return
    attributes, pairs = stored["attributes"], list[tuple[str, Any, Any]]()
    if whole:
        unknown = [f"key {brief_repr(name)}" for name in without_consolidated(stored).keys() - right.keys()]
        unknown += [f"attribute {brief_repr(name)}" for name in attributes.keys() - right["attributes"].keys()]
        yield from (f"has an unknown {name}" for name in unknown)
        pairs = [
            (name, stored.get(name), value)
            for name, value in without_consolidated(right).items()
            if name != "attributes"
        ]
    pairs += [(f"attribute {name}", attributes.get(name), value) for name, value in right["attributes"].items()]
    for pair in pairs:
        yield from _unlike(*pair)
    if not whole:
        if fault := form_fault(stored):
            yield fault
            return
        copies = nodes_of(stored)
        wrong = (key for key, node in nodes_of(right).items() if copy_difference(node, copies.get(key)))
        yield from (f"has consolidated metadata that differ from those of {key}" for key in wrong)


def _unlike(name: str, own: Any, must: Any) -> Iterator[str]:
    """Yield the differences of two values, in their innermost common entries; a spec stored as JSON is decoded."""
    if isinstance(own, str) and isinstance(must, str) and must.startswith("{"):
        with suppress(ValueError, RecursionError):
            own, must = json.loads(own), json.loads(must)
    if isinstance(own, dict) and isinstance(must, dict) and own.keys() == must.keys():
        for key in must:
            yield from _unlike(f"{name}.{key}", own[key], must[key])
    elif isinstance(own, list) and isinstance(must, list) and len(own) == len(must) and dict in map(type, must):
        for number, pair in enumerate(zip(own, must, strict=True)):
            yield from _unlike(f"{name}[{number}]", *pair)
    elif own != must:
        yield f"has {name} {brief_repr(own)}, must be {brief_repr(must)}"
