"""The zoom levels of a store: the group ``zoom`` with the cells that explorers solved.

``zoom/PLANE/METATILE`` is a metatile: a block of tiles of a zoom level, and a store within the store. It has its own
spec and digest and its own order of writing, so that every reader of atlases reads it. Explorers write metatiles while
they hold the lease of the store.
"""

import json
import shutil
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from atlas.store.object_backend import StoreBackend
from atlas.store.store import ROOT, ZOOM, AtlasStore
from workers.results import REGIME

_SEEN = "seen"
ABOUT = {"long_name": "cells between and beyond those of the atlas, as they were looked at; solved more coarsely"}
FILE_BLOCK = 4096
"""Minimum size, in bytes, counted for an object of unknown size."""


def metatile_backend(handle: AtlasStore, plane: str, sheet: str) -> StoreBackend:
    """Return the backend of a metatile of a plane, which may not exist. Raise ValueError for a read-only store."""
    return handle.backend.subfolder(f"{ZOOM}/{plane}/{sheet}")


def make_plane(handle: AtlasStore, plane: str, described: Mapping[str, Any]) -> None:
    """Create the group of a plane, and the group of all planes, if they are missing."""
    for key, attributes in ((ZOOM, ABOUT), (f"{ZOOM}/{plane}", dict(described))):
        if not handle.backend.exists(f"{key}/{ROOT}"):
            handle.backend.put_new(f"{key}/{ROOT}", _group(attributes))


def describe_planes(handle: AtlasStore) -> None:
    """Write the metadata of the group of all planes again."""
    handle.backend.put(f"{ZOOM}/{ROOT}", _group(ABOUT))


def _group(attributes: Mapping[str, Any]) -> bytes:
    return json.dumps({"zarr_format": 3, "node_type": "group", "attributes": attributes}).encode()


def list_metatiles(handle: AtlasStore) -> list[tuple[str, str]]:
    """Return the planes and names of all metatiles; empty for a read-only store."""
    if handle.backend.read_only_reason:
        return []
    local = handle.backend.local
    if local is not None:  # without listing the contents of metatiles
        keys = [path.relative_to(local).as_posix() for path in (local / ZOOM).glob(f"[!.]*/[!.]*/{ROOT}")]
    else:
        keys = [key for key in handle.backend.list_keys(f"{ZOOM}/") if key.count("/") == 3 and key.endswith(f"/{ROOT}")]
    return sorted((key.split("/")[1], key.split("/")[2]) for key in keys)


def metatile_bytes(handle: AtlasStore, plane: str, sheet: str) -> int:
    """Return the size of a metatile on its disk, in bytes, in whole blocks; at a URL, a lower bound."""
    total = 0
    for key in handle.backend.list_keys(f"{ZOOM}/{plane}/{sheet}/"):
        size = 1
        if handle.backend.local is not None:
            with suppress(FileNotFoundError):
                size = (handle.backend.local / key).stat().st_size
        total += -(-size // FILE_BLOCK) * FILE_BLOCK
    return total


def read_view_times(handle: AtlasStore) -> dict[tuple[str, str], float]:
    """Return the times when metatiles were last viewed, as far as recorded, in seconds since 1970."""
    times: dict[tuple[str, str], float] = {}
    for plane in {plane for plane, _ in list_metatiles(handle)}:
        noted = _plane_group(handle, plane).get("attributes", {}).get(_SEEN, {})
        times |= {(plane, sheet): float(when) for sheet, when in noted.items()}
    return times


def write_view_times(handle: AtlasStore, seen: Mapping[tuple[str, str], float]) -> None:
    """Record the times when metatiles were last viewed. Only the lease holder may call this."""
    for plane in {plane for plane, _ in seen}:
        key = f"{ZOOM}/{plane}/{ROOT}"
        group = _plane_group(handle, plane)
        noted = {sheet: when for (of, sheet), when in seen.items() if of == plane}
        if group and group["attributes"].get(_SEEN) != noted:
            group["attributes"][_SEEN] = noted
            handle.backend.put(key, json.dumps(group).encode())


def drop_metatile(handle: AtlasStore, plane: str, sheet: str) -> None:
    """Remove a metatile, its regimes first: a kill then leaves unfinished tiles, none that lacks an array."""
    root = f"{ZOOM}/{plane}/{sheet}/"
    keys = list(handle.backend.list_keys(root))
    done = [key for key in keys if f"/{REGIME.name}/c/" in key]
    last = [key for key in keys if key.endswith(ROOT)]
    for some in (done, {*keys} - {*done, *last}, last):
        handle.backend.remove_all(some)
    if handle.backend.local is not None:
        handle.backend.check_fence()
        shutil.rmtree(handle.backend.local / root, ignore_errors=True)


def _plane_group(handle: AtlasStore, plane: str) -> dict[str, Any]:
    """Return the metadata of a plane; empty if they are missing or damaged."""
    try:
        group = json.loads(handle.backend.get(f"{ZOOM}/{plane}/{ROOT}") or b"{}")
        return group if isinstance(group.get("attributes"), dict) else {}
    except (ValueError, AttributeError, RecursionError):
        return {}
