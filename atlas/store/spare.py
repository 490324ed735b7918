"""The spare of a store's metadata: a second object with the root's metadata as they were made.

Either object can be written again from the other. The spare lies in the folder of an array, where no reader of Zarr
groups finds it.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any

from atlas.errors import PACK, message_of, shown
from atlas.store.archive import ZipPlace
from atlas.store.axes import ROOT, goes_with
from atlas.store.place import Place
from atlas.store.schema import COMPONENT, ZOOM

SPARE = f"{COMPONENT}/spare"
"""The key of the spare: a checksum in the first line, then the root's metadata."""
Json = Mapping[str, Any]


def packed_spare(root: bytes) -> bytes:
    """The spare of these metadata of a root."""
    return hashlib.sha256(root).hexdigest().encode() + b"\n" + root


def read_spare(place: Place) -> dict[str, Any] | None:
    """The root's metadata by the spare of a store; None if it is missing or damaged, or another store's."""
    return spare_by(place, place.get(ROOT), place.get(SPARE))


def spare_by(place: Place, root: bytes | None, data: bytes | None) -> dict[str, Any] | None:
    """``read_spare``, given the object of the root's metadata and that of their spare.

    A spare with another spec than the root's is another store's if the coordinates at the place go with the root.
    """
    checksum, _, content = (data or b"").partition(b"\n")
    if hashlib.sha256(content).hexdigest().encode() != checksum:
        return None
    spare = dict(json.loads(content))
    try:
        own = json.loads(root or b"")["attributes"]
        other = own["digest"] != spare["attributes"]["digest"]
        return None if other and goes_with(place, json.loads(own["spec"]), own["digest"]) else spare
    except (ValueError, AttributeError, KeyError, TypeError, RecursionError):  # the root's are damaged
        return spare


def remedy(place: Place) -> str:
    """How metadata that are missing, damaged or wrong are mended, in words."""
    return PACK if isinstance(place, ZipPlace) else f"atlas verify --repair {place} writes them again"


def nodes_of(root: Json) -> dict[str, dict[str, Any]]:
    """The metadata of all arrays and groups that a root's metadata have copies of, by their keys."""
    nodes = (root.get("consolidated_metadata") or {}).get("metadata", {})
    return {f"{name}/{ROOT}": node for name, node in nodes.items()}


def spare_faults(place: Place, spare: Json) -> dict[str, str]:
    """What of a store's metadata is missing, damaged or not as its spare has it, in words by the keys."""
    faults = {}
    for key, right in {ROOT: spare, **nodes_of(spare)}.items():
        if fault := next(_faults(place.get(key), right, whole=key != ROOT), ""):
            faults[key] = fault
    return faults


def mend_by_spare(place: Place, spare: Json, keys: Mapping[str, str]) -> None:
    """Write these metadata as the spare has them, and the root's with copies of all that there is."""
    nodes = nodes_of(spare)
    for key in keys:
        if key != ROOT:
            place.put(key, json.dumps(alone(nodes[key])).encode())
    copy_metadata(place, spare)


def copy_metadata(place: Place, root: Json) -> None:
    """Write a root's metadata with copies of the metadata of its arrays and groups as these have them now.

    Such are the ones that ``root`` has copies of, and all others that are there now but the zoom levels: what a
    search or a run has added since is in no spare.
    """
    found = {key for key in place.list_keys() if key.endswith(f"/{ROOT}") and not key.startswith(f"{ZOOM}/")}
    keys = sorted({*nodes_of(root), *(key for key in found if _parents(key) <= found)})
    copies = {}
    for key, data in sorted(place.get_all(keys).items()):
        try:
            node = alone(json.loads(data))
            copies[key.removesuffix(f"/{ROOT}")] = node | (_copies({}) if node.get("node_type") == "group" else {})
        except (ValueError, AttributeError, RecursionError):
            continue  # damaged: whoever checks it says so
    place.put(ROOT, json.dumps(alone(root) | _copies(copies)).encode())


def _parents(key: str) -> set[str]:
    """The keys of the metadata of the groups that an array or a group lies in, the root's left out."""
    parts = key.split("/")[:-1]
    return {"/".join([*parts[:n], ROOT]) for n in range(1, len(parts))}


def _copies(nodes: Json) -> dict[str, Any]:
    return {"consolidated_metadata": {"kind": "inline", "must_understand": False, "metadata": nodes}}


def alone(metadata: Json) -> dict[str, Any]:
    """Metadata without copies of others."""
    return {name: value for name, value in metadata.items() if name != "consolidated_metadata"}


def root_fault(data: bytes | None, spare: Json) -> str:
    """The first thing that is wrong with the object of a root's metadata, in words; "" where it is as its spare."""
    return next(_faults(data, spare, whole=False), "")


def unlike_copy(own: Any, copy: Json | None) -> str:
    """The fault of metadata that differ from the root's copy of them, in words; "" where they do not."""
    alike = isinstance(own, dict) and copy is not None and alone(own) == alone(copy)
    return "" if alike else f"differs from its copy in {ROOT}"


def _faults(data: bytes | None, right: Json, whole: bool) -> Iterator[str]:
    """The fault of an object of metadata: ``whole``, or a root's, of which attributes and copies are compared."""
    if data is None:
        yield "is missing"
        return
    try:
        found = alone(json.loads(data))
    except (ValueError, AttributeError, RecursionError) as error:
        yield f"is damaged ({message_of(error)})"
        return
    try:
        copies = {} if whole else nodes_of(json.loads(data))
    except (AttributeError, TypeError) as error:
        yield f"is damaged ({message_of(error)})"
        return
    attributes = found.get("attributes")
    if not isinstance(attributes, dict):
        yield "is damaged (it has no attributes)"
        return
    pairs = [(f"attribute {name}", attributes.get(name), value) for name, value in right["attributes"].items()]
    if whole:
        fields = [name for name in alone(right) if name != "attributes"]
        pairs = [(name, found.get(name), right[name]) for name in fields] + pairs
    for pair in pairs:
        yield from _unlike(*pair)
    if not whole:
        wrong = (key for key, node in nodes_of(right).items() if alone(copies.get(key, {})) != alone(node))
        yield from (f"has consolidated metadata that differ from those of {key}" for key in wrong)


def _unlike(name: str, found: Any, must: Any) -> Iterator[str]:
    """Where two values differ, in the innermost parts that both have; the spec is kept as JSON, and looked into."""
    if isinstance(found, str) and isinstance(must, str) and must.startswith("{"):
        with suppress(ValueError, RecursionError):
            found, must = json.loads(found), json.loads(must)
    if isinstance(found, dict) and isinstance(must, dict) and found.keys() == must.keys():
        for key in must:
            yield from _unlike(f"{name}.{key}", found[key], must[key])
    elif isinstance(found, list) and isinstance(must, list) and len(found) == len(must) and dict in map(type, must):
        for number, pair in enumerate(zip(found, must, strict=True)):
            yield from _unlike(f"{name}[{number}]", *pair)
    elif found != must:
        yield f"has {name} {shown(found)}, must be {shown(must)}"
