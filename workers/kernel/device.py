"""Translation of kernels for another device: a kernel and all kernels that it calls are decorated anew from their code.

``numba.cuda.jit(device=True)`` makes device functions of the kernels. For a round of lanes, give each thread one lane
and its own array; all loops over lanes then run once.
"""

from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any

from workers.kernel.jit import Kernel

__all__ = ["make_translator"]


def make_translator(decorate: Callable[[Any], Any]) -> Callable[[Kernel], Any]:
    """Return a function that translates a kernel, with all kernels that it calls, by the decorator ``decorate``.

    Functions called by symbol, see ``external``, cannot be translated.
    """

    @cache
    def translate(kernel: Kernel) -> Any:
        text = kernel.py_func
        names = {name: text.__globals__[name] for name in text.__code__.co_names if name in text.__globals__}
        scope = {name: translate(value) if isinstance(value, Kernel) else value for name, value in names.items()}
        copy = FunctionType(text.__code__, {"__builtins__": __builtins__} | scope, text.__name__, text.__defaults__)
        return decorate(copy)

    return translate
