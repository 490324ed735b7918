"""Checks of the planes that explorers keep in a store, and dropping them."""

import json
from collections.abc import Iterable

from atlas.store.store import ROOT, ZOOM, Atlas
from atlas.store.zoom import ABOUT, describe_planes, drop_sheet


def plane_faults(handle: Atlas) -> dict[str, str]:
    """The faults in the metadata of planes, and of sheets that are not whole, by the keys of these metadata."""
    found: dict[str, str] = {}
    folders = {tuple(key.split("/")[1:-1][:2]) for key in handle.place.list_keys(f"{ZOOM}/")}
    whole = (folder for folder in folders if not any(name.startswith(".") for name in folder))  # not half made ones
    for parts in sorted({folder[:n] for folder in whole for n in range(len(folder) + 1)}):
        key = "/".join([ZOOM, *parts, ROOT])
        try:
            group = json.loads(handle.place.get(key) or b"")
            own = group["attributes"]
            wrong = {0: own != ABOUT, 1: "".join(parts[:1]) != own.get("digest", "")[:16]}.get(len(parts), False)
            if wrong or (group["zarr_format"], group["node_type"]) != (3, "group"):
                found[key] = "is damaged"
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            found[key] = "is missing or damaged"
    return found


def drop_zoom(handle: Atlas, folders: Iterable[tuple[str, ...]]) -> None:
    """Remove sheets, each given as (plane, sheet), and planes with all their sheets, as (plane,).

    Of the group of all planes, (), the metadata are written again.
    """
    for folder in folders:
        if not folder:
            describe_planes(handle)
        elif len(folder) == 2:
            drop_sheet(handle, *folder)
        else:
            handle.place.remove(f"{ZOOM}/{folder[0]}/{ROOT}")
            for sheet in sorted({key.split("/")[2] for key in handle.place.list_keys(f"{ZOOM}/{folder[0]}/")}):
                drop_sheet(handle, folder[0], sheet)
