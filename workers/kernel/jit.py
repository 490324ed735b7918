"""The one way a kernel is compiled: no GIL, IEEE arithmetic, cached on disk.

The compiler neither reorders nor fuses: what is rounded once is written so, see fma.py. So the bits of a result do not
depend on what was compiled or loaded before it, nor on the processor.

Loops of unknown length stay as they are. Most of them run over a few coordinates, blocks or harmonics; unrolled, they
took 155 s of processor time to compile in place of 109 and cost machines with modes 11 to 17 % of their periods.
"""

import inspect
from collections.abc import Callable
from functools import cached_property, partial, update_wrapper, wraps
from types import ModuleType
from typing import Any

import llvmlite.binding
from numba import config, njit, types
from numba.extending import overload, typeof_impl

from workers.kernel.apart import load
from workers.kernel.cache import CACHE
from workers.kernel.lend import Lent
from workers.model.oscillator import Block, Head, Numbers

__all__ = ["for_modes", "inline_always", "inlined", "kernel", "named_constants"]

llvmlite.binding.set_option("impact-atlas", "-unroll-runtime=false")

_HOW: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}

_PART: Any = _HOW | {"no_cpython_wrapper": True}
"""How parts are compiled, all alike: what they call of Numba's own, such as ``np.zeros``, is compiled for each way."""

_WITHIN: dict[bool, dict[str, Any]] = {False: {}, True: {"inline": "always"}}


class Kernel:
    """A function that Python calls as a kernel of its own, and other kernels as a part of them.

    A part has neither an entry for Python, which unpacks records of arrays and takes as long to compile as what the
    function does, nor a file in the cache. ``within``: its part is no function of its own but compiled with its caller.
    """

    def __init__(self, function: Callable[..., Any], *, within: bool = False, **how: Any) -> None:
        self.py_func, self._within, self._how = function, within, _HOW | how
        update_wrapper(self, function)

    @cached_property
    def alone(self) -> Any:
        """What Python calls. Made at first use: most of the kernels that a process imports it never calls."""
        return njit(cache=CACHE is not None, **self._how)(self.py_func)

    @cached_property
    def part(self) -> Any:
        """What other kernels call; made at first use, which compiles one of them."""
        return njit(**(_PART | self._how), **_WITHIN[self._within])(self.py_func)

    @property
    def targetoptions(self) -> Any:
        """Where Numba looks whether to inline the kernel."""
        return getattr(self.part, "targetoptions", {})

    def __call__(self, *given: Any) -> Any:
        """What the function makes of the arguments, compiled."""
        load()
        return self.alone(*given)


@typeof_impl.register(Kernel)
def _(kernel: Kernel, context: Any) -> types.Dispatcher:
    """What a kernel is in another one."""
    load()
    return types.Dispatcher(kernel.part)


def named_constants(*kinds: Any) -> None:
    """Make records of these kinds to kernels what a module is: names of constants.

    As a tuple a record would be compiled with all its numbers wherever one of them is used.
    """

    def module_of(record: Any, context: Any) -> types.Module:
        module = ModuleType(type(record).__name__)
        vars(module).update(record._asdict())
        return types.Module(module)

    for kind in kinds:
        typeof_impl.register(kind)(module_of)


named_constants(Block, Numbers, Head)

kernel: Callable[[Callable[..., Any]], Any] = Kernel
"""Decorator of every kernel."""

inlined: Callable[[Callable[..., Any]], Any] = partial(Kernel, forceinline=True)
"""Decorator of the small branch-free functions that loops over cells are made of: a call would stop vectorisation."""

inline_always: Callable[[Callable[..., Any]], Any] = partial(Kernel, within=True)
"""Decorator of kernels that are parts of one other or of few, compiled with their caller: a kernel compiles all that it
calls once more, and so would each of those on the way from it to the kernels below."""


def for_modes(act: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator of a kernel that is ``act`` where the oscillator, its first argument, has modes.

    Which of both it is is decided where another kernel is compiled, by the types of what it is given.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        own = kernel(function)

        @wraps(function)
        def chosen(*given: Any) -> Any:
            return (act if given[0].has_modes else own)(*given)

        def pick(*given: types.Type) -> Callable[..., Any]:
            record: Any = given[0].kind if isinstance(given[0], Lent) else given[0]
            modes = record[record.fields.index("table")]
            meant: Callable[..., Any] = (own if isinstance(modes, types.NoneType) else act).py_func
            return meant

        pick.__signature__ = inspect.signature(function)  # type: ignore[attr-defined]
        if not config.DISABLE_JIT:  # type: ignore[attr-defined]
            overload(chosen, jit_options=_PART)(pick)
        return chosen

    return decorate
