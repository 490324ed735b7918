"""Functions that kernels call where they lie. All else that a kernel calls it compiles once more, as a part of itself.

Such a function is compiled for one signature and known to the linker by its name. It has to be there before a kernel
that calls it is: one that comes from the cache on disk looks for the name as it is loaded.
"""

import inspect
import threading
from collections.abc import Callable
from functools import update_wrapper
from typing import Any

import llvmlite.binding
from llvmlite import ir
from numba import cfunc, config, njit, types
from numba.core.cgutils import alloca_once_value, get_or_insert_function
from numba.extending import intrinsic, lower_builtin, type_callable

from workers.kernel.borrow import without_counts
from workers.kernel.cache import CACHE

__all__ = ["FLOATS", "apart", "lent", "lent_matrix", "lent_row", "lent_vectors", "load"]

FLOATS = {axes: types.Array(types.float64, axes, "C") for axes in (1, 2, 3, 4)}
"""The types of float64 arrays by their number of axes."""

_waiting: list["Apart"] = []
_loading, _compiles = threading.RLock(), False


def load() -> None:
    """Compile, or load, the functions apart that have not been, in the order in which they stand in the modules."""
    global _compiles
    with _loading:  # other threads wait until they are all there
        if _compiles:  # what is compiled calls none but those before it
            return
        _compiles = True
        try:
            while _waiting:
                _waiting[0].compile()
                _waiting.pop(0)
        finally:
            _compiles = False


def apart(*kinds: types.Type, result: types.Type = types.void) -> Callable[[Callable[..., Any]], Any]:
    """Decorator of a function of arguments of these types that kernels call where it lies.

    It gets arrays and records by address, and has to take each of them with ``lent``; its result is a number.
    """
    return lambda function: function if config.DISABLE_JIT else Apart(function, kinds, result)  # type: ignore[attr-defined]


class Apart:
    """See apart. Called from Python it is compiled as a kernel of its own, which only tests do."""

    def __init__(self, function: Callable[..., Any], kinds: tuple[types.Type, ...], result: types.Type) -> None:
        self.function, self.kinds, self.result = function, kinds, result
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.alone = njit(nogil=True, error_model="numpy")(function)
        update_wrapper(self, function)
        type_callable(self)(self._typed)
        lower_builtin(self, *kinds)(self._code)
        _waiting.append(self)

    def __call__(self, *given: Any) -> Any:
        """What the function makes of the arguments."""
        load()
        return self.alone(*given)

    def compile(self) -> None:
        """Compile the function, or load it, and make it known to the linker."""
        signature = self.result(*(types.voidptr if _has_memory(kind) else kind for kind in self.kinds))
        self.compiled = cfunc(signature, cache=CACHE is not None, error_model="numpy")(self.function)
        llvmlite.binding.add_symbol(self.name, self.compiled.address)

    def _typed(self, context: Any) -> Callable[..., Any]:
        def typer(*given: types.Type) -> types.Type | None:
            return self.result if given == self.kinds else None

        typer.__signature__ = inspect.signature(self.function)  # type: ignore[attr-defined]
        return typer

    def _code(self, context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        given = []
        for kind, value in zip(self.kinds, arguments, strict=True):
            if _has_memory(kind):
                given.append(builder.bitcast(alloca_once_value(builder, value), ir.IntType(8).as_pointer()))
            else:
                given.append(context.get_value_as_argument(builder, kind, value))
        kind = ir.FunctionType(context.get_argument_type(self.result), [value.type for value in given])
        found = builder.call(get_or_insert_function(builder.module, kind, self.name), given)
        return context.get_argument_value(builder, self.result, found)


def lent(kind: types.Type) -> Any:
    """What takes an array or record of this type that a function apart is given, borrowed from who calls it."""
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return lambda given: given

    def typed(typingctx: Any, given: types.Type) -> Any:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            value = arguments[0]
            if by_address:
                value = builder.load(builder.bitcast(value, context.get_value_type(kind).as_pointer()))
            return without_counts(context, builder, found, value)

        by_address = given == types.voidptr
        found = kind if by_address else given  # as Python gave it
        return found(given), code

    return intrinsic(typed)


def _has_memory(kind: types.Type) -> bool:
    return isinstance(kind, types.BaseTuple | types.Array)


lent_row, lent_matrix, lent_vectors = lent(FLOATS[1]), lent(FLOATS[2]), lent(FLOATS[3])
"""The float64 arrays that a function apart is given: (n,), (n, m), and tangent vectors (m, n, 2)."""
