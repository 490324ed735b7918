"""a b + c rounded once.

Written out where the solver's time goes. Left to the compiler (``contract``), which product is fused with which sum
depends on what else a function is inlined into, and the last bits of a result with it.
"""

from fractions import Fraction
from math import isfinite
from typing import Any

from numba import types
from numba.extending import intrinsic, overload

__all__ = ["fma"]


def fma(a: float, b: float, c: float) -> float:
    """a b + c of float64 numbers, with one rounding: in kernels one instruction where the processor has it."""
    if not (isfinite(a) and isfinite(b) and isfinite(c)):
        return a * b + c
    return float(Fraction(a) * Fraction(b) + Fraction(c))


def _typed(typingctx: Any, a: Any, b: Any, c: Any) -> Any:
    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), code


_instruction: Any = intrinsic(_typed)


@overload(fma)
def _compiled(a, b, c):
    return lambda a, b, c: _instruction(a, b, c)
