"""Whether an orbit of the equations of a machine with modes exists: each leg ends at its own event and at no other.

Decided by the certified crossings of the kernel, leg by leg.
"""

import math
from collections.abc import Sequence

import numpy as np

from workers.continuation.admissible import CONTACT, HELD, LOST, ORDER, Fault, Touch
from workers.continuation.itinerary import Itinerary, Leg, Orbit
from workers.continuation.legs import ACT, MODE, NO_EVENT, RESTS, beyond_range, event_of_leg
from workers.continuation.switching import SwitchingMotion
from workers.kernel.chatter import chatter_time
from workers.model.hybrid_modes import OPEN, SIGNALS

AT_ONCE = 1e-6
"""Share of a period by which a certified event may be off that of the orbit and be the same; a leg as short is none."""

HOPS = 1e-3
"""Change of the load during a chatter that is left out, as a share of it."""

LOST_AT_ONCE = 3
"""Events that an orbit may lose together: a soft contact is reached, pushes no more, and opens."""

NEAR_TOUCH = 1e-3
"""Share of a period about a graze in which its signal is known to turn back there."""


def first_departure(motion: SwitchingMotion, touches: Sequence[Touch] = (), lost: int = -1) -> Fault | None:
    """The first reason, in time, why one orbit (all records of one) is not admissible; None if it is.

    ``touches`` are allowed: where signals graze ends of their ranges and turn back. An event ``lost`` has no rate.
    """
    rates, durations = motion.turn.signals[0, 1], (motion.ends - motion.begins)[0]
    period = 2.0 * math.pi / float(motion.lin.omega[0])
    for k, (_, event) in enumerate(motion.legs):
        if event not in (NO_EVENT, lost) and motion.legs[k + 1][0].side * rates[event] <= 0.0:
            return Fault(LOST, event)
        if durations[k] < -1e-9 * period:
            return _not_in_range(motion, k) or Fault(ORDER, event)
    wrong = _would_stick(motion) or _would_hop(motion)
    return wrong or next(
        (fault for k in range(len(motion.legs)) if (fault := _of_leg(motion, k, period, touches))), None
    )


def _would_stick(motion: SwitchingMotion) -> Fault | None:
    """A turn of friction that would rather stick."""
    for event, signal, _ in motion.turning:
        low, high = (float(motion.holding(event, signal, side)[0]) for side in (-1, 1))
        if low > 1e-9 * (low - high) and high < -1e-9 * (low - high):
            return Fault(HELD, event, signal=signal, side=1 if -high < low else -1)
    return None


def _would_hop(motion: SwitchingMotion) -> Fault | None:
    """A rest that takes the place of chatter whose hops are too long for that, as the load on the stop now changes.

    The load must change by a share of itself of HOPS at most while they last.
    """
    for k, (_, event) in enumerate(motion.legs):
        if motion.plan[k, ACT] != RESTS:
            continue
        signal, side = motion.legs[k + 1][0].signal, motion.legs[k + 1][0].side
        c, start = signal // SIGNALS, motion.begins[:, k + 1 : k + 2]
        R, weight = float(motion.lin.R[0, c]), float(motion.elements.weight[0, c])
        _, (force, rate, _, _) = motion.at(start, signal)
        load = -side * float(force[0, 0]) / weight
        speed = abs(float(motion.turn.signals[0, 1, event]))
        if R > 0.0 and not chatter_time(load, R * speed, R) * abs(float(rate[0, 0])) / weight <= HOPS * load:
            return Fault(ORDER, event)
    return None


def _not_in_range(motion: SwitchingMotion, k: int) -> Fault | None:
    """A leg in whose mode a signal is beyond its range from the beginning."""
    leg, mode = motion.legs[k][0], motion.plan[k, MODE]
    signal, side = beyond_range(
        motion.pieces, 0, mode, np.array(leg.begun), motion.turn.states[0, k], _phase(motion, k), 1e-9
    )
    return Fault(HELD, motion.legs[k - 1][1] if k else NO_EVENT, signal=signal, side=side) if signal >= 0 else None


def _phase(motion: SwitchingMotion, k: int, later: float = 0.0) -> float:
    """The phase of the force some time after the beginning of a leg."""
    own = motion.lin
    return math.fmod(float(own.tau[0]) + float(own.omega[0]) * (float(motion.begins[0, k]) + later), 2.0 * math.pi)


def _of_leg(motion: SwitchingMotion, k: int, period: float, touches: Sequence[Touch]) -> Fault | None:
    """What else happens on a leg than its event at its end."""
    (leg, event), begin, end = motion.legs[k], float(motion.begins[0, k]), float(motion.ends[0, k])
    tolerance = AT_ONCE * period
    if end - begin <= 1e-9 * period:
        return None
    wrong = _not_in_range(motion, k)
    if wrong is not None:
        return wrong
    expected = (motion.legs[k + 1][0].signal, motion.legs[k + 1][0].side) if event != NO_EVENT else (-1, 0)
    last = k + 1 == len(motion.legs)
    if last and motion.itinerary.sides:  # it ends at the first event of the next turn
        first = motion.legs[1][0] if motion.itinerary.sign > 0 else motion.legs[1][0].mirrored
        expected = first.signal, first.side
    z, begun, since = motion.turn.states[0, k], np.array(leg.begun), 0.0
    while True:
        left = end - begin - since
        s, signal, side = event_of_leg(
            motion.pieces, 0, motion.plan[k, MODE], z, _phase(motion, k, since), begun, left + tolerance
        )
        here = begin + since + s
        touched = next(
            (t for t in touches if (t.signal, t.side) == (signal, side) and _near(motion, t, here, period)), None
        )
        if signal == -1 or (abs(here - end) <= tolerance and ((signal, side) == expected or expected[0] < 0)):
            return None
        if touched is None or not _turns_back(motion, touched, period):
            return Fault(CONTACT, time=here, signal=signal, side=side)
        since = max(_since(motion, touched, begin), since + s)
        if since >= end - begin:
            return None
        z, begun = motion.at(np.array([[begin + since]]))[0][0, 0], np.zeros_like(begun)
        begun[signal] = 2 * side


