"""Orbits followed in their free parameters: branches (one, no condition) and curves of events (two, one condition).

Step by step, whatever changes sign on the way is located as the solution of a square system; the way ends at the edge
of the window, where it closes, where the orbit ceases to be admissible, or where it turns into a shorter one.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.orbit.admissible import LOST, ORDER, Fault
from workers.orbit.equations import Orbit, motion_at
from workers.orbit.extended import ANGLE, GRAZE, MINUS_ONE, PAIR, SPEED, UNIT, Condition, Extended, Solved, solve
from workers.orbit.minimal import difference, is_minimal, reduced, reductions
from workers.orbit.view import View, Watched, fault, name_of, view
from workers.orbit.walk import Walker, at_value, between

Array = NDArray[np.float64]

EDGE, CLOSED, BUDGET, STALLED, INADMISSIBLE, SHORTER = (
    "edge", "closed", "budget", "stalled", "inadmissible", "shorter_orbit",
)  # fmt: skip
"""How a way ends where it does not end at an event: at the window's edge; as a closed loop; its points are spent; no
step converges; another contact that could not be located; it became a shorter or symmetric orbit."""

HALVINGS = 14
"""Halvings of a step that help to locate an event."""


class Point(NamedTuple):
    """One orbit on the way: parameters (free,), its contact times (G,), multipliers of a turn, unstable ones besides
    the event's own.
    """

    values: Array
    orbit: Orbit
    contacts: Array
    multipliers: NDArray[np.complex128]
    unstable: int


class Event(NamedTuple):
    """An event on the way: its kind, its conditions, and the point; kappa = cos theta of a pair on the unit circle."""

    kind: str
    conditions: tuple[Condition, ...]
    point: Point
    kappa: float


class Way(NamedTuple):
    """Points in order, events on the way in order, how it ends at either end, and the Newton steps it took."""

    points: list[Point]
    events: list[Event]
    ends: tuple[str, str]
    newton_steps: int


class Window(NamedTuple):
    """Bounds (free,) of the parameters."""

    low: Array
    high: Array

    @property
    def width(self) -> Array:
        """Their widths (free,)."""
        return self.high - self.low

    def crossed(self, values: Array) -> tuple[int, float] | None:
        """The first parameter that is outside and the bound it has crossed; None inside."""
        for i, value in enumerate(values):
            if not self.low[i] <= value <= self.high[i]:
                return i, float(self.low[i] if value < self.low[i] else self.high[i])
        return None


def window_of(free: tuple[str, ...], window: dict[str, tuple[float, float]]) -> Window:
    """The window of these parameters; ValueError where one has no bounds or none between them."""
    for name in free:
        if name not in window or not window[name][0] < window[name][1]:
            raise ValueError(f"window of {name}: found {window.get(name)}; give (low, high) with low < high")
    return Window(np.array([window[name][0] for name in free]), np.array([window[name][1] for name in free]))


def follow(equations: Extended, start: Array, window: Window, resolution: float, budget: int) -> Way:
    """Both ways from a solution ``start`` (N,) of the equations, at most ``budget`` points each.

    ``resolution`` is the longest step, as a share of the window.
    """
    first = view(equations, start)
    if first.fault is not None:
        raise ValueError(f"the orbit to start from is not admissible: {first.fault.reason}")
    span, omega = _turn(equations, start)
    if not is_minimal(equations.itinerary, equations.points(start[None]), span, omega):
        raise ValueError("the orbit to start from is a shorter or symmetric one repeated: follow that one")
    place = len(start) - equations.free
    direction = np.zeros(len(start))
    direction[place:] = equations.scale[place:]
    ahead = _One(equations, start, first, direction, window, resolution, budget)
    ahead.run()
    points, events, ends, steps = ahead.points, ahead.events, ["", ahead.end], ahead.walker.newton_steps
    if ahead.end == CLOSED:
        ends[0] = CLOSED
    else:
        equations.follow(start)
        back = _One(equations, start, first, -direction, window, resolution, budget)
        back.run()
        points, events = back.points[:0:-1] + points, back.events[::-1] + events
        ends[0], steps = back.end, steps + back.walker.newton_steps
    return Way(points, events, (ends[0], ends[1]), steps)


class _One:
    """One of the two ways from a start."""

    def __init__(
        self,
        equations: Extended,
        start: Array,
        first: View,
        direction: Array,
        window: Window,
        resolution: float,
        budget: int,
    ) -> None:
        self.equations, self.start, self.window, self.budget = equations, start, window, budget
        self.view = first
        self.walker = Walker(equations, start, resolution, direction)
        self.leaving = self.walker.tangent
        self.points, self.events, self.end = [_point(equations, start, first)], [], ""

    def run(self) -> None:
        """Go on until the end."""
        walker, eq = self.walker, self.equations
        while not self.end:
            if len(self.points) > self.budget:
                self.end = BUDGET
                return
            here = walker.X
            if not walker.advance():
                self.end = STALLED
                return
            there, end = walker.X, ""
            crossed = self.window.crossed(eq.values(there))
            if crossed is not None:
                edge = at_value(eq, here, there, *crossed)
                if edge.converged:
                    there, end = edge.X, EDGE
            seen = view(eq, there)
            if self._went_too_far(seen) and not end and walker.length > 1e-3 * walker.longest:
                walker.back()
                eq.follow(here)
                continue
            if not end and self._closes(there):
                end = CLOSED
            if self._turns_shorter(here, there):
                end = SHORTER
            self._pass(here, there, seen, end)

    def _went_too_far(self, seen: View) -> bool:
        """Whether stability changed on a branch although nothing that is watched did."""
        known = seen.fault is not None or bool(_changes(self.view, seen))
        return not self.equations.conditions and seen.unstable != self.view.unstable and not known

    def _closes(self, there: Array) -> bool:
        """Whether the way has come back to its start."""
        away = (there - self.start) / self.equations.scale
        near = float(np.linalg.norm(away)) < 0.75 * self.walker.longest
        last = (self.points[-1].values - self.equations.values(self.start)) if near else None
        return (
            near
            and len(self.points) > 5
            and last is not None
            and float(away @ self.leaving) >= 0.0
            and float(self.walker.tangent @ self.leaving) > 0.5
        )

    def _turns_shorter(self, here: Array, there: Array) -> bool:
        """Whether the orbit passes one that is shorter or symmetric, where two impacts exchange their parts."""
        eq = self.equations
        for to in reductions(eq.itinerary):
            if to.parts == 2:
                a, b = (difference(eq.itinerary, eq.points(X[None]), *_turn(eq, X), to) for X in (here, there))
                if a @ b <= 0.0:
                    return True
        return False

    def _pass(self, here: Array, there: Array, seen: View, end: str) -> None:
        """Locate what happened between two points and add it; end the way where it ends."""
        eq, former, last = self.equations, self.view, _point(self.equations, there, seen)
        found: list[tuple[float, Event]] = []
        limit = math.inf
        if end == SHORTER:
            event = shorter_event(eq, here, there)
            if event is not None:
                end, last = event.kind, event.point
                found.append((0.99, event))
            limit = 1.0
        elif seen.fault is not None:
            located = _leaving(eq, here, there, seen.fault)
            if located is None:
                self.end = INADMISSIBLE
                return
            limit, event = located
            found.append(located)
            end, last = event.kind, event.point
        for change in _changes(former, seen):
            event_at = _located(eq, here, there, change)
            if event_at is None or event_at[0] > limit:
                continue
            if any(condition.kind == ANGLE and abs(condition.kappa) == 1.0 for condition in event_at[1].conditions) and (
                eq.conditions[0].kind == PAIR
            ):
                limit, (end, last) = event_at[0], (event_at[1].kind, event_at[1].point)
            found.append(event_at)
        self.events += [event for place, event in sorted(found, key=lambda item: item[0]) if place <= limit]
        self.points.append(last)
        self.view, self.end = seen, end


def _point(equations: Extended, X: Array, seen: View) -> Point:
    contacts = equations.contacts(X[None])[0].copy()
    return Point(equations.values(X).copy(), equations.orbit(X), contacts, seen.multipliers, seen.unstable)


def _turn(equations: Extended, X: Array) -> tuple[float, float]:
    """The length of a turn and the forcing frequency at X."""
    lin = equations.family.linear(equations.values(X)[None])
    return float(equations.itinerary.span(lin)[0]), float(lin.omega[0])


def _changes(before: View, after: View) -> list[tuple[float, Watched]]:
    """What changed its sign, with the share of the way at which a line through both values is zero."""
    found = []
    for name, b in after.watched.items():
        a = before.watched[name]
        if a.sign * b.sign < 0.0:
            found.append((1.0 / (1.0 + math.exp(min(b.log - a.log, 50.0))), b))
    return found


def _located(equations: Extended, here: Array, there: Array, change: tuple[float, Watched]) -> tuple[float, Event] | None:
    """The event at which something watched changed its sign, and its place on the way; None where there is none.

    A real pair of product 1 is none, nor is a pole.
    """
    share, watched = change
    low, high, guess = 0.0, 1.0, share
    for _ in range(4):
        X = here + guess * (there - here)
        event = _solved(equations, X, watched.conditions, None, here, there)
        if event is not None:
            return event
        middle = between(equations, here, there, 0.5 * (low + high))
        if not middle.converged:
            return None
        names = [name for name, w in view(equations, middle.X).watched.items() if w.conditions[-1].kind ==
                 watched.conditions[-1].kind and w.conditions[-1].kappa == watched.conditions[-1].kappa]
        if not names:
            return None
        sign = view(equations, middle.X).watched[names[0]].sign
        low, high = (0.5 * (low + high), high) if sign != watched.sign else (low, 0.5 * (low + high))
        guess = 0.5 * (low + high)
    return None


def _solved(
    equations: Extended,
    guess: Array,
    conditions: tuple[Condition, ...],
    contact: float | None,
    here: Array,
    there: Array,
) -> tuple[float, Event] | None:
    """The event with these conditions near a guess, and its place on the way from here to there, if it is there."""
    eq = equations
    values = eq.values(guess)
    square = Extended(eq.family, eq.orbit(guess), conditions, values, eq.scale[len(eq.scale) - eq.free :])
    contacts = eq.contacts(guess[None])[0] if square.grazes >= eq.grazes else np.zeros(0)
    X = square.pack(eq.orbit(guess), np.append(contacts, [] if contact is None else contact), values)
    try:
        square.follow(X)
        found = solve(square, X)
    except (ValueError, np.linalg.LinAlgError):
        return None
    if not found.converged:
        return None
    common = np.concatenate([np.arange(eq.states), len(guess) - eq.free + np.arange(eq.free)])
    own = np.concatenate([np.arange(eq.states), len(X) - eq.free + np.arange(eq.free)])
    way = (there - here)[common] / eq.scale[common]
    off = (found.X[own] - here[common]) / eq.scale[common]
    length = float(np.linalg.norm(way))
    place = float(off @ way) / length**2
    if not -0.5 < place < 1.5 or float(np.linalg.norm(off - place * way)) > max(length, 1e-6):
        return None
    span, omega = _turn(square, found.X)
    if not is_minimal(eq.itinerary, square.points(found.X[None]), span, omega):
        return None
    square.follow(found.X)
    kappa = math.nan
    for i, condition in enumerate(conditions):
        if condition.kind == PAIR:
            kappa = 0.5 * square.totals[i]
            if abs(kappa) > 1.0 + 1e-9 or (len(conditions) == 1 and abs(kappa) >= 1.0):
                return None
    seen = view(square, found.X) if len(conditions) == 1 else None
    return place, Event(name_of(conditions, eq.itinerary.symmetric), conditions, _event_point(square, found.X, seen), kappa)


def _event_point(square: Extended, X: Array, seen: View | None) -> Point:
    from workers.orbit.stability import multipliers
    from workers.orbit.view import without_own

    lin = square.family.linear(square.values(X)[None])
    mu = multipliers(lin, square.itinerary, square.points(X[None]))[0]
    others = without_own(mu, square.conditions, square.totals)
    del seen
    return Point(
        square.values(X).copy(), square.orbit(X), square.contacts(X[None])[0].copy(), mu, int(np.sum(np.abs(others) > 1.0))
    )


def _leaving(equations: Extended, here: Array, there: Array, why: Fault) -> tuple[float, Event] | None:
    """The event at which the orbit ceases to be admissible between two points, and its place; None if not found."""
    eq, low, high, X = equations, 0.0, 1.0, there
    for _ in range(HALVINGS):
        found = _fault_event(eq, X, why, here, there)
        if found is not None:
            place, event = found
            remaining = _fault_at(eq, event)
            if remaining is None:
                return place, event
        middle = between(eq, here, there, 0.5 * (low + high))
        if not middle.converged:
            return None
        seen = fault(eq, middle.X)
        if seen is None:
            low = 0.5 * (low + high)
        else:
            high, X, why = 0.5 * (low + high), middle.X, seen
    return None


def _fault_event(
    equations: Extended, X: Array, why: Fault, here: Array, there: Array
) -> tuple[float, Event] | None:
    """The graze or the lost impact that a fault at X comes from."""
    if why.reason == ORDER:
        return None
    if why.reason == LOST:
        return _solved(equations, X, (*equations.conditions, Condition(SPEED, index=why.index)), None, here, there)
    peak = _peak(equations, X, why)
    if peak is None:
        return None
    condition = Condition(GRAZE, side=why.side)
    return _solved(equations, X, (*equations.conditions, condition), peak, here, there)


def _fault_at(equations: Extended, event: Event) -> Fault | None:
    """Why the orbit of an event is not admissible."""
    point = event.point
    square = Extended(
        equations.family, point.orbit, event.conditions, point.values, equations.scale[len(equations.scale) - equations.free :]
    )
    return fault(square, square.pack(point.orbit, point.contacts, point.values))


def _peak(equations: Extended, X: Array, why: Fault) -> float | None:
    """About when y, beyond a stop since the time of a fault, turns back: where a graze is looked for."""
    lin = equations.family.linear(equations.values(X)[None])
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
    if k == 0:
        return float(s[0])
    return float(s[k - 1] + (s[k] - s[k - 1]) * speed[k - 1] / (speed[k - 1] - speed[k]))


def shorter_event(equations: Extended, here: Array, there: Array) -> Event | None:
    """The symmetry breaking or period doubling at which a branch becomes a symmetric or shorter orbit."""
    eq = equations
    if eq.conditions:
        return None
    for to in reductions(eq.itinerary):
        if to.parts != 2:
            continue
        a, b = (difference(eq.itinerary, eq.points(X[None]), *_turn(eq, X), to) for X in (here, there))
        if a @ b > 0.0:
            continue
        share = math.sqrt(a @ a) / (math.sqrt(a @ a) + math.sqrt(b @ b))
        guess = here + share * (there - here)
        orbit, values = reduced(eq.orbit(guess), to), eq.values(guess)
        square = Extended(eq.family, orbit, (Condition(MINUS_ONE),), values, eq.scale[len(eq.scale) - eq.free :])
        X = square.pack(orbit, np.zeros(0), values)
        square.follow(X)
        found: Solved = solve(square, X)
        if found.converged:
            kind = name_of(square.conditions, orbit.itinerary.symmetric)
            return Event(kind, square.conditions, _event_point(square, found.X, None), math.nan)
    return None


def unit_condition(kind: str, contact_side: int = 0, index: int = 0, kappa: float = 0.0) -> Condition:
    """The condition of an event of one kind."""
    names = {
        "fold": UNIT, "symmetry_breaking": MINUS_ONE, "period_doubling": MINUS_ONE, "neimark_sacker": PAIR,
        "graze": GRAZE, "impact_lost": SPEED,
    }  # fmt: skip
    return Condition(names[kind], contact_side, index, kappa)
