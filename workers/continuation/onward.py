"""Orbits of machines with modes beyond an event at which their contacts or slides change though nothing jumps.

The orbit of the event solves its own equations on both sides of it. Where it is not admissible there, the motion from
its section state passes the events of the orbit that takes its place, to first order at their times. Newton's method
then finds that orbit at whichever parameter it has these events as long apart, on either side: a contact that is
released by its force may turn a branch back.
"""

from collections.abc import Iterator

import numpy as np

from workers.continuation.events import CONTACT_LOST, GRAZING, GRAZING_SLIDING, STICK_END, STICK_ONSET, Event
from workers.continuation.extended import Extended, solve
from workers.continuation.itinerary import Itinerary, Orbit, many_orbits
from workers.continuation.orbits import many_of, moved, states_at_sections
from workers.continuation.oscillator import Family, NoOscillatorError
from workers.continuation.recording import halved, recorded_modes
from workers.model.hybrid_machines import HybridMachines
from workers.model.hybrid_modes import SIGNALS
from workers.model.oscillator import Array

LIFT_OFF = "lift_off"
OF_CONTACTS = (GRAZING, CONTACT_LOST, LIFT_OFF)
CHANGES = (*OF_CONTACTS, STICK_ONSET, STICK_END, GRAZING_SLIDING, "adding_sliding")
"""Kinds of events at which an orbit of a machine with modes may go on with other contacts or slides."""

BESIDE = (1e-3, 1e-4, 1e-5, 1e-6)
"""How far from an event, as shares of the window, the orbit beyond is looked for: another event may be near."""

NEARER = 0.25
"""Share of that distance at which it is looked for again, to see how the times of its events depend on it."""

SAME, SAME_STATE = 1e-8, 1e-6
"""Difference of the parameter, in widths of the window, and of section states, relative, of one orbit."""


def is_continuous(equations: Extended, event: Event) -> bool:
    """Whether motions near the orbit of an event depend on its parameter without a jump or a square root there.

    A soft contact without preload is touched and lifted from so, damped or not. Of friction, and of lift-off, it
    depends on what the motion does next: ``branches`` follows it back to see. A rigid contact or a preload is touched
    with a square root. A curve ends there.
    """
    lin, contact = equations.model(event.point.values), event.conditions[-1].signal // SIGNALS
    if not isinstance(lin, HybridMachines) or equations.conditions or equations.free != 1:
        return False
    if event.kind not in OF_CONTACTS:
        return event.kind in CHANGES
    soft, preloaded = bool(lin.soft[0, contact]), bool(np.any(lin.pad[0, :, contact, 2] > 0.0))
    return not preloaded and (soft or event.kind == LIFT_OFF)


def orbits_beyond(equations: Extended, event: Event, bounds: Array) -> Iterator[tuple[Extended, Array]]:
    """The orbits that may go on from an event of a branch, as equations with their solution; the farthest first.

    bounds (2, 1) of the parameter.
    """
    for share in BESIDE:
        for side in (1.0, -1.0):
            away = side * share * equations.width
            found = [_recorded(equations, event, event.point.values + part * away, bounds) for part in (1.0, NEARER)]
            far, near = found
            if far is None or near is None or far.itinerary != near.itinerary:
                continue
            if is_same_sequence(far.itinerary, equations.itinerary):
                continue  # the orbit that the event ends
            solved = _solved(equations, event, far, near, away)
            if solved is not None and is_within(solved[0].values(solved[1]), bounds):
                yield solved


def _recorded(equations: Extended, event: Event, values: Array, bounds: Array) -> Orbit | None:
    """The orbit as a motion passes it from the section state of the event's own orbit at other parameters (1,)."""
    if not is_within(values, bounds):
        return None
    family, (here, orbit, *_) = equations.family, event.point
    try:
        beside = moved(family, many_of([orbit], here[None]), values[None])
        known, at = (beside.orbits, values) if beside.found[0] else (many_orbits([orbit]), here)
        state = states_at_sections(family.model(at[None]), known)[0, 0]
        found = recorded_modes(_machine(family, values), state, orbit.itinerary.periods)
        return found if found.itinerary.sides or orbit.itinerary.sides else orbit  # which may be symmetric
    except (ValueError, np.linalg.LinAlgError):
        return None


def _machine(family: Family, values: Array) -> HybridMachines:
    """The machine with modes at parameters (1,), as the only one of a record of many."""
    found = family.model(values[None])
    assert isinstance(found, HybridMachines)
    return found


def is_within(values: Array, bounds: Array) -> bool:
    """Whether parameters (free,) are within bounds (2, free)."""
    return bool(np.all((bounds[0] <= values) & (values <= bounds[1])))


def _solved(equations: Extended, event: Event, far: Orbit, near: Orbit, away: Array) -> tuple[Extended, Array] | None:
    """The orbit next to one as it was recorded ``away`` from an event, and ``near`` it at NEARER of that."""
    values, none = event.point.values + away, np.zeros(0)
    changes = far.times - near.times
    try:
        there = Extended(equations.family, far, (), values, equations.width)
        row = np.eye(1, len(there.scale), there.states)[0]
        if np.any(changes) and not is_same_sequence(far.itinerary, event.point.orbit.itinerary):
            row = np.zeros(len(there.scale))
            row[there.states - there.m : there.states] = changes
        found = solve(there, there.pack(far, none, values), row / there.scale / np.linalg.norm(row))
        if not found.converged:
            return None
        orbit, values = there.orbit(found.X), there.values(found.X)
        half = halved(_machine(equations.family, values), orbit)
        if half is orbit:
            return there, found.X
        there = Extended(equations.family, half, (), values, equations.width)
        found = solve(there, there.pack(half, none, values), np.eye(1, len(there.scale), there.states)[0] / there.scale)
    except (NoOscillatorError, ValueError, np.linalg.LinAlgError):
        return None
    return (there, found.X) if found.converged else None


def is_same_sequence(one: Itinerary, other: Itinerary) -> bool:
    """Whether two itineraries have the same events and modes, whichever comes first."""
    if (one.periods, one.symmetric, len(one.sides)) != (other.periods, other.symmetric, len(other.sides)):
        return False
    a, b = (_sequence(each.twice if each.symmetric else each) for each in (one, other))
    return any(a == b[k:] + b[:k] for k in range(len(b)))


def _sequence(itinerary: Itinerary) -> list[tuple[int, tuple[object, ...]]]:
    sides = itinerary.sides or (0,)
    return [(side, tuple(leg.code for leg in legs)) for side, legs in zip(sides, itinerary.legs, strict=True)]


def is_same_event(equations: Extended, one: Event, other: Event) -> bool:
    """Whether two events of any kinds are at one orbit of one parameter."""
    if np.any(np.abs(one.point.values - other.point.values) > SAME * equations.width):
        return False
    a, b = (states_at_sections(equations.model(e.point.values), many_orbits([e.point.orbit]))[0] for e in (one, other))
    apart = np.max(np.abs(a[:1] - b), axis=1)
    return bool(np.min(apart) <= SAME_STATE * max(1e-300, float(np.max(np.abs(a)))))