def _since(motion: SwitchingMotion, touch: Touch, begin: float) -> float:
    """How long after the beginning of a leg its turn has a touch."""
    span = float(motion.span[0])
    return touch.time - begin - span * math.floor((touch.time - begin) / span)


def _near(motion: SwitchingMotion, touch: Touch, here: float, period: float) -> bool:
    span = float(motion.span[0])
    apart = (touch.time - here) / span
    return abs(apart - round(apart)) * span <= NEAR_TOUCH * period


def _turns_back(motion: SwitchingMotion, touch: Touch, period: float) -> bool:
    """Whether a signal comes nearer to its end before a touch, and leaves it after."""
    times = touch.time + NEAR_TOUCH * period * np.array([[-1.0, 1.0]])
    _, (_, rates, _, _) = motion.at(times, touch.signal)
    return bool(touch.side * rates[0, 0] > 0.0 > touch.side * rates[0, 1])


def peak_of(motion: SwitchingMotion, why: Fault) -> float | None:
    """About when a signal, beyond its end since the time of a fault, turns back, if within the leg."""
    k = int(np.searchsorted(motion.begins[0], why.time, side="right")) - 1
    s = np.linspace(why.time, float(motion.ends[0, max(k, 0)]), 402)[1:-1]
    _, (_, rates, _, _) = motion.at(s[None], why.signal)
    turned = np.flatnonzero(why.side * rates[0] <= 0.0)
    return float(s[turned[0]]) if len(turned) else None


def rotated(orbit: Orbit, k: int, span: float) -> Orbit:
    """The same orbit from its event k on."""
    (sides, periods, symmetric, legs), sign = orbit.itinerary, orbit.itinerary.sign
    turned = tuple(sign * side for side in sides[:k])
    itinerary = Itinerary(sides[k:] + turned, periods, symmetric, legs[k:] + orbit.itinerary.legs_after(0, sign)[:k])
    times = np.append(orbit.times[k:], orbit.times[:k] + span)
    return Orbit(itinerary, times, np.append(orbit.speeds[k:], sign * orbit.speeds[:k]))


def without_event(orbit: Orbit, event: int, span: float) -> tuple[Orbit, Leg, float] | None:
    """The orbit without an event, and without others at the same time if its mode comes back only then; the leg that
    began with it, whose signal grazes instead, and its time. None where that is no orbit.
    """
    m, found = len(orbit.itinerary.sides), []
    for count in range(1, min(LOST_AT_ONCE, m) + 1):
        place = int(m > count)  # an event is left before the lost ones
        for first in range(event - count + 1, event + 1):
            other = rotated(orbit, (first - place) % m, span)
            lost = slice(place, place + count)
            legs, times = other.itinerary.legs[lost], other.times[lost]
            kept = _before(other, place)
            if all(len(chain) == 1 for chain in legs[:-1]) and legs[-1][0].code == kept[-1].code:
                found.append(
                    (float(times[-1] - times[0]), _dropped(other, kept, lost), legs[0][0], float(np.mean(times)))
                )
    if not found:
        return None
    _, shorter, leg, time = min(found, key=lambda each: each[0])
    turns = 0.0 if shorter.itinerary.sides else math.floor(time / span)
    mirrored = turns % 2 != 0 and orbit.itinerary.symmetric
    return shorter, leg.mirrored if mirrored else leg, time - turns * span


def _before(orbit: Orbit, event: int) -> tuple[Leg, ...]:
    """The legs that end at an event."""
    return orbit.itinerary.legs[event - 1] if event else orbit.itinerary.legs_after(0, orbit.itinerary.sign)[-1]


def _dropped(orbit: Orbit, before: tuple[Leg, ...], lost: slice) -> Orbit:
    """The orbit without some events; ``before`` are the legs that end at the first of them."""
    sides, periods, symmetric, legs = orbit.itinerary
    kept = [i for i in range(len(sides)) if not lost.start <= i < lost.stop]
    chain = before + legs[lost][-1][1:]
    after = (*legs[: lost.start - 1], chain, *legs[lost.stop :]) if kept else (_of_phases(chain),)
    itinerary = Itinerary(tuple(sides[i] for i in kept), periods, symmetric, after)
    return Orbit(itinerary, orbit.times[kept], orbit.speeds[kept])


def _of_phases(chain: tuple[Leg, ...]) -> tuple[Leg, ...]:
    """The legs of a turn without events, which begins with the first phase."""
    first = next((k for k, leg in enumerate(chain) if leg.code.phase == 0), 0)
    turn = (chain[first:] + chain[:first])[: max(1, len(chain) - 1)]
    return tuple(leg._replace(begun=(0,) * len(leg.begun), signal=-1, side=0) for leg in turn)


def name_of_touch(motion: SwitchingMotion, touch: Touch) -> str:
    """What it is called where a signal touches an end of its range."""
    first = float(motion.begins[0, 0])
    k = int(np.searchsorted(motion.begins[0], first + _since(motion, touch, first), side="right")) - 1
    code = motion.legs[max(k, 0)][0].code
    friction = touch.signal - SIGNALS * len(code.contacts)
    if friction >= 0:
        return "grazing_sliding" if code.slips[friction] else "adding_sliding"
    return "graze" if code.contacts[touch.signal // SIGNALS] == OPEN else "lift_off"
