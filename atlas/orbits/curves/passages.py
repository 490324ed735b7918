"""Find the edges between cells that a curve passes within one cell."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from atlas.orbits.curves.chords import project_onto_chords
from atlas.orbits.curves.following import FollowedCurve
from atlas.orbits.curves.plane import Cells, CurvePlane
from workers.continuation import Orbit

Array = NDArray[np.float64]

ONE_CELL = 1.0
"""Maximum distance along either axis, in cells, of a curve from the midpoint of an edge that it counts as passing."""

DISTANCES_PER_BLOCK = 1 << 22
"""Maximum number of distances between edges and chords that are computed at a time, to limit memory."""


class CurvePassage(NamedTuple):
    """A position on a curve, at which the curve passes an edge between cells.

    curve  the curve
    chord  index of the chord, the straight line between two consecutive points of the curve
    share  position on the chord, from 0 at its first point to 1 at its last point
    """

    curve: FollowedCurve
    chord: int
    share: float


def edge_midpoints(plane: CurvePlane, edges: Cells) -> Array:
    """Return the midpoints (E, 2) of edges, each a pair of neighbouring cells, in units of cells."""
    along = len(plane.x)
    return np.stack([(edges % along).mean(axis=1), (edges // along).mean(axis=1)], axis=1)


def find_passed_edges(
    plane: CurvePlane, values: Array, at: Array
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Find the edges between cells that a curve passes within one cell along either axis.

    values (N, 2)  points of the curve, as parameter values
    at (E, 2)      midpoints of the edges, in units of cells

    Return the indices of the passed edges, the index of the chord nearest to each, and the position on that chord, from
    0 at its first point to 1 at its last point.
    """
    points = plane.places(values)
    rows, which, shares = [], [], []
    near = np.flatnonzero(np.all((at > points.min(0) - ONE_CELL) & (at < points.max(0) + ONE_CELL), axis=1))
    for part in np.array_split(near, max(1, len(near) * len(points) // DISTANCES_PER_BLOCK + 1)) if len(near) else []:
        share, offsets = project_onto_chords(at[part][:, None], points[:-1], points[1:])
        distance = np.max(np.abs(offsets), axis=2)
        chord = np.argmin(distance, axis=1)
        row = np.arange(len(part))
        close = distance[row, chord] <= ONE_CELL
        rows.append(part[close])
        which.append(chord[close])
        shares.append(share[row, chord][close])
    if not rows:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0)
    return np.concatenate(rows), np.concatenate(which), np.concatenate(shares)


def orbits_beside(passings: list[CurvePassage]) -> tuple[list[Orbit], Array]:
    """Return the approximate orbits at positions on curves, and the parameters (N, 2) there.

    Orbits and parameters are interpolated between the ends of the chord. If the orbits at the two ends have different
    sequences of impacts and other events, those of the nearer end are returned.
    """
    orbits, values = [], []
    for curve, chord, share in passings:
        first, last = curve.orbits[chord], curve.orbits[chord + 1]
        if first.itinerary != last.itinerary:
            nearer = chord + (share > 0.5)
            orbits.append(curve.orbits[nearer])
            values.append(curve.values[nearer])
            continue
        fields = ((1.0 - share) * a + share * b for a, b in zip(first[1:], last[1:], strict=True))
        orbits.append(Orbit(first.itinerary, *fields))
        values.append((1.0 - share) * curve.values[chord] + share * curve.values[chord + 1])
    return orbits, np.array(values).reshape(-1, 2)
