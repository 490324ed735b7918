"""Records of the hosts that solved tiles of a store; a record is an empty group named by a digest of facts about a
host.
"""

import json

from atlas.store.host import HOSTS, UNKNOWN, HostInfo, host_from_facts
from atlas.store.metadata import ROOT, encode_node, group_node
from atlas.store.object_backend import StoreBackend
from atlas.store.store import AtlasStore


def record_host(handle: AtlasStore, machine: HostInfo) -> None:
    """Add a host to the hosts that solved tiles of this store, once for each process."""
    key = f"{HOSTS}/{machine.name}/{ROOT}"
    handle.cached(key, lambda: handle.backend.put_new(key, _record(machine)))


def read_hosts(handle: AtlasStore) -> tuple[HostInfo, ...]:
    """Return the hosts that solved tiles of this store, in any order; a damaged record gives UNKNOWN."""
    return tuple(read_host(handle.backend, key) or UNKNOWN for key in host_keys(handle))


def host_keys(handle: AtlasStore) -> list[str]:
    """Return the keys of the host records."""
    keys = handle.backend.list_keys(f"{HOSTS}/")
    return sorted(key for key in keys if key.endswith(f"/{ROOT}") and key.count("/") == 2)


def read_host(backend: StoreBackend, key: str) -> HostInfo | None:
    """Return the host that a record describes; None if the record is missing or damaged."""
    data = backend.get(key)
    machine = _host_in(data, key)
    return machine if machine is not None and _record(machine) == data else None


def mend_record(handle: AtlasStore, key: str) -> bool:
    """Restore a damaged record of a host from its own facts, and return True.

    If the facts themselves are damaged, replace the record by that of the unknown host and return False.
    """
    if (machine := _host_in(handle.backend.get(key), key)) is not None:
        handle.backend.put(key, _record(machine))
        return True
    record_host(handle, UNKNOWN)  # verification still has to know that there was another host
    handle.backend.remove(key)
    return False


def _record(machine: HostInfo) -> bytes:
    return encode_node(group_node(machine.facts))


def _host_in(data: bytes | None, key: str) -> HostInfo | None:
    """Return the host that a record describes.

    ``data`` are the bytes of the record. None if they are damaged, or if the name that follows from the facts is not
    that in ``key``.
    """
    try:
        machine = host_from_facts(json.loads(data or b"")["attributes"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return machine if machine.name == key.split("/")[1] else None
