"""Equality of two orbits: up to a shift by forcing periods, as mirror images, as a shorter orbit repeated."""

from functools import cache
from itertools import product

import numpy as np

from workers.continuation.itinerary import Itinerary, Orbit
from workers.continuation.shooting import OrbitMotion
from workers.model.oscillator import Array

SAME_ORBIT = 1e-7
"""Maximum difference between equal orbits: of times, in radians of the force, and of speeds, relative."""


def distance(one: Orbit, other: Orbit, omega: float) -> float:
    """Return the distance of two orbits at the same parameters, the smallest over all phases and both mirror images.

    The distance is the largest difference of times, in radians of the force, and of speeds, relative to the fastest
    impact. It is infinite for different sequences of events. Cycles may begin at any time, and their times count in
    radians of their own turn. Mirror images are compared for every machine: the image of an orbit is no orbit of a
    machine that is not symmetric.
    """
    a, b = one.itinerary, other.itinerary
    if (a.periods, a.symmetric, len(a.sides)) != (b.periods, b.symmetric, len(b.sides)):
        return np.inf
    halves = np.pi * a.periods / omega
    one, other = (
        double_orbit(orbit, float(orbit.length) if a.is_cycle else halves) if a.symmetric else orbit
        for orbit in (one, other)
    )
    if a.is_cycle:  # so that a turn is 2 pi
        omega = 2.0 * np.pi / float(one.length)
    sides, others = np.array(one.itinerary.sides), np.array(other.itinerary.sides)
    duration = float(other.length) if a.is_cycle else 2.0 * np.pi * a.periods / omega
    times, m = np.append(other.times, other.times + duration), len(sides)
    best, longer = np.inf if m else 0.0, omega * abs(duration - float(one.length)) if a.is_cycle else 0.0
    for mirror, turn in product((1, -1), range(m)):
        if np.array_equal(mirror * np.roll(others, -turn), sides):
            # a whole number of forcing periods, plus a half for mirror images
            later = omega * (times[turn : turn + m] - one.times) - (0.0 if mirror > 0 else np.pi)
            later -= np.mean(later) if a.is_cycle else 2.0 * np.pi * np.round(np.mean(later) / (2.0 * np.pi))
            speeds = mirror * np.roll(other.speeds, -turn) - one.speeds
            best = min(best, max(np.max(np.abs(later)), np.max(np.abs(speeds)) / np.max(np.abs(one.speeds)), longer))
    return float(best)


def is_same_orbit(one: Orbit, other: Orbit, omega: float, tolerance: float = SAME_ORBIT) -> bool:
    """Return True if two orbits at the same parameters are equal up to phase and mirror image."""
    return distance(one, other, omega) < tolerance


def double_orbit(orbit: Orbit, span: float) -> Orbit:
    """Return two turns of length ``span`` as one orbit: the whole of a symmetric orbit, else the orbit twice."""
    times = np.append(orbit.times, orbit.times + span)
    speeds = np.append(orbit.speeds, orbit.itinerary.sign * orbit.speeds)
    return Orbit(orbit.itinerary.twice, times, speeds, 2.0 * orbit.length)


@cache
def beginnings(one: Itinerary, other: Itinerary) -> tuple[int, ...]:
    """Return the indices of events of an orbit from which on it has the sequence of events of another orbit.

    one    itinerary, the sequence of events and of the linear equations between them, of the orbit
    other  itinerary of the other orbit

    Indices of events in the second half of a symmetric orbit follow those of the first. The result is empty if the
    events differ, and (0,) if there are no events.
    """
    if (one.periods, one.symmetric, len(one.sides)) != (other.periods, other.symmetric, len(other.sides)):
        return ()
    full, target = _sequence(one.twice if one.symmetric and one.sides else one), _sequence(other)
    turned = ((k, full[k:] + full[:k]) for k in range(len(full)))
    return tuple(k for k, sequence in turned if sequence[: len(target)] == target)


def _sequence(itinerary: Itinerary) -> list[tuple[int, tuple[object, ...]]]:
    sides = itinerary.sides or (0,)
    return [(side, tuple(leg.code for leg in legs)) for side, legs in zip(sides, itinerary.chains, strict=True)]


def begun_with(orbit: Orbit, first: int, itinerary: Itinerary, span: float) -> Orbit:
    """Return an orbit with event ``first`` as its first one.

    orbit      the orbit
    first      index of the event, one of the ``beginnings`` of the orbit
    itinerary  sequence of the events from that event on
    span       length of a turn
    """
    turns, events = np.divmod(first + np.arange(len(orbit.times)), max(1, len(orbit.times)))
    times = orbit.times[events] + turns * span
    speeds = orbit.speeds[events] * np.where(turns % 2 == 0, 1.0, itinerary.sign)
    return Orbit(itinerary, times - times[0] if itinerary.is_cycle else times, speeds, orbit.length)


@cache
def reductions(itinerary: Itinerary) -> tuple[Itinerary, ...]:
    """Return the itineraries, sequences of events, of shorter or symmetric orbits that have this one if repeated."""
    sides, m, shorter = itinerary.sides, len(itinerary.sides), list[Itinerary]()
    halves = itinerary.periods * (1 if itinerary.symmetric else 2)  # half periods of a turn; 0 for a cycle
    for parts in (parts for parts in range(2, m + 1) if m % parts == halves % parts == 0):
        k, length = m // parts, halves // parts
        for sign in (1, -1):
            fits = itinerary.is_cycle or length % 2 == (sign < 0)
            if fits and sign**parts == itinerary.sign and itinerary.repeats(k, sign):
                periods = length if sign < 0 else length // 2
                shorter.append(Itinerary(sides[:k], periods, sign < 0, itinerary.legs[:k]))
    return tuple(shorter)


def difference(motion: OrbitMotion, to: Itinerary) -> Array:
    """Return how an orbit differs from a shorter orbit repeated: differences (2m,) of times, then of speeds.

    ``to`` is the itinerary, the sequence of events, of the shorter orbit.

    Times are in radians of the force; speeds are relative to the fastest one.
    """
    itinerary, t, v, _ = motion.orbits.at_rows(0)
    k, span = len(to.sides), motion.span[0]
    later = np.concatenate([t[k:], t[:k] + span]) - t - span / (len(t) // k)
    speeds = np.concatenate([v[k:], itinerary.sign * v[:k]])
    return np.concatenate([later * motion.lin.omega[0], (speeds - to.sign * v) / np.max(np.abs(v))])


def is_minimal(motion: OrbitMotion) -> bool:
    """Return True if an orbit is no repetition of a shorter orbit that its sequence of events allows."""
    return all(np.max(np.abs(difference(motion, to))) > SAME_ORBIT for to in reductions(motion.itinerary))


def reduce_orbit(orbit: Orbit, to: Itinerary) -> Orbit:
    """Return the shorter orbit, with the sequence of events ``to``, that an orbit nearly repeats."""
    k = len(to.sides)
    length = orbit.length * k / len(orbit.times)
    return Orbit(to, orbit.times[:k].copy(), orbit.speeds[:k].copy(), length)
