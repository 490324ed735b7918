"""Cache of the handles of the stores that this process uses; a handle is read again if its store has changed."""

from collections.abc import Hashable
from threading import Lock

from atlas.store.object_backend import StoreBackend, open_backend, with_patience
from atlas.store.outage import LONG_PATIENCE
from atlas.store.store import ROOT, AtlasStore, open_store
from atlas.store.tile_records import TileRecords

MAX_HANDLES = 16
"""Maximum number of handles kept; a worker of a long-lived cluster serves many runs, each of a store and its origin."""
_reading = Lock()
_records: dict[StoreBackend, TileRecords] = {}
_headers: dict[tuple[StoreBackend, float], tuple[Hashable, AtlasStore]] = {}
"""Handles by backend and patience, each with the version of the store's root."""


def cached_handle(store: str | StoreBackend, patience: float = LONG_PATIENCE) -> AtlasStore:
    """Return the handle of a store, after one check of its root's version. Raise errors like ``open_store``."""
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
    """Return the tile records of a store that no longer changes."""
    if handle.backend not in _records:
        _records[handle.backend] = TileRecords(handle)
    return _records[handle.backend]
