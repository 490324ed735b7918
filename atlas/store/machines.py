"""The records of machines that solved a store's tiles: a record is an empty group, named by a digest of its facts."""

import json
from contextlib import suppress
from functools import lru_cache

from atlas.store.location import Place
from atlas.store.machine import MACHINES, UNKNOWN, Machine, machine_of
from atlas.store.store import ROOT, Atlas


def record_machine(handle: Atlas, machine: Machine) -> None:
    """Add a machine to the list of machines that solved this store's tiles."""
    _recorded(handle.place, handle.run_id, machine)


@lru_cache(maxsize=64)  # once for each process and store
def _recorded(place: Place, run_id: str, machine: Machine) -> None:
    import zarr
    from zarr.errors import ContainsGroupError

    from atlas.store.remote import zarr_store  # with it Zarr, which takes a while to load

    path = f"{MACHINES}/{machine.name}"
    if place.exists(f"{path}/{ROOT}"):
        return
    with suppress(ContainsGroupError):  # another worker of this kind of machine was faster
        zarr.create_group(zarr_store(place, read_only=False), path=path, zarr_format=3, attributes=dict(machine.facts))


def machines(handle: Atlas) -> tuple[Machine, ...]:
    """The machines that solved tiles of this store, in no order; UNKNOWN for a damaged record."""
    return tuple(recorded_machine(handle.place, key) or UNKNOWN for key in machine_keys(handle))


def machine_keys(handle: Atlas) -> list[str]:
    """The keys of the records of the machines."""
    keys = handle.place.list_keys(f"{MACHINES}/")
    return sorted(key for key in keys if key.endswith(f"/{ROOT}") and key.count("/") == 2)


def recorded_machine(place: Place, key: str) -> Machine | None:
    """The machine of a record, None if it is damaged."""
    try:
        machine = machine_of(json.loads(place.get(key) or b"")["attributes"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return machine if machine.name == key.split("/")[1] else None
