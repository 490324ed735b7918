"""Orbits with conditions on them as one square system: events with one free parameter, curves and points with two.

    (t_1..t_m, v_1..v_m, offset, contact times, parameters) -> (orbit, conditions)

The residual is exact. Its derivatives by times, speeds and offset are exact too, all others central differences, so
that Newton's method still gains six digits or more a step.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation.equations import (
    Impacts,
    Orbit,
    check_orbits,
    linearised,
    motion_at,
    residual,
    unknown_offset,
)
from workers.continuation.linear import Family, ModalOscillator, NoOscillatorError, taken
from workers.continuation.stability import multipliers, pair_near
from workers.model.oscillator import Mode, each

Array = NDArray[np.float64]

DIFFERENCE = 6e-6
"""Half the length of a central difference, in units of an unknown's scale: about the cube root of rounding."""

CURVED = 1e-4
"""The same where a second derivative is differenced."""

REMEMBERED = 8
"""Oscillators that are kept, since one point is asked several things."""

UNIT, MINUS_ONE, PAIR, ANGLE, GRAZE, SPEED, CUSP = "unit", "minus_one", "pair", "angle", "graze", "speed", "cusp"
"""Conditions: a multiplier 1; a multiplier -1; a pair of product 1; of sum 2 kappa; y = stop and y' = 0 at a contact
time; v_i = 0; a fold without curvature."""


class Condition(NamedTuple):
    """One condition: its kind, the stop's side of a graze, the impact of a speed, the kappa of an angle."""

    kind: str
    side: int = 0
    impact: int = 0
    kappa: float = 0.0


