"""The folder of compiled kernels on disk.

Numba's cache does not notice an edit in another module, so the folder's name has a hash of all sources of this package.
NUMBA_CACHE_DIR is used if set; without a writable folder there is no cache.
"""

import hashlib
import multiprocessing
import os
import sys
import tempfile
from pathlib import Path

from numba import config

__all__ = ["CACHE"]


def _source_hash() -> str:
    """Hash of the sources and their folder: Numba looks kernels up by path and would miss those of a copy."""
    package = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256(os.fsencode(package) + b"\0")
    for source in sorted(package.rglob("*.py")):
        digest.update(source.relative_to(package).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def _cache_root() -> Path:
    """The user's cache folder: NUMBA_CACHE_DIR, else XDG_CACHE_HOME or ~/.cache."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return Path(os.environ["NUMBA_CACHE_DIR"])
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "impact-atlas" / "numba"


def _prepare_cache() -> Path | None:
    """Point numba at a folder for these sources; None, with a one-line warning, if it cannot be written."""
    folder = _cache_root() / f"workers-{_source_hash()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        if multiprocessing.parent_process() is None:  # once, not by every worker of a cluster
            reason = f"{folder} cannot be written ({error.strerror})"
            print(f"impact-atlas: kernels are compiled anew each time, {reason}", file=sys.stderr)
        return None
    config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]
    return folder


CACHE = _prepare_cache()
"""The folder of the compiled kernels of these sources; None if there is none."""
