"""Itineraries: the events of an orbit in order, its length, and the linear equations, or modes, between its events.

An itinerary stays fixed along a branch.
"""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from workers.model.family import OrbitMachines
from workers.model.hybrid_modes import FLYING, OPEN, SIGNALS, ModeCode
from workers.model.oscillator import Array

HIT, MOVES, SLIDES, STICKS = range(4)
"""What reaches the end of its range: an open contact, another contact, friction that slides, or friction that sticks.
"""


def mirror_sign(signal: int, contacts: int) -> int:
    """Return the factor of a signal under mirroring: -1, but 1 for the pushing forces of soft contacts.

    A signal is a number computed from the state. ``contacts`` is the number of contacts.
    """
    return 1 if signal in range(1, SIGNALS * contacts, SIGNALS) else -1


class Leg(NamedTuple):
    """The motion in one mode, a set of linear equations, from one event or change of phase to the next.

    code    the mode
    begun   (G,) end of its range, +-, at which each signal starts in the mode, 0 for none, see hybrid.events
    signal  signal, a number computed from the state, that reaches an end of its range at the event; -1 if the
            phase changes
    side    which end the signal reaches; 0 if the phase changes
    """

    code: ModeCode
    begun: tuple[int, ...]
    signal: int
    side: int

    @property
    def mirrored(self) -> "Leg":
        """The mirror image of the leg, a motion between two events, see ``mirror_sign``."""
        phase, contacts, slips = self.code
        code = ModeCode(phase, tuple(-number for number in contacts), tuple(-number for number in slips))
        begun = tuple(mirror_sign(g, len(contacts)) * number for g, number in enumerate(self.begun))
        return Leg(code, begun, self.signal, mirror_sign(self.signal, len(contacts)) * self.side)

    def label(self, before: ModeCode) -> int:
        """Return the label of the event at which the leg begins, a number with the opposite sign in the mirror image.

        A leg is a motion between two events. The label is +-1 if the first contact is reached. ``before`` is the mode,
        the set of linear equations, before the event.
        """
        contact, friction = self.signal // SIGNALS, self.signal - SIGNALS * len(before.contacts)
        if friction >= 0:
            return self.side * (1 + 4 * self.signal + (SLIDES if before.slips[friction] else STICKS))
        state = before.contacts[contact]
        sign = self.side if state == OPEN else int(math.copysign(1, state))
        return sign * (1 + 4 * self.signal + (HIT if state == OPEN else MOVES))


