"""Saddles on the boundaries of basins: the unstable orbits that decide which attractor a motion reaches.

Where a boundary between two basins is smooth, it is the stable manifold of an unstable orbit with a single multiplier
outside the unit circle. A motion on the boundary tends to that orbit, which is found as follows. Two states with a
boundary between them are bisected until their distance is BRACKET. Both are then mapped from section to section. When
they are more than RESTART_DISTANCE apart, they are bisected again. What stays between them is a motion on the boundary.
Once that motion recurs after q periods, Newton's method on P^q(z) - z gives the orbit, and its Jacobian the
multipliers. The left eigenvector l of the multiplier outside the unit circle is the normal of the stable manifold:
deviations dz along the manifold have l dz = 0.

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
"""Distances of the two states after a bisection, and before the next, relative to that of the first two states."""
MAX_STEPS, BURN = 400, 12
"""Maximum number of forcing periods for which a boundary is tracked, and number before its motion may recur."""
MAX_PERIOD, RECURRENCE_DISTANCE = 12, 1e-3
"""Maximum period of a saddle, and distance within which its motion recurs, relative to that of the first two states."""
PARTS = 8
"""Number of parts into which an interval is divided at once."""
MAX_ATTEMPTS, NEWTON, CLOSED = 12, 30, 1e-11
"""Maximum number of searches for an orbit, of Newton steps in each, and residual relative to the largest component."""
ASIDE = 1e-5
"""Deviation along the unstable direction that shows which basins meet at a saddle, relative to its size."""


@dataclass(frozen=True, eq=False)
class Saddle:
    """An unstable orbit between basins.

    states (q, 2n)     section states, physical
    multipliers (2n,)  multipliers of the whole orbit
    normal (q, 2n)     normal of its stable manifold at each state, of length 1 in the norm's coordinates w z
    sides              labels reached a little to either side of the first state, against its normal and along it
    residual           largest component of P^q(z) - z
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
        """The period q in forcing periods."""
        return len(self.states)

    @property
    def slopes(self) -> Array:
        """For n = 1, dv/dx along the stable manifold at each state (q,), in physical units."""
        x, v = (self.normal * self.weights).T
        return np.asarray(-x / v)


class TrackingResult(NamedTuple):
    """The saddles found, and for each boundary without one the reason, as a line of text."""

    saddles: list[Saddle]
    troubles: list[str]


def saddles_of(table: AttractorTable, weights: Array) -> TrackingResult:
    """Return the saddles between the basins of a table's attractors, tracked from each pair of attractors in both
    directions.
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
    """Return True if two saddles are one orbit."""
    return one.period == other.period and bool(are_on_orbit(other.states, one.states[0]))


class _Tracker:
    """Tracks the boundary of one attractor's basin."""

    def __init__(self, table: AttractorTable, label: int, weights: Array) -> None:
        self.table, self.label, self.weights = table, label, weights
        self.map = SectionMap(table.cell.oscillator)

    def inside(self, states: Array) -> NDArray[np.bool_]:
        """Return the mask of states (N, 2n) that reach the basin's attractor."""
        return np.asarray(reached_labels(self.table, states) == self.label)

    def size(self, deviation: Array) -> float:
        return float(np.linalg.norm(self.weights * deviation))

    def track(self, first: Array, last: Array) -> Saddle | str:
        """Return the saddle to which the boundary between a state inside and one outside leads, or the reason why there
        is none.
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
        """Return two states (2, 2n), BRACKET apart, on the line from a state inside to a state outside.

        The boundary lies between them.
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
        """Return the number of periods after which the motion has returned to its last state; 0 if it has not."""
        for period in range(1, min(MAX_PERIOD, len(history) - 1) + 1):
            if self.size(history[-1] - history[-1 - period]) <= RECURRENCE_DISTANCE * distance:
                return period
        return 0

    def orbit(self, state: Array, period: int, distance: float) -> Saddle | None:
        """Return the saddle of this period, or of a divisor of it, next to a state, by Newton's method; None if there
        is none.
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
        """Return the normal of the stable manifold in the norm's coordinates."""
        jacobian = self.weights[:, None] * self.map.orbit_with_jacobian(state, period)[2] / self.weights
        values, vectors = np.linalg.eig(jacobian.T)
        normal = np.real(vectors[:, np.argmax(np.abs(values))])
        return normal / np.linalg.norm(normal) * (1.0 if normal[np.argmax(np.abs(normal))] > 0.0 else -1.0)
