"""Which parts of lines run beside another line, and would hide what lies between. Lengths are in points."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

Array = NDArray[np.float64]

_STEP = 2.0
"""Distance between the points of a line that are looked at."""
_SHORTEST = 21
"""Such points over which the majority decides: dashes begin anew with each part, and lines that cross stay whole."""


def dense(line: Array) -> tuple[Array, Array]:
    """Points (M, 2) along a line, _STEP apart at most, and the line's length up to each."""
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T)))
    at = np.linspace(0.0, along[-1], 2 + int(along[-1] / _STEP))
    return np.column_stack([np.interp(at, along, line[:, i]) for i in range(2)]), at


def parts(lines: Sequence[Array], places: Sequence[Array], distance: float) -> Iterator[tuple[int, Array, bool]]:
    """Lines cut into parts: the number of the line, the part, and whether another line runs within ``distance`` of it.

    ``lines`` are (N, 2) each, ``places`` the same in points. Another part of the same line counts too where it is
    three times as far along the line.
    """
    if not lines:
        return
    found, lengths = zip(*map(dense, places), strict=True)
    everywhere, length = np.concatenate(found), np.concatenate(lengths)
    line = np.repeat(np.arange(len(lines)), [len(each) for each in found])
    near = np.zeros(len(everywhere), dtype=bool)
    one, two = KDTree(everywhere).query_pairs(distance, output_type="ndarray").T
    beside = (line[one] != line[two]) | (np.abs(length[one] - length[two]) > 3.0 * distance)
    near[one[beside]] = near[two[beside]] = True
    for k, (piece, place) in enumerate(zip(lines, places, strict=True)):
        smooth = ndimage.median_filter(near[line == k], _SHORTEST, mode="nearest")
        along = np.append(0.0, np.cumsum(np.hypot(*np.diff(place, axis=0).T)))
        crowded = smooth[np.searchsorted(lengths[k], along[:-1]).clip(max=len(smooth) - 1)]  # each step of the line
        for first, last in pairwise([0, *(np.flatnonzero(np.diff(crowded)) + 1), len(crowded)]):
            yield k, piece[first : last + 1], bool(crowded[first])
