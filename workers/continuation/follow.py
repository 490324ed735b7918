"""Orbits followed in their free parameters: branches (one, no condition) and curves of events (two, one condition).

Whatever changes sign from one step to the next is located as the solution of a square system. A run goes in both
directions from its start; either ends at the edge of the window, where it closes, where the orbit ceases to be
admissible, or where it turns into a shorter one.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from workers.continuation.events import (
    Event,
    LocatedEvent,
    changes,
    halves_between,
    leaving,
    located,
    nearly_halves,
    origin,
)
from workers.continuation.extended import ANGLE, PAIR, Extended
from workers.continuation.monitors import Point, TestFunctions, monitored
from workers.continuation.newton import Array
from workers.continuation.same import Reduction, is_minimal
from workers.continuation.walk import PseudoArclength, Step

EDGE, CLOSED, BUDGET, STALLED, INADMISSIBLE, SHORTER = (
    "edge", "closed", "budget", "stalled", "inadmissible", "shorter_orbit",
)  # fmt: skip
"""How a direction ends if not at an event: at the window's edge; as a closed loop; its points are spent; no step
converges; where the orbit ceases to be admissible, at no event that was found; it became a shorter orbit."""

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
"""Whether a run ends at an event."""


def never(event: Event) -> bool:
    """No run ends at an event that it can pass."""
    return False


def follow(
    equations: Extended, start: Array, window: Window, resolution: float, budget: int, until: Until = never
) -> BranchRun:
    """Both directions from a solution ``start`` (N,) of the equations, at most ``budget`` points each.

    ``resolution`` is the longest step, as a share of the window; either direction ends at the first event of which
    ``until`` is true. ValueError where the orbit to start from is not admissible or another one repeated.
    """
    first = monitored(equations, start)
    if first.fault is not None:
        raise ValueError(f"the orbit to start from is not admissible: {first.fault.reason}")
    if not is_minimal(*equations.motion(start)):
        raise ValueError("the orbit to start from is a shorter or symmetric one repeated: follow that one")
    direction = np.zeros(len(start))
    direction[len(start) - equations.free :] = equations.width
    walkers = (PseudoArclength(first.equations, start, resolution, sign * direction) for sign in (1.0, -1.0))
    ahead = _one_direction(next(walkers), first, window, budget, until)
    if CLOSED in ahead.ends:
        return ahead
    back = _one_direction(next(walkers), first, window, budget, until)
    return BranchRun(
        points=back.points[:0:-1] + ahead.points,
        events=back.events[::-1] + ahead.events,
        ends=(back.ends[1], ahead.ends[1]),
        newton_steps=ahead.newton_steps + back.newton_steps,
    )


class _Passage(NamedTuple):
    """What a step brings: events, points with those of events among them, how the direction ends there, if it does, and
    the test functions at the last point.
    """

    end: str
    events: tuple[Event, ...] = ()
    points: tuple[Point, ...] = ()
    after: TestFunctions | None = None


def _one_direction(
    walker: PseudoArclength, first: TestFunctions, window: Window, budget: int, until: Until
) -> BranchRun:
    """One of the two directions from a start, whose point comes first; how it ends is the second of both ends."""
    points, events, end, seen = [first.point], list[Event](), "", first
    while not end:
        if len(points) > budget:
            end = BUDGET
            break
        passage = _next(walker, seen, window, until)
        if passage is None:
            walker.back()
            continue
        points += passage.points
        events += passage.events
        end, seen = passage.end, passage.after or seen
        walker.equations = seen.equations
    return BranchRun(points, events, (CLOSED if end == CLOSED else "", end), walker.newton_steps)


def _next(walker: PseudoArclength, seen: TestFunctions, window: Window, until: Until) -> _Passage | None:
    """What the next step brings; None where it went too far, or slid onto another orbit, and a shorter one is left."""
    eq, here = walker.equations, walker.X
    if not walker.advance():  # where a branch meets the orbit that it left the equations are singular
        to = nearly_halves(eq, here)
        return _Passage(STALLED) if to is None else _meeting(Step(eq, here, here), to)
    there, end, crossed = walker.X, "", window.crossed(eq.values(walker.X))
    if crossed is not None:
        edge = Step(eq, here, there).at_value(*crossed)
        if not edge.converged:
            return _Passage(EDGE)
        there, end = edge.X, EDGE
    elif walker.closes():
        there, end = walker.start[0], CLOSED
    after = monitored(eq, there)
    step, slid = Step(after.equations, here, there), not is_minimal(*eq.motion(there))
    if (slid or _went_too_far(seen, after)) and walker.length > SHORTEST * walker.longest:
        return None
    to = halves_between(step)
    if to is not None:
        return _meeting(step, to)
    return _Passage(SHORTER) if slid else _passage(step, seen, after, end, until)


def _went_too_far(before: TestFunctions, after: TestFunctions) -> bool:
    """Whether stability changed on a branch although no test function changed its sign."""
    if after.equations.conditions or after.fault is not None or changes(before, after):
        return False
    one, other = np.abs(before.point.multipliers), np.abs(after.point.multipliers)
    gained = np.sum(other > 1.0 + DOUBT) > np.sum(one > 1.0 - DOUBT)
    return bool(gained or np.sum(other > 1.0 - DOUBT) < np.sum(one > 1.0 + DOUBT))


def _meeting(step: Step, to: Reduction) -> _Passage:
    """The end where a branch meets the orbit that it left."""
    found = origin(step, to)
    return _Passage(SHORTER) if found is None else _Passage(found.event.kind, (found.event,), (found.event.point,))


def _passage(step: Step, before: TestFunctions, after: TestFunctions, end: str, until: Until) -> _Passage:
    """The events of a step and its last point, at which the direction has this ``end``, unless it ends before that."""
    found, limit, last = list[LocatedEvent](), math.inf, after.point
    if after.fault is not None:
        ceases = leaving(step, after.fault)
        if ceases is None:
            return _Passage(INADMISSIBLE)
        found, limit, end, last = [ceases], ceases.share, ceases.event.kind, ceases.event.point
    for change in changes(before, after):
        met = located(step, change)
        if met is not None and met.share <= limit:
            found.append(met)
            if _ends_pair(step.equations, met.event) or until(met.event):
                limit, end, last = met.share, met.event.kind, met.event.point
    passed = tuple(met.event for met in sorted(found, key=lambda met: met.share) if met.share <= limit)
    return _Passage(end, passed, (*(event.point for event in passed if event.point is not last), last), after)


def _ends_pair(equations: Extended, event: Event) -> bool:
    """Whether a curve of pairs on the unit circle ends: beyond kappa = 1 or -1 they are real."""
    pair = bool(equations.conditions) and equations.conditions[0].kind == PAIR
    return pair and any(c.kind == ANGLE and abs(c.kappa) == 1.0 for c in event.conditions)
