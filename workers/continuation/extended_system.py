"""Extended systems: an orbit with conditions as one square system of equations.

    (state, t_1..t_m, contact times, parameters) -> (orbit, conditions)

Events have one free parameter; curves and their points have two. The residual is exact. Its derivatives by state and
times are exact too. All other derivatives are central differences, with which Newton's method still gains six digits or
more in each step.
"""

import math
from copy import copy
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from workers.continuation.equations import check_orbits, motion_of, motion_of_unknowns
from workers.continuation.families import Family
from workers.continuation.floquet import multipliers, pair_near
from workers.continuation.itinerary import Orbit, many_orbits
from workers.continuation.newton import NewtonResult, newton
from workers.continuation.shooting import OrbitMotion
from workers.model.block_decomposition import apply_stacked
from workers.model.family import NoOscillatorError, OrbitMachines
from workers.model.oscillator import Array, Rows

DIFFERENCE = 6e-6
"""Half the length of a central difference, in units of an unknown's scale: about the cube root of rounding."""

CURVED = 1e-4
"""Half the length of a central difference of a derivative, in units of an unknown's scale."""

FOLLOWS = 4.0
"""Size of a state's unit, in multiples of the size of the motion. The length of a step is set by times and parameters,
from which the state follows."""

REMEMBERED = 8
"""Maximum number of machines, and of motions, that an extended system caches: several properties of one solution point
are computed in turn."""

SAME_EVENT = 1e-2
"""Share of a turn within which an event of an orbit is identified with an event of another orbit with additional
events."""

UNIT, MINUS_ONE, PAIR, ANGLE, GRAZE, SPEED, CUSP, ONSET, ENDS, MEETS = (
    "unit", "minus_one", "pair", "angle", "graze", "speed", "cusp", "onset", "ends", "meets",
)  # fmt: skip
"""Conditions. UNIT: a multiplier is 1. MINUS_ONE: a multiplier is -1. PAIR: a pair has product 1. ANGLE: a pair has sum
2 kappa. GRAZE: y = stop and y' = 0 at a contact time, or another signal (number computed from the state) touches an end
of its range. SPEED: an event is reached at zero rate. CUSP: a fold without curvature. ONSET: the force that would hold
friction where it turns round is at its static level. ENDS: the force that holds friction where it begins to stick is at
its static level. MEETS: another signal reaches an end of its range at an event."""


class Condition(NamedTuple):
    """One condition on an orbit.

    kind    UNIT, MINUS_ONE, PAIR, ANGLE, GRAZE, SPEED, CUSP, ONSET, ENDS or MEETS
    side    side of a graze, or end of the range that is reached
    impact  index of the event
    kappa   cosine of the angle of a pair of multipliers on the unit circle
    signal  signal (number computed from the state) that grazes an end of its range, or is at an end at an event
    """

    kind: str
    side: int = 0
    impact: int = 0
    kappa: float = 0.0
    signal: int = 0


def conditions_on(
    orbit: Orbit, conditions: tuple[Condition, ...], former: Orbit, span: float
) -> tuple[Condition, ...] | None:
    """Return conditions on the orbit ``former`` as conditions on ``orbit``, whose events are at about these times.

    ``span`` is the length of a turn. Return None if the event of a condition is gone.
    """
    transferred, later = [], time_shift(orbit, former, span)
    for condition in conditions:
        if condition.kind in (SPEED, ONSET, ENDS, MEETS):
            near, flips = _apart(orbit, former, span, later)
            if not np.any(near[:, condition.impact] < SAME_EVENT):
                return None
            index = int(np.argmin(near[:, condition.impact]))
            condition = condition._replace(impact=index, side=int(flips[index, condition.impact]) * condition.side)
        transferred.append(condition)
    return tuple(transferred)


def time_shift(orbit: Orbit, former: Orbit, span: float) -> float:
    """Return the shift of the times of ``former`` that brings its events nearest to those of ``orbit``.

    ``span`` is the length of a turn. Only times of cycles are shifted, since they count from the first event.
    """
    if not (orbit.itinerary.is_cycle and former.itinerary.is_cycle):
        return 0.0
    shifts = (orbit.times[:, None] - former.times).ravel()
    fewer = int(len(orbit.times) > len(former.times))

    def misfit(shift: float) -> float:
        return float(np.sum(np.min(_apart(orbit, former, span, shift)[0], axis=1 - fewer)))

    return float(min(shifts, key=misfit))


