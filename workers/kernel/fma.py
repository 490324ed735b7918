"""The fused product and sum a b + c, with one rounding, and polynomials made of it.

Both are written explicitly where the solver spends its time. With LLVM's ``contract`` flag the compiler would choose
which product to fuse with which sum, depending on the function it inlines into. The last bits of a result would depend
on that choice.
"""

from fractions import Fraction
from math import isfinite
from typing import Any

from numba import types
from numba.core.cgutils import unpack_tuple
from numba.extending import lower_builtin, type_callable

__all__ = ["fma", "horner"]

FLOAT = types.float64


def fma(a: float, b: float, c: float) -> float:
    """Return a b + c of float64 numbers with one rounding; in kernels one instruction if the processor has it."""
    if not (isfinite(a) and isfinite(b) and isfinite(c)):
        return a * b + c
    exact = Fraction(a) * Fraction(b) + Fraction(c)
    return float(exact) if exact else a * b + c  # keeps the sign of zero


def horner(coefficients: tuple[float, ...], x: float) -> float:
    """Return the value at x of the polynomial with these coefficients, highest power first."""
    total = coefficients[0]
    for coefficient in coefficients[1:]:
        total = fma(total, x, coefficient)
    return total


@type_callable(fma)
def _fma_typed(context: Any) -> Any:
    return lambda a, b, c: FLOAT(FLOAT, FLOAT, FLOAT)


@lower_builtin(fma, FLOAT, FLOAT, FLOAT)
def _fma_compiled(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    return builder.fma(*arguments)


@type_callable(horner)
def _horner_typed(context: Any) -> Any:
    return lambda coefficients, x: FLOAT(coefficients, FLOAT)


@lower_builtin(horner, types.UniTuple, FLOAT)
def _horner_compiled(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    coefficients, x = unpack_tuple(builder, arguments[0]), arguments[1]
    total = coefficients[0]
    for coefficient in coefficients[1:]:
        total = builder.fma(total, x, coefficient)
    return total