class Extended:
    """The equations of orbits of one itinerary with conditions, over the free parameters of a family.

    ``scale`` (unknowns,) makes unknowns comparable, ``unit`` (2m + 1,) perturbations of times, speeds and offset;
    ``width`` (free,) is the scale of the parameters. ``follow`` takes the vectors that border singular matrices from a
    solution, and the sum of the pair that is watched.
    """

    def __init__(
        self, family: Family, orbit: Orbit, conditions: tuple[Condition, ...], values: Array, width: Array
    ) -> None:
        self.family, self.itinerary, self.conditions = family, orbit.itinerary, conditions
        self.known: dict[bytes, tuple[ModalOscillator, Mode | None]] = {}
        lin = self.model(np.asarray(values, dtype=np.float64))[0]
        check_orbits(lin, orbit.itinerary)
        self.m, self.free = len(orbit.itinerary.sides), len(family.free)
        self.shift = int(unknown_offset(lin, orbit.itinerary))
        self.grazes = sum(condition.kind == GRAZE for condition in conditions)
        time = 1.0 / float(lin.omega[0])
        stops_at = [abs(float(stop[0])) for stop in (lin.upper, lin.lower) if np.isfinite(stop[0])]
        forced_size = float(np.abs(lin.sin_part).sum() + np.abs(lin.cos_part).sum())
        speed = max(float(np.max(np.abs(orbit.speeds), initial=0.0)), 1e-3 * max(forced_size, *stops_at, 1e-300) / time)
        many = math.sqrt(max(1, self.m))
        parts = [np.full(self.m, many * time), np.full(self.m, many * speed), np.full(self.shift, speed * time)]
        self.scale = np.concatenate([*parts, np.full(self.grazes, time), np.asarray(width, dtype=np.float64)])
        self.unit = np.concatenate([self.scale[: 2 * self.m], [speed * time]])
        self.totals = [2.0 * condition.kappa for condition in conditions]
        self.borders: list[tuple[Array, Array] | None] = [None] * len(conditions)

    def model(self, values: Array) -> tuple[ModalOscillator, Mode | None]:
        """The oscillator, as the only one of a record of many, and its gap signal at parameters (free,)."""
        key = values.tobytes()
        if key not in self.known:
            lin, signals = self.family.model(values[None])
            if len(self.known) >= REMEMBERED:
                self.known.pop(next(iter(self.known)))
            signal = None if signals is None else each(signals, lambda field: field[0])
            self.known[key] = (lin, signal)
        return self.known[key]

    @property
    def states(self) -> int:
        """How many unknowns are times, speeds and the offset."""
        return 2 * self.m + self.shift

    def pack(self, orbit: Orbit, contacts: Array, values: Array) -> Array:
        """The unknowns (N,) of an orbit with contact times (G,) at parameters (free,)."""
        offset = [orbit.offset] if self.shift else []
        return np.concatenate([orbit.times, orbit.speeds, offset, contacts, values])

    def points(self, X: Array) -> Impacts:
        """The impacts of unknowns (B, N)."""
        m = self.m
        return Impacts(X[:, :m], X[:, m : 2 * m], X[:, 2 * m] if self.shift else np.zeros(len(X)))

    def contacts(self, X: Array) -> Array:
        """The contact times (B, G) of unknowns (B, N)."""
        return X[:, self.states : self.states + self.grazes]

    def values(self, X: Array) -> Array:
        """The parameters (..., free) of unknowns (..., N)."""
        return X[..., X.shape[-1] - self.free :]

    def orbit(self, X: Array) -> Orbit:
        """The orbit of unknowns (N,)."""
        points = self.points(X[None])
        return Orbit(self.itinerary, points.t[0].copy(), points.v[0].copy(), float(points.offset[0]))

    def residual(self, X: Array) -> Array:
        """All equations (equations,) at unknowns (N,), exact."""
        return self._all(X[None], self.model(self.values(X))[0])[0]

    def with_jacobian(self, X: Array) -> tuple[Array, Array]:
        """All equations (equations,) and their derivatives (equations, N) at unknowns (N,)."""
        N = len(X)
        first = 0 if self.conditions else N - self.free
        columns = np.arange(first, N)
        step = DIFFERENCE * self.scale[columns]
        rows = np.repeat(X[None], 1 + 2 * len(columns), axis=0)
        each = np.arange(len(columns))
        rows[1 + each, columns] += step
        rows[1 + len(columns) + each, columns] -= step
        which = np.zeros(len(rows), dtype=np.int64)
        if self.free:
            moved = np.arange(len(columns) - self.free, len(columns))
            of_build = np.concatenate([[0], 1 + moved, 1 + len(columns) + moved])
            which[of_build] = np.arange(len(of_build))
            lin = taken(self.family.model(self.values(rows[of_build]))[0], which)
        else:
            lin = taken(self.model(self.values(X))[0], which)
        found = self._all(rows, lin)
        J = np.zeros((found.shape[1], N))
        J[:, first:] = ((found[1 : 1 + len(columns)] - found[1 + len(columns) :]) / (2.0 * step[:, None])).T
        here = taken(lin, np.zeros(1, dtype=np.int64))
        J[: self.states, : self.states] = linearised(here, self.itinerary, self.points(X[None]))[0]
        J[: self.states, self.states : N - self.free] = 0.0
        return found[0], J

    def follow(self, X: Array) -> None:
        """Border with the null vectors at X, in the directions of the former ones; watch the pair found there."""
        lin = self.model(self.values(X))[0]
        points = self.points(X[None])
        for i, condition in enumerate(self.conditions):
            if condition.kind in (UNIT, MINUS_ONE):
                U, _, Vt = np.linalg.svd(self._bordered_matrix(condition, lin, points)[0])
                left, right = U[:, -1], Vt[-1]
                former = self.borders[i]
                if former is not None:
                    left, right = left * np.sign(left @ former[0] or 1.0), right * np.sign(right @ former[1] or 1.0)
                self.borders[i] = (left, right)
            if condition.kind == PAIR:
                total, _ = pair_near(multipliers(lin, self.itinerary, points), np.array([self.totals[i]]))
                self.totals[i] = float(total[0])

    def null_vector(self, condition: int) -> Array:
        """The perturbation (2m,) or (2m + 1,) that a multiplier 1 or -1 leaves free."""
        found = self.borders[condition]
        assert found is not None
        return found[1]

    def _all(self, X: Array, lin: ModalOscillator) -> Array:
        """All equations (B, equations) at unknowns (B, N), of oscillators of the same rows."""
        points, contacts = self.points(X), self.contacts(X)
        parts = [residual(lin, self.itinerary, points)]
        graze, values = 0, None
        for i, condition in enumerate(self.conditions):
            if condition.kind == GRAZE:
                y, v, _, _ = motion_at(lin, self.itinerary, points, contacts[:, graze : graze + 1])
                parts += [y - (lin.upper if condition.side > 0 else -lin.lower)[:, None], v]
                graze += 1
            elif condition.kind == SPEED:
                parts.append(points.v[:, condition.impact, None])
            elif condition.kind in (PAIR, ANGLE):
                values = multipliers(lin, self.itinerary, points) if values is None else values
                total, product = pair_near(values, np.full(len(X), self.totals[i]))
                parts.append((product - 1.0 if condition.kind == PAIR else total - 2.0 * condition.kappa)[:, None])
            elif condition.kind == CUSP:
                parts.append(self.curvature(lin, points)[:, None])
            else:
                parts.append(self._solved(i, lin, points)[:, -1:])
        return np.concatenate(parts, axis=1)

    def _bordered_matrix(self, condition: Condition, lin: ModalOscillator, points: Impacts) -> Array:
        """J_z of a condition on a multiplier, in units of the scale of the unknowns."""
        J = linearised(lin, self.itinerary, points, 1 if condition.kind == UNIT else -1)
        unit = self.unit[: J.shape[2]]
        return np.asarray(J * unit / unit[:, None])

    def _solved(self, i: int, lin: ModalOscillator, points: Impacts) -> Array:
        """(w, g) (B, M + 1) of [[J_z, left], [right, 0]] (w, g) = (0, 1): g vanishes where J_z is singular, along w."""
        J = self._bordered_matrix(self.conditions[i], lin, points)
        border = self.borders[i]
        assert border is not None
        size = J.shape[1]
        matrix = np.zeros((len(J), size + 1, size + 1))
        matrix[:, :size, :size], matrix[:, :size, -1], matrix[:, -1, :size] = J, border[0], border[1]
        right = np.zeros((len(J), size + 1, 1))
        right[:, -1] = 1.0
        return np.asarray(np.linalg.solve(matrix, right)[..., 0])

    def curvature(self, lin: ModalOscillator, points: Impacts) -> Array:
        """The derivative (B,) of a fold's g along its null vector: zero where the fold is a cusp."""
        fold = next(i for i, condition in enumerate(self.conditions) if condition.kind == UNIT)
        w = self._solved(fold, lin, points)[:, :-1] * self.scale[: self.states]
        m, found = self.m, []
        for sign in (1.0, -1.0):
            offset = points.offset + (sign * CURVED * w[:, 2 * m] if self.shift else 0.0)
            moved = Impacts(points.t + sign * CURVED * w[:, :m], points.v + sign * CURVED * w[:, m : 2 * m], offset)
            found.append(self._solved(fold, lin, moved)[:, -1])
        return np.asarray((found[0] - found[1]) / (2.0 * CURVED))


