"""Many orbits of one itinerary at once, each at parameters of its own: Newton's method, and whether they attract."""

from collections.abc import Hashable, Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation.admissible import first_fault
from workers.continuation.equations import Impacts, Itinerary, Orbit, check_orbits, linearised, residual, unknown_offset
from workers.continuation.extended import NEWTON_STEPS
from workers.continuation.linear import Family, ModalOscillator, taken
from workers.continuation.minimal import is_minimal
from workers.continuation.stability import multipliers
from workers.model.oscillator import Mode, each

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FARTHEST, DONE = 0.5, 1e-12
"""Newton's first step at most, and its last one, in radians of the force and relative to the fastest impact."""


class Many(NamedTuple):
    """Orbits (N,) of one itinerary at parameters (N, free); where ``found`` is not set Newton's method found none."""

    itinerary: Itinerary
    values: Array
    impacts: Impacts
    found: Mask

    def orbit(self, k: int) -> Orbit:
        """One of them."""
        points = self.impacts
        return Orbit(self.itinerary, points.t[k].copy(), points.v[k].copy(), float(points.offset[k]))


def alike(keys: Iterable[Hashable | None]) -> list[NDArray[np.int64]]:
    """The places of equal keys, in the order in which they are met; none of None."""
    found: dict[Hashable, list[int]] = {}
    for place, key in enumerate(keys):
        if key is not None:
            found.setdefault(key, []).append(place)
    return [np.array(places, dtype=np.int64) for places in found.values()]


def many_of(orbits: list[Orbit], values: Array) -> Many:
    """Orbits of one itinerary as one record."""
    shape = (len(orbits), len(orbits[0].times))
    points = Impacts(
        np.array([orbit.times for orbit in orbits]).reshape(shape),
        np.array([orbit.speeds for orbit in orbits]).reshape(shape),
        np.array([orbit.offset for orbit in orbits]),
    )
    return Many(orbits[0].itinerary, values, points, np.ones(len(orbits), dtype=bool))


def moved(family: Family, orbits: Many, values: Array) -> Many:
    """The orbits near these at other parameters (N, free), by Newton's method on each.

    It fails where steps do not shrink or are long: the orbit found would hardly be the same one.
    """
    lin = family.model(values)[0]
    check_orbits(lin, orbits.itinerary)
    m, N = len(orbits.itinerary.sides), len(values)
    if m == 0:
        return orbits._replace(values=values)
    shift = int(unknown_offset(lin, orbits.itinerary))
    X = np.concatenate([orbits.impacts.t, orbits.impacts.v, orbits.impacts.offset[:, None][:, :shift]], axis=1)
    fastest = np.max(np.abs(orbits.impacts.v), axis=1, keepdims=True)
    time = 1.0 / lin.omega[:, None]
    scale = np.concatenate([np.repeat(time, m, 1), np.repeat(fastest, m, 1), (fastest * time)[:, :shift]], axis=1)
    found, last = np.zeros(N, dtype=bool), np.full(N, FARTHEST)
    open_rows = np.flatnonzero(orbits.found)
    for _ in range(NEWTON_STEPS):
        if not len(open_rows):
            break
        here = taken(lin, open_rows)
        points = _points(X[open_rows], m, shift)
        J = linearised(here, orbits.itinerary, points) * scale[open_rows, None, :]
        right = -residual(here, orbits.itinerary, points)
        step = _solved(J, right)
        size = np.max(np.abs(step), axis=1)
        before = last[open_rows]
        good = size < np.minimum(FARTHEST, 2.0 * before)
        X[open_rows[good]] += (step * scale[open_rows])[good]
        last[open_rows] = size
        done = good & ((size < DONE) | ((size < 1e-10) & (size > 0.3 * before)))  # the latter is rounding
        found[open_rows[done]] = True
        open_rows = open_rows[good & ~done]
    return Many(orbits.itinerary, values, _points(X, m, shift), found)


def attract(family: Family, orbits: Many) -> Mask:
    """Which of the orbits found attract: all multipliers inside the unit circle, admissible, and no shorter one."""
    good = orbits.found.copy()
    rows = np.flatnonzero(good)
    if not len(rows):
        return good
    lin, signals = family.model(orbits.values[rows])
    points = _rows(orbits.impacts, rows)
    with np.errstate(all="ignore"):
        sizes = np.abs(multipliers(lin, orbits.itinerary, points))
    good[rows] = np.all(sizes < 1.0, axis=1)
    for k, row in enumerate(rows):
        if good[row]:
            one, own = np.array([k]), _rows(points, np.array([k]))
            signal = None if signals is None else _one_signal(signals, k)
            good[row] = _is_orbit(taken(lin, one), signal, orbits.itinerary, own)
    return good


def _one_signal(signals: Mode, k: int) -> Mode:
    found: Mode = each(signals, lambda field: field[k])
    return found


def _is_orbit(lin: ModalOscillator, signal: Mode | None, itinerary: Itinerary, points: Impacts) -> bool:
    if not is_minimal(itinerary, points, float(itinerary.span(lin)[0]), float(lin.omega[0])):
        return False
    return signal is None or first_fault(signal, lin, itinerary, points, np.zeros(0)) is None


def _points(X: Array, m: int, shift: int) -> Impacts:
    return Impacts(X[:, :m], X[:, m : 2 * m], X[:, 2 * m] if shift else np.zeros(len(X)))


def _rows(points: Impacts, rows: NDArray[np.int64]) -> Impacts:
    return Impacts(*(field[rows] for field in points))


def _solved(matrices: Array, right: Array) -> Array:
    """The solution of each system; NaN where it is singular."""
    try:
        return np.asarray(np.linalg.solve(matrices, right[..., None])[..., 0])
    except np.linalg.LinAlgError:
        found = np.full(right.shape, np.nan)
        for k, (matrix, side) in enumerate(zip(matrices, right, strict=True)):
            try:
                found[k] = np.linalg.solve(matrix, side)
            except np.linalg.LinAlgError:
                continue
        return found
