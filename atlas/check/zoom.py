"""Checks of the planes and metatiles that explorers save in a store."""

import json

from atlas.store.metadata import encode_node, group_node
from atlas.store.store import ROOT, ZOOM, AtlasStore
from atlas.store.zoom import ABOUT


def plane_faults(handle: AtlasStore) -> dict[str, str]:
    """Return the damaged metadata of planes and of metatiles, by their keys.

    Folders still being created are left out.
    """
    damage: dict[str, str] = {}
    folders = {tuple(key.split("/")[1:-1][:2]) for key in handle.backend.list_keys(f"{ZOOM}/")}
    whole = (folder for folder in folders if not any(name.startswith(".") for name in folder))
    for parts in sorted({folder[:n] for folder in whole for n in range(len(folder) + 1)}):
        key = "/".join([ZOOM, *parts, ROOT])
        try:
            data = handle.backend.get(key) or b""
            own = json.loads(data)["attributes"]
            wrong = {0: own != ABOUT, 1: "".join(parts[:1]) != own.get("digest", "")[:16]}.get(len(parts), False)
            if wrong or (len(parts) < 2 and encode_node(group_node(own)) != data):
                damage[key] = "is damaged"
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            damage[key] = "is missing or damaged"
    return damage
