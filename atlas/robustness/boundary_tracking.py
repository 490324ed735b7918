"""Saddles on the boundaries of basins: the unstable orbits that decide which attractor a motion reaches.

Where a boundary between two basins is smooth, it is the stable manifold of an unstable orbit with a single multiplier
outside the unit circle. A motion on the boundary tends to that orbit, which is found as follows. Two states with a
boundary between them are bisected until their distance is BRACKET. Both are then mapped from t = k T to t = (k + 1) T,
with forcing period T, again and again. When they are more than RESTART_DISTANCE apart, they are bisected again. What
stays between them is a motion on the boundary. Once that motion recurs after q periods, Newton's method on P^q(z) - z,
with P the map over one period, gives the orbit, and its Jacobian the multipliers. The left eigenvector l of the
multiplier outside the unit circle is the normal of the stable manifold: deviations dz along the manifold have l dz = 0.

Skufca, Yorke & Eckhardt, Phys. Rev. Lett. 96 (2006) 174101 (edge tracking).
"""

from dataclasses import dataclass
from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from atlas.orbits.orbit_table import are_on_orbit
from atlas.robustness.fatal_shock import CHAOS_STATES, NO_MOTION, reached_labels
from atlas.robustness.linear_measures import not_smooth
from atlas.robustness.section_map import SectionMap
from workers.attractors.basins import AttractorTable, section_points
from workers.model.oscillator import Array
from workers.results import UNKNOWN_LABEL

BRACKET, RESTART_DISTANCE = 1e-10, 1e-6
"""Distances of the two states on either side of the boundary, after a bisection and before the next.

Both are relative to the distance of the two states at first.
"""
MAX_STEPS, BURN = 400, 12
"""Maximum number of forcing periods for which a boundary is tracked, and number before recurrence is tested."""
MAX_PERIOD, RECURRENCE_DISTANCE = 12, 1e-3
"""Maximum period of a saddle, and distance within which the motion on the boundary counts as having recurred.

The distance is relative to that of the first two states.
"""
PARTS = 8
"""Number of parts into which an interval is divided in each step of the bisection."""
MAX_ATTEMPTS, NEWTON, CLOSED = 12, 30, 1e-11
"""Maximum numbers of Newton searches for a saddle and of steps in each, and largest residual of a converged search.

The residual is relative to the largest component of the orbit's states.
"""
ASIDE = 1e-5
"""Size of the deviations, relative to the saddle's states, that show which basins meet at a saddle."""


@dataclass(frozen=True, eq=False)
class Saddle:
    """An unstable orbit on the boundary between two basins, with one multiplier outside the unit circle.

    states (q, 2n)     states at t = k T, the start of each forcing period, in physical coordinates
    multipliers (2n,)  Floquet multipliers of the whole orbit
    normal (q, 2n)     normal of its stable manifold at each state, of length 1 in the norm's coordinates w z
    sides              labels of the attractors reached a little aside of the first state, against its normal and along
    residual           largest component of P^q(z) - z, with P the map over one forcing period
    weights (2n,)      weights of the norm
    """

    states: Array
    multipliers: NDArray[np.complex128]
    normal: Array
    sides: tuple[int, int]
    residual: float
    weights: Array

    @property
    def period(self) -> int:
        """The period q of the orbit in forcing periods."""
        return len(self.states)

    @property
    def slopes(self) -> Array:
        """The slope dv/dx of the stable manifold at each state (q,), in physical units, for one degree of freedom."""
        x, v = (self.normal * self.weights).T
        return np.asarray(-x / v)


class TrackingResult(NamedTuple):
    """The saddles found, and one line of text for each boundary without a saddle, with the reason."""

    saddles: list[Saddle]
    troubles: list[str]


def saddles_of(table: AttractorTable, weights: Array) -> TrackingResult:
    """Return the saddles between the basins of a table's attractors.

    table          attractors of one machine
    weights (2n,)  weights of the norm

    A boundary is tracked for each pair of attractors in both directions.
    """
    count = max([CHAOS_STATES, *(attractor.period for attractor in table.attractors)])
    points = section_points(table, count)
    saddles, troubles = list[Saddle](), list[str]()
    if len(table.attractors) < 2:
        count = len(table.attractors)
        troubles.append(f"between basins: number of attractors: found {count}, must be 2 or more")
    for index, other in permutations(range(len(table.attractors)), 2):
        tracker = _Tracker(table, index, weights)
        saddle = tracker.track(points[index, 0], points[other, 0])
        if isinstance(saddle, str):
            troubles.append(f"from {index} towards {other}: {saddle}")
        elif not any(_same(saddle, known) for known in saddles):
            saddles.append(saddle)
    return TrackingResult(saddles, troubles)


def _same(one: Saddle, other: Saddle) -> bool:
    """Return True if two saddles are the same orbit."""
    return one.period == other.period and bool(are_on_orbit(other.states, one.states[0]))


