"""Events between two points of a branch or curve, located as solutions of square systems."""

import math
from typing import NamedTuple

import numpy as np

from workers.continuation.admissible import LOST, ORDER, Fault
from workers.continuation.equations import motion_at
from workers.continuation.extended import GRAZE, MINUS_ONE, PAIR, SPEED, Condition, Extended, solve
from workers.continuation.monitors import Point, TestFunctions, fault, monitored, name_of, point_of
from workers.continuation.newton import Array
from workers.continuation.oscillator import NoOscillatorError
from workers.continuation.same import Reduction, difference, is_minimal, reduced, reductions
from workers.continuation.walk import Step

HALVINGS = 14
"""Halvings of a step that help to locate where an orbit ceases to be admissible."""

TINY = 1e-300

NEAR_HALVES = 1e-2
"""Difference of both halves, in radians of the force and relative speeds, below which a branch that stalls meets the
orbit of half the turn."""

TRIES = 4
"""Halvings of a step that help to locate where a test function is zero."""


class Event(NamedTuple):
    """An event: its kind, its conditions, and the point; kappa = cos theta of a pair on the unit circle, else NaN."""

    kind: str
    conditions: tuple[Condition, ...]
    point: Point
    kappa: float = math.nan


class LocatedEvent(NamedTuple):
    """An event at a share of a step; whether its orbit is admissible, the event's own grazes allowed."""

    share: float
    event: Event
    admissible: bool


class Change(NamedTuple):
    """A test function that changed its sign: its name, the share of the step at which it is zero, about, the sign after
    it, and the conditions of the event.
    """

    name: str
    share: float
    sign: float
    conditions: tuple[Condition, ...]


def changes(before: TestFunctions, after: TestFunctions) -> list[Change]:
    """The test functions that changed their sign."""
    found = []
    for name, b in after.functions.items():
        a = before.functions[name]
        if a.sign * b.sign < 0.0:
            found.append(Change(name, 1.0 / (1.0 + math.exp(min(b.log - a.log, 50.0))), b.sign, b.conditions))
    return found


def located(step: Step, change: Change) -> LocatedEvent | None:
    """The event at which a test function changed its sign; None at a pole, at a real pair of product 1."""
    low, high, guess = 0.0, 1.0, change.share
    for _ in range(TRIES):
        found = _solved(step, step.guess(guess), change.conditions)
        if found is not None:
            return found
        guess = 0.5 * (low + high)
        middle = step.solution(guess)
        if not middle.converged:
            return None
        changed = monitored(step.equations, middle.X).functions[change.name].sign == change.sign
        low, high = (low, guess) if changed else (guess, high)
        guess = 0.5 * (low + high)
    return None


def leaving(step: Step, why: Fault) -> LocatedEvent | None:
    """The event at which the orbit ceases to be admissible on a step, the first one; ``why`` it is not at the end."""
    low, high, X = 0.0, 1.0, step.there
    for _ in range(HALVINGS):
        found = _of_fault(step, X, why)
        if found is not None and found.admissible:
            return found
        half = 0.5 * (low + high)
        middle = step.solution(half)
        if not middle.converged:
            return None
        seen = fault(step.equations, middle.X)
        if seen is None:
            low = half
        else:
            high, X, why = half, middle.X, seen
    return None


def origin(step: Step, to: Reduction) -> LocatedEvent | None:
    """The symmetry breaking or period doubling at which a branch becomes that orbit of half the turn; on a curve of
    grazes too. None on other curves, and where it is not found.
    """
    eq = step.equations
    own = tuple(condition for condition in eq.conditions if condition.kind == GRAZE)
    if own != eq.conditions:
        return None
    a, b = (float(np.linalg.norm(difference(*eq.motion(X), to))) + TINY for X in (step.here, step.there))
    share = a / (a + b)
    guess = step.guess(share)
    orbit, values = reduced(eq.orbit(guess), to), eq.values(guess)
    square = Extended(eq.family, orbit, (*own, Condition(MINUS_ONE)), values, eq.width)
    X = square.pack(orbit, eq.contacts(guess[None])[0], values)
    square = square.at(X)
    found = solve(square, X)
    return _event(square, found.X, share) if found.converged else None


