"""A cache for functions of arrays: results are kept for further calls with the same bits.

Cells that are solved one by one, and steps of Newton's method, often need machines with the matrices of the previous
call.
"""

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

MAX_RESULTS = 64
"""Maximum number of results kept of one function."""

MAX_ARGUMENT_BYTES = 8192
"""Maximum number of bytes of the arguments of a kept result, since batches of many machines seldom occur again."""

Made = TypeVar("Made")


def memoize_arrays(make: Callable[..., Made]) -> Callable[..., Made]:
    """Return the function with a cache of its last results, by the bits of its array arguments.

    The results are shared between calls and must not be changed in place.
    """

    @lru_cache(MAX_RESULTS)
    def call_with_bits(shapes: tuple[Any, ...], bits: tuple[bytes, ...]) -> Made:
        return make(*(np.ndarray(shape, kind, raw) for (shape, kind), raw in zip(shapes, bits, strict=True)))

    @wraps(make)
    def call(*arrays: NDArray[Any]) -> Made:
        if sum(array.nbytes for array in arrays) > MAX_ARGUMENT_BYTES:
            return make(*arrays)
        shapes, bits = zip(*(((array.shape, array.dtype), array.tobytes()) for array in arrays), strict=True)
        return call_with_bits(shapes, bits)

    return call
