"""Chords of curves: straight lines between neighbouring points of a curve, and the points that lie near them."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def project_onto_chords(points: Array, first: Array, last: Array) -> tuple[Array, Array]:
    """Return the nearest position on a chord to each point (..., 2), and the vector (..., 2) from there to the point.

    The position is a share (...) of the chord. Points and chords broadcast.
    """
    steps, off = last - first, points - first
    square = np.vecdot(steps, steps)
    share = np.clip(np.vecdot(off, steps) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    return share, off - share[..., None] * steps


def find_passages(points: Array, at: Array, near: float) -> list[tuple[int, float]]:
    """Return the chords of a curve through points (N, 2) that pass a point (2,) within ``near``, one for each passage.

    Each is the nearest chord of the passage: its index, and the share of it. Chords of length 0 do not count.
    """
    shares, offsets = project_onto_chords(at, points[:-1], points[1:])
    off = np.hypot(*offsets.T)
    close = np.flatnonzero((off < near) & np.any(points[1:] != points[:-1], axis=1))
    if not len(close):
        return []
    best = [part[np.argmin(off[part])] for part in np.split(close, np.flatnonzero(np.diff(close) > 1) + 1)]
    return [(int(k), float(shares[k])) for k in best]
