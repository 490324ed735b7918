"""Itineraries: the events in order, length and modes that stay fixed along a branch."""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from workers.model.family import OrbitMachines
from workers.model.hybrid_modes import FLYING, OPEN, SIGNALS, ModeCode
from workers.model.oscillator import Array

HIT, MOVES, SLIDES, STICKS = range(4)
"""What reaches the end of its range: an open contact; another one; friction that slides; friction that sticks."""


def mirror_sign(signal: int, contacts: int) -> int:
    """-1 where the mirror image of a motion has minus its signal; 1 of the pushes of its soft contacts."""
    return 1 if signal in range(1, SIGNALS * contacts, SIGNALS) else -1


class Leg(NamedTuple):
    """The flow of a mode from an event, or from where the phase changes, to the next one.

    begun (G,): how the signals of the mode start, see hybrid.events; signal, side: what reached which end of its range
    at the event, -1 and 0 where the phase changes.
    """

    code: ModeCode
    begun: tuple[int, ...]
    signal: int
    side: int

    @property
    def mirrored(self) -> "Leg":
        """The same of the mirror image, see ``mirror_sign``."""
        phase, contacts, slips = self.code
        code = ModeCode(phase, tuple(-number for number in contacts), tuple(-number for number in slips))
        begun = tuple(mirror_sign(g, len(contacts)) * number for g, number in enumerate(self.begun))
        return Leg(code, begun, self.signal, mirror_sign(self.signal, len(contacts)) * self.side)

    def label(self, before: ModeCode) -> int:
        """The event as a number, of the other sign in the mirror image: +-1 where the first contact is reached."""
        contact, friction = self.signal // SIGNALS, self.signal - SIGNALS * len(before.contacts)
        if friction >= 0:
            return self.side * (1 + 4 * self.signal + (SLIDES if before.slips[friction] else STICKS))
        state = before.contacts[contact]
        sign = self.side if state == OPEN else int(math.copysign(1, state))
        return sign * (1 + 4 * self.signal + (HIT if state == OPEN else MOVES))


class Itinerary(NamedTuple):
    """Events in order, and length.

    sides    (m,) in one turn, see Leg.label: +1 for an impact at the upper stop, -1 at the lower
    periods  of the force in the whole orbit; 0 of a cycle without a force, whose length is its own
    symmetric  a turn is half the orbit
    legs     from each event to the next one; without events, of the turn; none where all are flights from impact to
             impact with a lone rigid contact, see ``chains``
    """

    sides: tuple[int, ...]
    periods: int
    symmetric: bool = False
    legs: tuple[tuple[Leg, ...], ...] = ()

    @property
    def sign(self) -> int:
        """What the motion is multiplied by from turn to turn: -1 for symmetric orbits, else +1."""
        return -1 if self.symmetric else 1

    @property
    def chains(self) -> tuple[tuple[Leg, ...], ...]:
        """``legs``, also where they are left out."""
        if self.legs:
            return self.legs
        return tuple((Leg(FLYING, (side, 0), 0, side),) for side in self.sides) or ((Leg(FLYING, (0, 0), -1, 0),),)

    @property
    def bare(self) -> "Itinerary":
        """The same with no legs where ``chains`` tells them."""
        other = self._replace(legs=())
        return other if other.chains == self.legs else self

    @property
    def is_cycle(self) -> bool:
        """Whether its length is its own, since no force tells it."""
        return self.periods == 0 and bool(self.sides)

    @property
    def turn(self) -> float:
        """The length of a turn in periods of the machine, one of which a whole cycle takes."""
        return (0.5 if self.symmetric else 1.0) * (self.periods or 1)

    def span(self, machines: OrbitMachines) -> Array:
        """The length (N,) of a turn of machines."""
        length: Array = self.turn * 2.0 * math.pi / machines.omega
        return length

    @property
    def sections(self) -> int:
        """How many sections the whole orbit has: periods of the force, or passages of the rarest event of a cycle."""
        if not self.is_cycle:
            return self.periods
        whole = self.twice if self.symmetric else self
        return min(Counter((leg.signal, leg.side, leg.code) for leg, *_ in whole.chains).values())

    def impacts(self, side: int) -> int:
        """How often a stop on this side is reached in the whole orbit."""
        hits = [label for label in self.sides if (abs(label) - 1) % 4 == HIT]
        return len(hits) if self.symmetric else sum(label * side > 0 for label in hits)

    def legs_after(self, first: int, sign: int) -> tuple[tuple[Leg, ...], ...]:
        """The legs from an event on, their mirror images for sign -1."""
        kept = self.legs[first:]
        return kept if sign > 0 else tuple(tuple(leg.mirrored for leg in legs) for legs in kept)

    @property
    def twice(self) -> "Itinerary":
        """Two turns as one: of symmetric orbits the whole of it."""
        sides = self.sides + tuple(self.sign * side for side in self.sides)
        legs = self.legs + self.legs_after(0, self.sign)
        return Itinerary(sides, self.periods if self.symmetric else 2 * self.periods, legs=legs)

    def repeats(self, k: int, sign: int) -> bool:
        """Whether each event is the k-th before it, or its mirror image for sign -1, and what follows."""
        here, before = (self.sides[k:], self.sides[: len(self.sides) - k])
        same = all(a == sign * b for a, b in zip(here, before, strict=True))
        return same and self.legs_after(k, 1) == self.legs_after(0, sign)[: max(0, len(self.legs) - k)]


class Orbit(NamedTuple):
    """A periodic orbit: times (m,) of its events in one turn after a section, signed speeds (m,) before them.

    The times alone define it, see ``equations.motion_of``; the speeds distinguish orbits. They are the rates of the
    signals that reach the end of their range, with the signs of the labels. Times of a cycle are counted from its first
    event, and ``length`` is that of a turn; NaN where the force tells it. Many orbits of one itinerary are one record
    with another axis in front of all.
    """

    itinerary: Itinerary
    times: Array
    speeds: Array
    length: Array = np.array(np.nan)

    def at_rows(self, rows: Any) -> "Orbit":
        """These rows of a record of many, in their order; of a number, that one orbit."""
        fields = self.times, self.speeds, np.broadcast_to(self.length, self.times.shape[:1])
        return Orbit(self.itinerary, *(np.take(field, rows, axis=0) for field in fields))

    @property
    def unknown_times(self) -> Array:
        """The times that are unknown: of a cycle the length of a turn in place of the first one, which is 0."""
        if not self.itinerary.is_cycle:
            return self.times
        return np.concatenate([np.asarray(self.length)[..., None], self.times[..., 1:]], axis=-1)

    def span(self, machines: OrbitMachines) -> float:
        """The length of a turn of this one orbit of one machine."""
        return float(self.length if self.itinerary.is_cycle else self.itinerary.span(machines)[0])


def many_orbits(orbits: Sequence[Orbit]) -> Orbit:
    """Orbits of one itinerary as one record."""
    return Orbit(orbits[0].itinerary, *(np.array(fields) for fields in list(zip(*orbits, strict=True))[1:]))
