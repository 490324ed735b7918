"""The points of an axis at all zoom levels: level 0 has the points of the atlas, each finer level adds the midpoints.

At level k point j lies at the position j / 2^k, counted in cells of the atlas from its first point on. Point j of a
level is point 2 j of the next. Levels are therefore nested, and a point has the same value, to the bit, at every level
that contains the point. Levels below zero leave points out.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.spec.axis import Axis

MIN_STEP_ULPS = 64.0
"""Minimum distance of two points of an axis, in units in the last place of a double.

Closer points would not be evenly spaced.
"""


@dataclass(frozen=True)
class Lattice:
    """The points of an axis at all zoom levels, evenly spaced on the axis's scale between two points of the atlas.

    Beyond the ends of the axis the spacing is that of the first two or the last two points. Raise InputError if the
    axis has only one point.
    """

    axis: Axis

    def __post_init__(self) -> None:
        if len(self.axis) < 2:
            raise InputError(f"axis {self.axis.name}: found one point, must have two or more to be explored")

    @property
    def log(self) -> bool:
        """True if the axis is logarithmic."""
        return self.axis.scale == "log"

    @cached_property
    def _points(self) -> NDArray[np.float64]:
        return np.array(self.axis.values)

    @cached_property
    def deepest(self) -> int:
        """The finest zoom level, whose points still differ by MIN_STEP_ULPS units in the last place of a double."""
        steps = np.diff(self._points) / np.spacing(np.abs(self._points).max())
        return max(0, math.floor(math.log2(float(steps.min()) / MIN_STEP_ULPS)))

    def values(self, level: int, index: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the values (N,) of the points of a zoom level with the indices ``index`` (N,)."""
        if level > 0:
            point_index, rest = np.divmod(index, 1 << level)
            share = rest / (1 << level)  # exact: a power of two
        else:
            point_index, share = index << -level, np.zeros(index.shape)
        cell = np.clip(point_index, 0, self._points.size - 2)
        low, high, along = self._points[cell], self._points[cell + 1], (point_index - cell) + share
        with np.errstate(over="ignore", under="ignore"):
            between = low * (high / low) ** along if self.log else low + (high - low) * along
        is_point = (share == 0.0) & (point_index >= 0) & (point_index < self._points.size)
        return np.where(is_point, self._points[np.clip(point_index, 0, self._points.size - 1)], between)

    def positions(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the positions of axis values, in cells from the atlas's first point on; the inverse of ``values``."""
        cell = np.clip(np.searchsorted(self._points, values, side="right") - 1, 0, self._points.size - 2)
        low, high = self._points[cell], self._points[cell + 1]
        share = np.log(values / low) / np.log(high / low) if self.log else (values - low) / (high - low)
        return np.asarray(cell + share)

    def parts(self, one: float, other: float) -> bool:
        """Return True if two values of the axis differ by more than rounding."""
        first, last = self.positions(np.array([one, other]))
        return bool(abs(last - first) * 2.0**self.deepest * MIN_STEP_ULPS > 1.0)

    def nearest(self, level: int, value: float) -> int:
        """Return the index of the point of a zoom level whose cell contains the axis value ``value``."""
        return math.floor(float(self.positions(np.array([value]))[0]) * 2.0**level + 0.5)

    def edges(self, level: int, first: int, last: int) -> tuple[float, float]:
        """Return the lower edge of cell ``first`` and the upper edge of cell ``last`` of a zoom level."""
        low, high = self.values(level + 1, np.array([2 * first - 1, 2 * last + 1]))
        return float(low), float(high)

    @property
    def ends(self) -> tuple[float, float]:
        """The outer edges of the first and the last cell of the atlas."""
        return self.edges(0, 0, len(self.axis) - 1)

    def level(self, low: float, high: float, pixels: int) -> int:
        """Return the finest zoom level whose cells are not narrower than the pixels of a window.

        low, high   limits of the window
        pixels      width of the window, in pixels

        As in the choice of overviews (coarser copies of an atlas), cells may be narrower than pixels by a factor of
        2^(1/4).
        """
        first, last = self.positions(np.array([low, high]))
        return min(self.deepest, math.floor(math.log2(max(pixels, 1) / float(last - first)) + 0.25))
