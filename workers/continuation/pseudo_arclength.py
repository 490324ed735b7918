"""Pseudo-arclength continuation: from one solution of an extended system with one unknown too many to the next."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from workers.continuation.extended_system import ExtendedSystem, solve
from workers.continuation.newton import NewtonResult
from workers.continuation.orbit_equality import beginnings, begun_with
from workers.model.oscillator import Array

TARGET_ANGLE, MAX_ANGLE = 0.1, 0.35
"""Angle, in radians, by which the tangent turns in a step: target and maximum."""

FEW_STEPS = 3
"""Maximum number of Newton steps after which the next step may be longer."""

MIN_STEP = 1e-6
"""Shortest step, in units of the longest."""


OVERSHOOT, SAME_SOLUTION = 0.1, 1e-6
"""Distance from a step, in step lengths, at which its curve may pass the start; and maximum difference of equal
solutions, in units of the scale."""


class PseudoArclength:
    """A place on a curve of solutions, from which the next step is taken.

    equations  extended system; it may be bordered anew between steps
    X          (N,) unknowns
    tangent    (N,) unit tangent, in units of the scale
    length     length of the next step
    longest    maximum length of a step
    start      equations and unknowns at which the curve may close

    ``advance`` takes a step; ``step_back`` returns to where the last step began, so that a shorter one can be tried.
    """

    def __init__(self, equations: ExtendedSystem, X: Array, longest: float, direction: Array) -> None:
        self.equations, self.longest, self.length = equations, longest, 0.2 * longest
        _, J = equations.with_jacobian(X[None])
        self.X, self.tangent = X, tangent_at(equations, J[0], direction / equations.scale)
        self.start = equations, X
        self.former: tuple[Array, Array, float] | None = None
        self.newton_steps = 0

    def advance(self) -> bool:
        """Take one step, as long as the last one suggests, and shorter if it does not converge or turns too much.

        Return False if no step is possible, for example if the parameter's window is so narrow that a step is rounding.
        """
        while self.length >= MIN_STEP * self.longest:
            solved = solve(self.equations, self._predicted(), self.tangent / self.equations.scale)
            self.newton_steps += solved.steps
            if solved.converged:
                tangent = tangent_at(self.equations, solved.jacobian, self.tangent)
                angle = math.acos(min(1.0, float(tangent @ self.tangent)))
                ahead = float((solved.X - self.X) / self.equations.scale @ self.tangent)
                if angle < MAX_ANGLE and abs(ahead - self.length) < 0.5 * self.length:
                    self.former = (self.X, self.tangent, self.length)
                    self.X, self.tangent = solved.X, tangent
                    grow = min(2.0, max(0.5, TARGET_ANGLE / max(angle, 1e-6)))
                    grow = grow if solved.steps <= FEW_STEPS else min(grow, 0.7)
                    self.length = min(self.length * grow, self.longest)
                    return True
            self.length *= 0.5
        return False

    def step_back(self) -> None:
        """Return to where the last step began, to take a step of half its length."""
        assert self.former is not None
        self.X, self.tangent, length = self.former
        self.former = None
        self.length = 0.5 * length

    def closes(self) -> Array | None:
        """Return the start as unknowns (N,) of the present equations if the last step passed it; None if it did not.

        The same orbit may have events that are whole periods later by now, or may begin with another one of its events.
        """
        assert self.former is not None
        eq, previous, (of, start) = self.equations, self.former[0], self.start
        if previous is start or np.max(np.abs(eq.values(previous) - of.values(start)) / eq.width) > 1.5 * self.longest:
            return None
        step = ContinuationStep(eq, previous, self.X)
        chord = (self.X - previous) / eq.scale
        for candidate in _as_unknowns(of, start, eq, previous):
            share = float((candidate - previous) / eq.scale @ chord) / float(chord @ chord)
            if -OVERSHOOT < share < 1.0 + OVERSHOOT:
                passed = step.solution(share)
                if passed.converged and np.max(np.abs(passed.X - candidate) / eq.scale) < SAME_SOLUTION:
                    return candidate
        return None

    def _predicted(self) -> Array:
        """Return a prediction of the next solution.

        It lies on the tangent, or on the cubic through the last two solutions with their tangents.
        """
        eq = self.equations
        if self.former is None:
            return self.X + self.length * self.tangent * eq.scale
        X0, T0, _ = self.former
        chord = (self.X - X0) / eq.scale
        h = float(np.linalg.norm(chord))
        u = self.length / h
        # p(u), u in steps from the last solution, with p(-1) = X0, p(0) = X and slopes h T0, h T there
        a = h * (self.tangent + T0) - 2.0 * chord
        b = a + h * self.tangent - chord
        return self.X + (h * self.tangent * u + b * u**2 + a * u**3) * eq.scale


def tangent_at(equations: ExtendedSystem, jacobian: Array, direction: Array) -> Array:
    """Return the unit tangent of the solutions, in units of the scale, on the side of a direction in these units."""
    tangent = np.linalg.qr((jacobian * equations.scale).T, mode="complete")[0][:, -1]
    return np.asarray(tangent * np.copysign(1.0, tangent @ direction))


def _as_unknowns(equations: ExtendedSystem, X: Array, other: ExtendedSystem, near: Array) -> Iterator[Array]:
    """Yield the solution X of one extended system as unknowns of another one, near the unknowns ``near`` in time.

    There is one result for each event from which on the sequences of events of both systems agree.
    """
    orbit, contacts, values = equations.orbit(X), equations.contacts(X), equations.values(X)
    lin, itinerary, times = equations.model(values), other.itinerary, other.orbit(near).times
    span, period = orbit.span(lin), 2.0 * math.pi / float(lin.omega[0])
    full_span = span * (2 if itinerary.symmetric else 1)
    for first in beginnings(orbit.itinerary, itinerary):
        turned = begun_with(orbit, first, itinerary, span)
        later = 0.0
        if itinerary.is_cycle:  # times count from the first event
            later = -float(orbit.times[first % len(times)] + first // len(times) * span)
        elif len(times):
            later = period * round(float(np.mean(times - turned.times)) / period)
            turned = turned._replace(times=turned.times + later)
        touched = contacts + later
        touched = touched + full_span * np.round((other.contacts(near) - touched) / full_span)
        unmoved = equations.itinerary == itinerary and first == 0 and later == 0.0 and np.array_equal(touched, contacts)
        yield X if unmoved else other.pack(turned, touched, values)


class ContinuationStep(NamedTuple):
    """A step along the solutions of equations with one unknown too many, from unknowns ``start`` (N,) to ``end``."""

    equations: ExtendedSystem
    start: Array
    end: Array

    def guess(self, share: float) -> Array:
        """Return the unknowns (N,) at this share, from 0 to 1, of the straight line from start to end of the step."""
        return self.start + share * (self.end - self.start)

    def solution(self, share: float) -> NewtonResult:
        """Return the solution at this share of the step, on the plane across the step."""
        eq = self.equations
        chord = (self.end - self.start) / eq.scale
        return solve(eq, self.guess(share), chord / eq.scale / np.linalg.norm(chord))

    def at_value(self, index: int, value: float) -> NewtonResult:
        """Return the solution at which parameter ``index`` has this value."""
        eq, column = self.equations, len(self.start) - self.equations.free + index
        guess = self.guess((value - self.start[column]) / (self.end[column] - self.start[column]))
        guess[column] = value
        return solve(eq, guess, np.eye(1, len(guess), column)[0] / eq.scale)

    def share_of(self, X: Array) -> float | None:
        """Return the share of the step at which a solution X of other equations lies; None if it is far from the step.

        Contact times are ignored.
        """
        eq = self.equations
        start, end, point, scale = (
            np.concatenate([field[: eq.states], field[len(field) - eq.free :]])
            for field in (self.start, self.end, X, eq.scale)
        )
        chord, off = (end - start) / scale, (point - start) / scale
        length = float(np.linalg.norm(chord))
        share = float(off @ chord) / length**2
        near = -0.5 < share < 1.5 and float(np.linalg.norm(off - share * chord)) <= max(length, 1e-6)
        return share if near else None

    def is_near(self, guess: Array, values: Array, near: float = 0.0) -> bool:
        """Return True if parameters (free,) of a solution of other equations lie near a guess.

        The maximum distance is the length of the step, or ``near`` if that is larger.
        """
        eq = self.equations
        length = float(np.linalg.norm((self.end - self.start) / eq.scale))
        return bool(np.linalg.norm((values - guess) / eq.width) <= max(length, near, 1e-6))
