"""Functions compiled once and called through a pointer, instead of being compiled again into each calling kernel.

Such a function has one signature. Its pointer is linked by its name, the symbol, which a cached kernel looks up while
it is loaded. Some functions are only for machines whose law of motion changes by more than one rigid contact. They are
compiled when a kernel first receives such a machine; until then their pointers are null.
"""

import ctypes
import inspect
import threading
from collections.abc import Callable
from functools import update_wrapper
from typing import Any

import llvmlite.binding
from llvmlite import ir
from numba import cfunc, config, njit, types
from numba.extending import lower_builtin, type_callable

from workers.kernel.by_reference import make_reference, type_by_reference
from workers.kernel.cache import CACHE, in_own_folder
from workers.kernel.unrolling import not_unrolled

__all__ = ["FLOATS", "INTEGERS", "external", "load"]

FLOATS, INTEGERS = (
    {axes: types.Array(number, axes, "C") for axes in range(1, 7)} for number in (types.float64, types.int64)
)
"""Types of arrays of float64, and of int64, by their number of axes."""

_waiting: dict[bool, list["ExternalFunction"]] = {False: [], True: []}
_loading, _compiles = threading.RLock(), False


def load(modes: bool = False) -> None:
    """Compile the functions called by symbol that are not compiled yet, or load them from the cache on disk.

    They are compiled in the order of their definition. With ``modes`` functions for machines whose law of motion
    changes by more than one rigid contact are included.
    """
    global _compiles
    if not _waiting[False] and not (modes and _waiting[True]):
        return  # without this lock: a compiling thread holds Numba's lock, for which the holder of this lock may wait
    with _loading:  # other threads wait until all are compiled
        if _compiles:  # a function calls only functions defined before it
            return
        _compiles = True
        try:
            for waiting in (_waiting[False], _waiting[True] if modes else []):
                while waiting:
                    waiting[0].compile()
                    waiting.pop(0)
        finally:
            _compiles = False


def external(
    *kinds: types.Type, result: types.Type = types.void, modes: bool = False
) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that makes a function callable by symbol: kernels call it through a pointer with its name.

    kinds   types of the arguments
    result  type of the result, a number
    modes   True if the function is only for machines whose law changes by more than one rigid contact

    Arrays and records are passed by reference, see ``by_reference.py``. The function uses fields of records directly,
    and arrays through ``by_value``.
    """
    return lambda function: function if config.DISABLE_JIT else ExternalFunction(function, kinds, result, modes)  # type: ignore[attr-defined]


class ExternalFunction:
    """A function that kernels call through a pointer linked by the function's name, see ``external``.

    A call from Python compiles the function as a kernel (tests only).
    """

    def __init__(
        self, function: Callable[..., Any], kinds: tuple[types.Type, ...], result: types.Type, modes: bool
    ) -> None:
        self.function, self.result = function, result
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.alone = njit(nogil=True, error_model="numpy")(function)
        update_wrapper(self, function)
        self.reference_types = tuple(map(type_by_reference, kinds))
        self.pointer = ctypes.c_void_p()
        llvmlite.binding.add_symbol(self.name, ctypes.addressof(self.pointer))
        type_callable(self)(self._typed)
        lower_builtin(self, *(types.Any for _ in kinds))(self._code)
        _waiting[modes].append(self)

    def __call__(self, *arguments: Any) -> Any:
        """Call the compiled function."""
        load()
        return self.alone(*arguments)

    def compile(self) -> None:
        """Compile the function, or load it from the cache, and store its address in the pointer that kernels read."""
        with in_own_folder(), not_unrolled():
            self.compiled = cfunc(self.result(*self.reference_types), cache=CACHE is not None, error_model="numpy")(
                self.function
            )
        self.pointer.value = self.compiled.address

    def _typed(self, context: Any) -> Callable[..., Any]:
        def typer(*kinds: types.Type) -> types.Type | None:
            return self.result if tuple(map(type_by_reference, kinds)) == self.reference_types else None

        typer.__signature__ = inspect.signature(self.function)  # type: ignore[attr-defined]
        return typer

    def _code(self, context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        values = [make_reference(context, builder, *typed) for typed in zip(signature.args, arguments, strict=True)]
        values = [
            context.get_value_as_argument(builder, *typed) for typed in zip(self.reference_types, values, strict=True)
        ]
        kind = ir.FunctionType(context.get_argument_type(self.result), [value.type for value in values])
        function = builder.load(context.get_c_value(builder, kind.as_pointer(), self.name))
        result = builder.call(function, values)
        return context.get_argument_value(builder, self.result, result)
