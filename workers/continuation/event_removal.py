"""Orbits with one event fewer, after that event has been lost along a branch.

A leg is the motion in one mode between two events. Signals are numbers computed from the state that decide events.
"""

import math

import numpy as np

from workers.continuation.itinerary import Itinerary, Leg, Orbit

LOST_AT_ONCE = 3
"""Maximum number of events that an orbit may lose together: a soft contact is reached, pushes no more, and opens."""


def rotated(orbit: Orbit, k: int, span: float) -> Orbit:
    """Return the same orbit with its event k as the first event; ``span`` is the length of a turn."""
    (sides, periods, symmetric, legs), sign = orbit.itinerary, orbit.itinerary.sign
    turned = tuple(sign * side for side in sides[:k])
    itinerary = Itinerary(sides[k:] + turned, periods, symmetric, legs[k:] + orbit.itinerary.legs_after(0, sign)[:k])
    times = np.append(orbit.times[k:], orbit.times[:k] + span)
    return Orbit(itinerary, times, np.append(orbit.speeds[k:], sign * orbit.speeds[:k]), orbit.length)


def without_event(orbit: Orbit, event: int, span: float) -> tuple[Orbit, Leg, float] | None:
    """Return an orbit without one of its events, and without others at the same time if need be.

    Others are dropped if only after them the linear equations of motion are again those before the event. Also return
    the leg (motion between two events) that began with the event, which becomes a graze, and the time of the graze.
    Return None if the remaining events are no orbit. ``span`` is the length of a turn.
    """
    m, choices = len(orbit.itinerary.sides), []
    for count in range(1, min(LOST_AT_ONCE, m) + 1):
        n_before = int(m > count)  # an event remains before the lost ones
        for first in range(event - count + 1, event + 1):
            other = rotated(orbit, (first - n_before) % m, span)
            lost = slice(n_before, n_before + count)
            legs, times = other.itinerary.legs[lost], other.times[lost]
            legs_before = _before(other, n_before)
            if all(len(chain) == 1 for chain in legs[:-1]) and legs[-1][0].code == legs_before[-1].code:
                choices.append(
                    (float(times[-1] - times[0]), _dropped(other, legs_before, lost), legs[0][0], float(np.mean(times)))
                )
    if not choices:
        return None
    _, shorter, leg, time = min(choices, key=lambda choice: choice[0])
    if shorter.itinerary.is_cycle and shorter.itinerary.sides:  # times count from the first event
        begin = float(shorter.times[0])
        shorter, time = shorter._replace(times=shorter.times - begin), time - begin
    turns = 0 if shorter.itinerary.sides else math.floor(time / span)
    mirrored = turns % 2 != 0 and orbit.itinerary.symmetric
    return shorter, leg.mirrored if mirrored else leg, time - turns * span


def _before(orbit: Orbit, event: int) -> tuple[Leg, ...]:
    """Return the legs, motions between events or changes of phase, from the event before ``event`` to ``event``."""
    return orbit.itinerary.legs[event - 1] if event else orbit.itinerary.legs_after(0, orbit.itinerary.sign)[-1]


def _dropped(orbit: Orbit, before: tuple[Leg, ...], lost: slice) -> Orbit:
    """Return the orbit without the events in the slice ``lost``.

    ``before`` are the legs, motions between events or changes of phase, that end at the first of these events.
    """
    sides, periods, symmetric, legs = orbit.itinerary
    remaining = [i for i in range(len(sides)) if not lost.start <= i < lost.stop]
    chain = before + legs[lost][-1][1:]
    after = (*legs[: lost.start - 1], chain, *legs[lost.stop :]) if remaining else (_of_phases(chain),)
    itinerary = Itinerary(tuple(sides[i] for i in remaining), periods or int(not remaining), symmetric, after)
    return Orbit(itinerary, orbit.times[remaining], orbit.speeds[remaining], orbit.length)


def _of_phases(chain: tuple[Leg, ...]) -> tuple[Leg, ...]:
    """Return the legs of a turn without events, which begins with the machine's first phase.

    A leg is here the motion from one change of phase to the next.
    """
    first = next((k for k, leg in enumerate(chain) if leg.code.phase == 0), 0)
    turn = (chain[first:] + chain[:first])[: max(1, len(chain) - 1)]
    return tuple(leg._replace(begun=(0,) * len(leg.begun), signal=-1, side=0) for leg in turn)
