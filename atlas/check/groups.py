"""Check the small objects of a store: intermediate results of searches, and records of hosts."""

from collections.abc import Iterator

from atlas.check.report import MACHINE, PART, StoreFault
from atlas.store.host_records import host_keys, read_host
from atlas.store.parts import damaged_parts
from atlas.store.schema import groups_of
from atlas.store.store import AtlasStore


def small_faults(handle: AtlasStore) -> Iterator[StoreFault]:
    """Yield the faults of the stored parts of searches, their intermediate results, and of the records of hosts."""
    for key in (key for group in groups_of(handle.spec) for key in damaged_parts(handle, group)):
        yield StoreFault(None, f"{key} is damaged", (PART, key))
    for key in host_keys(handle):
        if read_host(handle.backend, key) is None:
            yield StoreFault(None, f"{key} is damaged", (MACHINE, key))
