"""Continuation of branches and curves past events at which the itinerary changes but the motion does not jump.

The itinerary is the sequence of an orbit's events. The orbit of the event solves its equations on both sides of the
event, but is admissible on one side only. On the other side, the motion from its section state passes the events of the
orbit that replaces it, at times that are right to first order. Newton's method refines that orbit, with the conditions
of the curve if there are any. Its parameters are those at which the times of its events differ this much from the times
at the event. The orbit is sought on either side of the event, since a contact that is released by its force may turn a
branch back. Near the graze of a soft contact the multipliers change with the square root of the depth, so a curve turns
into the curve of grazes there.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from workers.continuation.admissibility import VERTEX
from workers.continuation.equations import motion_of
from workers.continuation.events import (
    CONTACT_LOST,
    EXCHANGE,
    GRAZING,
    GRAZING_SLIDING,
    STICK_END,
    STICK_ONSET,
    Event,
)
from workers.continuation.extended_system import (
    MINUS_ONE,
    PAIR,
    UNIT,
    Condition,
    ExtendedSystem,
    conditions_on,
    solve,
    time_shift,
)
from workers.continuation.families import Family
from workers.continuation.floquet import multipliers, pair_near
from workers.continuation.itinerary import Itinerary, Orbit, many_orbits
from workers.continuation.orbit_equality import beginnings
from workers.continuation.orbit_from_motion import record_orbit, reduce_symmetry
from workers.continuation.orbits import comparison_states, continued_to, many_of, states_at_sections
from workers.continuation.pseudo_arclength import tangent_at
from workers.model.family import NoOscillatorError
from workers.model.hybrid_modes import SIGNALS
from workers.model.machines import Machines
from workers.model.oscillator import Array

LIFT_OFF = "lift_off"
OF_CONTACTS = (GRAZING, CONTACT_LOST, LIFT_OFF)
CHANGES = (*OF_CONTACTS, STICK_ONSET, STICK_END, GRAZING_SLIDING, "adding_sliding", VERTEX, EXCHANGE)
"""Kinds of events at which an orbit may continue with other contacts or slides."""

OF_MULTIPLIERS = (UNIT, MINUS_ONE, PAIR)
"""Conditions that need a continuous derivative of the motion, in addition to a continuous motion."""

OFFSETS = (1e-3, 1e-4, 1e-5, 1e-6)
"""Distances from an event, as shares of the window, at which the orbit beyond is sought: another event may be near."""

CURVE_OFFSETS, CURVE_DEPTH = (1e-2, 1e-3, 1e-4, 1e-5), 1e-2
"""Distances from an event along the curve on which the event occurs, as shares of the window, and distance from that
curve. The latter is a share of the former, or of its square if the curve has a condition on multipliers: next to a fold
an orbit moves with the square root of the parameters."""

SECOND_OFFSET = 0.25
"""Share of the distance from the event at which the orbit is recorded again: shows how the times of its events change.
"""

HALVES_TOLERANCE = 1e-2
"""Share of a turn by which the halves of a symmetric orbit may differ if it is recorded next to its own parameters."""

SAME_PARAMETER, SAME_STATE = 1e-8, 1e-6
"""Maximum difference between equal orbits: of the parameter, in widths of the window, and of their states, relative."""


def is_continuous(equations: ExtendedSystem, event: Event) -> bool:
    """Return True if motions near the orbit of an event depend on the parameters there without a jump or a square root.

    This holds at touching and leaving a soft contact without preload, damped or not. A rigid or preloaded contact is
    touched with a square root. At lift-off and at events of friction it depends on the motion that follows:
    ``branches`` follows it back to decide. A curve of folds, doublings or pairs also needs ``is_smooth``.
    """
    if event.last not in CHANGES:
        return False
    lin, contact = equations.model(event.point.values).machines, event.conditions[-1].signal // SIGNALS
    if asks_multipliers(equations):
        return is_smooth(lin, event)
    if event.last not in OF_CONTACTS:
        return True
    preloaded = bool(np.any(lin.contact_constants[0, :, contact, 2] > 0.0))
    return not preloaded and (bool(lin.soft[0, contact]) or event.last == LIFT_OFF)


def asks_multipliers(equations: ExtendedSystem) -> bool:
    """Return True if an extended system has a condition on multipliers, as on a curve of folds."""
    return any(condition.kind in OF_MULTIPLIERS for condition in equations.conditions)


def is_smooth(machine: Machines, event: Event) -> bool:
    """Return True if multipliers are continuous where the sequence of an orbit's events changes.

    ``machine`` is a single machine in a batch.

    Multipliers jump where friction begins to stick at zero rate. At the graze of a contact they are continuous only if
    the contact is soft and has no preload. They also jump at a damped contact that is released by its force. The damper
    of this contact, with S = I - c M^-1 r r, acts when the contact begins and not when it ends.
    """
    if event.last not in OF_CONTACTS:
        return event.last != GRAZING_SLIDING
    contact = event.conditions[-1].signal // SIGNALS
    _, damping, preload = np.max(machine.contact_constants[0, :, contact], axis=0)
    jumps = machine.soft[0, contact] == 0.0 or (machine.by_force[0, contact] > 0.0 and damping > 0.0)
    return bool(preload == 0.0 and (event.last == LIFT_OFF or not jumps))


class _NearbyOrbit(NamedTuple):
    """An orbit from which to look for the continuation past an event.

    It is the orbit of the event, or a nearby orbit on the curve in two parameters on which the event occurs.

    orbit   the orbit
    values  (free,) its parameters
    away    (free,) step in the parameters to take from it
    along   (free,) direction of the curve
    """

    orbit: Orbit
    values: Array
    away: Array
    along: Array


def orbits_beyond(equations: ExtendedSystem, event: Event, bounds: Array) -> Iterator[tuple[ExtendedSystem, Array]]:
    """Yield the orbits that may continue a branch or curve past an event, the farthest first.

    Each is an extended system with its solution (N,). ``bounds`` (2, free) are the lower and upper parameter bounds.
    """
    for nearby in _beside_branch(equations, event) if equations.free == 1 else _beside_curve(equations, event, bounds):
        far, near = (_recorded(equations.family, nearby, share, bounds) for share in (1.0, SECOND_OFFSET))
        if far is None or near is None or far.itinerary != near.itinerary:
            continue
        if is_same_sequence(far.itinerary, equations.itinerary):
            continue  # the orbit that ends at the event
        solved = _solved(equations, event, nearby, far, near)
        if solved is not None and is_within(solved[0].values(solved[1]), bounds):
            yield solved


def _beside_branch(equations: ExtendedSystem, event: Event) -> Iterator[_NearbyOrbit]:
    """Yield nearby orbits from which to look for a branch beyond an event.

    Each is the orbit of the event itself, with one of several steps along the parameter.
    """
    for share in OFFSETS:
        for side in (1.0, -1.0):
            away = side * share * equations.width
            yield _NearbyOrbit(event.point.orbit, event.point.values, away, away)


def _beside_curve(equations: ExtendedSystem, event: Event, bounds: Array) -> Iterator[_NearbyOrbit]:
    """Yield nearby orbits from which to look for a curve beyond an event.

    Each is an orbit on the curve of the event's change, with a step in the parameters across that curve, to either
    side.
    """
    values, orbit, contacts, *_ = event.point
    change = ExtendedSystem(equations.family, orbit, event.conditions[-1:], values, equations.width)
    X = change.pack(orbit, contacts[len(contacts) - change.grazes :], values)
    tangent = tangent_at(change, change.with_jacobian(X[None])[1][0], np.ones(len(X)))
    row = tangent / change.scale
    tangent /= np.linalg.norm(tangent[-2:])
    for share in CURVE_OFFSETS:
        for side in (1.0, -1.0):
            solved = solve(change, X + side * share * tangent * change.scale, row)
            if not solved.converged:
                continue
            nearby_values, nearby_orbit = change.values(solved.X), change.orbit(solved.X)
            along = (nearby_values - values) / change.width
            depth = CURVE_DEPTH * share if event.conditions[0].kind in OF_MULTIPLIERS else CURVE_DEPTH
            across = depth * np.array([-along[1], along[0]]) * change.width
            for away in (across, -across):
                yield from _at_depth(
                    equations, event, _NearbyOrbit(nearby_orbit, nearby_values, away, along * change.width), bounds
                )


def _at_depth(equations: ExtendedSystem, event: Event, nearby: _NearbyOrbit, bounds: Array) -> Iterator[_NearbyOrbit]:
    """Yield at most one nearby orbit, with a step in its parameters.

    After the step its multipliers meet the condition, to first order. Multipliers change with the square root of the
    length of the step. Nothing is yielded if there is no such step.
    """
    deep, (condition, *_) = _recorded(equations.family, nearby, 1.0, bounds), event.conditions
    same = deep is None or is_same_sequence(deep.itinerary, nearby.orbit.itinerary)
    if deep is None or same or condition.kind not in OF_MULTIPLIERS:
        yield nearby
        return
    miss, deep_miss = (
        _misses(equations, condition, event.kappa, orbit, values)
        for orbit, values in ((nearby.orbit, nearby.values), (deep, nearby.values + nearby.away))
    )
    if miss * deep_miss < 0.0:
        yield nearby._replace(away=(miss / (miss - deep_miss)) ** 2 * nearby.away)


def _misses(equations: ExtendedSystem, condition: Condition, kappa: float, orbit: Orbit, values: Array) -> float:
    """Return how far the multipliers of an orbit are from a condition on them; NaN if a multiplier is infinite.

    kappa   cosine of the angle of the pair, if the condition is on a pair
    values  (free,) parameters of the orbit
    """
    of_turn = multipliers(motion_of(equations.model(values), many_orbits([orbit])))
    if not np.all(np.isfinite(of_turn)):
        return np.nan
    if condition.kind == PAIR:
        return float(pair_near(of_turn, np.array([2.0 * kappa]))[1][0]) - 1.0
    return float(np.prod(of_turn[0] - (1.0 if condition.kind == UNIT else -1.0)).real)


def _recorded(family: Family, nearby: _NearbyOrbit, share: float, bounds: Array) -> Orbit | None:
    """Return the orbit found by simulation from the state of a nearby orbit at t = 0, at a ``share`` of its step.

    Return None if the parameters are out of bounds, the motion cannot be followed, or the orbit and the nearby orbit
    differ in symmetry.
    """
    orbit, origin = nearby.orbit, nearby.values
    values = origin + share * nearby.away
    if not is_within(values, bounds):
        return None
    try:
        continued = continued_to(family, many_of([orbit], origin[None]), values[None])
        known, at = (continued.orbits, values) if continued.converged[0] else (many_orbits([orbit]), origin)
        state = states_at_sections(family.model(at[None]), known)[0, 0]
        machine, cycle = family.model(values[None]), None
        if orbit.itinerary.is_cycle:
            cycle = float(known.length[0]) / orbit.itinerary.turn
        passed = record_orbit(machine, state, orbit.itinerary.periods, cycle=cycle)
    except (ValueError, np.linalg.LinAlgError):
        return None
    if not passed.itinerary.sides and not orbit.itinerary.sides:
        return orbit  # the orbit may be symmetric
    passed = reduce_symmetry(machine, passed, HALVES_TOLERANCE) if orbit.itinerary.symmetric else passed
    return passed if passed.itinerary.symmetric == orbit.itinerary.symmetric else None


def is_within(values: Array, bounds: Array) -> bool:
    """Return True if parameters (free,) are within bounds (2, free)."""
    return bool(np.all((bounds[0] <= values) & (values <= bounds[1])))


def _solved(
    equations: ExtendedSystem, event: Event, nearby: _NearbyOrbit, far: Orbit, near: Orbit
) -> tuple[ExtendedSystem, Array] | None:
    """Return the extended system and solution of an orbit recorded past an event; None if there is no solution.

    ``far`` is the orbit recorded at the end of the step, ``near`` the one at the share SECOND_OFFSET of the step.
    """
    (event_values, orbit, contacts, *_), free, values = event.point, equations.free, nearby.values + nearby.away
    other_conditions = [
        condition._replace(kappa=event.kappa) if condition.kind == PAIR else condition
        for condition in event.conditions[:-1]
    ]
    try:
        span = orbit.span(equations.model(event_values))
        conditions = conditions_on(far, tuple(other_conditions), orbit, span)
        if conditions is None:
            return None
        extended = ExtendedSystem(equations.family, far, conditions, values, equations.width)
        row, changes = np.zeros(len(extended.scale)), far.unknown_times - near.unknown_times
        if free > 1 or not np.any(changes) or is_same_sequence(far.itinerary, orbit.itinerary):
            row[len(row) - free :] = nearby.along / equations.width
        else:
            row[extended.states - extended.m : extended.states] = changes
        X = extended.pack(far, contacts[: extended.grazes] + time_shift(far, orbit, span), values)
        extended = extended.rebordered(X)
        solved = solve(extended, X, row / extended.scale / np.linalg.norm(row))
    except (NoOscillatorError, ValueError, np.linalg.LinAlgError):
        return None
    return (extended, solved.X) if solved.converged else None


def is_same_sequence(one: Itinerary, other: Itinerary) -> bool:
    """Return True if two orbits have the same events and linear equations between events, from any event on."""
    return bool(beginnings(one, other))


def is_same_event(equations: ExtendedSystem, one: Event, other: Event) -> bool:
    """Return True if two events, of equal or different kinds, are at the same orbit and the same parameters."""
    if np.any(np.abs(one.point.values - other.point.values) > SAME_PARAMETER * equations.width):
        return False
    a, b = (comparison_states(equations.model(e.point.values), many_orbits([e.point.orbit]))[0] for e in (one, other))
    apart = np.max(np.abs(a[:, None] - b), axis=2)
    return bool(np.min(apart) <= SAME_STATE * max(1e-300, float(np.max(np.abs(a)))))
