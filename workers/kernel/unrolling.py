"""Compilation of the kernels of this package without unrolling loops whose number of rounds is unknown.

Kernels of other packages are compiled as usual. LLVM, Numba's compiler, has no such option for one function. The option
is therefore set while a kernel of this package is compiled.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import llvmlite.binding
from numba.core import event

__all__ = ["not_unrolled"]

_OWN = __name__.partition(".")[0] + "."

_depth = 0
"""Number of kernels of this package that are being compiled, each for another one."""


def _enter() -> None:
    global _depth
    _depth += 1
    if _depth == 1:
        llvmlite.binding.set_option("impact-atlas", "-unroll-runtime=false")


def _leave() -> None:
    global _depth
    _depth -= 1
    if _depth == 0:
        llvmlite.binding.set_option("impact-atlas", "-unroll-runtime=true")


@contextmanager
def not_unrolled() -> Iterator[None]:
    """Compile within the block without unrolling loops whose number of rounds is unknown."""
    _enter()
    try:
        yield
    finally:
        _leave()


class _Compiling(event.Listener):
    """Listener to Numba that switches loop unrolling off while a function of this package is compiled."""

    def on_start(self, event: event.Event) -> None:
        """Switch loop unrolling off. Numba holds its lock here, so no other thread compiles."""
        if _is_own(event):
            _enter()

    def on_end(self, event: event.Event) -> None:
        if _is_own(event):
            _leave()


def _is_own(event: event.Event) -> bool:
    return str(event.data["dispatcher"].py_func.__module__).startswith(_OWN)


event.register("numba:compile", _Compiling())
