"""Checks of the small objects beside cells, overviews and tables: parts of searches, records of hosts."""

from collections.abc import Iterator

from atlas.check.report import MACHINE, PART, StoreFault
from atlas.store.host_records import host_keys, read_host
from atlas.store.parts import damaged_parts
from atlas.store.schema import groups_of
from atlas.store.store import AtlasStore


def small_faults(handle: AtlasStore) -> Iterator[StoreFault]:
    """Yield the faults of the parts of searches and of the records of hosts, which are read."""
    for key in (key for group in groups_of(handle.spec) for key in damaged_parts(handle, group)):
        yield StoreFault(None, f"{key} is damaged", (PART, key))
    for key in host_keys(handle):
        if read_host(handle.backend, key) is None:
            yield StoreFault(None, f"{key} is damaged", (MACHINE, key))
