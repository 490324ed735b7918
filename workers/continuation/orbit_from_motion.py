"""Orbits recorded along a motion: the events and modes of its turn."""

from collections.abc import Sequence

import numpy as np

from workers.continuation.itinerary import Itinerary, Leg, Orbit
from workers.model.family import OrbitMachines, with_modes
from workers.model.hybrid_modes import FLYING, ModeCode
from workers.model.oscillator import Array
from workers.orbit.recorded_legs import RecordedLeg, record_legs

ALIKE, ASKED = 1e-6, 1e-2
"""Share of a turn by which the events of both halves may differ and still be mirror images, in general and for an orbit
that is known to be symmetric."""


def record_orbit(
    machine: OrbitMachines, state: Array, periods: int, symmetric: bool = False, cycle: float | None = None
) -> Orbit:
    """Return the orbit of one machine whose events occur in ``periods`` periods from a state at a section t = k T.

    machine    the machine
    state      (2n,) physical state at a section; of a cycle, any of its states
    periods    forcing periods of the orbit
    symmetric  True if the orbit is known to be symmetric
    cycle      period of a cycle without a force; None for an orbit with a force

    The orbit is symmetric if its second half is the mirror image of the first. Raise ValueError if the motion cannot be
    followed.
    """
    state = state - machine.rest[0]
    if cycle is not None:
        return reduce_symmetry(machine, _cycle(machine, state, cycle), ASKED if symmetric else ALIKE)
    phases = machine.elements.starts.shape[1] > 2  # without phases, the section is no event
    motions = record_legs(machine.oscillators, state, periods)
    if not phases and all(motion.code == FLYING for motion in motions):
        motions = _between_impacts(machine, state, periods)
    legs = [Leg(motion.code, motion.begun, motion.signal, motion.side) for motion in motions]
    indices = [i for i, leg in enumerate(legs) if phases or leg.signal >= 0]
    first = next((i for i in indices if legs[i].signal >= 0), None)
    if first is None:
        itinerary = Itinerary((), periods, symmetric, (tuple(legs[i] for i in indices or [0]),)).bare
        return Orbit(itinerary, np.zeros(0), np.zeros(0))
    turn = [motions[i] for i in indices if i >= first] + [motions[i] for i in indices if i < first]
    return reduce_symmetry(machine, orbit_from_turn(turn, legs[first - 1].code, periods), ASKED if symmetric else ALIKE)


def _between_impacts(machine: OrbitMachines, state: Array, periods: int) -> list[RecordedLeg]:
    """Return the impacts of a motion in free flight over ``periods`` periods, in order of their phase, after the start.

    The periods begin in the middle of the longest flight of the first period. Otherwise rounding could count an impact
    at the section, t = k T, twice or not at all.
    """
    start, *motions = record_legs(machine.oscillators, state, periods + 1)
    period = 2.0 * np.pi / float(machine.omega[0])
    times = np.array([0.0, *(m.time for m in motions if m.signal >= 0 and m.time < period), period])
    longest = int(np.argmax(np.diff(times)))
    begin, span = 0.5 * (times[longest] + times[longest + 1]), periods * period
    turn = [m for m in motions if m.signal >= 0 and begin <= m.time < begin + span]
    return [start, *sorted((m._replace(time=m.time % span) for m in turn), key=lambda m: m.time)]


def _cycle(machine: OrbitMachines, state: Array, period: float) -> Orbit:
    """Return a limit cycle that begins with the event after its longest motion without an event.

    machine  machine without a force
    state    (2n,) state on the cycle
    period   period of the cycle

    The recorded motion is cut in the middle of its longest part without events, since it may not close exactly yet.
    """
    turn_machine = with_modes(machine.machines._replace(omega=np.array([2.0 * np.pi / period])))
    motions = [motion for motion in record_legs(turn_machine.oscillators, state, 3) if motion.signal >= 0]
    times = np.array([motion.time for motion in motions])
    lengths = np.diff(times)[: np.sum(times < 1.5 * period)]
    if not len(lengths):
        raise ValueError(f"no event occurs in {period:g} units of time, the period of the cycle")
    longest = int(np.argmax(lengths))
    ends = 0.5 * (times[longest] + times[longest + 1]) + period
    turn = [
        motion._replace(time=motion.time - times[longest + 1])
        for motion in motions[longest + 1 :]
        if motion.time < ends
    ]
    return orbit_from_turn(turn, motions[longest].code, 0, period)


def orbit_from_turn(turn: Sequence[RecordedLeg], before: ModeCode, periods: int, length: float = np.nan) -> Orbit:
    """Return the orbit of one turn, given as legs, motions between two events each; the turn begins with an event.

    turn     recorded legs of the turn
    before   mode, the set of linear equations, before the first event
    periods  forcing periods of the orbit; 0 for a cycle
    length   length of a cycle
    """
    chains, sides, times, speeds = list[list[Leg]](), list[int](), list[float](), list[float]()
    for motion in turn:
        leg = Leg(motion.code, motion.begun, motion.signal, motion.side)
        if leg.signal >= 0:
            chains.append([])
            sides.append(leg.label(before))
            times.append(motion.time)
            speeds.append(float(np.copysign(motion.rate, sides[-1])))
        chains[-1].append(leg)
        before = leg.code
    itinerary = Itinerary(tuple(sides), periods, legs=tuple(map(tuple, chains))).bare
    return Orbit(itinerary, np.array(times), np.array(speeds), np.array(length))


def reduce_symmetry(machine: OrbitMachines, orbit: Orbit, alike: float = ALIKE) -> Orbit:
    """Return the first half of an orbit if the other half is its mirror image; else the orbit itself.

    Times of events of both halves may differ by the share ``alike`` of a turn. ``machine`` is a single machine in a
    batch.
    """
    (sides, periods, symmetric, legs), half = orbit.itinerary, len(orbit.times) // 2
    span = orbit.span(machine)
    if symmetric or not sides:
        return orbit
    can_halve = orbit.itinerary.is_cycle or periods % 2 == 1
    if len(sides) % 2 or not can_halve or not machine.mirrored[0] or not orbit.itinerary.repeats(half, -1):
        return orbit
    if np.max(np.abs(orbit.times[half:] - orbit.times[:half] - 0.5 * span)) > alike * span:
        return orbit
    itinerary = Itinerary(sides[:half], periods, True, legs[:half])
    return Orbit(itinerary, orbit.times[:half], orbit.speeds[:half], 0.5 * orbit.length)
