"""Whether an orbit of the equations is another one in disguise: shorter, or symmetric."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation.equations import Impacts, Itinerary, Orbit

Array = NDArray[np.float64]

SAME = 1e-7
"""Difference of times, in radians of the force, and of speeds, relative, below which two orbits are the same."""


class Reduction(NamedTuple):
    """A turn that may be ``parts`` turns of another orbit, which changes by ``sign`` from one to the next."""

    parts: int
    sign: int


def reductions(itinerary: Itinerary) -> list[Reduction]:
    """The shorter or symmetric orbits whose sides and length allow them to be repeated as this one."""
    sides, m, found = itinerary.sides, len(itinerary.sides), []
    for parts in range(2, m + 1):
        if m % parts:
            continue
        k = m // parts
        for sign in (1, -1):
            closes = sign**parts == itinerary.sign
            repeats = all(sides[i + k] == sign * sides[i] for i in range(m - k))
            halves = itinerary.periods * (1 if itinerary.symmetric else 2)  # half periods of a turn
            fits = halves % parts == 0 and (halves // parts) % 2 == (0 if sign > 0 else 1)
            if closes and repeats and fits:
                found.append(Reduction(parts, sign))
    return found


def difference(itinerary: Itinerary, points: Impacts, span: float, omega: float, to: Reduction) -> Array:
    """How one orbit differs from that orbit repeated: (m,) times in radians of the force, (m,) speeds, relative."""
    t, v, m = points.t[0], points.v[0], len(itinerary.sides)
    k = m // to.parts
    later = np.concatenate([t[k:], t[:k] + span])
    kicks = np.concatenate([v[k:], itinerary.sign * v[:k]])
    return np.concatenate([(later - t - span / to.parts) * omega, (kicks - to.sign * v) / np.max(np.abs(v))])


def is_minimal(itinerary: Itinerary, points: Impacts, span: float, omega: float) -> bool:
    """Whether one orbit is none of those repeated that its itinerary allows."""
    return all(np.max(np.abs(difference(itinerary, points, span, omega, to))) > SAME for to in reductions(itinerary))


def reduced(orbit: Orbit, to: Reduction) -> Orbit:
    """The shorter or symmetric orbit next to one that is nearly that orbit repeated."""
    k = len(orbit.itinerary.sides) // to.parts
    halves = orbit.itinerary.periods * (1 if orbit.itinerary.symmetric else 2) // to.parts
    itinerary = Itinerary(orbit.itinerary.sides[:k], halves if to.sign < 0 else halves // 2, to.sign < 0)
    return Orbit(itinerary, orbit.times[:k].copy(), orbit.speeds[:k].copy(), orbit.offset if to.sign > 0 else 0.0)
