"""Decorators that compile all kernels in one way: without the GIL, in IEEE arithmetic, cached on disk.

The compiler neither reorders operations nor fuses them; products to be fused are written with ``fma.py``. The bits of a
result therefore depend neither on the order of compilation or loading nor on the processor.

Loops of unknown length are not unrolled, see ``unrolling.py``. Most of these loops run over a few coordinates or
harmonics. Unrolled loops took 155 s of processor time to compile instead of 109 s. They also made the simulation of
machines with more than one rigid contact 11 to 17 % slower.
"""

from collections.abc import Callable
from functools import cached_property, partial, update_wrapper
from types import ModuleType
from typing import Any

from numba import njit, types
from numba.extending import typeof_impl

from workers.kernel.cache import CACHE, in_own_folder
from workers.kernel.external import load
from workers.model.oscillator import Block, ForcedBounds, OscillatorScalars

__all__ = ["inline_always", "inlined", "kernel", "named_constants"]

_HOW: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}

_PART: Any = _HOW | {"no_cpython_wrapper": True}
"""Compilation options of all inner kernels: Numba's own functions, such as ``np.zeros``, are compiled once per set of
options."""

_WITHIN: dict[bool, dict[str, Any]] = {False: {}, True: {"inline": "always"}}


class Kernel:
    """A function that is compiled twice: once for calls from Python, and once for calls from other compiled functions.

    The second form, an inner kernel, has no file in the cache and no entry for Python. That entry unpacks records of
    arrays and takes as long to compile as the function itself. With ``within`` the inner kernel is compiled into its
    caller.
    """

    def __init__(self, function: Callable[..., Any], *, within: bool = False, **how: Any) -> None:
        self.py_func, self._within, self._how = function, within, _HOW | how
        update_wrapper(self, function)

    @cached_property
    def python_kernel(self) -> Any:
        """The compiled function that Python calls, made at first use, since a process never calls most kernels."""
        with in_own_folder():
            return njit(cache=CACHE is not None, **self._how)(self.py_func)

    @cached_property
    def inner_kernel(self) -> Any:
        """The compiled function that other kernels call, made at first use while one of these kernels is compiled."""
        return njit(**(_PART | self._how), **_WITHIN[self._within])(self.py_func)

    @property
    def targetoptions(self) -> Any:
        """Options in which Numba looks up whether to inline the kernel."""
        return getattr(self.inner_kernel, "targetoptions", {})

    def __call__(self, *arguments: Any) -> Any:
        """Call the compiled function."""
        load()
        return self.python_kernel(*arguments)


@typeof_impl.register(Kernel)
def _(kernel: Kernel, context: Any) -> types.Dispatcher:
    """Return the Numba type of a Kernel that occurs as a name in another kernel."""
    load()
    return types.Dispatcher(kernel.inner_kernel)


def named_constants(*kinds: Any) -> None:
    """Let kernels read the fields of these classes of named tuples as named constants, like those of a module.

    If such a tuple were passed as a tuple, all its numbers would be compiled in wherever one of its numbers is used.
    """

    def module_of(record: Any, context: Any) -> types.Module:
        module = ModuleType(type(record).__name__)
        vars(module).update(record._asdict())
        return types.Module(module)

    for kind in kinds:
        typeof_impl.register(kind)(module_of)


named_constants(Block, ForcedBounds, OscillatorScalars)

kernel: Callable[[Callable[..., Any]], Any] = Kernel
"""Decorator of every kernel."""

inlined: Callable[[Callable[..., Any]], Any] = partial(Kernel, forceinline=True)
"""Decorator of small branch-free functions called in loops over cells: a call would stop vectorisation."""

inline_always: Callable[[Callable[..., Any]], Any] = partial(Kernel, within=True)
"""Decorator of inner kernels that one or a few other kernels call, compiled into their caller. Otherwise each caller,
and every kernel in between, would compile all callees once more."""