def _apart(orbit: Orbit, former: Orbit, span: float, later: float) -> tuple[Array, Array]:
    """Return the distances (m, k), in turns, of the events of an orbit (m,) from those of another orbit (k,).

    Distances are infinite for events of different kinds. The second result (m, k) is -1 if the one event is compared
    with the mirror image of the other.
    """
    turns = (orbit.times[:, None] - (former.times + later)) / span
    flips = np.where(np.round(turns) % 2 == 0, 1, orbit.itinerary.sign)
    alike = flips * np.array(orbit.itinerary.sides)[:, None] == np.array(former.itinerary.sides)
    return np.where(alike, np.abs(turns - np.round(turns)), np.inf), flips


class ExtendedSystem:
    """The equations of orbits with one sequence of events and conditions, over the free parameters of a family.

    scale   (unknowns,) scale that makes unknowns comparable
    unit    (2n + m,) scale of the residuals of the orbit
    width   (free,) scale of the parameters
    m       number of events
    states  number of unknowns that are the state and the times of the orbit
    grazes  number of contact times among the unknowns
    free    number of free parameters

    ``rebordered`` sets the vectors that border singular matrices, and the sum of a pair of multipliers, at a solution.
    """

    def __init__(
        self, family: Family, orbit: Orbit, conditions: tuple[Condition, ...], values: Array, width: Array
    ) -> None:
        self.family, self.itinerary, self.conditions = family, orbit.itinerary, conditions
        self.width = np.asarray(width, dtype=np.float64)
        self._model = lru_cache(REMEMBERED)(lambda *values: family.model(np.array([values], dtype=np.float64)))
        self._motion = lru_cache(REMEMBERED)(
            lambda *X: motion_of_unknowns(self.model(self.values(np.array(X))), self.itinerary, np.array([X]))
        )
        lin = self.model(np.asarray(values, dtype=np.float64))
        check_orbits(lin, orbit.itinerary)
        motion = motion_of(lin, many_orbits([orbit]))
        self.m, self.free, self.states = len(orbit.itinerary.sides), len(family.free), motion.unknowns.shape[1]
        self.grazes = sum(condition.kind == GRAZE for condition in conditions)
        time = float(motion.span[0]) if orbit.itinerary.is_cycle else 1.0 / float(lin.omega[0])
        (size,), (guards,) = motion.scale()
        size, root = FOLLOWS * math.sqrt(len(size)) * size, math.sqrt(max(1, self.m))
        times = np.repeat([root * time, time], [self.m, self.grazes])
        self.scale = np.concatenate([size, times, self.width])
        self.unit = np.concatenate([size, root * guards])
        self.totals = [2.0 * condition.kappa for condition in conditions]
        self.borders = [(np.zeros(1), np.zeros(1))] * len(conditions)

    def model(self, values: Array) -> OrbitMachines:
        """Return the machine at parameters (free,), alone in a batch."""
        return self._model(*values.tolist())

    def pack(self, orbit: Orbit, contacts: Array, values: Array) -> Array:
        """Return the unknowns (N,) of an orbit with contact times (G,) at parameters (free,)."""
        motion = motion_of(self.model(values), many_orbits([orbit]))
        return np.concatenate([motion.unknowns[0], contacts, values])

    def contacts(self, X: Array) -> Array:
        """Return the contact times (..., G) of unknowns (..., N)."""
        return X[..., self.states : self.states + self.grazes]

    def values(self, X: Array) -> Array:
        """Return the parameters (..., free) of unknowns (..., N)."""
        return X[..., X.shape[-1] - self.free :]

    def motion(self, X: Array) -> OrbitMotion:
        """Return the motion of the orbit at unknowns (N,), alone in a batch."""
        return self._motion(*X.tolist())

    def orbit(self, X: Array) -> Orbit:
        """Return the orbit of unknowns (N,)."""
        return self.motion(X).orbits.at_rows(0)

    def residual(self, X: Array, _: Rows | None = None) -> Array:
        """Return the residuals (1, equations) of all equations at unknowns (1, N), without differences."""
        return self._all(X, self.motion(X[0]))

    def with_jacobian(self, X: Array, _: Rows | None = None) -> tuple[Array, Array]:
        """Return the residuals (1, equations) at unknowns (1, N), and their derivatives (1, equations, N)."""
        N = X.shape[1]
        columns = np.arange(0 if self.conditions else N - self.free, N)
        steps = np.diag(DIFFERENCE * self.scale)[columns]
        rows = np.concatenate([X, X + steps, X - steps])
        # machines of the rows with other parameters, and one machine for all other rows
        places = 1 + np.concatenate([k * len(columns) - 1 - np.arange(self.free)[::-1] for k in (1, 2)])
        lin = self.family.model(self.values(rows[np.append(0, places)]))
        if len(columns) > self.free:
            which = np.zeros(len(rows), dtype=np.int64)
            which[places] = np.arange(1, 1 + len(places))
            lin = lin.at_rows(which)
        motion = motion_of_unknowns(lin, self.itinerary, rows)
        base, ahead, behind = np.split(self._all(rows, motion), [1, 1 + len(columns)])
        J = np.zeros((base.shape[1], N))
        with np.errstate(invalid="ignore"):  # residuals may be infinite; Newton's method fails then
            J[:, columns] = ((ahead - behind) / (2.0 * DIFFERENCE * self.scale[columns, None])).T
        J[: self.states, : self.states] = motion.linearised()[0]
        J[: self.states, self.states : N - self.free] = 0.0
        return base, J[None]

    def rebordered(self, X: Array) -> "ExtendedSystem":
        """Return these equations with new borders: null vectors at X (N,), in the directions of the former ones.

        Borders make the singular matrix of a condition on a multiplier regular. The sum of the pair of a condition PAIR
        is taken at X, too.
        """
        renewed, motion = copy(self), self.motion(X)
        renewed.borders, renewed.totals = list(self.borders), list(self.totals)
        for i, condition in enumerate(self.conditions):
            if condition.kind in (UNIT, MINUS_ONE):
                U, _, Vt = np.linalg.svd(self._bordered_matrix(condition, motion)[0])
                (a, b), left, right = self.borders[i], U[:, -1], Vt[-1]
                renewed.borders[i] = left * np.sign(np.sum(a * left) or 1.0), right * np.sign(np.sum(b * right) or 1.0)
            if condition.kind == PAIR:
                total, _, _ = pair_near(multipliers(motion), np.array([self.totals[i]]))
                renewed.totals[i] = float(total[0])
        return renewed

    def _all(self, X: Array, motion: OrbitMotion) -> Array:
        """Return the residuals (B, equations) of all equations at unknowns (B, N), whose motions are given."""
        contacts, graze, parts = self.contacts(X), 0, [motion.turn.residuals]
        for i, condition in enumerate(self.conditions):
            if condition.kind == GRAZE:
                parts += motion.distance_to_end(condition.signal, condition.side, contacts[:, graze : graze + 1])
                graze += 1
            elif condition.kind in (ONSET, ENDS, MEETS):
                parts.append(motion.holding_margin(condition.impact, condition.signal, condition.side)[:, None])
            elif condition.kind == SPEED:
                parts.append(motion.turn.signals[:, 1, condition.impact, None])
            elif condition.kind in (PAIR, ANGLE):
                total, product, _ = pair_near(multipliers(motion), np.full(len(X), self.totals[i]))
                parts.append((product - 1.0 if condition.kind == PAIR else total - 2.0 * condition.kappa)[:, None])
            elif condition.kind == CUSP:
                parts.append(self.curvature(motion)[:, None])
            else:
                parts.append(self._solved(i, motion)[:, -1:])
        return np.concatenate(parts, axis=1)

    def _bordered_matrix(self, condition: Condition, motion: OrbitMotion) -> Array:
        """Return the matrix (B, M, M) that is singular if a multiplier is z = 1 or -1, in units of the unknowns.

        If all events are impacts, the matrix is J_z, see ``OrbitMotion.linearised``, which has no poles where an impact
        has zero speed. Otherwise it is DP - z, with DP the map of a turn. J_z is nearly singular for any multipliers if
        a soft contact is hardly touched, and DP is not. The matrix of a cycle is always J_z, since DP of a cycle always
        has the multiplier 1 and J_1 does not.
        """
        z = 1.0 if condition.kind == UNIT else -1.0
        if motion.plan.impacts or motion.itinerary.is_cycle:
            return np.asarray(motion.linearised(z) * self.scale[: self.states] / self.unit[:, None])
        size = self.scale[: motion.start.shape[1]]
        return np.asarray((motion.turn.maps - z * np.eye(len(size))) * size / size[:, None])

    def critical(self, X: Array) -> Array:
        """Return the direction (states,) of the disturbance whose multiplier the first condition fixes.

        It is a disturbance of state and times at unknowns X (N,), in units of the scale.
        """
        return self._of_unknowns(self.motion(X), self.rebordered(X).borders[0][1][None])[0]

    def _of_unknowns(self, motion: OrbitMotion, along: Array) -> Array:
        """Return null vectors of ``_bordered_matrix`` as directions (B, states) of state and times, in scale units."""
        if motion.plan.impacts or motion.itinerary.is_cycle:
            return along
        size = self.scale[: motion.start.shape[1]]
        direction = motion.unknowns_along(along * size) / self.scale[: self.states]
        return np.asarray(direction / np.linalg.norm(direction, axis=1, keepdims=True))

    def _solved(self, i: int, motion: OrbitMotion) -> Array:
        """Return the solutions (w, g) (B, M + 1) of [[J_z, left], [right, 0]] (w, g) = (0, 1), the bordered matrix.

        J_z is the matrix of condition i, see ``_bordered_matrix``. It is singular where g vanishes, with the null
        vector w.
        """
        J = self._bordered_matrix(self.conditions[i], motion)
        size = J.shape[1]
        matrix = np.zeros((len(J), size + 1, size + 1))
        matrix[:, :size, :size], matrix[:, :size, -1], matrix[:, -1, :size] = J, *self.borders[i]
        right = np.zeros((len(J), size + 1, 1))
        right[:, -1] = 1.0
        return np.asarray(apply_stacked(np.linalg.solve, right.shape, matrix, right)[..., 0])

    def curvature(self, motion: OrbitMotion) -> Array:
        """Return the derivative (B,) of the number g of a fold, see ``_solved``, along the null vector of the fold.

        It is zero if the fold is a cusp.
        """
        fold = next(i for i, condition in enumerate(self.conditions) if condition.kind == UNIT)
        along = self._of_unknowns(motion, self._solved(fold, motion)[:, :-1]) * self.scale[: self.states]
        ends = (motion.unknowns + sign * CURVED * along for sign in (1.0, -1.0))
        ahead, behind = (self._solved(fold, motion_of_unknowns(motion.lin, self.itinerary, end))[:, -1] for end in ends)
        return np.asarray((ahead - behind) / (2.0 * CURVED))


def solve(equations: ExtendedSystem, X: Array, row: Array | None = None) -> NewtonResult:
    """Return the result of Newton's method from unknowns X (N,).

    ``row`` (N,) has the weights of a sum of the unknowns that stays constant; it is needed if there is one unknown more
    than equations. The result has not converged if ``newton`` fails or if there is no oscillator at the parameters.
    """
    try:
        forced = equations.motion(X).forced_sizes
        sizes = np.pad(forced, [(0, 0), (0, len(X) - (row is not None) - forced.shape[1])])
        solved = newton(
            equations.residual, equations.with_jacobian, X[None], equations.scale[None], row, sizes=sizes
        )  # fmt: skip
    except NoOscillatorError:
        return NewtonResult(X, np.zeros((0, 0)), 0, False)
    return NewtonResult(solved.X[0], solved.jacobian[0], solved.steps, bool(solved.converged[0]))
