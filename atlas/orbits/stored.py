"""Stored cells as orbits: the one way from the results of periodic cells to the equations of their impacts.

An orbit is recorded in one turn of the motion from its stored state, and then found by Newton's method, all of one
itinerary together.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.continuation import Family, Orbit
from workers.continuation.orbits import alike, continued_to, many_of
from workers.continuation.recording import halved, recorded
from workers.results import CYCLE_PERIOD, NO_IMPACT, REGIME

Array = NDArray[np.float64]

NEEDED = (REGIME.name, "period", "symmetric", "state")
"""The variables that an orbit is made of, besides the cell's parameters; without a force also CYCLE_PERIOD."""


def orbits_of(family: Family, points: Array, cells: Mapping[str, NDArray[Any]]) -> list[Orbit | str]:
    """The orbit of each of N periodic cells, exact; or why there is none, in words, as where it rests on a rigid stop.

    points (N, free)   their parameters, those that are free in the family
    cells              the columns NEEDED as the store has them: (N,), of states (N, 2n)
    Motion without impact is its own mirror image wherever the machine has any, whatever the store says.
    Raises NoOscillatorError for a point without a machine.
    """
    if not len(points):
        return []
    machines, still = family.model(points), cells[REGIME.name] == NO_IMPACT
    symmetric = np.where(still, machines.mirrored, cells["symmetric"]).astype(bool)
    lengths = cells[CYCLE_PERIOD.name].tolist() if CYCLE_PERIOD.name in cells else [None] * len(points)
    turns = zip(cells["state"], np.maximum(cells["period"], 1).tolist(), symmetric.tolist(), lengths, strict=True)
    found = list[Orbit | str]()
    for k, turn in enumerate(turns):
        try:
            found.append(recorded(machines.taken(np.array([k])), *turn))
        except ValueError as error:
            found.append(str(error))
    found = _exact(family, found, points)
    for k, orbit in enumerate(found):
        half = halved(machines.taken(np.array([k])), orbit) if isinstance(orbit, Orbit) else orbit
        if half is not orbit:
            (found[k],) = _exact(family, [half], points[k : k + 1])
    return found


def _exact(family: Family, orbits: Sequence[Orbit | str], points: Array) -> list[Orbit | str]:
    """The orbits near these at their points (N, free), to rounding; or why there is none. Words stay."""
    found = list(orbits)
    for rows in alike(orbit.itinerary if isinstance(orbit, Orbit) else None for orbit in orbits):
        same = [orbit for k in rows.tolist() if isinstance(orbit := orbits[k], Orbit)]
        for k, orbit in zip(rows.tolist(), _by_newton(family, same, points[rows]), strict=True):
            found[k] = orbit
    return found


def _by_newton(family: Family, orbits: list[Orbit], points: Array) -> list[Orbit | str]:
    """``_exact`` of orbits of one itinerary."""
    try:
        near = continued_to(family, many_of(orbits, points), points)
    except ValueError as error:
        if len(orbits) == 1:
            return [str(error)]
        return [one for k, orbit in enumerate(orbits) for one in _by_newton(family, [orbit], points[k : k + 1])]
    return [near.orbit(k) if near.found[k] else "Newton's method finds no orbit there" for k in range(len(orbits))]
