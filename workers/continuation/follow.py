"""Orbits followed in their free parameters: branches (one, no condition) and curves of events (two, one condition).

Whatever changes sign from one step to the next is located as the solution of a square system. The way ends at the edge
of the window, where it closes, where the orbit ceases to be admissible, or where it turns into a shorter one.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation.events import (
    Event,
    LocatedEvent,
    Point,
    changes,
    halves_between,
    leaving,
    located,
    nearly_halves,
    origin,
    point_of,
    turn_of,
)
from workers.continuation.extended import ANGLE, PAIR, Extended
from workers.continuation.minimal import Reduction, is_minimal
from workers.continuation.view import TestFunctions, view
from workers.continuation.walk import PseudoArclength, at_value

Array = NDArray[np.float64]

EDGE, CLOSED, BUDGET, STALLED, INADMISSIBLE, SHORTER = (
    "edge", "closed", "budget", "stalled", "inadmissible", "shorter_orbit",
)  # fmt: skip
"""How a way ends where it does not end at an event: at the window's edge; as a closed loop; its points are spent; no
step converges; where the orbit ceases to be admissible, at no event that was found; it became a shorter orbit."""


SHORTEST = 1e-3
"""Share of the longest step down to which a step is repeated that went too far, or slid onto another orbit."""


DOUBT = 1e-4
"""Distance from the unit circle within which a multiplier may be on either side: beside a pitchfork it flickers."""


class BranchRun(NamedTuple):
    """Points in order, those of events among them; events in order; how it ends at either end; Newton steps taken."""

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


def window_of(free: tuple[str, ...], window: Mapping[str, tuple[float, float]]) -> Window:
    """The window of these parameters; ValueError where one has no bounds or none between them."""
    for name in free:
        if name not in window or not window[name][0] < window[name][1]:
            raise ValueError(f"window of {name}: found {window.get(name)}; give (low, high) with low < high")
    return Window(np.array([window[name][0] for name in free]), np.array([window[name][1] for name in free]))


Until = Callable[[Event], bool]
"""Whether a way ends at an event."""


def never(event: Event) -> bool:
    """No way ends at any event that it can pass."""
    return False


def follow(
    equations: Extended, start: Array, window: Window, resolution: float, budget: int, until: Until = never
) -> BranchRun:
    """Both ways from a solution ``start`` (N,) of the equations, at most ``budget`` points each.

    ``resolution`` is the longest step, as a share of the window; either way ends at the first event of which ``until``
    is true. ValueError where the orbit to start from is not
    admissible or another one repeated.
    """
    first = view(equations, start)
    if first.fault is not None:
        raise ValueError(f"the orbit to start from is not admissible: {first.fault.reason}")
    if not is_minimal(equations.itinerary, equations.points(start[None]), *turn_of(equations, start)):
        raise ValueError("the orbit to start from is a shorter or symmetric one repeated: follow that one")
    totals, borders = list(equations.totals), list(equations.borders)
    direction = np.zeros(len(start))
    direction[len(start) - equations.free :] = equations.scale[len(start) - equations.free :]
    ahead = _OneWay(equations, start, first, direction, window, resolution, budget, until)
    ahead.run()
    if ahead.end == CLOSED:
        return BranchRun(ahead.points, ahead.events, (CLOSED, CLOSED), ahead.walker.newton_steps)
    equations.totals, equations.borders = totals, borders  # those of the start, not of the other end
    back = _OneWay(equations, start, first, -direction, window, resolution, budget, until)
    back.run()
    return BranchRun(
        points=back.points[:0:-1] + ahead.points,
        events=back.events[::-1] + ahead.events,
        ends=(back.end, ahead.end),
        newton_steps=ahead.walker.newton_steps + back.walker.newton_steps,
    )


class _OneWay:
    """One of the two ways from a start, point by point."""

    def __init__(
        self,
        equations: Extended,
        start: Array,
        first: TestFunctions,
        direction: Array,
        window: Window,
        resolution: float,
        budget: int,
        until: Until,
    ) -> None:
        self.equations, self.start, self.window, self.budget, self.until = equations, start, window, budget, until
        self.walker = PseudoArclength(equations, start, resolution, direction)
        self.leaving = self.walker.tangent
        self.view = first
        self.points: list[Point] = [point_of(equations, start, first)]
        self.events: list[Event] = []
        self.end = ""

    def run(self) -> None:
        """Go on until the end."""
        while not self.end:
            here = self.walker.X
            if len(self.points) > self.budget:
                self.end = BUDGET
            elif not self.walker.advance():
                self._stall(here)
            else:
                self._arrive(here, self.walker.X)

    def _stall(self, here: Array) -> None:
        """End where no step converges: where a branch meets the orbit that it left the equations are singular."""
        to = nearly_halves(self.equations, here)
        if to is None:
            self.end = STALLED
        else:
            self._become_shorter(here, here, to)

    def _arrive(self, here: Array, there: Array) -> None:
        """Take the step from one point to the next, or a shorter one where it went too far."""
        eq, end = self.equations, ""
        crossed = self.window.crossed(eq.values(there))
        if crossed is not None:
            edge = at_value(eq, here, there, *crossed)
            if not edge.converged:
                self.end = EDGE
                return
            there, end = edge.X, EDGE
        if not end and self._closes(here, there):
            there, end = self.start, CLOSED
        seen = view(eq, there)
        slid = not is_minimal(eq.itinerary, eq.points(there[None]), *turn_of(eq, there))
        if (slid or self._went_too_far(seen)) and self.walker.length > SHORTEST * self.walker.longest:
            self.walker.back()
            eq.follow(here)
            return
        to = halves_between(eq, here, there)
        if slid and to is None:
            self.end = SHORTER
        elif to is not None:
            self._become_shorter(here, there, to)
        else:
            self._pass(here, there, seen, end)

    def _went_too_far(self, seen: TestFunctions) -> bool:
        """Whether stability changed on a branch although nothing that is watched did."""
        if self.equations.conditions or seen.fault is not None or changes(self.view, seen):
            return False
        before, after = np.abs(self.view.multipliers), np.abs(seen.multipliers)
        gained = np.sum(after > 1.0 + DOUBT) > np.sum(before > 1.0 - DOUBT)
        return bool(gained or np.sum(after > 1.0 - DOUBT) < np.sum(before > 1.0 + DOUBT))

    def _closes(self, here: Array, there: Array) -> bool:
        """Whether a step passes the start in the direction in which the way left it."""
        before, after = ((X - self.start) / self.equations.scale for X in (here, there))
        passes = float(before @ self.leaving) < 0.0 <= float(after @ self.leaving)
        away = max(float(np.linalg.norm(before)), float(np.linalg.norm(after)))
        return passes and away < 1.5 * self.walker.longest

    def _become_shorter(self, here: Array, there: Array, to: Reduction) -> None:
        """End where a branch meets the orbit that it left."""
        placed = origin(self.equations, here, there, to)
        self.end = SHORTER
        if placed is not None:
            self.events.append(placed.event)
            self.points.append(placed.event.point)
            self.end = placed.event.kind

    def _pass(self, here: Array, there: Array, seen: TestFunctions, end: str) -> None:
        """Locate what happened between two points and add it; end the way where it ends."""
        eq, found, limit = self.equations, list[LocatedEvent](), math.inf
        last = point_of(eq, there, seen)
        if seen.fault is not None:
            ceases = leaving(eq, here, there, seen.fault)
            if ceases is None:
                self.end = INADMISSIBLE
                return
            found.append(ceases)
            limit, end, last = ceases.share, ceases.event.kind, ceases.event.point
        for change in changes(self.view, seen):
            placed = located(eq, here, there, change)
            if placed is not None and placed.share <= limit:
                found.append(placed)
                if _ends_pair(eq, placed.event) or self.until(placed.event):
                    limit, end, last = placed.share, placed.event.kind, placed.event.point
        found.sort(key=lambda placed: placed.share)
        passed = [placed.event for placed in found if placed.share <= limit]
        self.events += passed
        self.points += [event.point for event in passed if event.point is not last]
        self.points.append(last)
        self.view, self.end = seen, end


def _ends_pair(equations: Extended, event: Event) -> bool:
    """Whether a curve of pairs on the unit circle ends: beyond kappa = 1 or -1 they are real."""
    pair = bool(equations.conditions) and equations.conditions[0].kind == PAIR
    return pair and any(c.kind == ANGLE and abs(c.kappa) == 1.0 for c in event.conditions)
