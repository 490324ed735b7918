"""Cache of the handles of stores that this process uses; all that was read of a store is in the cache of its handle."""

from atlas.store.object_backend import Given, open_backend, with_patience
from atlas.store.outage import LONG_PATIENCE
from atlas.store.store import AtlasStore, open_store

MAX_HANDLES = 64
"""Maximum number of handles in the cache; a worker of a long-lived cluster serves many runs."""
_handles: dict[str, AtlasStore] = {}
"""Handles by name of the store, the least recently used first. A handle has the access to its store."""


def keep_handle(handle: AtlasStore) -> AtlasStore:
    """Put a handle into the cache, in place of another one of its name, and return it."""
    name = str(handle.backend)
    _handles.pop(name, None)
    _handles[name] = handle
    for oldest in list(_handles)[:-MAX_HANDLES]:
        _handles.pop(oldest, None)  # another thread may have been faster
    return handle


def known_handle(name: str) -> AtlasStore:
    """Return the handle of the store with this name: the handle in the cache, unless the store has been replaced since.

    Raise errors like ``open_store``.
    """
    known = _handles.get(name)
    return open_store(name) if known is None else known.current()


def cached_handle(store: Given, patience: float = LONG_PATIENCE) -> AtlasStore:
    """Return the handle of a store like ``known_handle``, with a backend that waits ``patience`` seconds for a server
    that does not respond.
    """
    backend = with_patience(open_backend(store), patience)
    known = _handles.get(str(backend))
    same = known is not None and known.backend == backend
    return keep_handle(known.with_backend(backend).current() if known is not None and same else open_store(backend))
