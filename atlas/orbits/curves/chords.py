"""The margin of a point of a plane: the distance to the nearest curve, and the number of that curve.

A curve is given by certified points with straight chords between them. The distance to the chords is exact to rounding.
The distance from the chords to the curve is at most about kappa L^2 / 8, for a chord of length L and a curvature kappa
of the circle through three neighbouring points. With few points on a bend, that is an estimate, not a bound.

The nearest chord is found in two steps. Chords are cut into pieces of equal length, at most h. The nearest midpoint of
a piece, at a distance m, lies on a chord. The nearest chord is therefore not farther than m, and the midpoint of its
piece not farther than m + h/2. The exact distance to each chord with such a piece decides.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

POINTS_PER_BLOCK = 4096
"""Number of points whose nearest chords are searched at a time."""


class Chords(NamedTuple):
    """Chords of curves. A curve without chords has one of length 0.

    first (N, 2)  first point
    last (N, 2)   last point
    curve (N,)    number of the curve
    away (N,)     estimated distance of the chord from the curve
    """

    first: Array
    last: Array
    curve: Rows
    away: Array


class Margins(NamedTuple):
    """The margin of each point (N,).

    distance (N,)  distance to the nearest chord
    curve (N,)     number of the chord's curve
    error (N,)     estimated distance of the chord from the curve
    """

    distance: Array
    curve: Rows
    error: Array


def chords_of(curves: Iterable[tuple[Array, NDArray[np.bool_]]]) -> Chords:
    """Return the chords of curves between two neighbouring points that both count.

    Each curve is given by its points (N, 2) and the mask of points that count. A point that counts between two that do
    not is a chord of length 0.
    """
    pieces = [(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, dtype=np.int64), np.zeros(0))]
    for number, (points, counts) in enumerate(curves):
        both = np.flatnonzero(counts[:-1] & counts[1:])
        alone = np.setdiff1d(np.flatnonzero(counts), np.append(both, both + 1))
        begins, ends = np.append(both, alone), np.append(both + 1, alone)
        away = np.append(sagittas(points)[both], np.zeros(len(alone)))
        pieces.append((points[begins], points[ends], np.full(len(begins), number), away))
    return Chords(*(np.concatenate(parts) for parts in zip(*pieces, strict=True)))


def sagittas(points: Array) -> Array:
    """Return approximately how far (N - 1,) the chords of a curve through points (N, 2) are from the curve: kappa L^2 /
    8.

    kappa is the curvature of the circle through a point and its neighbours; the larger one of both ends is used.
    """
    steps = np.diff(points, axis=0)
    lengths = np.hypot(*steps.T)
    if len(points) < 3:
        return np.full(len(steps), np.nan)
    area = np.abs(steps[:-1, 0] * steps[1:, 1] - steps[:-1, 1] * steps[1:, 0])
    product = lengths[:-1] * lengths[1:] * np.hypot(*(points[2:] - points[:-2]).T)
    inner = np.where(product > 0.0, 2.0 * area / np.where(product > 0.0, product, 1.0), 0.0)
    curvature = np.concatenate([inner[:1], inner, inner[-1:]])
    return np.asarray(np.maximum(curvature[:-1], curvature[1:]) * lengths**2 / 8.0)


def margins(points: Array, chords: Chords) -> Margins:
    """Return the margin of each point (N, 2) to the nearest of the chords; there must be at least one chord."""
    from scipy.spatial import cKDTree  # slow to import

    steps = chords.last - chords.first
    lengths = np.hypot(*steps.T)
    h = max(float(np.mean(lengths)), float(lengths.max()) / 64.0)
    parts = np.maximum(1, np.ceil(lengths / h if h > 0.0 else lengths)).astype(np.int64)
    owner = np.repeat(np.arange(len(lengths)), parts)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)
    share = (number + 0.5) / parts[owner]
    middles = chords.first[owner] + share[:, None] * steps[owner]
    half = 0.5 * lengths / parts
    tree = cKDTree(middles)
    nearest, piece = tree.query(points)
    best, chord = np.full(len(points), np.inf), owner[piece]
    for rows in np.array_split(np.arange(len(points)), max(1, len(points) // POINTS_PER_BLOCK)):
        reach = (nearest[rows] + float(half.max(initial=0.0))) * (1.0 + 1e-12)
        near = tree.query_ball_point(points[rows], reach)
        counts = np.array([len(places) for places in near], dtype=np.int64)
        row, candidate = np.repeat(rows, counts), owner[np.concatenate([*near, []]).astype(np.int64)]
        away = distances(points[row], chords.first[candidate], chords.last[candidate])
        order = np.lexsort((candidate, away, row))
        first = order[np.unique(row[order], return_index=True)[1]]
        best[rows], chord[rows] = away[first], candidate[first]
    return Margins(best, chords.curve[chord], chords.away[chord])


def distances(points: Array, first: Array, last: Array) -> Array:
    """Return the distance of each point (N, 2) to its own chord, from ``first`` (N, 2) to ``last`` (N, 2)."""
    return np.asarray(np.hypot(*project_onto_chords(points, first, last)[1].T))


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
    shares, way = project_onto_chords(at, points[:-1], points[1:])
    off = np.hypot(*way.T)
    close = np.flatnonzero((off < near) & np.any(points[1:] != points[:-1], axis=1))
    if not len(close):
        return []
    best = [part[np.argmin(off[part])] for part in np.split(close, np.flatnonzero(np.diff(close) > 1) + 1)]
    return [(int(k), float(shares[k])) for k in best]
