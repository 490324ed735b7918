"""Branches of periodic orbits in one parameter, with their events and the branches that leave at them.

Events, at which a test function changes sign on a step, are located as solutions of square systems. A run goes in both
directions from its start. A direction ends at the edge of the window, or where the branch closes. It also ends where
the orbit ceases to be admissible or turns into a shorter one. If the contacts or slides of an orbit change without a
jump of the motion, the branch or curve continues, and the change is one of its events.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from workers.continuation.beyond_events import is_continuous, is_same_event, orbits_beyond
from workers.continuation.events import (
    Event,
    LocatedEvent,
    MonitoredPoint,
    SolutionPoint,
    find_origin,
    halves_met,
    locate_event,
    monitor_point,
    sign_changes,
)
from workers.continuation.extended_system import ANGLE, MINUS_ONE, PAIR, UNIT, Condition, ExtendedSystem, solve
from workers.continuation.families import Family
from workers.continuation.itinerary import Orbit
from workers.continuation.orbit_equality import double_orbit, is_minimal
from workers.continuation.pseudo_arclength import ContinuationStep, PseudoArclength
from workers.continuation.termination import leaving, nearly_lost
from workers.model.oscillator import Array

EDGE, CLOSED, BUDGET, STALLED, INADMISSIBLE, SHORTER = (
    "edge", "closed", "budget", "stalled", "inadmissible", "shorter_orbit",
)  # fmt: skip
"""How a direction ends if it does not end at an event. EDGE: at the edge of the window. CLOSED: as a closed loop.
BUDGET: its solution points are spent. STALLED: no step converges. INADMISSIBLE: the orbit ceases to be admissible, and
no event was found there. SHORTER: the orbit became a shorter one."""

RESOLUTION, MAX_POINTS = 0.02, 2000
"""Longest step, as a share of the window; maximum number of points of either direction, which then ends with BUDGET."""

MAX_BACK_POINTS = 200
"""Maximum number of points for which an orbit beyond a change of its sequence of events is followed back to the change.
"""

MIN_STEP_SHARE = 1e-3
"""Shortest step, as a share of the longest, to which a step is reduced that went too far or slid onto another orbit."""

DOUBT = 1e-4
"""Distance of a multiplier from the unit circle within which it may be on either side: near a pitchfork it flickers."""

NOISE = 1e-6
"""Size of an entry of a null vector, as a share of the largest entry, up to which the entry and its sign may be
rounding."""

OWN_MULTIPLIERS = {UNIT: 1, MINUS_ONE: 1, PAIR: 2}
"""Number of multipliers that cross the unit circle at an event, by the condition of the event."""


class BranchRun(NamedTuple):
    """The result of following a branch or a curve.

    points        solution points in order, events included
    events        events in order
    ends          how either end of the branch ends
    newton_steps  number of Newton steps

    Points beyond an event at which the orbit continues with other contacts or slides have another itinerary, or
    sequence of events.
    """

    points: list[SolutionPoint]
    events: list[Event]
    ends: tuple[str, str]
    newton_steps: int


def bounds_of(free: tuple[str, ...], window: Mapping[str, tuple[float, float]]) -> Array:
    """Return the bounds (2, free) of these parameters, low and high.

    Raise ValueError if the window lacks a parameter, or if its low bound is not below its high one.
    """
    for name in free:
        if name not in window or not window[name][0] < window[name][1]:
            raise ValueError(f"window of {name}: found {window.get(name)}, must be (low, high) with low < high")
    return np.array([window[name] for name in free], dtype=np.float64).T


Until = Callable[[Event], bool]
"""Predicate on events: a run ends at an event for which it is True."""


class BranchStart(NamedTuple):
    """An orbit from which another branch starts, and the parameter ``value`` there."""

    orbit: Orbit
    value: float


def branch(
    family: Family,
    orbit: Orbit,
    value: float,
    window: tuple[float, float],
    *,
    resolution: float = RESOLUTION,
    budget: int = MAX_POINTS,
    until: Until | None = None,
) -> BranchRun:
    """Return the branch of an orbit of a family with one free parameter, in both directions from ``value``.

    The branch is followed by pseudo-arclength in state, times and the parameter. Its events are folds, symmetry
    breakings, period doublings, Neimark-Sacker points, and changes of the itinerary, the sequence of events: grazes,
    lost impacts, changes of stick. At a change of itinerary the branch continues with another itinerary if the motion
    depends continuously on the parameter, else it ends.

    family      machines over one free parameter
    orbit       orbit near the one to start from
    value       parameter of the start
    window      (low, high) of the parameter
    resolution  longest step, as a share of the window
    budget      maximum number of points of either direction
    until       predicate: either direction ends at the first event for which it is True

    Raise ValueError, in one line, for flight after an impact with R = 0, and if there is no orbit near the start. Also
    raise ValueError if the start lies outside the window, is not admissible, or is a shorter or symmetric orbit
    repeated.
    """
    bounds = bounds_of(family.free, dict.fromkeys(family.free, window))
    if not window[0] <= value <= window[1]:
        raise ValueError(f"{family.free[0]}: found {value:g}, must be in {window[0]:g}..{window[1]:g}")
    values = np.array([value])
    equations = ExtendedSystem(family, orbit, (), values, bounds[1] - bounds[0])
    row = np.eye(1, len(equations.scale), equations.states)[0] / equations.scale
    solved = solve(equations, equations.pack(orbit, np.zeros(0), values), row)
    if not solved.converged:
        raise ValueError(f"Newton's method finds no orbit at {family.free[0]} = {value:g}")
    return follow_both_ways(equations, solved.X, bounds, resolution, budget, until)


def switch_branch(family: Family, event: Event, width: float, amplitude: float = 0.02) -> BranchStart:
    """Return the doubled orbit next to a period doubling, or the asymmetric one next to a symmetry breaking.

    family     machines over one free parameter
    event      period doubling or symmetry breaking
    width      width of the parameter's window
    amplitude  distance along the critical direction, in units of the scale of state and times

    The other half of the orbit, or its mirror image, is the same branch in the other direction. Raise ValueError for
    other events, and if Newton's method finds no orbit.
    """
    if event.conditions != (Condition(MINUS_ONE),):
        raise ValueError(f"event: found {event.kind}, must be symmetry_breaking or period_doubling")
    none, widths, (values, orbit, *_) = np.zeros(0), np.array([width]), event.point
    square = ExtendedSystem(family, orbit, event.conditions, values, widths)
    critical = square.critical(square.pack(orbit, none, values))
    sizes = np.abs(critical)  # either sign is a null vector: the first entry above rounding decides
    critical = critical * np.sign(critical[np.argmax(sizes > NOISE * np.max(sizes))])
    doubled = double_orbit(orbit, orbit.span(square.model(values)))
    equations = ExtendedSystem(family, doubled, (), values, widths)
    unit = np.concatenate([critical, -critical[len(critical) - square.m :], np.zeros(1)])
    if doubled.itinerary.is_cycle:  # times count from the first event, and so does the length of a turn
        unit[len(critical) - square.m : -1] -= unit[len(critical) - square.m]
    unit /= np.linalg.norm(unit)
    X = equations.pack(doubled, none, values) + amplitude * unit * equations.scale
    solved = solve(equations, X, unit / equations.scale)
    if not solved.converged:
        raise ValueError(f"Newton's method finds no orbit near the {event.kind}; try another amplitude")
    return BranchStart(equations.orbit(solved.X), float(equations.values(solved.X)[0]))


def follow_both_ways(
    equations: ExtendedSystem, start: Array, bounds: Array, resolution: float, budget: int, until: Until | None
) -> BranchRun:
    """Return a branch or a curve, followed in both directions from a solution for at most ``budget`` points each.

    equations   extended system of the branch or curve
    start       (N,) its solution to start from
    bounds      (2, free) bounds of the parameters
    resolution  longest step, as a share of the window
    budget      maximum number of points of either direction
    until       predicate: either direction ends at the first event for which it is True

    Raise ValueError if the orbit to start from is not admissible or is another orbit repeated.
    """
    first = monitor_point(equations, start)
    if first.fault is not None:
        raise ValueError(f"the orbit to start from is not admissible: {first.fault.reason}")
    if not is_minimal(equations.motion(start)):
        raise ValueError("the orbit to start from repeats a shorter or symmetric orbit: start from the latter")
    direction = np.zeros(len(start))
    direction[len(start) - equations.free :] = equations.width
    walks = (PseudoArclength(first.equations, start, resolution, sign * direction) for sign in (1.0, -1.0))
    ahead = _one_direction(next(walks), first, bounds, budget, until)
    if CLOSED in ahead.ends:
        return ahead
    back = _one_direction(next(walks), first, bounds, budget, until)
    return BranchRun(
        points=back.points[:0:-1] + ahead.points,
        events=back.events[::-1] + ahead.events,
        ends=(back.ends[1], ahead.ends[1]),
        newton_steps=ahead.newton_steps + back.newton_steps,
    )


class _StepOutcome(NamedTuple):
    """The result of one step along a branch or curve.

    end     how the direction ends; empty if it continues
    events  events on the step
    points  solution points, events included
    after   test functions at the last point
    """

    end: str
    events: tuple[Event, ...] = ()
    points: tuple[SolutionPoint, ...] = ()
    after: MonitoredPoint | None = None


def _one_direction(
    walk: PseudoArclength,
    first: MonitoredPoint,
    bounds: Array,
    budget: int,
    until: Until | None,
    goes_on: bool = True,
) -> BranchRun:
    """Return the part of a branch or curve in one direction from a start, whose point ``first`` comes first.

    walk     continuation, at the start
    first    test functions at the start
    bounds   (2, free) bounds of the parameters
    budget   maximum number of points
    until    predicate: the direction ends at the first event for which it is True
    goes_on  True to follow the branch through continuous changes of its sequence of events

    The end of the direction is the second of the two ends of the result.
    """
    points, events, end, seen = [first.point], list[Event](), "", first
    begun, steps = walk, 0
    while not end:
        passage = _next(walk, seen, bounds, until) if len(points) <= budget else _StepOutcome(BUDGET)
        if passage is None:
            walk.step_back()
            continue
        points += passage.points
        events += passage.events
        end, seen = passage.end, passage.after or seen
        walk.equations = seen.equations
        changes = goes_on and end and passage.events and is_continuous(walk.equations, events[-1])
        beyond = _beyond(walk, events[-1], bounds) if changes and not (until and until(events[-1])) else None
        if beyond is not None:
            steps += walk.newton_steps + beyond.newton_steps
            points += beyond.points
            end, seen, walk = "", beyond.seen, beyond.walk
            walk.start = begun.start  # where the branch may close
    return BranchRun(points, events, (CLOSED if end == CLOSED else "", end), steps + walk.newton_steps)


class _ContinuedWalk(NamedTuple):
    """A branch or a curve beyond a change of the orbit's sequence of events.

    walk          continuation from there
    seen          test functions where ``walk`` starts
    points        solution points from the change up to the start of ``walk``
    newton_steps  number of Newton steps
    """

    walk: PseudoArclength
    seen: MonitoredPoint
    points: list[SolutionPoint]
    newton_steps: int


def _beyond(walk: PseudoArclength, event: Event, bounds: Array) -> _ContinuedWalk | None:
    """Return the branch or curve that continues past an event at which another one ends; None if no branch is found.

    The motion does not jump if the orbits beyond the event, followed back, end at the same orbit of the same
    parameters.
    """
    for equations, X in orbits_beyond(walk.equations, event, bounds):
        seen = monitor_point(equations, X)
        if seen.fault is not None or not is_minimal(equations.motion(X)):
            continue
        away = seen.point.values - event.point.values
        share = float(np.max(np.abs(away) / equations.width))
        direction = np.zeros(len(X))
        direction[len(X) - equations.free :] = away
        margin = 0.5 * share * equations.width
        near = np.array([
            np.minimum(event.point.values - margin, seen.point.values),
            np.maximum(event.point.values + margin, seen.point.values),
        ])  # fmt: skip
        back = PseudoArclength(seen.equations, X, share, -direction)
        run = _one_direction(back, seen, near, MAX_BACK_POINTS, None, goes_on=False)
        if run.events and run.events[-1].point is run.points[-1] and is_same_event(equations, event, run.events[-1]):
            on = PseudoArclength(seen.equations, X, walk.longest, direction)
            on.length = min(on.length, share)
            return _ContinuedWalk(on, seen, run.points[-2::-1], run.newton_steps)
    return None


def _next(walk: PseudoArclength, seen: MonitoredPoint, bounds: Array, until: Until | None) -> _StepOutcome | None:
    """Take the next step along a branch or curve, and return its result.

    Return None if the step went too far, or slid onto another orbit, and can be repeated with a shorter length.
    """
    eq, X_before = walk.equations, walk.X
    if not walk.advance():  # the equations are singular where a branch meets the orbit that it left
        return _meeting(ContinuationStep(eq, X_before, X_before)) or _corner(ContinuationStep(eq, X_before, X_before))
    X_after, end, values = walk.X, "", eq.values(walk.X)
    outside = np.flatnonzero((values < bounds[0]) | (values > bounds[1]))
    if len(outside):
        edge = ContinuationStep(eq, X_before, X_after).at_value(outside[0], np.clip(values, *bounds)[outside[0]])
        if not edge.converged:
            return _StepOutcome(EDGE)
        X_after, end = edge.X, EDGE
    elif (start := walk.closes()) is not None:
        X_after, end = start, CLOSED
    after = monitor_point(eq, X_after)
    step, slid = ContinuationStep(after.equations, X_before, X_after), not is_minimal(eq.motion(X_after))
    may_repeat = walk.length > MIN_STEP_SHARE * walk.longest
    if slid and may_repeat:
        return None
    if slid:
        passage = _meeting(step) or _meeting(ContinuationStep(eq, X_before, X_before)) or _StepOutcome(SHORTER)
    else:
        passage = _meeting(step) or _passage(step, seen, after, end, until)
    if passage.end == INADMISSIBLE and may_repeat:  # the step may have slid onto another root of an event
        return None
    accounted = _accounted_for(seen, passage)
    return accounted if may_repeat else accounted or passage


def _accounted_for(before: MonitoredPoint, passage: _StepOutcome) -> _StepOutcome | None:
    """Return the outcome of a step if its events explain how the number of unstable multipliers changes on it.

    Return None if the events do not account for all changes of stability. Two multipliers of one pair that change
    together need not change a sign.
    """
    if before.equations.conditions:
        return passage
    count = before.point.unstable
    for event in passage.events:
        if event.conditions[-1].kind not in OWN_MULTIPLIERS:
            return passage  # a multiplier may be infinite where the orbit ceases
        change, others = OWN_MULTIPLIERS[event.conditions[-1].kind], event.point.unstable
        if count not in (others, others + change):
            return None
        count = others if count > others else others + change
    after = passage.after
    if after is None or after.fault is not None:
        return passage
    sizes = np.abs(after.point.multipliers)
    if not np.sum(sizes > 1.0 + DOUBT) <= count <= np.sum(sizes > 1.0 - DOUBT):
        return None
    point = after.point._replace(unstable=count)
    points = tuple(point if known is after.point else known for known in passage.points)
    return passage._replace(points=points, after=after._replace(point=point))


def _corner(step: ContinuationStep) -> _StepOutcome:
    """Return the outcome of a step at the start of which a branch ends, since no step from there converges.

    An event of the orbit is lost there; if no such event is found, the end is STALLED.
    """
    met = nearly_lost(step)
    return _StepOutcome(STALLED) if met is None else _StepOutcome(met.event.kind, (met.event,), (met.event.point,))


def _meeting(step: ContinuationStep) -> _StepOutcome | None:
    """Return the outcome of a step on which a branch ends where it had left another one, at a doubled orbit.

    The other orbit is of half the length, or symmetric. Return None if the branch does not reach it on the step.
    """
    to = halves_met(step)
    if to is None:
        return None
    event = find_origin(step, to)
    return _StepOutcome(SHORTER) if event is None else _StepOutcome(event.kind, (event,), (event.point,))


def _passage(
    step: ContinuationStep, before: MonitoredPoint, after: MonitoredPoint, end: str, until: Until | None
) -> _StepOutcome:
    """Return the outcome of a step from solution point ``before`` to ``after``: its events and its last point.

    The direction has this ``end`` at the last point, unless it ends before.
    """
    events, limit, last = list[LocatedEvent](), math.inf, after.point
    if after.fault is not None:
        ceases = leaving(step, after.fault)
        if ceases is None:
            return _StepOutcome(INADMISSIBLE)
        events, limit, end, last = [ceases], ceases.share, ceases.event.kind, ceases.event.point
    for name in sign_changes(before, after):
        met = locate_event(step, before, after, name, exists=after.fault is not None)
        if met is not None and met.share <= limit:
            events.append(met)
            if _ends_pair(step.equations, met.event) or (until and until(met.event)):
                limit, end, last = met.share, met.event.kind, met.event.point
    passed = tuple(met.event for met in sorted(events, key=lambda met: met.share) if met.share <= limit)
    return _StepOutcome(end, passed, (*(event.point for event in passed if event.point is not last), last), after)


def _ends_pair(equations: ExtendedSystem, event: Event) -> bool:
    """Return True if a curve of pairs on the unit circle ends at the event: the pairs are real beyond kappa = +-1."""
    pair = bool(equations.conditions) and equations.conditions[0].kind == PAIR
    return pair and any(c.kind == ANGLE and abs(c.kappa) == 1.0 for c in event.conditions)
