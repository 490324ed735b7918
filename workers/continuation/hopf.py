"""Curves of Hopf points of equilibria in two parameters.

The equilibrium changes its stability where the curve crosses a circle about a point of it, with the step as radius. The
crossing, located to rounding, is the next point. The method needs no derivative, so that the curve can turn round its
corners at the segments of laws.
"""

import math
from collections.abc import Mapping

import numpy as np

from workers.continuation.branches import (
    BUDGET,
    CLOSED,
    EDGE,
    INADMISSIBLE,
    MAX_POINTS,
    RESOLUTION,
    BranchRun,
    bounds_of,
)
from workers.continuation.equilibria import FOLD, Equilibrium, code_of, equilibrium_near, point_of_event
from workers.continuation.events import SolutionPoint
from workers.continuation.families import Family
from workers.continuation.itinerary import Orbit
from workers.model.oscillator import Array

ANGLES = 24
STEP = 2.0 * math.pi / ANGLES
"""Angle between the points on a circle at which the stability is examined, before a crossing is located by halving."""

SHARP = 1e-13
"""Angle at which the halving of a crossing ends."""

BACK = 0.75 * math.pi
"""Maximum angle by which a curve turns in a step."""


def hopf_curve(
    family: Family,
    orbit: Orbit,
    values: Array,
    window: Mapping[str, tuple[float, float]],
    *,
    resolution: float = RESOLUTION,
    budget: int = MAX_POINTS,
) -> BranchRun:
    """Return the curve of a Hopf point in two free parameters, in both directions from ``values`` (2,).

    family      machines over two free parameters
    orbit       the equilibrium there, see ``equilibria.equilibrium_of``
    values      (2,) parameters of the Hopf point
    window      bounds of both parameters, by name
    resolution  length of a step, as a share of the window
    budget      maximum number of points of either direction

    The orbits of the curve's points have the length of the limit cycle that begins there. The curve ends at the edge of
    the window, where it closes, or after ``budget`` points per direction. It also ends where a real exponent crosses 0
    instead ("fold"), and where the equilibrium ends ("inadmissible"). Raise ValueError if the stability changes nowhere
    around ``values``.
    """
    walk = _HopfCurveWalk(family, orbit, bounds_of(family.free, window), resolution)
    angles = walk.begin(np.asarray(values, dtype=np.float64))
    ahead, end = walk.along(angles[0], budget)
    if end == CLOSED:
        return BranchRun([walk.first, *ahead, walk.first], [], (CLOSED, CLOSED), 0)
    back, other = walk.along(angles[1], budget) if len(angles) > 1 else ([], INADMISSIBLE)
    return BranchRun([*back[::-1], walk.first, *ahead], [], (other, end), 0)


