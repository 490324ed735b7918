"""Loops of unknown length are not unrolled in kernels of this package; kernels of others are compiled as ever.

LLVM has no such option of one function: it is set while a kernel of this package is compiled.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import llvmlite.binding
from numba.core import event

__all__ = ["not_unrolled"]

_OWN = __name__.partition(".")[0] + "."

_depth = 0
"""Kernels of this package that are being compiled, one for another."""


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
    """Compile without unrolling loops of unknown length."""
    _enter()
    try:
        yield
    finally:
        _leave()


class _Compiling(event.Listener):
    """Sets the option while Numba compiles a function of this package."""

    def on_start(self, event: event.Event) -> None:
        """Numba holds its lock here: no other thread compiles."""
        if _is_own(event):
            _enter()

    def on_end(self, event: event.Event) -> None:
        if _is_own(event):
            _leave()


def _is_own(event: event.Event) -> bool:
    return str(event.data["dispatcher"].py_func.__module__).startswith(_OWN)


event.register("numba:compile", _Compiling())
