"""The text of a kernel for another device: the same function, and all kernels that it calls, by another decorator.

``numba.cuda.jit(device=True)`` makes device functions of them. Where a round of lanes is meant, give each thread a lane
and an array of its own: all loops over lanes are of one turn then.
"""

from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any

from workers.kernel.jit import Kernel

__all__ = ["translated"]


def translated(decorate: Callable[[Any], Any]) -> Callable[[Kernel], Any]:
    """What makes a function for another device of a kernel: its text decorated so, calling others made alike.

    Of kernels that choose by the types of what they are given, ``for_modes``, there is none.
    """

    @cache
    def translate(kernel: Kernel) -> Any:
        text = kernel.py_func
        names = {name: text.__globals__[name] for name in text.__code__.co_names if name in text.__globals__}
        scope = {name: translate(value) if isinstance(value, Kernel) else value for name, value in names.items()}
        made = FunctionType(text.__code__, {"__builtins__": __builtins__} | scope, text.__name__, text.__defaults__)
        return decorate(made)

    return translate
