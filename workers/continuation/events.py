"""Events between two points of a branch or curve, located as solutions of square systems."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation.admissible import LOST, ORDER, Fault
from workers.continuation.equations import Orbit, motion_at
from workers.continuation.extended import GRAZE, MINUS_ONE, PAIR, SPEED, Condition, Extended, solve
from workers.continuation.linear import NoOscillatorError
from workers.continuation.minimal import Reduction, difference, is_minimal, reduced, reductions
from workers.continuation.stability import multipliers
from workers.continuation.view import TestFunctions, fault, name_of, view, without_own
from workers.continuation.walk import between

Array = NDArray[np.float64]

HALVINGS = 14
"""Halvings of a step that help to locate where an orbit ceases to be admissible."""

TINY = 1e-300

NEAR_HALVES = 1e-2
"""Difference of both halves, in radians of the force and relative speeds, below which a branch that stalls meets the
orbit of half the turn."""

TRIES = 4
"""Halvings of a step that help to locate what is watched."""


class Point(NamedTuple):
    """One orbit on the way, at parameters (free,).

    contacts (G,)      times at which it grazes
    multipliers (2n,)  of a turn, which is half the orbit where it is symmetric; unstable: how many have modulus above
                       1, besides those that the event itself fixes
    """

    values: Array
    orbit: Orbit
    contacts: Array
    multipliers: NDArray[np.complex128]
    unstable: int


class Event(NamedTuple):
    """An event: its kind, its conditions, and the point; kappa = cos theta of a pair on the unit circle, else NaN."""

    kind: str
    conditions: tuple[Condition, ...]
    point: Point
    kappa: float = math.nan


class LocatedEvent(NamedTuple):
    """An event at a share of the way between two points."""

    share: float
    event: Event


class Change(NamedTuple):
    """What changed its sign between two views, by name; the share of the way at which it is zero, about."""

    name: str
    share: float
    conditions: tuple[Condition, ...]


def point_of(equations: Extended, X: Array, seen: TestFunctions) -> Point:
    """The point of unknowns X (N,) and their view."""
    contacts = equations.contacts(X[None])[0].copy()
    return Point(equations.values(X).copy(), equations.orbit(X), contacts, seen.multipliers, seen.unstable)


def _event_point(equations: Extended, X: Array) -> Point:
    """The point of unknowns X (N,) that solve the conditions of an event."""
    lin = equations.model(equations.values(X))[0]
    mu = multipliers(lin, equations.itinerary, equations.points(X[None]))[0]
    others = without_own(mu, equations.conditions, equations.totals)
    unstable = int(np.sum(np.abs(others) > 1.0))
    return Point(equations.values(X).copy(), equations.orbit(X), equations.contacts(X[None])[0].copy(), mu, unstable)


def turn_of(equations: Extended, X: Array) -> tuple[float, float]:
    """The length of a turn and the forcing frequency at unknowns X (N,)."""
    lin = equations.model(equations.values(X))[0]
    return float(equations.itinerary.span(lin)[0]), float(lin.omega[0])


def changes(before: TestFunctions, after: TestFunctions) -> list[Change]:
    """What changed its sign."""
    found = []
    for name, b in after.watched.items():
        a = before.watched[name]
        if a.sign * b.sign < 0.0:
            found.append(Change(name, 1.0 / (1.0 + math.exp(min(b.log - a.log, 50.0))), b.conditions))
    return found


def located(equations: Extended, here: Array, there: Array, change: Change) -> LocatedEvent | None:
    """The event at which something watched changed its sign; None at a pole, at a real pair of product 1."""
    low, high, guess, end = 0.0, 1.0, change.share, view(equations, there).watched[change.name].sign
    for _ in range(TRIES):
        found = solved(equations, here + guess * (there - here), change.conditions, None, here, there)
        if found is not None:
            return found
        guess = 0.5 * (low + high)
        middle = between(equations, here, there, guess)
        if not middle.converged:
            return None
        low, high = (guess, high) if view(equations, middle.X).watched[change.name].sign != end else (low, guess)
        guess = 0.5 * (low + high)
    return None


def solved(
    equations: Extended,
    guess: Array,
    conditions: tuple[Condition, ...],
    contact: float | None,
    here: Array,
    there: Array,
) -> LocatedEvent | None:
    """The event with these conditions near a guess, if between two points; ``contact`` is a new contact time."""
    values = equations.values(guess)
    square = Extended(equations.family, equations.orbit(guess), conditions, values, _width(equations))
    kept = equations.contacts(guess[None])[0] if square.grazes >= equations.grazes else np.zeros(0)
    X = square.pack(equations.orbit(guess), np.append(kept, [] if contact is None else contact), values)
    try:
        square.follow(X)
        found = solve(square, X)
    except (NoOscillatorError, np.linalg.LinAlgError):
        return None
    share = _share(equations, square, found.X, here, there) if found.converged else None
    if share is None:
        return None
    if not is_minimal(square.itinerary, square.points(found.X[None]), *turn_of(square, found.X)):
        return None
    square.follow(found.X)
    kappa = math.nan
    for condition, total in zip(conditions, square.totals, strict=True):
        if condition.kind == PAIR:
            kappa = 0.5 * total
    if (len(conditions) == 1 and abs(kappa) >= 1.0) or abs(kappa) > 1.0 + 1e-9:
        return None
    kind = name_of(conditions, square.itinerary.symmetric)
    return LocatedEvent(share, Event(kind, conditions, _event_point(square, found.X), kappa))


def leaving(equations: Extended, here: Array, there: Array, why: Fault) -> LocatedEvent | None:
    """The event at which the orbit ceases to be admissible between two points, the first on the way."""
    low, high, X = 0.0, 1.0, there
    for _ in range(HALVINGS):
        found = _of_fault(equations, X, why, here, there)
        if found is not None and _is_admissible(equations, found.event):
            return found
        half = 0.5 * (low + high)
        middle = between(equations, here, there, half)
        if not middle.converged:
            return None
        seen = fault(equations, middle.X)
        if seen is None:
            low = half
        else:
            high, X, why = half, middle.X, seen
    return None


def halves_between(equations: Extended, here: Array, there: Array) -> Reduction | None:
    """The orbit of half the turn that is passed between two points: both halves exchange their parts there."""
    for to in reductions(equations.itinerary):
        if to.parts == 2:
            a, b = (_difference(equations, X, to) for X in (here, there))
            if a @ b <= 0.0:
                return to
    return None


def nearly_halves(equations: Extended, X: Array) -> Reduction | None:
    """The orbit of half the turn that unknowns X (N,) nearly are."""
    for to in reductions(equations.itinerary):
        if to.parts == 2 and np.max(np.abs(_difference(equations, X, to))) < NEAR_HALVES:
            return to
    return None


def origin(equations: Extended, here: Array, there: Array, to: Reduction) -> LocatedEvent | None:
    """The symmetry breaking or period doubling at which a branch becomes that orbit of half the turn; on a curve of
    grazes too. None on other curves, and where it is not found.
    """
    own = tuple(condition for condition in equations.conditions if condition.kind == GRAZE)
    if own != equations.conditions:
        return None
    a, b = (float(np.linalg.norm(_difference(equations, X, to))) + TINY for X in (here, there))
    share = a / (a + b)
    guess = here + share * (there - here)
    orbit, values = reduced(equations.orbit(guess), to), equations.values(guess)
    square = Extended(equations.family, orbit, (*own, Condition(MINUS_ONE)), values, _width(equations))
    X = square.pack(orbit, equations.contacts(guess[None])[0], values)
    square.follow(X)
    found = solve(square, X)
    if not found.converged:
        return None
    kind = name_of(square.conditions, orbit.itinerary.symmetric)
    return LocatedEvent(share, Event(kind, square.conditions, _event_point(square, found.X)))


def _difference(equations: Extended, X: Array, to: Reduction) -> Array:
    span, omega = turn_of(equations, X)
    return difference(equations.itinerary, equations.points(X[None]), span, omega, to)


def _width(equations: Extended) -> Array:
    """The scale of the free parameters."""
    return equations.scale[len(equations.scale) - equations.free :]


def _share(equations: Extended, square: Extended, X: Array, here: Array, there: Array) -> float | None:
    """At which share of the way from here to there X lies, contact times left out; None where it is not near it."""
    ours = np.concatenate([np.arange(equations.states), len(here) - equations.free + np.arange(equations.free)])
    theirs = np.concatenate([np.arange(equations.states), len(X) - equations.free + np.arange(equations.free)])
    chord = (there - here)[ours] / equations.scale[ours]
    off = (X[theirs] - here[ours]) / equations.scale[ours]
    length = float(np.linalg.norm(chord))
    share = float(off @ chord) / length**2
    near = -0.5 < share < 1.5 and float(np.linalg.norm(off - share * chord)) <= max(length, 1e-6)
    return share if near else None


def _of_fault(equations: Extended, X: Array, why: Fault, here: Array, there: Array) -> LocatedEvent | None:
    """The graze or the lost impact that a fault at X comes from."""
    own = equations.conditions
    if why.reason == ORDER:
        return None
    if why.reason == LOST:
        return solved(equations, X, (*own, Condition(SPEED, impact=why.impact)), None, here, there)
    peak = _peak(equations, X, why)
    if peak is None:
        return None
    return solved(equations, X, (*own, Condition(GRAZE, side=why.side)), peak, here, there)


def _is_admissible(equations: Extended, event: Event) -> bool:
    point = event.point
    square = Extended(equations.family, point.orbit, event.conditions, point.values, _width(equations))
    return fault(square, square.pack(point.orbit, point.contacts, point.values)) is None


def _peak(equations: Extended, X: Array, why: Fault) -> float | None:
    """About when y, beyond a stop since the time of a fault, turns back: where Newton's method looks for a graze."""
    lin = equations.model(equations.values(X))[0]
    points, itinerary = equations.points(X[None]), equations.itinerary
    span = float(itinerary.span(lin)[0])
    ends = [t + k * span for t in points.t[0] for k in (0, 1, 2)]
    limit = min([end for end in ends if end > why.time + 1e-9 * span], default=why.time + span)
    s = np.linspace(why.time, limit, 402)[1:-1]
    speed = why.side * motion_at(lin, itinerary, points, s[None])[1][0]
    turned = np.flatnonzero(speed <= 0.0)
    if not len(turned):
        return None
    k = int(turned[0])
    return float(s[0] if k == 0 else s[k - 1] + (s[k] - s[k - 1]) * speed[k - 1] / (speed[k - 1] - speed[k]))