def halves_between(step: Step) -> Reduction | None:
    """The orbit of half the turn that is passed on a step: both halves exchange their parts there."""
    for to in _halves(step.equations):
        a, b = (difference(*step.equations.motion(X), to) for X in (step.here, step.there))
        if a @ b <= 0.0:
            return to
    return None


def nearly_halves(equations: Extended, X: Array) -> Reduction | None:
    """The orbit of half the turn that unknowns X (N,) nearly are."""
    for to in _halves(equations):
        if np.max(np.abs(difference(*equations.motion(X), to))) < NEAR_HALVES:
            return to
    return None


def _halves(equations: Extended) -> list[Reduction]:
    return [to for to in reductions(equations.itinerary) if to.parts == 2]


def _solved(
    step: Step, guess: Array, conditions: tuple[Condition, ...], contact: float | None = None
) -> LocatedEvent | None:
    """The event with these conditions near a guess, if on the step; ``contact`` is a new contact time."""
    eq = step.equations
    orbit, values = eq.orbit(guess), eq.values(guess)
    square = Extended(eq.family, orbit, conditions, values, eq.width)
    kept = eq.contacts(guess[None])[0] if square.grazes >= eq.grazes else np.zeros(0)
    X = square.pack(orbit, np.append(kept, [] if contact is None else contact), values)
    try:
        square = square.at(X)
        found = solve(square, X)
    except (NoOscillatorError, np.linalg.LinAlgError):
        return None
    share = step.share_of(found.X) if found.converged else None
    if share is None or not is_minimal(*square.motion(found.X)):
        return None
    located = _event(square.at(found.X), found.X, share)
    kappa = located.event.kappa
    return None if (len(conditions) == 1 and abs(kappa) >= 1.0) or abs(kappa) > 1.0 + 1e-9 else located


def _event(square: Extended, X: Array, share: float) -> LocatedEvent:
    """The event that unknowns X of a square system are."""
    totals = (total for c, total in zip(square.conditions, square.totals, strict=True) if c.kind == PAIR)
    kind = name_of(square.conditions, square.itinerary.symmetric)
    event = Event(kind, square.conditions, point_of(square, X), 0.5 * next(totals, math.nan))
    return LocatedEvent(share, event, fault(square, X) is None)


def _of_fault(step: Step, X: Array, why: Fault) -> LocatedEvent | None:
    """The graze or the lost impact that a fault at X comes from."""
    own = step.equations.conditions
    if why.reason == ORDER:
        return None
    if why.reason == LOST:
        return _solved(step, X, (*own, Condition(SPEED, impact=why.impact)))
    peak = _peak(step.equations, X, why)
    return None if peak is None else _solved(step, X, (*own, Condition(GRAZE, side=why.side)), peak)


def _peak(equations: Extended, X: Array, why: Fault) -> float | None:
    """About when y, beyond a stop since the time of a fault, turns back: where Newton's method looks for a graze."""
    lin, itinerary, points = equations.motion(X)
    span = float(itinerary.span(lin)[0])
    ends = [t + k * span for t in points.t[0] for k in (0, 1, 2)]
    limit = min([end for end in ends if end > why.time + 1e-9 * span], default=why.time + span)
    s = np.linspace(why.time, limit, 402)[1:-1]
    speed = why.side * motion_at(lin, itinerary, points, s[None])[1, 0]
    turned = np.flatnonzero(speed <= 0.0)
    if not len(turned):
        return None
    k = int(turned[0])
    return float(s[0] if k == 0 else s[k - 1] + (s[k] - s[k - 1]) * speed[k - 1] / (speed[k - 1] - speed[k]))
