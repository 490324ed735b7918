"""Events on a step of continuation at which orbits cease: grazes, lost events, onset and end of stick."""

from itertools import pairwise

import numpy as np

from workers.continuation.admissibility import CONTACT, LOST, ORDER, AdmissibilityFault, peak_of
from workers.continuation.beyond_events import asks_multipliers, is_smooth
from workers.continuation.event_removal import without_event
from workers.continuation.events import (
    CONTACT_LOST,
    GRAZING,
    IMPACT_LOST,
    LocatedEvent,
    event_of,
    fault,
    solution,
    solve_on_step,
)
from workers.continuation.extended_system import ENDS, GRAZE, MEETS, ONSET, SPEED, Condition, conditions_on, time_shift
from workers.continuation.legs import ACT, SLOWS
from workers.continuation.pseudo_arclength import ContinuationStep
from workers.continuation.shooting import OrbitMotion
from workers.model.hybrid_modes import SIGNALS
from workers.model.oscillator import Array

HALVINGS = 14
"""Maximum number of halvings of a step that help to locate where an orbit ceases to be admissible."""

NEARLY = 1e-3
"""Share of the window within which a curve that continues no further ends at the loss of an event. The rate of that
event is less than the same share of its size: rates fall faster than distances, to rounding."""


def leaving(step: ContinuationStep, reason: AdmissibilityFault) -> LocatedEvent | None:
    """Return the first event on a step at which the orbit ceases to be admissible; None if no event is found.

    ``reason`` is why the orbit is not admissible at the end of the step.
    """
    low, high, X = 0.0, 1.0, step.end
    for _ in range(HALVINGS):
        event = _of_fault(step, X, reason)
        if event is not None:
            return event
        half = 0.5 * (low + high)
        middle = step.solution(half)
        if not middle.converged:
            return None
        seen = fault(step.equations, middle.X)
        if seen is None:
            low = half
        else:
            high, X, reason = half, middle.X, seen
    return None


def nearly_lost(step: ContinuationStep) -> LocatedEvent | None:
    """Return the event at which an orbit loses the event of least rate, if that is next to a step's start; else None.

    The loss is a corner of a branch. Return None if all events are impacts, since the equations are smooth beyond the
    loss of an impact.
    """
    motion = step.equations.motion(step.start)
    if motion.plan.impacts:
        return None
    rates = np.abs(motion.turn.signals[0, 1]) / motion.scale()[1][0]
    slowest = int(np.argmin(rates))
    near = NEARLY if step.equations.conditions and rates[slowest] < NEARLY else 0.0
    return _of_loss(step, step.start, motion, AdmissibilityFault(LOST, slowest), near)


def _of_fault(step: ContinuationStep, X: Array, reason: AdmissibilityFault) -> LocatedEvent | None:
    """Return the graze, the lost event or the change of stick that makes the orbit at unknowns X (N,) inadmissible.

    Return None if it is not found. ``reason`` is why the orbit is not admissible.
    """
    conditions, motion = step.equations.conditions, step.equations.motion(X)
    if reason.reason == ORDER:
        return None
    if reason.reason != CONTACT:
        return (_of_loss if reason.reason == LOST else _of_holding)(step, X, motion, reason)
    peak, graze = peak_of(motion, reason), Condition(GRAZE, side=reason.side, signal=reason.signal)
    return None if peak is None else solve_on_step(step, X, (*conditions, graze), (peak,))


def _of_holding(
    step: ContinuationStep, X: Array, motion: OrbitMotion, reason: AdmissibilityFault
) -> LocatedEvent | None:
    """Return the event at which the force that would hold friction, at an event of the orbit, is at its static level.

    For any other signal, a number computed from the state, it is the event at which this signal reaches an end of its
    range at an event of the orbit: both exchange their order there.
    """
    if reason.impact < 0:
        return None
    friction = reason.signal - SIGNALS * motion.lin.elements.soft.shape[1]
    after = next(leg for (_, event), (leg, _) in pairwise(motion.plan.legs) if event == reason.impact)
    turns = any((event, signal) == (reason.impact, reason.signal) for event, signal, _ in motion.plan.turning)
    sticks = friction >= 0 and after.code.slips[friction] == 0
    kind = ONSET if turns else ENDS if sticks else MEETS
    condition = Condition(kind, side=reason.side, impact=reason.impact, signal=reason.signal)
    return solve_on_step(step, X, (*step.equations.conditions, condition))


def _of_loss(
    step: ContinuationStep, X: Array, motion: OrbitMotion, reason: AdmissibilityFault, near: float = 0.0
) -> LocatedEvent | None:
    """Return the event of a branch at which an event of the orbit is lost; None if it is not found.

    step    step of the continuation
    X       (N,) unknowns at which the event is lost or nearly so
    motion  motion of the orbit there
    reason  fault with the index of the event
    near    distance from the step within which the loss may lie

    A lost impact, or a lost slide that sticks, has zero speed there. Any other event is lost at the graze of the orbit
    without it.
    """
    eq = step.equations
    if motion.plan.impacts or motion.plan.reached[reason.impact, ACT] == SLOWS:
        return solve_on_step(step, X, (*eq.conditions, Condition(SPEED, impact=reason.impact)))
    shorter = without_event(eq.orbit(X), reason.impact, float(motion.span[0]))
    if shorter is None:
        return None
    orbit, leg, time = shorter
    transferred = conditions_on(orbit, eq.conditions, eq.orbit(X), float(motion.span[0]))
    if transferred is None:
        return None
    conditions = (*transferred, Condition(GRAZE, side=leg.side, signal=leg.signal))
    contacts = np.append(eq.contacts(X) + time_shift(orbit, eq.orbit(X), float(motion.span[0])), time)
    if not orbit.itinerary.sides and motion.lin.elements.starts.shape[1] == 2 and not eq.conditions:
        # the forced response of one period, which grazes once in that period
        orbit = orbit._replace(itinerary=orbit.itinerary._replace(periods=1))
    solved = solution(eq, orbit, conditions, contacts, X)
    before, after = (eq.motion(end).turn.signals[0, 1, reason.impact] for end in (step.start, step.end))
    share = float(np.clip(before / (before - after), 0.0, 1.0)) if before != after else 0.0  # where the rate is zero
    if (
        solved is None
        or not step.is_near(eq.values(step.guess(share)), solved[0].values(solved[1]), near)
        or fault(*solved)
    ):
        return None
    event = event_of(*solved)
    if event.last == GRAZING:
        lost = CONTACT_LOST if motion.lin.elements.soft[0, leg.signal // SIGNALS] > 0.0 else IMPACT_LOST
        event = event._replace(last=lost, kind=event.kind if transferred else lost)
    if asks_multipliers(eq) and not is_smooth(motion.lin.machines, event):
        return None  # the orbit with the event has other multipliers
    return LocatedEvent(share, event)
