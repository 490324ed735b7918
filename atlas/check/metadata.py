"""Compare a store's metadata and coordinates, byte by byte, with the bytes that follow from its spec."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from atlas.check.report import GROUP, METADATA, StoreFault
from atlas.errors import REBUILD_COMMANDS, ChunkError
from atlas.overview.pyramid import Pyramid
from atlas.spec.resolved import resolved_digest
from atlas.store.backend import StoreBackend
from atlas.store.groups import group_layout
from atlas.store.metadata import ROOT, describe_difference, encode_node, encode_whole, members_of, unsealed
from atlas.store.schema import FORMAT, OVERVIEWS, SPEC_KEY, chunk_of_whole, groups_of, remedy, root_with_groups
from atlas.store.store import AtlasStore, handle_by, open_store

ROUNDING = 1e-9
"""Maximum relative or absolute difference of an overview's coordinates: on log axes, rounding depends on the host."""


def open_damaged_store(backend: StoreBackend) -> AtlasStore:
    """Return the handle of a store, also if its root is lost or damaged.

    The attributes of the root are stored a second time, in the group ``spec``. If the two copies are intact but differ,
    the copy is right from which more of the store's objects follow. Raise InputError if there is no store.
    """
    stored = backend.get_all([ROOT, SPEC_KEY])
    sound = [attributes for key in (ROOT, SPEC_KEY) if (attributes := unsealed(stored.get(key))) is not None]
    handles = [handle_by(backend, attributes) for attributes in sound if attributes.get("format") == FORMAT]
    if not handles or (len(handles) == 1 and unsealed(stored.get(ROOT)) is not None):
        return open_store(backend)
    return handles[0] if handles[0].attributes == handles[-1].attributes else max(handles, key=_count_right)


def _count_right(handle: AtlasStore) -> int:
    stored = handle.backend.get_all(handle.layout)
    return sum(data == handle.layout[key] for key, data in stored.items())


class RightObjects(dict[str, bytes]):
    """The metadata and coordinates that a store should have, as bytes by key.

    ``faults`` are those of groups that cannot be restored.
    """

    def __init__(self, handle: AtlasStore) -> None:
        super().__init__(handle.layout)
        self.faults: list[StoreFault] = []
        root = handle.backend.get(ROOT)
        groups = {name: data for name in (OVERVIEWS, *groups_of(handle.spec)) if (data := self._group(handle, name))}
        listed = {name: data for name, data in groups.items() if name in members_of(root)}
        # A killed write may have left a new group without its copy in the root.
        for copied in (groups, listed):
            self[ROOT] = root_with_groups(handle.attributes, handle.nodes, copied)
            if root == self[ROOT]:
                break
        else:
            self[ROOT] = root_with_groups(handle.attributes, handle.nodes, groups)

    def _group(self, handle: AtlasStore, name: str) -> bytes | None:
        """Add the metadata that a group and its arrays should have.

        Return the metadata of the group itself; None if the group is absent or lost.
        """
        key, copies = f"{name}/{ROOT}", members_of(handle.backend.get(ROOT))
        stored = data = handle.backend.get(key)
        if unsealed(data) is None and name in copies:
            plain = {path: _without_copies(node) for path, node in copies.items()}
            below = {path.removeprefix(f"{name}/"): n for path, n in plain.items() if path.startswith(f"{name}/")}
            data = encode_node(plain[name], below)
        fault = f"{key} is damaged" if stored is not None else f"{key} is missing"
        if data is not None and unsealed(data) is not None:
            try:
                coarse = name == OVERVIEWS
                self.update(Pyramid(handle, data=data).layout() if coarse else group_layout(handle, name, data))
                return self[key]
            except ChunkError as error:
                self.faults += [_group_fault(handle, name, line) for line in error.lines]
                return data
        if stored is not None or any(handle.backend.list_keys(f"{name}/")):
            self.faults.append(_group_fault(handle, name, fault))
        return None


def metadata_faults(handle: AtlasStore, right: Mapping[str, bytes]) -> Iterator[StoreFault]:
    """Yield a fault for each stored object that differs from the bytes that it should have, ``right`` by key."""
    pyramid = Pyramid(handle)
    coarse = pyramid.coordinates() if pyramid.exists else {}
    rounded = {chunk_of_whole(path, stored): stored.values for path, stored in coarse.items()}
    stored = handle.backend.get_all(right)
    for key, must in right.items():
        stored_bytes = stored.get(key)
        if stored_bytes == must or (key in rounded and _is_close(stored_bytes, rounded[key])):
            continue
        yield StoreFault(
            None, f"{key} {describe_difference(stored_bytes, must)}: {remedy(handle.backend)}", (METADATA, key)
        )
    if resolved_digest(handle.resolved) != handle.digest:
        yield StoreFault(None, f"{ROOT}: the digest does not match the spec")


def _is_close(stored: bytes | None, values: Any) -> bool:
    """Return True if the bytes of a stored chunk differ from these values by rounding alone."""
    if stored is None or values.dtype.kind != "f" or len(stored) != values.nbytes + 4:
        return False
    stored_values = np.frombuffer(stored[:-4], dtype="<f8").reshape(values.shape)
    return encode_whole(stored_values) == stored and bool(
        np.allclose(stored_values, values, rtol=ROUNDING, atol=ROUNDING)
    )


def _group_fault(handle: AtlasStore, group: str, text: str) -> StoreFault:
    anew = f" ({REBUILD_COMMANDS[group]} {handle.backend} makes it anew)" if group in REBUILD_COMMANDS else ""
    return StoreFault(None, text + anew, (GROUP, group))


def _without_copies(node: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in node.items() if name != "consolidated_metadata"}
