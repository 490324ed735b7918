"""Pseudo-arclength continuation: from one solution of an extended system with one unknown too many to the next."""

import math

import numpy as np
from numpy.typing import NDArray

from workers.continuation.extended import Extended, Solved, solve

Array = NDArray[np.float64]

TURN, MOST_TURN = 0.1, 0.35
"""Angle in radians that the tangent may turn by in a step: wanted, and at most."""

FEW_STEPS = 3
"""Newton steps up to which a step may grow."""

LEAST = 1e-6
"""The shortest step, in units of the longest."""


class PseudoArclength:
    """A place on a curve of solutions: unknowns X, unit tangent in units of the scale, length of the next step.

    ``advance`` goes one step on; ``back`` returns to where the last one began, so that a shorter one can be tried.
    """

    def __init__(self, equations: Extended, X: Array, longest: float, direction: Array) -> None:
        self.equations, self.longest, self.length = equations, longest, 0.2 * longest
        self.X, self.tangent = X, tangent_at(equations, equations.with_jacobian(X)[1], direction / equations.scale)
        self.former: tuple[Array, Array, float] | None = None
        self.newton_steps = 0

    def advance(self) -> bool:
        """One step on, as long as the last one suggests, shorter where it does not converge or turns too much."""
        eq = self.equations
        while self.length >= LEAST * self.longest:
            guess = self._predicted()
            found = solve(eq, guess, self.tangent / eq.scale)
            self.newton_steps += found.steps
            if found.converged:
                tangent = tangent_at(eq, found.jacobian, self.tangent)
                angle = math.acos(min(1.0, float(tangent @ self.tangent)))
                if angle < MOST_TURN:
                    self.former = (self.X, self.tangent, self.length)
                    self.X, self.tangent = found.X, tangent
                    grow = min(2.0, max(0.5, TURN / max(angle, 1e-6)))
                    self.length = min(
                        self.length * (grow if found.steps <= FEW_STEPS else min(grow, 0.7)), self.longest
                    )
                    return True
            self.length *= 0.5
        return False

    def back(self) -> None:
        """Return to where the last step began, to take one of half its length."""
        assert self.former is not None
        self.X, self.tangent, length = self.former
        self.former = None
        self.length = 0.5 * length

    def _predicted(self) -> Array:
        """The next solution as the tangent has it, or the cubic through the last two solutions and their tangents."""
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


def tangent_at(equations: Extended, jacobian: Array, direction: Array) -> Array:
    """The unit tangent of the solutions, in units of the scale, on the side of a direction in these units."""
    size = np.linalg.norm(direction)
    matrix = np.vstack([jacobian * equations.scale, direction / size])
    right = np.zeros(len(matrix))
    right[-1] = 1.0
    try:
        tangent = np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        tangent = np.linalg.svd(jacobian * equations.scale)[2][-1]
        tangent = tangent * (1.0 if tangent @ direction >= 0.0 else -1.0)
    return np.asarray(tangent / np.linalg.norm(tangent))


def between(equations: Extended, here: Array, there: Array, share: float) -> Solved:
    """The solution this share of the way from one to the next one near it, on the plane across the way."""
    chord = (there - here) / equations.scale
    return solve(equations, here + share * (there - here), chord / equations.scale / np.linalg.norm(chord))


def at_value(equations: Extended, here: Array, there: Array, index: int, value: float) -> Solved:
    """The solution between two near ones at which parameter ``index`` has this value."""
    place = len(here) - equations.free + index
    share = (value - here[place]) / (there[place] - here[place])
    guess = here + share * (there - here)
    guess[place] = value
    row = np.zeros(len(here))
    row[place] = 1.0 / equations.scale[place]
    return solve(equations, guess, row)