class _Tracker:
    """Tracks the boundary of one attractor's basin to a saddle."""

    def __init__(self, table: AttractorTable, label: int, weights: Array) -> None:
        self.table, self.label, self.weights = table, label, weights
        self.map = SectionMap(table.cell.oscillator)

    def inside(self, states: Array) -> NDArray[np.bool_]:
        """Return the mask of the states (N, 2n) that lie in the basin, so that they reach its attractor."""
        return np.asarray(reached_labels(self.table, states) == self.label)

    def size(self, deviation: Array) -> float:
        return float(np.linalg.norm(self.weights * deviation))

    def track(self, first: Array, last: Array) -> Saddle | str:
        """Return the saddle to which motions on the boundary of the basin tend, or the reason why none is found.

        The boundary is looked for between the state ``first`` inside the basin and the state ``last`` outside.
        """
        distance = self.size(last - first)
        pair = self.bisected(first, last, distance)
        history: list[Array] = []
        tried = 0
        for step in range(MAX_STEPS):
            if self.size(pair[1] - pair[0]) > RESTART_DISTANCE * distance:
                pair = self.bisected(pair[0], pair[1], distance)
            history.append(0.5 * (pair[0] + pair[1]))
            period = self._recurs(history, distance) if step >= BURN else 0
            if period and tried < MAX_ATTEMPTS:
                tried += 1
                orbit = self.orbit(history[-1], period, distance)
                if orbit is not None:
                    return orbit
            pair = self.map.images(pair, 1)
            if not np.isfinite(pair).all():
                return "the motion on the boundary cannot be followed"
        if tried:
            return f"the motion on the boundary nearly recurs, but {tried} attempts found no saddle there"
        return f"found no orbit of up to {MAX_PERIOD} periods in {MAX_STEPS} on the boundary, which may be fractal"

    def bisected(self, first: Array, last: Array, distance: float) -> Array:
        """Return two states (2, 2n), BRACKET times ``distance`` apart, between which the boundary lies.

        They are found by bisection between the state ``first`` inside the basin and the state ``last`` outside.
        """
        low, high, length = 0.0, 1.0, self.size(last - first)
        while (high - low) * length > BRACKET * distance:
            shares = np.linspace(low, high, PARTS + 1)
            if not np.all(np.diff(shares) > 0.0):
                break
            inside = self.inside(first + shares[1:-1, None] * (last - first))
            first_outside = int(np.argmin(np.append(inside, False)))  # the first state outside
            low, high = float(shares[first_outside]), float(shares[first_outside + 1])
        return np.stack([first + low * (last - first), first + high * (last - first)])

    def _recurs(self, history: list[Array], distance: float) -> int:
        """Return the number of periods after which a motion has returned to its last state; 0 if it has not.

        ``history`` are its states, one per period. States within RECURRENCE_DISTANCE times ``distance`` count as equal.
        """
        for period in range(1, min(MAX_PERIOD, len(history) - 1) + 1):
            if self.size(history[-1] - history[-1 - period]) <= RECURRENCE_DISTANCE * distance:
                return period
        return 0

    def orbit(self, state: Array, period: int, distance: float) -> Saddle | None:
        """Return the saddle near a state, found by Newton's method; None if there is none.

        Its period is ``period`` or a divisor of it. ``distance`` limits how far the method may move.
        """
        z, eye = state.copy(), np.eye(len(state))
        for _ in range(NEWTON):
            states, last, jacobian = self.map.orbit_with_jacobian(z, period)
            residual = float(np.abs(last - z).max())
            if not np.isfinite(residual):
                return None
            if residual <= CLOSED * max(1e-300, float(np.abs(states).max())):
                break
            step = np.linalg.lstsq(jacobian - eye, z - last)[0]
            z = z + step
            if self.size(z - state) > 100.0 * RECURRENCE_DISTANCE * distance:
                return None
        else:
            return None
        for turn in range(1, period):  # a rotating motion recurs after multiples of its orbit's period
            if period % turn == 0 and are_on_orbit(states[turn : turn + 1], z):
                return self.orbit(z, turn, distance)
        multipliers = np.linalg.eigvals(jacobian).astype(np.complex128)
        if np.sum(np.abs(multipliers) > 1.0) != 1 or not_smooth(self.map.oscillator, states):
            return None
        normal = [self._normal(one, period) for one in states]
        aside = ASIDE * max(self.size(one) for one in states) * normal[0] / self.weights
        low, high = reached_labels(self.table, np.stack([z - aside, z + aside])).tolist()
        if low == high or {low, high} & {UNKNOWN_LABEL, NO_MOTION}:
            return None
        return Saddle(states, multipliers, np.array(normal), (int(low), int(high)), residual, self.weights)

    def _normal(self, state: Array, period: int) -> Array:
        """Return the normal of the stable manifold of a saddle at one of its states, in the norm's coordinates w z."""
        jacobian = self.weights[:, None] * self.map.orbit_with_jacobian(state, period)[2] / self.weights
        values, vectors = np.linalg.eig(jacobian.T)
        normal = np.real(vectors[:, np.argmax(np.abs(values))])
        return normal / np.linalg.norm(normal) * (1.0 if normal[np.argmax(np.abs(normal))] > 0.0 else -1.0)
