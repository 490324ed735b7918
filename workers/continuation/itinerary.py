"""Itineraries: the events in order, length and modes that stay fixed along a branch."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from workers.model.family import FLYING, OrbitMachines
from workers.model.hybrid_modes import OPEN, SIGNALS, Code
from workers.model.oscillator import Array

HIT, MOVES, SLIDES, STICKS = range(4)
"""What reaches the end of its range: an open contact; another one; friction that slides; friction that sticks."""


def turns_round(signal: int, contacts: int) -> int:
    """-1 where the mirror image of a motion has minus its signal; 1 of the pushes of its soft contacts."""
    return 1 if signal in range(1, SIGNALS * contacts, SIGNALS) else -1


class Leg(NamedTuple):
    """The flow of a mode from an event, or from where the phase changes, to the next one.

    begun (G,): how the signals of the mode start, see hybrid.events; signal, side: what reached which end of its range
    at the event, -1 and 0 where the phase changes.
    """

    code: Code
    begun: tuple[int, ...]
    signal: int
    side: int

    @property
    def mirrored(self) -> "Leg":
        """The same of the mirror image, see ``turns_round``."""
        phase, contacts, slips = self.code
        code = Code(phase, tuple(-each for each in contacts), tuple(-each for each in slips))
        begun = tuple(turns_round(g, len(contacts)) * each for g, each in enumerate(self.begun))
        return Leg(code, begun, self.signal, turns_round(self.signal, len(contacts)) * self.side)

    def label(self, before: Code) -> int:
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
    periods  of the force in the whole orbit
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
        return tuple((Leg(FLYING, (side,), 0, side),) for side in self.sides) or ((Leg(FLYING, (0,), -1, 0),),)

    @property
    def bare(self) -> "Itinerary":
        """The same with no legs where ``chains`` tells them."""
        other = self._replace(legs=())
        return other if other.chains == self.legs else self

    def span(self, lin: OrbitMachines) -> Array:
        """The length (N,) of a turn of machines."""
        found: Array = (0.5 if self.symmetric else 1.0) * self.periods * 2.0 * math.pi / lin.omega
        return found

    def impacts(self, side: int) -> int:
        """How often a stop on this side is reached in the whole orbit."""
        hits = [each for each in self.sides if (abs(each) - 1) % 4 == HIT]
        return len(hits) if self.symmetric else sum(each * side > 0 for each in hits)

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
    signals that reach the end of their range, with the signs of the labels. Many orbits of one itinerary are one record
    with another axis in front of both.
    """

    itinerary: Itinerary
    times: Array
    speeds: Array

    def taken(self, rows: Any) -> "Orbit":
        """These rows of a record of many, in their order; of a number, that one orbit."""
        return Orbit(self.itinerary, *(np.take(field, rows, axis=0) for field in self[1:]))


def many_orbits(orbits: Sequence[Orbit]) -> Orbit:
    """Orbits of one itinerary as one record."""
    return Orbit(orbits[0].itinerary, *(np.array(fields) for fields in list(zip(*orbits, strict=True))[1:]))
