"""The margin of a point of a plane: the distance to the nearest curve, and the number of that curve.

A curve is given by certified points with straight chords between. The distance to the chords is exact to rounding. From
the chords to the curve it is at most about kappa L^2 / 8 for a chord of length L and a curvature kappa; kappa is that
of the circle through three neighbouring points. Where few points lie on a bend, that is an estimate, not a bound.

The nearest chord is found in two steps. Chords are cut into pieces of equal length at most h. The nearest middle of a
piece, at a distance m, lies on a chord, so that the nearest chord is not farther than m, and the middle of its piece
not farther than m + h/2. The exact distance to each chord with such a piece decides.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

POINTS_PER_BLOCK = 4096
"""Points whose nearest chords are looked for at a time."""


class Chords(NamedTuple):
    """Straight pieces of curves: from ``first`` (N, 2) to ``last`` (N, 2), of ``curve`` (N,), ``away`` (N,) from it.

    A curve without chords is one of length 0.
    """

    first: Array
    last: Array
    curve: Rows
    away: Array


class Margins(NamedTuple):
    """Of each point (N,): the distance to the nearest chord, its curve, and the chord's own distance from the curve."""

    distance: Array
    curve: Rows
    error: Array


def chords_of(curves: Iterable[tuple[Array, NDArray[np.bool_]]]) -> Chords:
    """The chords of curves, given by their points (N, 2) and which of these count: those between two points that do.

    A point that counts between two that do not is a chord of length 0.
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
    """About how far (N - 1,) the chords of a curve through points (N, 2) are from it: kappa L^2 / 8.

    kappa, that of the circle through a point and its neighbours, is the larger one of the two ends.
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
    """The distance of each point (N, 2) to the nearest of the chords, of which there is one at least."""
    from scipy.spatial import cKDTree  # it takes a while to load

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
    """The distance of each point (N, 2) to its own chord, from ``first`` (N, 2) to ``last`` (N, 2)."""
    return np.asarray(np.hypot(*project_onto_chords(points, first, last)[1].T))


def project_onto_chords(points: Array, first: Array, last: Array) -> tuple[Array, Array]:
    """The nearest place on a chord to each point (..., 2), as a share (...) of the chord; the way (..., 2) from there.

    Points and chords broadcast.
    """
    steps, off = last - first, points - first
    square = np.vecdot(steps, steps)
    share = np.clip(np.vecdot(off, steps) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    return share, off - share[..., None] * steps


def find_passages(points: Array, at: Array, near: float) -> list[tuple[int, float]]:
    """Chords of a curve through points (N, 2) nearer than ``near`` to a point (2,), one for each time that it passes.

    The nearest one, by its number, and the share of it. Chords of length 0 do not count.
    """
    shares, way = project_onto_chords(at, points[:-1], points[1:])
    off = np.hypot(*way.T)
    close = np.flatnonzero((off < near) & np.any(points[1:] != points[:-1], axis=1))
    if not len(close):
        return []
    best = [part[np.argmin(off[part])] for part in np.split(close, np.flatnonzero(np.diff(close) > 1) + 1)]
    return [(int(k), float(shares[k])) for k in best]
