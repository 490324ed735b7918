"""The orbits of attractors as equations of their impacts, all of an atlas together."""

import numpy as np

from atlas.orbits.labels.rows import Attractors
from workers.continuation import Family, Orbit, orbit_from_state
from workers.continuation.orbits import alike, many_of, moved, recorded_each


def orbits_of(attractors: Attractors, family: Family) -> list[Orbit | None]:
    """The orbit of each attractor; None where its impacts alone make none: it rests on a stop, or R = 0.

    Times and speeds as they are recorded in one turn from its state, then by Newton's method on all of one itinerary.
    """
    own, count = attractors, len(attractors)
    points = own.values[own.cell]
    given = {p.name: np.full(count, own.fixed.get(p.name, p.default)) for p in own.system.parameters}
    given |= {name: np.ascontiguousarray(points[:, k]) for k, name in enumerate(own.axes)}
    found = recorded_each(own.system, given, own.state, own.period.tolist(), own.symmetric.tolist())
    for rows in alike(None if orbit is None else orbit.itinerary for orbit in found):
        orbits = [orbit for k in rows if (orbit := found[k]) is not None]
        try:
            exact = moved(family, many_of(orbits, points[rows]), points[rows])
        except ValueError:  # R = 0
            exact = None
        for place, k in enumerate(rows.tolist()):
            if exact is not None and exact.found[place]:
                found[k] = exact.orbit(place)
            else:
                found[k] = _alone(own, k)
    return found


def _alone(own: Attractors, k: int) -> Orbit | None:
    """The orbit of attractor k by Newton's method on it alone."""
    given = own.fixed | dict(zip(own.axes, own.values[own.cell[k]].tolist(), strict=True))
    try:
        return orbit_from_state(own.system, given, own.state[k], int(own.period[k]), bool(own.symmetric[k]))
    except ValueError:
        return None
