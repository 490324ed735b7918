"""Whether an orbit of the equations exists between the stops: each impact arrives at its stop, and nothing else does.

Decided by the certified crossing of the kernel, without sampling.
"""

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from workers.continuation.equations import ImpactMotion
from workers.kernel.crossing import TINY, next_crossing
from workers.kernel.signal import derivative_bounds
from workers.model.oscillator import Array, Mode, each

CONTACT, LOST, ORDER, HELD = "contact", "impact_lost", "order", "held"
"""Why an orbit is not admissible: another contact; an impact that moves off its stop; impacts out of order; friction
that would stick where it does not, or cannot where it does."""


class Fault(NamedTuple):
    """Why an orbit is not admissible: CONTACT at a time on a side; ``impact`` LOST, out of ORDER or wrongly HELD.

    Of machines with modes impacts are events of any kind, and a contact that of any signal with the end of its range.
    """

    reason: str
    impact: int = -1
    time: float = math.nan
    side: int = 0
    signal: int = 0


class Touch(NamedTuple):
    """A graze: its time, and which end of its range a signal touches; of one rigid contact alone its gap, signal 0."""

    time: float
    signal: int
    side: int


class _Contact(NamedTuple):
    """A contact of a turn: an impact, or a graze with v = 0; with the acceleration before it."""

    time: float
    side: int
    v: float
    a: float


def first_fault(motion: ImpactMotion, grazes: Iterable[float] = (), lost: int = -1) -> Fault | None:
    """The first reason, in time, why one orbit (all records of one) is not admissible; None if it is.

    ``grazes`` (G,) are times at which it touches a stop, y' = 0: no fault where y'' points inward. Impact ``lost``,
    if any, is one whose speed is zero and counts as a graze.
    """
    span, sign = float(motion.span[0]), motion.itinerary.sign
    found = _contacts(motion, grazes, lost)
    if isinstance(found, Fault):
        return found
    begins = found or [_Contact(0.0, 0, 1.0, 0.0)]
    (states,), _ = motion.at(np.array([[contact.time for contact in begins]]))
    signal = each(motion.lin.gap, lambda field: field[0])
    if not found:
        return _next_contact(signal, motion, states[0], begins[0], span)
    first = found[0]
    again = _Contact(first.time + span, sign * first.side, sign * first.v, sign * first.a)
    flights = pairwise([*found, again])
    faults = (
        _next_contact(signal, motion, h, here, there.time - here.time, there)
        for h, (here, there) in zip(states, flights, strict=True)
    )
    return next((fault for fault in faults if fault), None)


def _contacts(motion: ImpactMotion, grazes: Iterable[float], lost: int) -> list[_Contact] | Fault:
    """The contacts of a turn in order of time; a fault where an impact moves off its stop or orders differ."""
    span, t, sides = float(motion.span[0]), motion.times[0], motion.itinerary.sides
    _, v, a = motion.turn.signals[0]
    off = [i for i, side in enumerate(sides) if i != lost and side * v[i] <= 0.0]
    if off:
        return Fault(LOST, off[0])
    apart = np.diff(np.append(t, t[:1] + span))
    if np.any(apart <= 0.0):
        return Fault(ORDER, int(np.argmin(apart)))
    speeds = np.where(np.arange(len(sides)) == lost, 0.0, v)
    found = [_Contact(*of) for of in zip(t.tolist(), sides, speeds.tolist(), a.tolist(), strict=True)]
    start = t[0] if len(t) else 0.0
    for s in grazes:
        time = float(s) - math.floor((s - start) / span) * span
        y, _, bend = motion.at(np.array([[time]]))[1][:, 0, 0]
        found.append(_Contact(time, 1 if y > 0.0 or not math.isfinite(motion.lin.lower[0]) else -1, 0.0, float(bend)))
    found.sort()
    outward = (contact for contact in found if not contact.v and contact.side * contact.a >= 0.0)
    return next((Fault(CONTACT, time=contact.time, side=contact.side) for contact in outward), found)


def _open_for(contact: _Contact, M3: float) -> float:
    """A time before a contact in which its gap is certainly open, with |y'''| <= M3.

    The gap a time s before is at least v s - |a| s^2 / 2 - M3 s^3 / 6, or |a| s^2 / 2 - M3 s^3 / 6 at a graze.
    """
    v, a, M3 = abs(contact.v), abs(contact.a), max(M3, TINY)
    return 0.5 * min(v / max(a, TINY), math.sqrt(v / M3)) if v else 1.5 * a / M3


def _next_contact(
    signal: Mode, motion: ImpactMotion, h: Array, here: _Contact, duration: float, there: _Contact | None = None
) -> Fault | None:
    """A contact on the flight from one contact, with block state h after it, to the next; None if there is none."""
    lin = motion.lin
    M3 = derivative_bounds(signal.blocks, signal.numbers, h, duration)[2]
    H = duration - (_open_for(there, M3) if there else 0.0)
    if H <= 0.0:
        return None
    phase = math.fmod(float(lin.omega[0]) * here.time + float(lin.tau[0]), 2.0 * math.pi)
    start = here.side if here.v else 2 * here.side
    stops = float(lin.upper[0]), -float(lin.lower[0])
    s, side, _count = next_crossing(signal, h, phase, 0.0, *stops, start, H, np.zeros(h.shape))
    return Fault(CONTACT, time=here.time + s, side=int(side)) if side else None
