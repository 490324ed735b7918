"""Geometry of curves as polylines: the chords, straight lines between consecutive points, and points near them."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def project_onto_chords(points: Array, first: Array, last: Array) -> tuple[Array, Array]:
    """Project points (..., 2) onto chords, each the straight line between two consecutive points of a curve.

    points (..., 2)  points
    first (..., 2)   first points of the chords
    last (..., 2)    last points of the chords

    Return the nearest position (...) on the chord, from 0 at its first to 1 at its last point, and the vector (..., 2)
    from there to the point. The arguments broadcast.
    """
    steps, off = last - first, points - first
    square = np.vecdot(steps, steps)
    share = np.clip(np.vecdot(off, steps) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    return share, off - share[..., None] * steps


def find_passages(points: Array, at: Array, near: float) -> list[tuple[int, float]]:
    """Return each passage of a curve, a polyline through points (N, 2), within distance ``near`` of a point ``at``
    (2,).

    A passage is given by its chord nearest to the point: the index of the chord, and the nearest position on it, from 0
    at its first point to 1 at its last point. Chords of length 0 do not count.
    """
    shares, offsets = project_onto_chords(at, points[:-1], points[1:])
    off = np.hypot(*offsets.T)
    close = np.flatnonzero((off < near) & np.any(points[1:] != points[:-1], axis=1))
    if not len(close):
        return []
    best = [part[np.argmin(off[part])] for part in np.split(close, np.flatnonzero(np.diff(close) > 1) + 1)]
    return [(int(k), float(shares[k])) for k in best]
