"""The stable manifold of a saddle of a map of the plane, grown point by point without the inverse of the map.

The points z_0 (the saddle), z_1, ... of a branch lie on the manifold in order. The next one is looked for on a circle
about the last one: f maps it into the part that is known, since f draws the manifold towards the saddle. The directions
of a fan about the last step are mapped, and the one whose image lies on the known polyline is found by sections of
intervals. The radius Delta of the circle adapts to the angle alpha between steps: alpha below
BEND, and Delta alpha below SAGITTA times the extent. Deviations across the manifold grow by f, so that an error of an
image is smaller at its preimage: chords bound the accuracy, not the steps.

At a rigid stop a state before an impact, (b, v), and after it, (b, -R v), are one: the manifold leaves at the one and
continues at the other.

England, Krauskopf & Osinga, SIAM J. Appl. Dyn. Syst. 3 (2004) 161; Hobson, J. Comput. Phys. 104 (1993) 14.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from atlas.orbits.curves.chords import distances
from workers.model.oscillator import Array

Map = Callable[[Array], Array]
"""Images (N, 2) of states (N, 2), NaN for states that are none."""
Across = Callable[[Array, Array], tuple[Array, Array, Array] | None]
"""Of a state (2,) and a step (2,) that meets a stop: the state there, the one at which the branch continues, and the
direction away from the stop; None if there is no stop on the way.
"""

FIRST, MIN_STEP, MAX_STEP = 1e-4, 1e-7, 1e-2
"""Steps relative to the extent of the picture: the first, the shortest and the longest."""
BEND, STRAIGHT, SAGITTA = 0.3, 0.1, 1e-5
"""Largest angle between steps; that below which a step may double; largest Delta alpha relative to the extent."""
FAN, WIDE = np.pi / 4.0, 0.8 * np.pi
"""Half of the fan of directions; at a sharp bend, and after a stop."""
DIRECTIONS, ROUNDS = 17, 12
"""Directions that are mapped at once, and rounds, each in the interval that the last one has found."""
ON = 1e-7
"""Distance of an image from the known part, relative to the extent, at which its point is taken to lie on it."""
MAX_POINTS = 4000

LENGTH, OUTSIDE, BUDGET, LOST = "length", "outside", "budget", "lost"
"""Why a branch ends: it has the requested length; it leaves the box; MOST_POINTS; no direction leads on."""


@dataclass
class ManifoldBranch:
    """One half of a manifold: points (N, 2) in order, from the saddle; ``breaks``: points that begin anew at a stop."""

    points: list[Array]
    breaks: list[int] = field(default_factory=list)
    end: str = ""

    @property
    def pieces(self) -> list[Array]:
        """Its parts between stops."""
        return np.split(np.array(self.points), self.breaks)


def grow_manifold(
    image: Map, saddle: Array, direction: Array, box: tuple[Array, Array], length: float, across: Across
) -> ManifoldBranch:
    """The branch of the stable manifold that leaves a fixed point along a direction, both of length-1 coordinates.

    image    the map, of a positive multiplier inside: f o f where it is negative
    box      lowest and highest state; a branch ends a step after it leaves
    length   at which it ends
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
    """The point a step from the last one whose image lies on the branch, and the segment it lies on; None without one.

    at   segment of the branch on which the image of the last point lies
    """
    points = np.array(branch.points)
    first, last = points[:-1], points[1:]
    real = np.ones(len(first), dtype=np.bool_)
    real[[k - 1 for k in branch.breaks]] = False
    known = np.flatnonzero(real & (np.arange(len(first)) >= at - 1))
    base = np.arctan2(heading[1], heading[0])
    centre, place, whole = base, -1, (base, half)
    for _ in range(ROUNDS):
        for middle, wide in ((centre, half), whole):  # the second if the image bends so much that the first misses it
            angle = np.linspace(middle - wide, middle + wide, DIRECTIONS)
            images = image(points[-1] + step * np.stack([np.cos(angle), np.sin(angle)], axis=1))
            segments = known[_near(images, first[known], last[known])]
            hit = _crossing(images, first[segments], last[segments], np.abs(angle - base))
            if hit is not None or place < 0:
                break
        if hit is None:  # at last the images differ by rounding alone
            break
        k, share, segment = hit
        between = angle[k + 1] - angle[k]
        centre, place = angle[k] + share * between, int(segments[segment])
        half, whole = between / 8.0, (angle[k] + 0.5 * between, 0.55 * between)
        if np.linalg.norm(images[k + 1] - images[k]) <= 0.1 * tolerance:  # beside a graze they are far apart for long
            break
    if place < 0:
        return None
    point = points[-1] + step * np.array([np.cos(centre), np.sin(centre)])
    away = distances(image(point[None]), first[place], last[place])[0]  # NaN where there is no image
    return (point, place) if away <= tolerance else None


def _near(images: Array, first: Array, last: Array) -> NDArray[np.int64]:
    """Which segments (S, 2) may meet a polyline of images (D, 2): their boxes meet its box."""
    low, high = np.fmin.reduce(images, initial=np.inf), np.fmax.reduce(images, initial=-np.inf)  # which pass over NaN
    return np.flatnonzero(np.all((np.maximum(first, last) >= low) & (np.minimum(first, last) <= high), axis=1))


def _crossing(images: Array, first: Array, last: Array, turn: Array) -> tuple[int, float, int] | None:
    """Where the polyline of images (D, 2) crosses segments (S, 2): after which image and at which share, which segment.

    Of several the one of the least ``turn`` (D,). None without any.
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
