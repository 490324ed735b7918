"""Handles of the stores in use by this process: read once, and again after a change."""

from collections.abc import Hashable
from threading import Lock

from atlas.store.location import Place, beside, place_of, waiting
from atlas.store.outage import LONG
from atlas.store.records import Records
from atlas.store.store import ROOT, Atlas, open_handle

_reading = Lock()
_records: dict[Place, Records] = {}
_headers: dict[tuple[Place, float], tuple[Hashable, Atlas]] = {}
"""Handles by place and patience, each with the state of the store's root."""


def known_handle(store: str | Place, patience: float = LONG) -> Atlas:
    """The handle of a store, after one check of its root's state; errors as of ``open_handle``."""
    place = waiting(place_of(store), patience)
    version = place.version(ROOT)
    with _reading:  # the threads of a worker come at once
        known = _headers.get((place, patience))
        if known is None or known[0] != version:
            known = _headers[place, patience] = version, open_handle(place)
            _records.pop(place, None)
    return known[1]


def known_records(handle: Atlas) -> Records:
    """The records of the tiles of a store that no longer changes."""
    if handle.place not in _records:
        _records[handle.place] = Records(handle)
    return _records[handle.place]


def forget_handle(store: str | Place, patience: float = LONG) -> None:
    """Drop the handles of a store and of its origin."""
    place = place_of(store)
    known = _headers.pop((place, patience), None)
    _records.pop(place, None)
    if known is not None and known[1].origin is not None:
        forget_handle(beside(place, known[1].origin.store))
