"""Ends of scales: as wide as nearly all cells need, without outliers."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BEYOND_EXPONENTS, _BEYOND = 2.0, 0.5
"""Per cent of cells that may lie beyond an end of a scale of exponents, and of other numbers."""


def scale_ends(largest: Array) -> tuple[float, float]:
    """The ends of the two halves of a scale of exponents, below and above zero.

    A half without cells is as long as the other.
    """
    finite = largest[np.isfinite(largest)]
    low, high = _reach(-finite[finite < 0]), _reach(finite[finite > 0])
    return -(low or high or 1.0), high or low or 1.0


def _reach(sizes: Array) -> float:
    """How far a half of the scale goes: the percentile, rounded up to two digits."""
    if sizes.size == 0:
        return 0.0
    reach = float(np.percentile(sizes, 100.0 - _BEYOND_EXPONENTS))
    digit = 10.0 ** (np.floor(np.log10(reach)) - 1.0)
    return float(np.ceil(reach / digit - 1e-9) * digit)


def number_ends(values: Array, log: bool) -> tuple[float, float]:
    """The ends of a scale of finite values, of positive ones where it is logarithmic: percentiles near both ends.

    A logarithmic scale spans a decade at least. Without such values, the default ends apply.
    """
    finite = values[np.isfinite(values) & (values > 0.0)] if log else values[np.isfinite(values)]
    if not finite.size:
        return (0.1, 1.0) if log else (0.0, 1.0)
    low, high = (float(end) for end in np.percentile(finite, [_BEYOND, 100.0 - _BEYOND]))
    if log:  # nobody reads the ticks of a scale within a decade
        return min(low, high / 10.0), max(high, low * 10.0 if low == high else high)
    return low, high if high > low else low + 1.0
