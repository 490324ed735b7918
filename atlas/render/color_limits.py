"""Default colour limits: wide enough for nearly all cells, but not for outliers."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BEYOND_EXPONENTS, _BEYOND = 2.0, 0.5
"""Percentages of cells that may lie beyond a default colour limit: of exponents, and of other numbers."""


def scale_ends(largest: Array) -> tuple[float, float]:
    """Return the lower and the upper colour limit for Lyapunov exponents ``largest``, one on each side of zero.

    If all exponents lie on one side, the other side of the scale gets the same size.
    """
    finite = largest[np.isfinite(largest)]
    low, high = _reach(-finite[finite < 0]), _reach(finite[finite > 0])
    return -(low or high or 1.0), high or low or 1.0


def _reach(sizes: Array) -> float:
    """Return a colour limit for positive numbers: a high percentile, rounded up to two digits; 0.0 for no numbers."""
    if sizes.size == 0:
        return 0.0
    reach = float(np.percentile(sizes, 100.0 - _BEYOND_EXPONENTS))
    digit = 10.0 ** (np.floor(np.log10(reach)) - 1.0)
    return float(np.ceil(reach / digit - 1e-9) * digit)


def number_ends(values: Array, log: bool) -> tuple[float, float]:
    """Return the colour limits for the finite values of an array, or with ``log`` for its positive values.

    The limits are percentiles near both ends. Logarithmic limits span at least a decade. If no value counts, the limits
    are 0 and 1, or with ``log`` 0.1 and 1.
    """
    finite = values[np.isfinite(values) & (values > 0.0)] if log else values[np.isfinite(values)]
    if not finite.size:
        return (0.1, 1.0) if log else (0.0, 1.0)
    low, high = (float(end) for end in np.percentile(finite, [_BEYOND, 100.0 - _BEYOND]))
    if log:  # within a decade logarithmic ticks are unreadable
        return min(low, high / 10.0), max(high, low * 10.0 if low == high else high)
    return low, high if high > low else low + 1.0
