"""Orbits to start from: of a cell's section state on a periodic attractor; and back to section states."""

from collections.abc import Mapping, Sequence

import numpy as np

from workers.continuation.equations import (
    Itinerary,
    Orbit,
    at_impacts,
    block_state,
    impacts_of,
    in_one_turn,
    stops,
    unknown_offset,
)
from workers.continuation.many import many_of, moved
from workers.continuation.oscillator import Array, Family, family_of, modal
from workers.kernel.motion import LOST, RECORDED, RUNNING, STATUS, STUCK, motion_at
from workers.kernel.stroboscopic import motion_from, propagate
from workers.model.oscillator import Oscillator
from workers.model.system import System
from workers.orbit.section import AT_SECTION, quiet_section

RECORD = 256
"""Impacts of one period that an orbit may have."""


def orbit_from_state(
    system: System, values: Mapping[str, float], state: Array, periods: int, symmetric: bool = False
) -> Orbit:
    """The periodic orbit through (or next to) a physical section state, by Newton's method.

    values   parameters by name; those left out have their defaults
    periods  of the force in the whole orbit
    Raises ValueError where the motion from there rests on a stop, where R = 0, or where no orbit is found.
    """
    osc = system.build({p.name: float(values.get(p.name, p.default)) for p in system.parameters})
    return orbit_of(osc, family_of(system, values, ()), np.zeros(0), state, periods, symmetric)


def orbit_of(osc: Oscillator, family: Family, values: Array, state: Array, periods: int, symmetric: bool) -> Orbit:
    """The same where the oscillator is built, of a family at parameters (free,)."""
    orbit = recorded(osc, state, periods, symmetric)
    lin = family.model(values[None])
    if orbit.itinerary.sides and unknown_offset(lin, orbit.itinerary):  # about what impacts miss their stops by
        y = at_impacts(lin, orbit.itinerary, impacts_of(orbit))[0]
        orbit = orbit._replace(offset=float(np.mean(stops(lin, orbit.itinerary) - y)))
    return refined(family, orbit, values)


def recorded(osc: Oscillator, state: Array, periods: int, symmetric: bool) -> Orbit:
    """The orbit as its impacts are recorded in one turn from a physical section state; ValueError as above."""
    start = motion_from(osc, state)
    # From there on no impact is lost or counted twice.
    shift, h, contact, _ = quiet_section(osc, start.h, int(start.contact[0]))
    there = osc._replace(tau=osc.tau + 2.0 * np.pi * shift)
    motion = motion_at(h, contact, record=RECORD)
    rows = []
    for k in range(periods):
        propagate(there, motion, osc.period)
        if motion.tally[STATUS] != RUNNING or motion.tally[STUCK] > 0.0 or motion.tally[LOST] > 0.0:
            raise ValueError("the motion rests on a stop: it is no orbit of impacts alone")
        count = int(motion.tally[RECORDED])
        if count == RECORD:
            raise ValueError(f"{RECORD} impacts in one period: too many for an orbit of impacts")
        rows.append(motion.impacts[:count] + np.array([k * osc.period, 0.0, 0.0]))
        motion.tally[RECORDED] = 0.0
    impacts = np.concatenate(rows) if rows else np.zeros((0, 3))
    span = (0.5 if symmetric else 1.0) * periods * osc.period
    impacts = impacts[impacts[:, 0] < span]
    sides = impacts[:, 1]
    itinerary = Itinerary(tuple(int(side) for side in sides), periods, symmetric)
    return in_one_turn(Orbit(itinerary, impacts[:, 0] + shift * osc.period, sides * impacts[:, 2]), span)


def refined(family: Family, orbit: Orbit, values: Array) -> Orbit:
    """The orbit near one, at parameters (free,), to rounding. ValueError where Newton's method finds none."""
    found = moved(family, many_of([orbit], values[None]), values[None])
    if not found.found[0]:
        raise ValueError("Newton's method finds no orbit there")
    return found.orbit(0)


def section_state(system: System, values: Mapping[str, float], orbit: Orbit) -> Array:
    """The physical state (2n,) of an orbit at the section, t = 0."""
    found: Array = section_states(system, {name: np.array([value]) for name, value in values.items()}, [orbit])[0, 0]
    return found


def section_states(system: System, values: Mapping[str, Array], orbits: Sequence[Orbit], shift: float = 0.0) -> Array:
    """The physical states (N, n, 2d) of N orbits of one itinerary at the n sections t = k T of a turn.

    values   parameters (N,) by name; those left out have their defaults
    shift    of the section, in forcing periods: -states at 1/2 are those of the mirror images in a symmetric machine
    An impact at a section counts as past, also one that rounding puts up to AT_SECTION T after it.
    """
    count, itinerary = len(orbits), orbits[0].itinerary
    given = {p.name: np.full(count, p.default) for p in system.parameters} | dict(values)
    oscillators, _ = system.build_many({name: np.ascontiguousarray(column) for name, column in given.items()})
    lin, points = modal(oscillators), impacts_of(*orbits)
    period = 2.0 * np.pi / lin.omega[:, None]
    since = np.mod(points.t / period - shift, 1.0)
    points = points._replace(t=np.where(since <= AT_SECTION, points.t - AT_SECTION * period, points.t))
    parts = block_state(lin, itinerary, points, (np.arange(itinerary.periods) + shift) * period)
    angles = (lin.tau[:, None] + 2.0 * np.pi * shift) * np.arange(1.0, oscillators.forced.shape[3] + 1.0)
    waves = np.stack([np.sin(angles), np.cos(angles)], axis=-1)[:, None, None]
    still = oscillators.rest + np.sum(oscillators.forced * waves, axis=(3, 4))
    blocks = np.moveaxis(parts, (0, 3), (3, 1)) + still[:, None]
    flat = blocks.reshape(count, itinerary.periods, -1)
    return np.asarray(np.einsum("nij,nkj->nki", oscillators.to_physical, flat))
