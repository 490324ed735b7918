"""Orbits beyond an event at which contacts or slides change though nothing jumps.

The orbit of the event solves its own equations on both sides of it. Where it is not admissible there, the motion from
its section state passes the events of the orbit that takes its place, to first order at their times. Newton's method
then finds that orbit, with the conditions of a curve if it is one, at the parameters at which its events have these
distances, on either side: a contact that is released by its force may turn a branch back. A multiplier changes with the
square root of the depth in a soft contact, so that a curve turns into the curve of grazes there.
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
from workers.model.hybrid_machines import HybridMachines
from workers.model.hybrid_modes import SIGNALS
from workers.model.oscillator import Array

LIFT_OFF = "lift_off"
OF_CONTACTS = (GRAZING, CONTACT_LOST, LIFT_OFF)
CHANGES = (*OF_CONTACTS, STICK_ONSET, STICK_END, GRAZING_SLIDING, "adding_sliding", VERTEX, EXCHANGE)
"""Kinds of events at which an orbit may continue with other contacts or slides."""

OF_MULTIPLIERS = (UNIT, MINUS_ONE, PAIR)
"""Conditions that take the derivative of the motion to be continuous, and not the motion alone."""

OFFSETS = (1e-3, 1e-4, 1e-5, 1e-6)
"""How far from an event, as shares of the window, the orbit beyond is looked for: another event may be near."""

CURVE_OFFSETS, CURVE_DEPTH = (1e-2, 1e-3, 1e-4, 1e-5), 1e-2
"""The same on the curve of a change; and how far from that curve, as a share of that, of its square where multipliers
are asked for: next to a fold an orbit moves with the square root of parameters."""

SECOND_OFFSET = 0.25
"""Share of that distance at which it is looked for again, to see how the times of its events depend on it."""

HALVES_TOLERANCE = 1e-2
"""Share of a turn by which the halves of a symmetric orbit may differ as it is recorded beside its own parameters."""

SAME_PARAMETER, SAME_STATE = 1e-8, 1e-6
"""Difference of the parameter, in widths of the window, and of section states, relative, of one orbit."""


def is_continuous(equations: ExtendedSystem, event: Event) -> bool:
    """Whether motions near the orbit of an event depend on parameters without a jump or a square root there.

    A soft contact without preload is touched and lifted from so, damped or not. Of friction, and of lift-off, it
    depends on what the motion does next: ``branches`` follows it back to see. A rigid contact or a preload is touched
    with a square root. A curve of folds, doublings or pairs ends where the derivative jumps too: see ``is_smooth``.
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
    """Whether a condition of a curve is on multipliers."""
    return any(condition.kind in OF_MULTIPLIERS for condition in equations.conditions)


def is_smooth(machine: HybridMachines, event: Event) -> bool:
    """Whether multipliers are continuous through a change of one machine: not where friction begins to stick at no
    rate, nor at the graze of a contact, but for a soft one without preload.

    Nor at that of a damped one that its force releases: its damper, S = I - c M^-1 r r, acts when the contact begins
    and not when it ends.
    """
    if event.last not in OF_CONTACTS:
        return event.last != GRAZING_SLIDING
    contact = event.conditions[-1].signal // SIGNALS
    _, damping, preload = np.max(machine.contact_constants[0, :, contact], axis=0)
    jumps = machine.soft[0, contact] == 0.0 or (machine.by_force[0, contact] > 0.0 and damping > 0.0)
    return bool(preload == 0.0 and (event.last == LIFT_OFF or not jumps))


class _NearbyOrbit(NamedTuple):
    """Where to look beyond an event: the orbit of the event, or one next to it on the curve of its change, at
    parameters ``values`` (free,); the way (free,) to leave it; and the direction (free,) in which it lies.
    """

    orbit: Orbit
    values: Array
    away: Array
    along: Array


def orbits_beyond(equations: ExtendedSystem, event: Event, bounds: Array) -> Iterator[tuple[ExtendedSystem, Array]]:
    """The orbits that may continue from an event of a branch or a curve, as equations with their solution; the
    farthest first.

    bounds (2, free) of the parameters.
    """
    for beside in _beside_branch(equations, event) if equations.free == 1 else _beside_curve(equations, event, bounds):
        far, near = (_recorded(equations.family, beside, share, bounds) for share in (1.0, SECOND_OFFSET))
        if far is None or near is None or far.itinerary != near.itinerary:
            continue
        if is_same_sequence(far.itinerary, equations.itinerary):
            continue  # the orbit that the event ends
        solved = _solved(equations, event, beside, far, near)
        if solved is not None and is_within(solved[0].values(solved[1]), bounds):
            yield solved


def _beside_branch(equations: ExtendedSystem, event: Event) -> Iterator[_NearbyOrbit]:
    """The orbit of an event, to be left along the parameter."""
    for share in OFFSETS:
        for side in (1.0, -1.0):
            away = side * share * equations.width
            yield _NearbyOrbit(event.point.orbit, event.point.values, away, away)


def _beside_curve(equations: ExtendedSystem, event: Event, bounds: Array) -> Iterator[_NearbyOrbit]:
    """Orbits with the change of an event of a curve, to be left across their own curve."""
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
            here, left = change.values(solved.X), change.orbit(solved.X)
            along = (here - values) / change.width
            depth = CURVE_DEPTH * share if event.conditions[0].kind in OF_MULTIPLIERS else CURVE_DEPTH
            across = depth * np.array([-along[1], along[0]]) * change.width
            for away in (across, -across):
                yield from _at_depth(equations, event, _NearbyOrbit(left, here, away, along * change.width), bounds)


