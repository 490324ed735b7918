"""Notes that several processes share at a URL: written only if absent, or only if what is there is what was read.

A run claims a store by one of them. An object store makes each write one act (If-None-Match, If-Match); it has no
removal under a condition, so that a note that was removed under one is empty, which reads and counts as none.
"""

from dataclasses import dataclass, replace
from urllib.parse import urlsplit

from atlas.errors import InputError
from atlas.store.location import ObjectPlace

_REMOVED = b""


@dataclass(frozen=True)
class UrlNotes:
    """Notes as small objects under one prefix."""

    place: ObjectPlace

    def read(self, name: str) -> bytes | None:
        """A note's bytes, None where there is none."""
        return self.place.get(name) or None

    def put(self, name: str, data: bytes, expected: bytes | None) -> bool:
        """Write a note if it is absent (``expected`` None) or holds the expected bytes; False, unwritten, if not."""
        if expected is None and self.place.put_new(name, data):
            return True
        found = self.place.get_tagged(name)
        return found is not None and found[0] == (expected or _REMOVED) and self.place.put_if(name, data, found[1])

    def remove(self, name: str, expected: bytes) -> bool:
        """Remove a note that holds the expected bytes; False where it does not."""
        return self.put(name, _REMOVED, expected)

    def clear(self, keep: str) -> None:
        """Remove all notes but one, for good; only the holder of that one may."""
        self.place.remove_all(name for name in self.place.list_keys() if name != keep)

    def drop(self, name: str) -> None:
        """Remove a note, whatever it holds."""
        self.place.remove(name)


def notes_at_url(store: ObjectPlace) -> UrlNotes:
    """The notes of a store at a URL, next to it: ``s3://bucket/.plane.zarr.run/`` for ``s3://bucket/plane.zarr``."""
    above, _, name = str(store).rpartition("/")
    if not urlsplit(str(store)).path.strip("/"):
        raise InputError(f"{store}: a store needs a name below the bucket, such as {store}/plane.zarr")
    return UrlNotes(replace(store, url=f"{above}/.{name}.run"))
