"""Headers of stores that this process works on or copies from: read once, and again where a store has changed."""

from collections.abc import Hashable
from threading import Lock

from atlas.store.location import Place, beside, place_of, waiting
from atlas.store.outage import LONG
from atlas.store.records import Records
from atlas.store.store import ROOT, Header, read_header

_reading = Lock()
_records: dict[Place, Records] = {}
_headers: dict[tuple[Place, float], tuple[Hashable, Header]] = {}
"""By place and patience: each with the state of the store's root."""


def known_header(store: str | Place, patience: float = LONG) -> Header:
    """The header of a store, by one look at the state of its root; errors as of ``read_header``."""
    place = waiting(place_of(store), patience)
    version = place.version(ROOT)
    with _reading:  # the threads of a worker come at once
        known = _headers.get((place, patience))
        if known is None or known[0] != version:
            known = _headers[place, patience] = version, read_header(place)
            _records.pop(place, None)
    return known[1]


def known_records(header: Header) -> Records:
    """The records of the tiles of a store that changes no more."""
    if header.place not in _records:
        _records[header.place] = Records(header)
    return _records[header.place]


def forget_header(store: str | Place, patience: float = LONG) -> None:
    """Drop what is kept of a store, and of the one that it copies cells from."""
    place = place_of(store)
    known = _headers.pop((place, patience), None)
    _records.pop(place, None)
    if known is not None and known[1].origin is not None:
        forget_header(beside(place, known[1].origin.store))