def _at_depth(equations: ExtendedSystem, event: Event, beside: _NearbyOrbit, bounds: Array) -> Iterator[_NearbyOrbit]:
    """The orbit so far across the curve of a change that its multipliers meet the condition to first order, if any.

    Multipliers change with the square root of that distance.
    """
    deep, (condition, *_) = _recorded(equations.family, beside, 1.0, bounds), event.conditions
    same = deep is None or is_same_sequence(deep.itinerary, beside.orbit.itinerary)
    if deep is None or same or condition.kind not in OF_MULTIPLIERS:
        yield beside
        return
    here, there = (
        _misses(equations, condition, event.kappa, orbit, values)
        for orbit, values in ((beside.orbit, beside.values), (deep, beside.values + beside.away))
    )
    if here * there < 0.0:
        yield beside._replace(away=(here / (here - there)) ** 2 * beside.away)


def _misses(equations: ExtendedSystem, condition: Condition, kappa: float, orbit: Orbit, values: Array) -> float:
    """How far the multipliers of an orbit are from a condition on them; NaN where one is infinite."""
    of_turn = multipliers(motion_of(equations.model(values), many_orbits([orbit])))
    if not np.all(np.isfinite(of_turn)):
        return np.nan
    if condition.kind == PAIR:
        return float(pair_near(of_turn, np.array([2.0 * kappa]))[1][0]) - 1.0
    return float(np.prod(of_turn[0] - (1.0 if condition.kind == UNIT else -1.0)).real)


def _recorded(family: Family, beside: _NearbyOrbit, share: float, bounds: Array) -> Orbit | None:
    """The orbit of a motion from the section state of an orbit beside it, this share of the way from that."""
    orbit, here = beside.orbit, beside.values
    values = here + share * beside.away
    if not is_within(values, bounds):
        return None
    try:
        continued = continued_to(family, many_of([orbit], here[None]), values[None])
        known, at = (continued.orbits, values) if continued.converged[0] else (many_orbits([orbit]), here)
        state = states_at_sections(family.model(at[None]), known)[0, 0]
        machine, cycle = family.model(values[None]), None
        if orbit.itinerary.is_cycle:
            cycle = float(known.length[0]) / orbit.itinerary.turn
        passed = record_orbit(machine, state, orbit.itinerary.periods, cycle=cycle)
    except (ValueError, np.linalg.LinAlgError):
        return None
    if not passed.itinerary.sides and not orbit.itinerary.sides:
        return orbit  # which may be symmetric
    passed = reduce_symmetry(machine, passed, HALVES_TOLERANCE) if orbit.itinerary.symmetric else passed
    return passed if passed.itinerary.symmetric == orbit.itinerary.symmetric else None


def is_within(values: Array, bounds: Array) -> bool:
    """Whether parameters (free,) are within bounds (2, free)."""
    return bool(np.all((bounds[0] <= values) & (values <= bounds[1])))


def _solved(
    equations: ExtendedSystem, event: Event, beside: _NearbyOrbit, far: Orbit, near: Orbit
) -> tuple[ExtendedSystem, Array] | None:
    """The orbit next to one as it was recorded beside an event, and ``near`` it at NEARER of the way."""
    (here, orbit, contacts, *_), free, values = event.point, equations.free, beside.values + beside.away
    own = [
        condition._replace(kappa=event.kappa) if condition.kind == PAIR else condition
        for condition in event.conditions[:-1]
    ]
    try:
        span = orbit.span(equations.model(here))
        conditions = conditions_on(far, tuple(own), orbit, span)
        if conditions is None:
            return None
        there = ExtendedSystem(equations.family, far, conditions, values, equations.width)
        row, changes = np.zeros(len(there.scale)), far.unknown_times - near.unknown_times
        if free > 1 or not np.any(changes) or is_same_sequence(far.itinerary, orbit.itinerary):
            row[len(row) - free :] = beside.along / equations.width
        else:
            row[there.states - there.m : there.states] = changes
        X = there.pack(far, contacts[: there.grazes] + time_shift(far, orbit, span), values)
        there = there.rebordered(X)
        solved = solve(there, X, row / there.scale / np.linalg.norm(row))
    except (NoOscillatorError, ValueError, np.linalg.LinAlgError):
        return None
    return (there, solved.X) if solved.converged else None


def is_same_sequence(one: Itinerary, other: Itinerary) -> bool:
    """Whether two itineraries have the same events and modes, whichever comes first."""
    return bool(beginnings(one, other))


def is_same_event(equations: ExtendedSystem, one: Event, other: Event) -> bool:
    """Whether two events of any kinds are at one orbit of one parameter."""
    if np.any(np.abs(one.point.values - other.point.values) > SAME_PARAMETER * equations.width):
        return False
    a, b = (comparison_states(equations.model(e.point.values), many_orbits([e.point.orbit]))[0] for e in (one, other))
    apart = np.max(np.abs(a[:, None] - b), axis=2)
    return bool(np.min(apart) <= SAME_STATE * max(1e-300, float(np.max(np.abs(a)))))
