"""Colour scales: how numbers become colours, as plain data, and their default limits.

Limits are wide enough for nearly all cells, but not for outliers. The page computes the same colours to the bit.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from atlas.render import kinds, looks

Array = NDArray[np.float64]
Colors = NDArray[np.uint8]

LINEAR, LOG, TWO_SIDED = "linear", "log", "two-sided"
"""Forms of a scale; a two-sided scale is linear on either side of zero, which lies in its middle."""
BELOW = ("#0b2520", "#1e4d44", "#3f7b70", "#6faaa0", "#a9d3cb")
"""Colours of negative numbers on a scale of both signs, from the largest to the smallest."""
_PALEST = "#f6f4f4"
"""Colour of zero on a scale of both signs."""
_STEPS = 512

_BEYOND_EXPONENTS, _BEYOND = 2.0, 0.5
"""Percentages of cells that may lie beyond a default colour limit: of exponents, and of other numbers."""


@cache
def color_table(colors: tuple[str, ...], steps: int = _STEPS, places: tuple[float, ...] = ()) -> Colors:
    """Return colours (steps, 3) interpolated between given ones, evenly spaced or at ``places`` from 0 to 1."""
    at, given = np.linspace(0.0, 1.0, steps), np.array([looks.rgb(color) for color in colors], np.float64)
    between = places or tuple(np.linspace(0.0, 1.0, len(colors)))
    table = np.rint(np.stack([np.interp(at, between, channel) for channel in given.T], axis=1)).astype(np.uint8)
    table.setflags(write=False)
    return table


def pick(table: Colors, shares: Array | float) -> Colors:
    """Return the colours (..., 3) at ``shares`` of a table, from 0 at its first to 1 at its last colour."""
    return np.asarray(table[np.clip(np.floor(np.multiply(shares, len(table))), 0, len(table) - 1).astype(np.intp)])


# The step in hue at zero keeps the border of chaos sharp between small exponents of both signs.
EXPONENT = color_table(
    (*kinds.STABLE, *kinds.CHAOTIC),
    1024,
    (*np.linspace(0.0, 0.5, len(kinds.STABLE)), *np.linspace(0.5, 1.0, len(kinds.CHAOTIC))),
)
CHAOS = color_table(kinds.CHAOTIC)


def both_signs(above: tuple[str, ...]) -> Colors:
    """Return colours for limits symmetric about zero, pale in the middle; ``above`` are those of positive numbers."""
    return color_table((*BELOW, _PALEST, *above[1:]), 1024)


@dataclass(frozen=True, eq=False)
class ColorMapping:
    """How numbers become colours.

    form    LINEAR, LOG or TWO_SIDED
    ends    the lower and the upper colour limit
    above   colours from the lower to the upper limit, if zero does not lie inside or has no colour of its own
    both    colours for limits symmetric about zero, which replace ``above`` if zero lies inside the limits; or None
    """

    form: str
    ends: tuple[float, float]
    above: Colors
    both: Colors | None = None

    @cached_property
    def table(self) -> Colors:
        """The colours (n, 3) from the lower to the upper limit; both signs darken equally with distance from zero."""
        low, high = self.ends
        if self.both is None or not low < 0.0 < high:
            return self.above
        return pick(self.both, 0.5 + 0.5 * (np.linspace(low, high, _STEPS) / max(-low, high)))

    def colors(self, values: Array) -> Colors:
        """Return the colours (..., 3) of values.

        On a logarithmic scale zero, which has no logarithm, gets the colour of the lower limit, and so does NaN.
        """
        low, high = self.ends
        clipped = np.maximum(np.where(np.isnan(values), low, values), low)
        if self.form == TWO_SIDED:
            shares = np.where(clipped < 0.0, (0.5 / -low) * (clipped - low), (0.5 / high) * clipped + 0.5)
        elif self.form == LOG:
            shares = (np.log10(clipped) - np.log10(low)) / (np.log10(high) - np.log10(low))
        else:
            shares = (clipped - low) / (high - low) if high > low else 0.0 * clipped
        return pick(self.table, shares)

    def hex(self, value: float) -> str:
        """Return the colour of a value as "#rrggbb"."""
        return "#" + self.colors(np.array(value)).tobytes().hex()


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
