"""Records of the hosts that solved tiles of a store; a record is an empty group named by a digest of its facts."""

import json
from contextlib import suppress
from functools import lru_cache
from typing import Any

from atlas.store.host import HOSTS, UNKNOWN, HostInfo, host_from_facts
from atlas.store.metadata_backup import FORM, form_fault
from atlas.store.object_backend import StoreBackend
from atlas.store.store import ROOT, AtlasStore


def record_host(handle: AtlasStore, machine: HostInfo) -> None:
    """Add a host to the hosts that solved tiles of this store."""
    _recorded(handle.backend, handle.run_id, machine)


@lru_cache(maxsize=64)  # once for each process and store
def _recorded(place: StoreBackend, run_id: str, machine: HostInfo) -> None:
    import zarr
    from zarr.errors import ContainsGroupError

    from atlas.store.zarr_stores import zarr_store  # loads Zarr, which takes a while

    path = f"{HOSTS}/{machine.name}"
    if place.exists(f"{path}/{ROOT}"):
        return
    with suppress(ContainsGroupError):  # another worker on this kind of host was faster
        zarr.create_group(zarr_store(place, read_only=False), path=path, zarr_format=3, attributes=dict(machine.facts))


def read_hosts(handle: AtlasStore) -> tuple[HostInfo, ...]:
    """Return the hosts that solved tiles of this store, in any order; a damaged record gives UNKNOWN."""
    return tuple(read_host(handle.backend, key) or UNKNOWN for key in host_keys(handle))


def host_keys(handle: AtlasStore) -> list[str]:
    """Return the keys of the host records."""
    keys = handle.backend.list_keys(f"{HOSTS}/")
    return sorted(key for key in keys if key.endswith(f"/{ROOT}") and key.count("/") == 2)


def read_host(place: StoreBackend, key: str) -> HostInfo | None:
    """Return the host of a record; None if the record is damaged."""
    group = _group(place, key)
    machine = _machine(group, key)
    return None if form_fault(group) else machine


def mend_record(handle: AtlasStore, key: str) -> bool:
    """Restore a damaged record from its facts and return True.

    If the facts are damaged, replace the record by that of the unknown host and return False.
    """
    if (machine := _machine(_group(handle.backend, key), key)) is not None:
        handle.backend.put(key, json.dumps({**FORM, "attributes": machine.facts}).encode())
        return True
    record_host(handle, UNKNOWN)  # verification still has to know that there was another host
    handle.backend.remove(key)
    return False


def _group(place: StoreBackend, key: str) -> Any:
    """Return the metadata of a record; None if they are not JSON."""
    with suppress(ValueError, RecursionError):
        return json.loads(place.get(key) or b"")
    return None


def _machine(group: Any, key: str) -> HostInfo | None:
    """Return the host with the facts of a record; None if the key has another name than the facts give."""
    try:
        machine = host_from_facts(group["attributes"])
    except (KeyError, TypeError):
        return None
    return machine if machine.name == key.split("/")[1] else None