class Itinerary(NamedTuple):
    """The events of an orbit in order, and its length.

    sides      (m,) labels of the events of a turn, see Leg.label: +1 for an impact at the upper stop, -1 at the lower
    periods    forcing periods of the whole orbit; 0 for a cycle without a force, whose length is its own
    symmetric  True if a turn is half the orbit
    legs       legs, motions under one set of linear equations, between events; without events, those of the turn

    ``legs`` is empty if all legs are flights from impact to impact with a lone rigid contact, see ``chains``.
    """

    sides: tuple[int, ...]
    periods: int
    symmetric: bool = False
    legs: tuple[tuple[Leg, ...], ...] = ()

    @property
    def sign(self) -> int:
        """Factor of the motion from turn to turn: -1 for symmetric orbits, else +1."""
        return -1 if self.symmetric else 1

    @property
    def chains(self) -> tuple[tuple[Leg, ...], ...]:
        """The legs, motions under one set of linear equations, between the events, also if ``legs`` is empty."""
        if self.legs:
            return self.legs
        return tuple((Leg(FLYING, (side, 0), 0, side),) for side in self.sides) or ((Leg(FLYING, (0, 0), -1, 0),),)

    @property
    def bare(self) -> "Itinerary":
        """The same events, with empty ``legs`` if all motions are flights between impacts: ``chains`` restores them."""
        other = self._replace(legs=())
        return other if other.chains == self.legs else self

    @property
    def is_cycle(self) -> bool:
        """True for a cycle of a machine without a force, whose length is not given by a force."""
        return self.periods == 0 and bool(self.sides)

    @property
    def turn(self) -> float:
        """Length of a turn in periods of the machine.

        A limit cycle has a period of its own, and takes 1, or 0.5 if symmetric.
        """
        return (0.5 if self.symmetric else 1.0) * (self.periods or 1)

    def span(self, machines: OrbitMachines) -> Array:
        """Return the duration (N,) of a turn in each of N machines."""
        length: Array = self.turn * 2.0 * math.pi / machines.omega
        return length

    @property
    def sections(self) -> int:
        """Number of sections of the whole orbit: instants t = k T, or passages of the rarest event of a cycle."""
        if not self.is_cycle:
            return self.periods
        full = self.twice if self.symmetric else self
        return min(Counter((leg.signal, leg.side, leg.code) for leg, *_ in full.chains).values())

    def impacts(self, side: int) -> int:
        """Return how often a stop on this side, +1 for upper and -1 for lower stops, is reached in the whole orbit."""
        hits = [label for label in self.sides if (abs(label) - 1) % 4 == HIT]
        return len(hits) if self.symmetric else sum(label * side > 0 for label in hits)

    def legs_after(self, first: int, sign: int) -> tuple[tuple[Leg, ...], ...]:
        """Return the legs, motions between events, from event ``first`` on; for sign -1 their mirror images."""
        later_legs = self.legs[first:]
        return later_legs if sign > 0 else tuple(tuple(leg.mirrored for leg in legs) for legs in later_legs)

    @property
    def twice(self) -> "Itinerary":
        """The sequence of events of two turns as one, which is the whole of a symmetric orbit."""
        sides = self.sides + tuple(self.sign * side for side in self.sides)
        legs = self.legs + self.legs_after(0, self.sign)
        return Itinerary(sides, self.periods if self.symmetric else 2 * self.periods, legs=legs)

    def repeats(self, k: int, sign: int) -> bool:
        """Return True if each event, with the motion after it, is like the event k places before.

        For sign -1 it is like the mirror image of that event.
        """
        later, before = (self.sides[k:], self.sides[: len(self.sides) - k])
        same = all(a == sign * b for a, b in zip(later, before, strict=True))
        return same and self.legs_after(k, 1) == self.legs_after(0, sign)[: max(0, len(self.legs) - k)]


class Orbit(NamedTuple):
    """A periodic orbit: the times and speeds of its events.

    itinerary  its sequence of events, and the linear equations, or modes, between them
    times      (m,) times of the events in one turn after a section t = k T; of a cycle, after its first event
    speeds     (m,) signed speeds before the events
    length     length of a turn of a cycle; NaN if the force determines it

    The times alone define the orbit, see ``equations.motion_of``; the speeds distinguish orbits. The speeds are the
    rates of the numbers that reach an end of their range, with the signs of the labels. A batch of orbits of one
    itinerary has another axis in front of all fields.
    """

    itinerary: Itinerary
    times: Array
    speeds: Array
    length: Array = np.array(np.nan)

    def at_rows(self, rows: Any) -> "Orbit":
        """Return some orbits of a batch, in the order of ``rows``; for a single number, one orbit."""
        fields = self.times, self.speeds, np.broadcast_to(self.length, self.times.shape[:1])
        return Orbit(self.itinerary, *(np.take(field, rows, axis=0) for field in fields))

    @property
    def unknown_times(self) -> Array:
        """The times that are unknown. A cycle has the length of a turn in place of the first time, which is 0."""
        if not self.itinerary.is_cycle:
            return self.times
        return np.concatenate([np.asarray(self.length)[..., None], self.times[..., 1:]], axis=-1)

    def span(self, machines: OrbitMachines) -> float:
        """Return the length of a turn of this one orbit of one machine."""
        return float(self.length if self.itinerary.is_cycle else self.itinerary.span(machines)[0])


def many_orbits(orbits: Sequence[Orbit]) -> Orbit:
    """Return orbits with one sequence of events as one batch."""
    return Orbit(orbits[0].itinerary, *(np.array(fields) for fields in list(zip(*orbits, strict=True))[1:]))
