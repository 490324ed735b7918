"""One turn of orbits over their events: what it shows, and what rigid contacts and modes have in common of it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation.itinerary import Itinerary
from workers.model.oscillator import Array

Table = NDArray[Any]
"""Real numbers, complex ones where z is."""


class Turn(NamedTuple):
    """What ``shooting.turns`` and ``legs.turns_of_modes`` find of N orbits: see there."""

    signals: Array
    states: Array
    residuals: Array
    tangents: Array
    shifts: Array


@dataclass(frozen=True)
class TurnMotion:
    """N orbits of one itinerary with their machines: times (N, m) of events, states (N, ...) before the first of them.

    Without events the states are at time 0.
    """

    lin: Any
    itinerary: Itinerary
    times: Array
    start: Array

    @property
    def span(self) -> Array:
        """The length (N,) of a turn."""
        return self.itinerary.span(self.lin)

    @property
    def unknowns(self) -> Array:
        """States, then times (N, 2n + m)."""
        return np.concatenate([self.start.reshape(len(self.start), -1), self.times], axis=1)

    @cached_property
    def turn(self) -> Turn:
        """One turn from the state just before the first event."""
        raise NotImplementedError

    @property
    def lost(self) -> int:
        """How many multipliers are zero since dimensions are lost on the way."""
        return 0

    def linearised(self, z: complex = 1) -> Table:
        """J_z (N, M, M): the equations linearised for perturbations of states and times that grow by z a turn.

        z = 1 is the Jacobian of the residuals of ``turn``. With r'_i the rate of what each event is reached by, just
        before it, v_i of an impact,

            det J_z = det(DP - z I) prod_i r'_i:

        zero where z is a multiplier, and without poles.
        """
        found: Table = self.turn.tangents - z * self.turn.shifts
        return found
