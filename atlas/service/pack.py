"""Pack a store into one zip file, which every reading command and plain xarray can open."""

import glob
import os
import re
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from atlas.argument_checks import validate_flag, validate_path
from atlas.errors import ChunkError, InputError
from atlas.formatting import PrintableResult, byte_size, plural
from atlas.platform import file_lock, move_whole, temporary_beside
from atlas.service.lease import LeaseObserver
from atlas.service.notebook import progress_reporter
from atlas.service.progress import Progress
from atlas.service.timing import TIMING, Timing
from atlas.store.groups import read_group
from atlas.store.object_backend import Given, open_backend
from atlas.store.schema import groups_of
from atlas.store.sidecar import sidecar_of
from atlas.store.store import AtlasStore, chunk_key, done_tiles, open_store
from atlas.store.zarr_backend import SUFFIX

_SINCE = (1980, 1, 1, 0, 0, 0)
"""Modification date of every member of the zip file; it is constant, so that equal atlases give equal files."""
_PARTIAL = re.compile(r"\.[0-9a-f]{32}\.partial")
SHOWN = 3
"""Maximum number of missing chunks that a message names."""


@dataclass(frozen=True, repr=False)
class PackSummary(PrintableResult):
    """The result of packing a store into a zip file.

    file               path of the zip file
    objects, bytes     number of its objects, and its size
    tiles, tiles_done  numbers of tiles of the atlas: all, and finished ones
    """

    file: str
    objects: int
    bytes: int
    tiles: int
    tiles_done: int

    @property
    def is_complete(self) -> bool:
        """True if every tile is finished."""
        return self.tiles_done == self.tiles

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The facts about the zip file to show, as sentences."""
        packed = f"{self.file}: {plural(self.objects, 'object')}, {byte_size(self.bytes)}"
        if self.is_complete:
            return [(packed,)]
        tiles_text = f"only {self.tiles_done} of {self.tiles} tiles are done"
        rest = f"{tiles_text}: the rest reads as pending, and a zip file cannot be completed; keep the store"
        return [(packed,), (rest,)]

    def as_dict(self) -> dict[str, Any]:
        """Return the dict that ``atlas pack --json`` prints."""
        return super().as_dict() | {"complete": self.is_complete}


def pack(
    store: Given,
    file: str | os.PathLike[str],
    force: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
    timing: Timing = TIMING,
    storage_options: Mapping[str, Any] | None = None,
) -> PackSummary:
    """Pack a store, a folder or a URL, into one zip file; the store stays as it is, and may be incomplete.

    The name of the file ends in .zip. The file appears whole or not at all, and replaces an existing file only with
    ``force``. ``storage_options`` are those of ``open``. Raise ChunkError if a chunk of a finished tile or of a table
    is missing. Raise InputError for another suffix, if the file exists, or if there is no store or it contains links or
    special files. Raise InputError also if a run holds the lease of the store, since the file could then contain part
    of a tile.

    >>> import atlas
    >>> atlas.pack("plane.zarr", "plane.zip").is_complete
    True
    """
    target = validate_path(file, "file").absolute()
    validate_flag("force", force)
    if target.suffix.lower() != SUFFIX:
        raise InputError(f"{file}: must end in {SUFFIX}, by which other commands recognise a zip file")
    if target.is_dir():
        raise InputError(f"{file}: is a folder")
    handle = open_store(store, storage_options)
    if open_backend(target) == handle.backend:
        raise InputError(f"{file}: is the store itself")
    if target.exists() and not force:
        raise InputError(f"{file}: exists already; --force (force=True) replaces it")
    _refuse_running(handle, timing)
    if handle.backend.local is not None:
        _refuse_links(handle.backend.local)
    tiles, keys = done_tiles(handle), sorted(handle.backend.whole_keys(handle.backend.list_keys()))
    _refuse_lost(handle, tiles, set(keys))
    with progress_reporter(on_progress) as report:
        size = _pack(handle, keys, target, report or (lambda _: None), timing)
    return PackSummary(str(file), len(keys), size, handle.tiling.count, len(tiles))


def _pack(handle: AtlasStore, keys: list[str], target: Path, notify: Callable[[Progress], None], timing: Timing) -> int:
    """Write the objects of a store with these keys into a zip file, and return the number of bytes of the file."""

    def members() -> Iterator[tuple[str, bytes]]:
        for k, key in enumerate(keys, 1):
            data = handle.backend.get(key)
            if data is None:
                raise InputError(
                    f"{handle.backend}: {key} was removed meanwhile by a run; pack the store when the run has ended"
                )
            yield key, data
            notify(Progress("packing", detail=f"{k} of {plural(len(keys), 'object')}"))
        _refuse_running(handle, timing)  # a run may have begun meanwhile

    try:
        return write_zip(target, members())
    except OSError as error:
        raise InputError(f"{target}: cannot be packed: {error.strerror or error}") from None


def _refuse_links(store: Path) -> None:
    """Raise InputError if the folder of a store contains a link or a special file."""
    for folder, folders, files in os.walk(store):
        for name in (*folders, *files):
            path = Path(folder) / name
            if path.is_symlink() or not (path.is_dir() or path.is_file()):
                kind = "a link" if path.is_symlink() else "no file"
                raise InputError(f"{store}: {path.relative_to(store)} is {kind}; only folders and files are packed")


def _refuse_lost(handle: AtlasStore, tiles: set[tuple[int, ...]], keys: set[str]) -> None:
    """Raise ChunkError if a chunk of a finished tile is not among the keys, or a table cannot be read.

    handle  the store
    tiles   indices of its finished tiles
    keys    keys of all its objects
    """
    needed = [v for v in handle.variables if not v.sparse]
    lost = [key for index in sorted(tiles) for variable in needed if (key := chunk_key(variable, index)) not in keys]
    if lost:
        raise ChunkError(handle.backend, dict.fromkeys(lost[:SHOWN], "is missing"))
    for group in groups_of(handle.spec):
        read_group(handle, group)


def _refuse_running(handle: AtlasStore, timing: Timing) -> None:
    seen = LeaseObserver(sidecar_of(handle.backend), timing).observe_until_settled()
    if seen is not None and seen.alive is not False and not seen.trouble:
        raise InputError(f"{handle.backend}: leased by another run ({seen.record}); pack it when the run has ended")


@contextmanager
def _held(unfinished: Path, timeout: float = -1) -> Iterator[None]:
    """Hold the lock of an unfinished zip file within the block; the lock file is deleted at the end.

    ``timeout`` is the time in seconds to wait for the lock, -1 for no limit. Raise OSError if another process holds it.
    """
    path = unfinished.with_suffix(".lock")
    path.touch()  # the lock would create a missing folder
    lock = file_lock(path)
    lock.acquire(timeout=timeout)
    try:
        yield
    finally:
        with suppress(OSError):
            path.unlink()
        lock.release()


def write_zip(target: Path, members: Iterable[tuple[str, bytes]]) -> int:
    """Write (name, bytes) members into a zip file, and return its size in bytes. The file appears whole, or not at all.

    Nothing is compressed: chunks already are, and metadata are small. Unlocked files left by killed writers are
    removed.
    """
    begin = f".{target.name}"
    for left in target.parent.glob(f"{glob.escape(begin)}.*.partial"):
        if _PARTIAL.fullmatch(left.name.removeprefix(begin)):
            with suppress(OSError), _held(left, timeout=0):
                left.unlink()
    with temporary_beside(target, ".") as unfinished, ExitStack() as lock:
        with suppress(OSError):  # a file system without locks
            lock.enter_context(_held(unfinished))
        with zipfile.ZipFile(unfinished, "w", zipfile.ZIP_STORED, strict_timestamps=True) as archive:
            for key, data in members:
                member = zipfile.ZipInfo(key, _SINCE)
                member.external_attr = 0o644 << 16
                archive.writestr(member, data)
        size = unfinished.stat().st_size
        move_whole(unfinished, target)
    return size
