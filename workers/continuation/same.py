"""Whether two orbits are one: the same motion, begun later by some forcing periods, or its mirror image."""

import numpy as np
from numpy.typing import NDArray

from workers.continuation.equations import Orbit

Array = NDArray[np.float64]

SAME = 1e-7
"""Difference of times, in radians of the force, and of speeds, relative, below which two orbits are the same."""


def distance(one: Orbit, other: Orbit, omega: float) -> float:
    """The largest difference between two orbits at the same parameters, of times in radians of the force and of speeds
    relative to the fastest impact; over all phases and both mirror images the smallest. Infinite for other itineraries.

    Mirror images are compared whatever the machine: of one that is not its own, none is an orbit of it.
    """
    a, b = one.itinerary, other.itinerary
    if (a.periods, a.symmetric, len(a.sides)) != (b.periods, b.symmetric, len(b.sides)):
        return np.inf
    if not a.sides:
        return 0.0
    sides_a, times_a, speeds_a = whole(one, omega)
    sides_b, times_b, speeds_b = whole(other, omega)
    length, fastest = 2.0 * np.pi * a.periods, np.max(np.abs(speeds_a))
    best = np.inf
    for mirror in (1, -1):
        for turn in range(len(sides_b)):
            sides = mirror * np.roll(sides_b, -turn)
            if not np.array_equal(sides, sides_a):
                continue
            later = np.roll(times_b + length * (np.arange(len(times_b)) < turn), -turn) - times_a
            # whole forcing periods apart, an image half a period more
            unit = later - (0.0 if mirror > 0 else np.pi)
            shift = 2.0 * np.pi * np.round(np.mean(unit) / (2.0 * np.pi))
            speeds = mirror * np.roll(speeds_b, -turn) - speeds_a
            best = min(best, max(np.max(np.abs(unit - shift)), np.max(np.abs(speeds)) / fastest))
    return float(best)


def same_orbit(one: Orbit, other: Orbit, omega: float, tolerance: float = SAME) -> bool:
    """Whether two orbits at the same parameters are the same up to phase and mirror image."""
    return distance(one, other, omega) < tolerance


def whole(orbit: Orbit, omega: float) -> tuple[Array, Array, Array]:
    """Sides, times in radians of the force and speeds of all impacts of an orbit, in order from the first one given."""
    sides, times, speeds = np.array(orbit.itinerary.sides), orbit.times * omega, orbit.speeds
    if orbit.itinerary.symmetric:
        half = np.pi * orbit.itinerary.periods
        sides, speeds = np.concatenate([sides, -sides]), np.concatenate([speeds, -speeds])
        times = np.concatenate([times, times + half])
    return sides, times, speeds
