"""The stable manifold of a saddle of a map of the plane, grown point by point without the inverse of the map.

The points z_0 (the saddle), z_1, ... of a branch lie on the manifold in order. The next point is searched on a circle
about the last one. The map f takes it into the known part, since f moves the manifold towards the saddle. The
directions of a fan about the last step are mapped, and intervals of directions are refined until an image lies on the
known polyline. The radius Delta of the circle adapts to the angle alpha between steps: alpha stays below BEND, and
Delta alpha below SAGITTA times the extent. Deviations across the manifold grow under f, so an error of an image is
smaller at its preimage. Chords therefore bound the accuracy, not the steps.

At a rigid stop, the state before an impact (b, v) and the state after it (b, -R v) are the same. The manifold leaves at
one of them and continues at the other.

England, Krauskopf & Osinga, SIAM J. Appl. Dyn. Syst. 3 (2004) 161; Hobson, J. Comput. Phys. 104 (1993) 14.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from atlas.orbits.curves.chords import distances
from workers.model.oscillator import Array

Map = Callable[[Array], Array]
"""Function that returns the images (N, 2) of states (N, 2), NaN if there is none."""
Across = Callable[[Array, Array], tuple[Array, Array, Array] | None]
"""Function of a state (2,) and a step (2,) that may meet a stop; None if there is no stop on the way.

