"""The cache folder of compiled kernels on disk.

Numba's cache does not notice an edit in a module other than the kernel's, so the folder's name contains a hash of all
sources of this package. The folder lies in NUMBA_CACHE_DIR if that variable is set. If the folder cannot be written,
there is no cache. Folders of other versions of the sources that have not been used for UNUSED_DAYS are removed.
"""

import hashlib
import multiprocessing
import os
import re
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from numba import config

__all__ = ["CACHE", "in_own_folder"]

UNUSED_DAYS = 30.0
"""Length, in days, of disuse after which the folder of other sources is removed. Several versions on one computer keep
their folders meanwhile."""


def _source_hash() -> str:
    """Return a hash of all sources of the package and of the path of its folder, for the name of the cache folder.

    The path counts since Numba looks kernels up by path and would not find those of a copy.
    """
    package = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256(os.fsencode(package) + b"\0")
    for source in sorted(package.rglob("*.py")):
        digest.update(source.relative_to(package).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def _cache_root() -> Path:
    """Return the user's cache folder: NUMBA_CACHE_DIR, else a folder in XDG_CACHE_HOME or ~/.cache."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return Path(os.environ["NUMBA_CACHE_DIR"])
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "impact-atlas" / "numba"


def _prepare_cache() -> Path | None:
    """Make the cache folder of these sources and return it.

    Return None if it cannot be written. The main process then prints a warning of one line.
    """
    folder = _cache_root() / f"workers-{_source_hash()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            os.utime(folder)  # records the use
    except OSError as error:
        if multiprocessing.parent_process() is None:  # once, not by every worker of a cluster
            reason = f"{folder}: cannot be written ({error.strerror})"
            print(
                f"impact-atlas: {reason}; each process compiles its kernels, set NUMBA_CACHE_DIR to a writable folder",
                file=sys.stderr,
            )
        return None
    if multiprocessing.parent_process() is None:
        _remove_unused(folder)
    return folder


def _remove_unused(current: Path) -> None:
    """Remove the cache folders of other versions of the sources beside ``current`` that are unused for UNUSED_DAYS."""
    oldest = time.time() - UNUSED_DAYS * 86400.0
    for folder in current.parent.glob("workers-*"):
        if folder == current or not re.fullmatch("workers-[0-9a-f]{16}", folder.name):
            continue
        try:
            if not folder.is_symlink() and _last_use(folder) < oldest:
                shutil.rmtree(folder, ignore_errors=True)
        except OSError:  # another process removes it, or writes there
            continue


def _last_use(folder: Path) -> float:
    """Return the time, in seconds since 1970, when the folder was last opened or a file in it was read or written."""
    stats = [path.stat() for path in folder.rglob("*") if path.is_file()]
    return max([folder.stat().st_mtime, *(time for stat in stats for time in (stat.st_mtime, stat.st_atime))])


CACHE = _prepare_cache()
"""The cache folder of the compiled kernels of these sources; None if it cannot be written."""

_lock = threading.RLock()


@contextmanager
def in_own_folder() -> Iterator[None]:
    """Place the cache of the functions that Numba makes within the block in the folder CACHE.

    Other functions keep their own folder. Numba decides on the folder when it makes a function.
    """
    if CACHE is None:
        yield
        return
    with _lock:
        before = config.CACHE_DIR  # type: ignore[attr-defined]
        config.CACHE_DIR = str(CACHE)  # type: ignore[attr-defined]
        try:
            yield
        finally:
            config.CACHE_DIR = before  # type: ignore[attr-defined]