class _HopfCurveWalk:
    """A walk along a curve of Hopf points, with parameters in units of the window; ``first`` is its first point."""

    def __init__(self, family: Family, orbit: Orbit, bounds: Array, length: float) -> None:
        self.family, self.code, self.length = family, code_of(orbit), length
        self.low, self.width = bounds[0], bounds[1] - bounds[0]
        self.least = 0

    def begin(self, values: Array) -> list[float]:
        """Return the directions, as angles, in which the curve leaves its first point."""
        self.start = (values - self.low) / self.width
        counts = [
            equilibrium.unstable
            for angle in self._circle()
            if (equilibrium := self._seen(self.start, angle)) is not None
        ]
        if len(set(counts)) < 2:
            raise ValueError("no equilibrium changes its stability around the Hopf point")
        self.least = min(counts)
        angles = self._crossings(self.start)
        point = self._point(self.start, angles[0]) if angles else None
        if point is None:
            raise ValueError("no pair of exponents crosses the imaginary axis around the Hopf point")
        self.first = point._replace(values=values)
        return angles

    def along(self, angle: float, budget: int) -> tuple[list[SolutionPoint], str]:
        """Return the points of the curve in one direction, at most ``budget``, and why the direction ends.

        ``angle`` is the direction in which the curve leaves its first point.
        """
        center, points = self.start, list[SolutionPoint]()
        while len(points) < budget:
            next_center = center + self.length * np.array([math.cos(angle), math.sin(angle)])
            if np.any((next_center < 0.0) | (next_center > 1.0)):
                edge = self._at_edge(center, next_center)
                return points + ([edge] if edge is not None else []), EDGE
            point = self._point(center, angle)
            if point is None:
                return points, FOLD
            points.append(point)
            if len(points) > 2 and np.linalg.norm(next_center - self.start) < self.length:
                return points, CLOSED
            next_angle = self._onward(next_center, angle)
            if next_angle is None:
                return points, INADMISSIBLE
            center, angle = next_center, next_angle
        return points, BUDGET

    def _equilibrium(self, position: Array) -> Equilibrium | None:
        return equilibrium_near(self.family, self.low + position * self.width, self.code)

    def _seen(self, center: Array, angle: float) -> Equilibrium | None:
        return self._equilibrium(center + self.length * np.array([math.cos(angle), math.sin(angle)]))

    def _is_stable(self, equilibrium: Equilibrium | None) -> bool:
        return equilibrium is not None and equilibrium.unstable <= self.least

    def _circle(self) -> list[float]:
        return [STEP * (k + 0.5) for k in range(ANGLES)]

    def _crossings(self, center: Array) -> list[float]:
        """Return the angles at which the curve crosses the circle about a center (2,), whose radius is a step."""
        angles = self._circle()
        stable = [self._is_stable(self._seen(center, angle)) for angle in angles]
        return [
            self._crossing(center, angles[k] - STEP, stable[k - 1], angles[k])
            for k in range(ANGLES)
            if stable[k - 1] != stable[k]
        ]

    def _onward(self, center: Array, angle: float) -> float | None:
        """Return the angle of the curve's next point, seen from ``center`` (2,); None if the curve would turn back.

        The point is where the curve crosses the circle about the center, nearest to the direction ``angle``.
        """
        ends = [angle - 0.5 * STEP, angle + 0.5 * STEP]
        stable = [self._is_stable(self._seen(center, end)) for end in ends]
        if stable[0] != stable[1]:
            return self._crossing(center, ends[0], stable[0], ends[1])
        for k in range(1, int(BACK / STEP) + 1):
            for side, sign in ((1, 1.0), (0, -1.0)):
                end = angle + sign * (k + 0.5) * STEP
                if self._is_stable(self._seen(center, end)) != stable[side]:
                    return self._crossing(center, ends[side], stable[side], end)
                ends[side] = end
        return None

    def _crossing(self, center: Array, low: float, stable: bool, high: float) -> float:
        """Return the angle, to rounding, at which the curve crosses the circle about ``center`` (2,).

        low, high  angles between which it crosses
        stable     True if the equilibrium is stable at ``low``
        """
        while abs(high - low) > SHARP:
            middle = 0.5 * (low + high)
            if self._is_stable(self._seen(center, middle)) == stable:
                low = middle
            else:
                high = middle
        return high

    def _point(self, center: Array, angle: float) -> SolutionPoint | None:
        """Return the point of the curve in the direction ``angle`` from ``center`` (2,).

        Return None if no pair of exponents crosses the imaginary axis there.
        """
        neighbours = [self._seen(center, angle + sign * 1e-9) for sign in (-1.0, 1.0)]
        return self._between(neighbours, center + self.length * np.array([math.cos(angle), math.sin(angle)]))

    def _between(self, neighbours: list[Equilibrium | None], position: Array) -> SolutionPoint | None:
        seen = sorted(
            (equilibrium for equilibrium in neighbours if equilibrium is not None),
            key=lambda equilibrium: equilibrium.unstable,
        )
        if len(seen) < 2 or len(seen[1].exponents) <= self.least or not seen[1].exponents[self.least].imag:
            return None
        frequency = abs(float(seen[1].exponents[self.least].imag))
        return point_of_event(seen[0], self.least, frequency)._replace(values=self.low + position * self.width)

    def _at_edge(self, start: Array, end: Array) -> SolutionPoint | None:
        """Return the point at which the curve leaves the window between two positions (2,); None if it is not found."""
        axis = int(np.argmax(np.maximum(-end, end - 1.0)))
        edge, other = float(np.clip(end[axis], 0.0, 1.0)), 1 - axis
        share = (edge - start[axis]) / (end[axis] - start[axis])
        position = start + share * (end - start)
        position[axis] = edge

        def at(value: float) -> Equilibrium | None:
            shifted = position.copy()
            shifted[other] = value
            return self._equilibrium(shifted)

        low, high = position[other] - self.length, position[other] + self.length
        before = self._is_stable(at(low))
        if self._is_stable(at(high)) == before:
            return None
        while low < (middle := 0.5 * (low + high)) < high:
            low, high = (middle, high) if self._is_stable(at(middle)) == before else (low, middle)
        position[other] = high
        return self._between([at(high - 1e-9), at(high + 1e-9)], position) if 0.0 <= high <= 1.0 else None