It returns the state at the stop, the state at which the branch continues, and the direction away from the stop.
"""

FIRST, MIN_STEP, MAX_STEP = 1e-4, 1e-7, 1e-2
"""First, minimum and maximum step, relative to the extent of the box."""
BEND, STRAIGHT, SAGITTA = 0.3, 0.1, 1e-5
"""Maximum angle between steps; angle below which a step may double; maximum of Delta alpha, relative to the extent."""
FAN, WIDE = np.pi / 4.0, 0.8 * np.pi
"""Half angle of the fan of directions; half angle at a sharp bend and after a stop."""
DIRECTIONS, ROUNDS = 17, 12
"""Number of directions that are mapped at once, and of rounds, each in the interval found by the round before."""
ON = 1e-7
"""Distance of an image from the known part, relative to the extent, up to which it counts as on it."""
MAX_POINTS = 4000

LENGTH, OUTSIDE, BUDGET, LOST = "length", "outside", "budget", "lost"
"""Reasons why a branch ends: it has the requested length, leaves the box, has MAX_POINTS points, or cannot be
continued.
"""


@dataclass
class ManifoldBranch:
    """One half of a manifold.

    points  (2,) points in order, from the saddle
    breaks  indices of the points at which the branch starts again at a stop
    end     reason why the branch ends
    """

    points: list[Array]
    breaks: list[int] = field(default_factory=list)
    end: str = ""

    @property
    def pieces(self) -> list[Array]:
        """The pieces between stops, (N, 2) each."""
        return np.split(np.array(self.points), self.breaks)


def grow_manifold(
    image: Map, saddle: Array, direction: Array, box: tuple[Array, Array], length: float, across: Across
) -> ManifoldBranch:
    """Return the branch of the stable manifold that leaves a fixed point along a direction.

    image      the map, with a positive multiplier inside the unit circle: f o f if that of f is negative
    saddle     (2,) the fixed point
    direction  (2,) direction of the branch, of length 1
    box        lowest and highest state; a branch ends one step after it leaves the box
    length     length at which the branch ends
    across     continuation at a stop
    """
    low, high = box
    extent = float(np.linalg.norm(high - low))
    branch = ManifoldBranch([saddle, saddle + FIRST * extent * direction])
    step, grown, at = FIRST * extent, FIRST * extent, 0
    heading, half = direction, FAN
    while True:
        if grown >= length:
            branch.end = LENGTH
        elif np.any(branch.points[-1] < low) or np.any(branch.points[-1] > high):
            branch.end = OUTSIDE
        elif len(branch.points) >= MAX_POINTS:
            branch.end = BUDGET
        if branch.end:
            return branch
        following = _next(image, branch, heading, step, half, at, ON * extent)
        if following is None:
            if step > MIN_STEP * extent:
                step *= 0.5
                continue
            beyond = across(branch.points[-1], 2.0 * step * heading)
            if beyond is None and half < WIDE:
                half = WIDE
                continue
            if beyond is None:
                branch.end = LOST
                return branch
            branch.points.append(beyond[0])
            branch.breaks.append(len(branch.points))
            branch.points.append(beyond[1])
            heading, half, step = beyond[2], WIDE, FIRST * extent
            continue
        point, place = following
        turned = (point - branch.points[-1]) / step
        alpha = float(np.arccos(np.clip(turned @ heading, -1.0, 1.0)))
        new = half == WIDE
        if not new and step > MIN_STEP * extent and (alpha > BEND or step * alpha > SAGITTA * extent):
            step *= 0.5
            continue
        branch.points.append(point)
        grown, at, heading, half = grown + step, place, turned, FAN
        if alpha < STRAIGHT and step * alpha < 0.25 * SAGITTA * extent:
            step = min(2.0 * step, MAX_STEP * extent)


def _next(
    image: Map, branch: ManifoldBranch, heading: Array, step: float, half: float, at: int, tolerance: float
) -> tuple[Array, int] | None:
    """Return the point one step from the last one whose image lies on the branch, and the segment of the image.

    Return None if there is no such point. ``at`` is the segment with the image of the last point.
    """
    points = np.array(branch.points)
    first, last = points[:-1], points[1:]
    real = np.ones(len(first), dtype=np.bool_)
    real[[k - 1 for k in branch.breaks]] = False
    known = np.flatnonzero(real & (np.arange(len(first)) >= at - 1))
    base = np.arctan2(heading[1], heading[0])
    centre, place, whole = base, -1, (base, half)
    for _ in range(ROUNDS):
        for middle, wide in ((centre, half), whole):  # whole: if the image bends too much for half
            angle = np.linspace(middle - wide, middle + wide, DIRECTIONS)
            images = image(points[-1] + step * np.stack([np.cos(angle), np.sin(angle)], axis=1))
            segments = known[_near(images, first[known], last[known])]
            hit = _crossing(images, first[segments], last[segments], np.abs(angle - base))
            if hit is not None or place < 0:
                break
        if hit is None:  # finally images differ only by rounding
            break
        k, share, segment = hit
        between = angle[k + 1] - angle[k]
        centre, place = angle[k] + share * between, int(segments[segment])
        half, whole = between / 8.0, (angle[k] + 0.5 * between, 0.55 * between)
        if np.linalg.norm(images[k + 1] - images[k]) <= 0.1 * tolerance:  # beside a graze images stay far apart
            break
    if place < 0:
        return None
    point = points[-1] + step * np.array([np.cos(centre), np.sin(centre)])
    away = distances(image(point[None]), first[place], last[place])[0]  # NaN where there is no image
    return (point, place) if away <= tolerance else None


def _near(images: Array, first: Array, last: Array) -> NDArray[np.int64]:
    """Return the indices of segments (S, 2) that may meet a polyline of images (D, 2): their boxes overlap its box."""
    low, high = np.fmin.reduce(images, initial=np.inf), np.fmax.reduce(images, initial=-np.inf)  # these ignore NaN
    return np.flatnonzero(np.all((np.maximum(first, last) >= low) & (np.minimum(first, last) <= high), axis=1))


def _crossing(images: Array, first: Array, last: Array, turn: Array) -> tuple[int, float, int] | None:
    """Return where the polyline of images (D, 2) crosses segments (S, 2): image before, share of the way, and segment.

    Of several crossings the one with the least ``turn`` (D,) is returned; None if there is none.
    """
    a, d = images[:-1, None], (images[1:] - images[:-1])[:, None]
    b, e = first[None], (last - first)[None]
    with np.errstate(divide="ignore", invalid="ignore"):
        det = d[..., 0] * e[..., 1] - d[..., 1] * e[..., 0]
        off = b - a
        s = (off[..., 0] * e[..., 1] - off[..., 1] * e[..., 0]) / det
        t = (off[..., 0] * d[..., 1] - off[..., 1] * d[..., 0]) / det
    slack = 1e-9
    hits = (s >= -slack) & (s <= 1.0 + slack) & (t >= -slack) & (t <= 1.0 + slack)
    if not hits.any():
        return None
    rows, columns = np.nonzero(hits)
    best = int(np.argmin(np.minimum(turn[rows], turn[rows + 1])))
    return int(rows[best]), float(s[rows[best], columns[best]]), int(columns[best])
