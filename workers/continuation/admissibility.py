"""Admissibility of orbits: each leg, the motion between two events, ends at its own event and at no other.

The kernel finds the first event of each leg with certainty, without sampling. A signal is a number computed from the
state, and an event occurs where a signal reaches an end of its range.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from workers.continuation.itinerary import mirror_sign
from workers.continuation.legs import ACT, MODE, NO_EVENT, REBOUNDS, RESTS, beyond_range, event_of_leg
from workers.continuation.shooting import OrbitMotion
from workers.kernel.chatter import chatter_time
from workers.model.hybrid_modes import DETACHED, OPEN, SIGNALS

CONTACT, LOST, ORDER, HELD = "contact", "impact_lost", "order", "held"
"""Why an orbit is not admissible. CONTACT: another contact. LOST: an impact that moves off its stop. ORDER: impacts out
of order. HELD: friction that would stick where it slides, or cannot stick where it does."""

VERTEX = "vertex"
"""Kind of the event at which a motion touches a vertex, the corner between two segments of a force law."""

AT_ONCE = 1e-6
"""Share of a period by which the first event found by the kernel may differ from the event of the orbit. A leg, the
motion between two events, that is shorter has no length."""

HOPS = 1e-3
"""Maximum change of the load during a chatter that is replaced by rest, as a share of the load."""

NEAR_TOUCH = 1e-3
"""Share of a period about a graze within which the number that touches an end of its range is known to turn back."""


class AdmissibilityFault(NamedTuple):
    """Why an orbit is not admissible.

    reason  CONTACT, LOST, ORDER or HELD
    impact  index of the event that is lost or out of order, or at which friction sticks or slides wrongly; else -1
    time    time of the contact, NaN for other reasons
    side    end of its range that the signal reaches
    signal  the signal, a number computed from the state

    An orbit is admissible if each motion between two of its events ends at its own event and at no other. Events of any
    kind count as impacts, and any signal at an end of its range as a contact.
    """

    reason: str
    impact: int = -1
    time: float = math.nan
    side: int = 0
    signal: int = 0


class Graze(NamedTuple):
    """A grazing contact: its time, the signal, and the end of its range that the signal touches at zero rate.

    A signal is a number computed from the state, such as the displacement at a contact.
    """

    time: float
    signal: int
    side: int


def first_fault(motion: OrbitMotion, touches: Sequence[Graze] = (), lost: int = -1) -> AdmissibilityFault | None:
    """Return the first reason, in time, why an orbit is not admissible; None if it is admissible.

    motion   the orbit, alone in a batch
    touches  grazes that are allowed: numbers computed from the state touch ends of their ranges there and turn back
    lost     index of an event whose rate is zero; if it is an impact it counts as a graze
    """
    rates, durations = motion.turn.signals[0, 1], (motion.ends - motion.begins)[0]
    period = 2.0 * math.pi / float(motion.lin.omega[0])
    for k, (_, event) in enumerate(motion.plan.legs):
        if event not in (NO_EVENT, lost) and motion.plan.legs[k + 1][0].side * rates[event] <= 0.0:
            return AdmissibilityFault(LOST, event)
        if durations[k] < -1e-9 * period:
            return _not_in_range(motion, k) or AdmissibilityFault(ORDER, event)
    wrong, known = _would_stick(motion) or _would_hop(motion), [_in_turn(motion, touch) for touch in touches]
    return wrong or next(
        (fault for k in range(len(motion.plan.legs)) if (fault := _of_leg(motion, k, period, known, lost))), None
    )


def _in_turn(motion: OrbitMotion, touch: Graze) -> Graze:
    """Return a grazing contact with its time moved by whole turns into the turn that begins with the first event.

    For a symmetric orbit, whose turn is half of it, the contact may become its mirror image.
    """
    begin, span = float(motion.begins[0, 0]), float(motion.span[0])
    turns = math.floor((touch.time - begin) / span)
    flips = motion.itinerary.symmetric and turns % 2 != 0
    side = touch.side * (mirror_sign(touch.signal, motion.lin.elements.soft.shape[1]) if flips else 1)
    return Graze(touch.time - turns * span, touch.signal, side)


def _would_stick(motion: OrbitMotion) -> AdmissibilityFault | None:
    """Return the fault of friction whose sliding changes sign but which would stick there; None if there is none."""
    for event, signal, _ in motion.plan.turning:
        low, high = (float(motion.holding_margin(event, signal, side)[0]) for side in (-1, 1))
        if low > 1e-9 * (low - high) and high < -1e-9 * (low - high):
            return AdmissibilityFault(HELD, event, signal=signal, side=1 if -high < low else -1)
    return None


def _would_hop(motion: OrbitMotion) -> AdmissibilityFault | None:
    """Return the fault of a rest that stands for chatter whose hops would last too long; None if there is none.

    While the hops last, the load on the stop may change by the share HOPS of itself at most.
    """
    for k, (_, event) in enumerate(motion.plan.legs):
        if motion.plan.table[k, ACT] != RESTS:
            continue
        signal, side = motion.plan.legs[k + 1][0].signal, motion.plan.legs[k + 1][0].side
        c, start = signal // SIGNALS, motion.begins[:, k + 1 : k + 2]
        R, weight = float(motion.lin.elements.R[0, c]), float(motion.lin.elements.weight[0, c])
        _, (force, rate, _, _) = motion.states_at(start, signal)
        load = -side * float(force[0, 0]) / weight
        speed = abs(float(motion.turn.signals[0, 1, event]))
        if R > 0.0 and not chatter_time(load, R * speed, R) * abs(float(rate[0, 0])) / weight <= HOPS * load:
            return AdmissibilityFault(ORDER, event)
    return None


def _not_in_range(motion: OrbitMotion, k: int) -> AdmissibilityFault | None:
    """Return the fault of leg k if an event is overdue already where the leg begins; else None.

    A leg is the motion between two events. An event is overdue if a signal, a number computed from the state, is out of
    its range.
    """
    leg, mode = motion.plan.legs[k][0], motion.plan.table[k, MODE]
    signal, side = beyond_range(
        motion.pieces, 0, mode, np.array(leg.begun), motion.turn.states[0, k], _phase(motion, k), 1e-9
    )
    return (
        AdmissibilityFault(HELD, motion.plan.legs[k - 1][1] if k else NO_EVENT, signal=signal, side=side)
        if signal >= 0
        else None
    )


def _phase(motion: OrbitMotion, k: int, later: float = 0.0) -> float:
    """Return the phase of the force at the time ``later`` after the beginning of leg k, a motion between two events."""
    machines = motion.lin
    return math.fmod(
        float(machines.tau[0]) + float(machines.omega[0]) * (float(motion.begins[0, k]) + later), 2.0 * math.pi
    )


def _of_leg(
    motion: OrbitMotion, k: int, period: float, touches: Sequence[Graze], lost: int
) -> AdmissibilityFault | None:
    """Return the first fault on leg k, a motion between two events, before the event at its end; None without a fault.

    period   forcing period
    touches  grazes that are allowed
    lost     index of an event whose rate is zero
    """
    (leg, _), begin, end = motion.plan.legs[k], float(motion.begins[0, k]), float(motion.ends[0, k])
    tolerance = AT_ONCE * period
    if end - begin <= 1e-9 * period:
        return None
    wrong = _not_in_range(motion, k)
    if wrong is not None:
        return wrong
    expected = _events_at_end(motion, k, tolerance)
    z, begun, since = motion.turn.states[0, k], np.array(leg.begun), 0.0
    if k and motion.plan.legs[k - 1][1] == lost and motion.plan.table[k - 1, ACT] == REBOUNDS:
        begun[leg.signal] = 2 * leg.side
    while True:
        remaining = end - begin - since
        s, signal, side = event_of_leg(
            motion.pieces, 0, motion.plan.table[k, MODE], z, _phase(motion, k, since), begun, remaining + tolerance
        )
        time = begin + since + s
        touched = next(
            (t for t in touches if (t.signal, t.side) == (signal, side) and _near(motion, t, time, period)), None
        )
        if signal == -1 or (abs(time - end) <= tolerance and ((signal, side) in expected or not expected)):
            return None
        if touched is None or not _turns_back(motion, touched, period):
            return AdmissibilityFault(CONTACT, time=time, signal=signal, side=side)
        since = max(touched.time - begin, since + s)
        if since >= end - begin:
            return None
        z, begun = motion.states_at(np.array([[begin + since]]))[0][0, 0], np.zeros_like(begun)
        begun[signal] = 2 * side


def _events_at_end(motion: OrbitMotion, k: int, tolerance: float) -> set[tuple[int, int]]:
    """Return (signal, side) of the event at the end of leg k, and of the events that follow it within ``tolerance``.

    A leg is a motion between two events; ``signal`` is the number whose event it is, ``side`` the end of its range.
    Rounding decides the order of these events. The set is empty if the leg ends where the phase changes, or with a turn
    without events.
    """
    legs, (lengths,) = motion.plan.legs, motion.ends - motion.begins
    if legs[k][1] == NO_EVENT and not (k + 1 == len(legs) and motion.itinerary.sides):
        return set()
    following = legs[k + 1 :]
    if k + 1 == len(legs):  # it ends at the first event of the next turn
        following = legs[1:] if motion.itinerary.sign > 0 else tuple((leg.mirrored, i) for leg, i in legs[1:])
        lengths = np.append(lengths, lengths[1:])
    events = set[tuple[int, int]]()
    for leg, length in zip((leg for leg, _ in following), lengths[k + 1 :], strict=False):
        events.add((leg.signal, leg.side))
        if length > tolerance:
            break
    return events


def _near(motion: OrbitMotion, touch: Graze, time: float, period: float) -> bool:
    span = float(motion.span[0])
    apart = (touch.time - time) / span
    return abs(apart - round(apart)) * span <= NEAR_TOUCH * period


def _turns_back(motion: OrbitMotion, touch: Graze, period: float) -> bool:
    """Return True if a signal comes nearer to its end before a graze, and moves away from this end after the graze.

    A signal is a number computed from the state, with an event at each end of its range.
    """
    times = touch.time + NEAR_TOUCH * period * np.array([[-1.0, 1.0]])
    _, (_, rates, _, _) = motion.states_at(times, touch.signal)
    return bool(touch.side * rates[0, 0] > 0.0 > touch.side * rates[0, 1])


def peak_of(motion: OrbitMotion, reason: AdmissibilityFault) -> float | None:
    """Return about when a signal that is beyond the end of its range turns back; None if it does not on this leg.

    The signal, a number computed from the state, has been beyond its end since the fault ``reason``. A leg is the
    motion between two events.
    """
    k = int(np.searchsorted(motion.begins[0], reason.time, side="right")) - 1
    s = np.linspace(reason.time, float(motion.ends[0, max(k, 0)]), 402)[1:-1]
    _, (_, rates, _, _) = motion.states_at(s[None], reason.signal)
    turned = np.flatnonzero(reason.side * rates[0] <= 0.0)
    return float(s[turned[0]]) if len(turned) else None


def name_of_touch(motion: OrbitMotion, touch: Graze) -> str:
    """Return the kind of the event at which a signal, a number computed from the state, touches an end of its range."""
    k = int(np.searchsorted(motion.begins[0], _in_turn(motion, touch).time, side="right")) - 1
    code = motion.plan.legs[max(k, 0)][0].code
    contact, friction = touch.signal // SIGNALS, touch.signal - SIGNALS * len(code.contacts)
    if friction >= 0:
        slip = code.slips[friction]
        if not slip:
            return "adding_sliding"
        return "grazing_sliding" if slip == -touch.side else VERTEX
    state, counted = code.contacts[contact], motion.lin.elements.counted[0, contact] > 0.0
    if state == OPEN:
        return "graze" if counted else VERTEX
    first = abs(state) <= DETACHED and np.sign(state) == -touch.side
    return "lift_off" if counted and (first or touch.signal % SIGNALS) else VERTEX
