"""Results of functions of arrays, kept for further calls with the same bits.

Cells solved one by one, and the steps of Newton's method, ask for machines whose matrices are those of the last ones.
"""

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

MAX_RESULTS = 64
"""Results kept of one function."""

MAX_ARGUMENT_BYTES = 8192
"""Most bytes of the arguments of a kept result: many machines seldom come again."""

Made = TypeVar("Made")


def memoize_arrays(make: Callable[..., Made]) -> Callable[..., Made]:
    """A function of arrays whose last results are kept, by the bits of the arrays: nothing changes them in place."""

    @lru_cache(MAX_RESULTS)
    def made_of_bits(shapes: tuple[Any, ...], bits: tuple[bytes, ...]) -> Made:
        return make(*(np.ndarray(shape, kind, raw) for (shape, kind), raw in zip(shapes, bits, strict=True)))

    @wraps(make)
    def made(*arrays: NDArray[Any]) -> Made:
        if sum(array.nbytes for array in arrays) > MAX_ARGUMENT_BYTES:
            return make(*arrays)
        shapes, bits = zip(*(((array.shape, array.dtype), array.tobytes()) for array in arrays), strict=True)
        return made_of_bits(shapes, bits)

    return made
