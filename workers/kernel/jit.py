"""The one way a kernel is compiled: no GIL, IEEE arithmetic, cached on disk under a key of the sources.

The compiler neither reorders nor fuses: what is rounded once is written so, see fma.py. So the bits of a result do not
depend on what was compiled or loaded before it, nor on the processor.

Numba's cache does not notice an edit in another module, so its folder carries a hash of all sources of
this package. NUMBA_CACHE_DIR is respected where set; a folder that cannot be written means no cache.
"""

import hashlib
import multiprocessing
import os
import sys
import tempfile
from collections.abc import Callable
from functools import partial, update_wrapper
from pathlib import Path
from typing import Any

from numba import config, njit, types
from numba.extending import typeof_impl

__all__ = ["CACHE", "inline_always", "inlined", "kernel", "kernel_and_part", "kernel_within"]


def _source_hash() -> str:
    """Of where the sources lie, too: Numba looks for a kernel by that, and would not find what a copy compiled."""
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
    """Point numba at a folder of these sources alone; None, said in one line, where it cannot be written."""
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
"""The folder of the compiled kernels of these sources; None where there is none."""

_HOW: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}

_NO_ENTRY: dict[str, Any] = {"no_cpython_wrapper": True}

_WITHIN: dict[bool, dict[str, Any]] = {False: {}, True: {"inline": "always"}}


class Kernel:
    """A function that Python calls as a kernel of its own, and other kernels as a part of them.

    A part has neither an entry for Python, which unpacks records of arrays and takes as long to compile as what the
    function does, nor a file in the cache. ``both``: compiled once for either, where a run needs it either way.
    ``within``: its part is no function of its own but compiled with its caller.
    """

    def __init__(self, function: Callable[..., Any], *, both: bool = False, within: bool = False, **how: Any) -> None:
        self.py_func = function
        self.alone = njit(cache=CACHE is not None, **_HOW, **how)(function)
        self.part = self.alone if both else njit(**_HOW, **_NO_ENTRY, **_WITHIN[within], **how)(function)
        self.targetoptions = getattr(self.part, "targetoptions", {})  # where Numba looks whether to inline
        update_wrapper(self, function)

    def __call__(self, *given: Any) -> Any:
        """What the function makes of the arguments, compiled."""
        return self.alone(*given)


@typeof_impl.register(Kernel)
def _(kernel: Kernel, context: Any) -> types.Dispatcher:
    """What a kernel is in another one."""
    return types.Dispatcher(kernel.part)


kernel: Callable[[Callable[..., Any]], Any] = Kernel
"""Decorator of every kernel."""

kernel_and_part: Callable[[Callable[..., Any]], Any] = partial(Kernel, both=True)
"""Decorator of kernels that are parts of others and are called from Python too, other than by tests."""

inlined: Callable[[Callable[..., Any]], Any] = partial(Kernel, forceinline=True)
"""Decorator of the small branch-free functions that loops over cells are made of: a call would stop vectorisation."""

kernel_within: Callable[[Callable[..., Any]], Any] = partial(Kernel, within=True)
"""Decorator of kernels that are parts of few others: a kernel compiles all that it calls once more, and so would each
of those on the way from it to the kernels below."""

inline_always = njit(inline="always", **_HOW)
"""Decorator of parts of one kernel: compiled with their caller, since a kernel compiles all that it calls once more."""
