"""Cache of the handles of stores that this process uses. A handle is replaced if the root of its store has changed."""

from collections.abc import Hashable
from threading import Lock

from atlas.store.object_backend import StoreBackend, open_backend, with_patience
from atlas.store.outage import LONG_PATIENCE
from atlas.store.store import ROOT, AtlasStore, open_store
from atlas.store.tile_records import TileRecords

MAX_HANDLES = 16
"""Maximum number of handles in the cache. A worker of a long-lived cluster serves many runs, each with one or two
stores.
"""
_reading = Lock()
_records: dict[StoreBackend, TileRecords] = {}
_headers: dict[tuple[StoreBackend, float], tuple[Hashable, AtlasStore]] = {}
"""Cached handles by backend and patience, each with the version that the root of its store had."""


def cached_handle(store: str | StoreBackend, patience: float = LONG_PATIENCE) -> AtlasStore:
    """Return the handle of a store from the cache, or open the store if its root has changed.

    ``patience`` is the time in seconds to wait for a server that does not respond. Raise errors like ``open_store``.
    """
    backend = with_patience(open_backend(store), patience)
    version = backend.version(ROOT)
    with _reading:  # the threads of a worker ask at the same time
        known = _headers.get((backend, patience))
        if known is None or known[0] != version:
            if len(_headers) >= MAX_HANDLES:
                oldest = next(iter(_headers))
                del _headers[oldest]
                _records.pop(oldest[0], None)
            known = _headers[backend, patience] = version, open_store(backend)
            _records.pop(backend, None)
    return known[1]


def cached_records(handle: AtlasStore) -> TileRecords:
    """Return the tile records of a store that no longer changes, read once per process."""
    if handle.backend not in _records:
        _records[handle.backend] = TileRecords(handle)
    return _records[handle.backend]