class Solved(NamedTuple):
    """What Newton's method found: unknowns (N,), Jacobian near there, steps taken, and whether it converged."""

    X: Array
    jacobian: Array
    steps: int
    converged: bool


NEWTON_STEPS = 12
DONE = 1e-14
"""Expected distance from the solution, in units of the scale, at which Newton's method ends."""


def solve(equations: Extended, X: Array, row: Array | None = None) -> Solved:
    """Newton's method from X; ``row`` (N,) is a direction in which nothing changes, where one unknown is free.

    The Jacobian is kept for a step where the last one gained two digits. It ends where the next step would be below
    DONE, and fails where steps do not shrink, at a singular matrix and where there is no oscillator.
    """
    try:
        return _newton(equations, X, row)
    except (np.linalg.LinAlgError, NoOscillatorError):
        return Solved(X, np.zeros((0, 0)), 0, False)


def _newton(equations: Extended, X: Array, row: Array | None) -> Solved:
    known, J = equations.with_jacobian(X)
    last = math.inf
    for step in range(1, NEWTON_STEPS + 1):
        matrix, right = (J, known) if row is None else (np.vstack([J, row]), np.append(known, 0.0))
        change = np.linalg.solve(matrix * equations.scale, -right)
        size = float(np.max(np.abs(change), initial=0.0))
        if not size < min(1.0, 2.0 * last):
            break
        X = X + change * equations.scale
        ratio = min(size / last, 1.0) if math.isfinite(last) else math.sqrt(size)
        if size * max(ratio, 1e-7) < DONE:
            return Solved(X, J, step, True)
        if step > 1 and size > 0.3 * last and size < 1e-10:  # rounding
            return Solved(X, J, step, True)
        if step == 1 or size > 1e-2 * last:
            known, J = equations.with_jacobian(X) if size > 1e-4 else (equations.residual(X), J)
        else:
            known = equations.residual(X)
        last = size
    return Solved(X, J, NEWTON_STEPS, False)
