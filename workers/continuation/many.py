"""Many orbits of one itinerary at once, each at parameters of its own: Newton's method, and whether they attract."""

from collections.abc import Hashable, Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation.admissible import first_fault
from workers.continuation.equations import (
    Impacts,
    Itinerary,
    Motion,
    Orbit,
    check_orbits,
    impacts_of,
    linearised,
    residual,
    unknown_offset,
    unpacked,
)
from workers.continuation.newton import Array, Rows, newton
from workers.continuation.oscillator import Family
from workers.continuation.same import is_minimal
from workers.continuation.stability import multipliers
from workers.model.oscillator import taken

Mask = NDArray[np.bool_]

FARTHEST = 0.5
"""Newton's first step at most, in radians of the force and relative to the fastest impact."""


class Many(NamedTuple):
    """Orbits (N,) of one itinerary at parameters (N, free); where ``found`` is not set Newton's method found none."""

    itinerary: Itinerary
    values: Array
    impacts: Impacts
    found: Mask

    def orbit(self, k: int) -> Orbit:
        """One of them."""
        return self.impacts.orbit(self.itinerary, k)


def alike(keys: Iterable[Hashable | None]) -> list[NDArray[np.int64]]:
    """The places of equal keys, in the order in which they are met; none of None."""
    found: dict[Hashable, list[int]] = {}
    for place, key in enumerate(keys):
        if key is not None:
            found.setdefault(key, []).append(place)
    return [np.array(places, dtype=np.int64) for places in found.values()]


def many_of(orbits: list[Orbit], values: Array) -> Many:
    """Orbits of one itinerary as one record."""
    return Many(orbits[0].itinerary, values, impacts_of(*orbits), np.ones(len(orbits), dtype=bool))


def moved(family: Family, orbits: Many, values: Array) -> Many:
    """The orbits near these at other parameters (N, free), by Newton's method on each.

    It fails where steps do not shrink or are long: the orbit found would hardly be the same one.
    """
    lin, itinerary, before = family.model(values), orbits.itinerary, orbits.impacts
    check_orbits(lin, itinerary)
    m, shift = len(itinerary.sides), int(unknown_offset(lin, itinerary))
    if m == 0 or not orbits.found.any():
        return orbits._replace(values=values)
    fastest, time = np.max(np.abs(before.v), axis=1, keepdims=True), 1.0 / lin.omega[:, None]
    scale = np.repeat(np.concatenate([time, fastest, fastest * time], axis=1), [m, m, shift], axis=1)

    def motion(X: Array, rows: Rows) -> Motion:
        return taken(lin, known[rows]), itinerary, unpacked(X, m, shift)

    known = np.flatnonzero(orbits.found)
    X = np.concatenate([before.t, before.v, before.offset[:, None][:, :shift]], axis=1)
    found = newton(
        lambda X, rows: residual(*motion(X, rows)),
        lambda X, rows: (residual(*motion(X, rows)), linearised(*motion(X, rows))),
        X[known],
        scale[known],
        farthest=FARTHEST,
    )
    X[known] = found.X
    return Many(itinerary, values, unpacked(X, m, shift), np.isin(np.arange(len(X)), known[found.converged]))


def attract(family: Family, orbits: Many) -> Mask:
    """Which of the orbits found attract: all multipliers inside the unit circle, admissible, and no shorter one."""
    good = orbits.found.copy()
    rows = np.flatnonzero(good)
    if not len(rows):
        return good
    motion = family.model(orbits.values[rows]), orbits.itinerary, taken(orbits.impacts, rows)
    with np.errstate(all="ignore"):
        good[rows] = np.all(np.abs(multipliers(*motion)) < 1.0, axis=1)
    for k in np.flatnonzero(good[rows])[:, None]:
        one = taken(motion[0], k), orbits.itinerary, taken(motion[2], k)
        good[rows[k]] = is_minimal(*one) and not (family.certified and first_fault(*one))
    return good
