"""A periodic orbit with m impacts as 2n + m equations by single shooting, and these linearised.

    sign h(t_0 + L) - h(t_0) = 0,  y(t_i) = +upper or -lower

Unknown are the block state h (2n) just before the first impact and the times t_i of all. Of a symmetric orbit,
y(t + L/2) = -y(t), only the impacts of one half are unknown: a turn is half the orbit, and sign is -1.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation.oscillator import Array, ModalOscillator
from workers.continuation.shooting import between, turns
from workers.model.modes import stacked
from workers.model.oscillator import COLUMN

Table = NDArray[Any]
"""Real numbers, complex ones where z is."""


class Itinerary(NamedTuple):
    """What is fixed while an orbit is followed: its stops in order, +1 upper and -1 lower, and its length.

    sides (m,) of one turn; periods of the force in the whole orbit; symmetric: a turn is half the orbit.
    """

    sides: tuple[int, ...]
    periods: int
    symmetric: bool = False

    @property
    def sign(self) -> int:
        """What the motion is multiplied by from turn to turn: -1 for symmetric orbits, else +1."""
        return -1 if self.symmetric else 1

    def span(self, lin: ModalOscillator) -> Array:
        """The length (N,) of a turn."""
        return (0.5 if self.symmetric else 1.0) * self.periods * 2.0 * math.pi / lin.omega

    def impacts(self, side: int) -> int:
        """Impacts at this stop in the whole orbit."""
        return len(self.sides) if self.symmetric else self.sides.count(side)


class Orbit(NamedTuple):
    """A periodic orbit: times (m,) of its impacts in one turn after a section, signed speeds (m,) before them.

    Times alone define it, see ``motion_of``; speeds tell orbits apart. Many orbits of one itinerary are one record with
    another axis in front of both.
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


def in_one_turn(orbit: Orbit, span: float) -> Orbit:
    """The same orbit with its times in the turn that begins at the section, 0 <= t < span, in order."""
    turns = np.floor(orbit.times / span)
    flips = np.where(turns % 2 == 0, 1, orbit.itinerary.sign)
    times = orbit.times - turns * span
    order = np.argsort(times, kind="stable")
    sides = (flips * np.array(orbit.itinerary.sides))[order]
    itinerary = orbit.itinerary._replace(sides=tuple(int(side) for side in sides))
    return Orbit(itinerary, times[order], (flips * orbit.speeds)[order])


def check_orbits(lin: ModalOscillator, itinerary: Itinerary) -> None:
    """ValueError, in one line, where these equations do not hold: R = 0, stops that are not there, false symmetry; two
    rigid modes, lam = 0, since one gap coordinate sees only one.
    """
    if (rigid := np.count_nonzero(lin.gap.lam[0] == 0.0)) > 1:
        raise ValueError(f"{rigid} rigid modes; one gap coordinate sees only one: leave out what it does not see")
    if np.any(lin.R <= 0.0):
        raise ValueError(
            "R = 0: an impact without rebound may rest on its stop, which these orbits exclude; take R > 0"
        )
    for side, name, stop in ((1, "upper", lin.upper), (-1, "lower", lin.lower)):
        if side in itinerary.sides and not np.all(np.isfinite(stop)):
            raise ValueError(f"an impact at the {name} stop, which is not there: b_{name} = {stop[0]}")
    if itinerary.periods < 1 or any(side not in (1, -1) for side in itinerary.sides):
        raise ValueError(f"itinerary {itinerary}: sides must be +1 or -1 and periods at least 1")
    if not itinerary.symmetric:
        return
    if itinerary.periods % 2 == 0:
        raise ValueError(f"a symmetric orbit takes an odd number of periods, found {itinerary.periods}")
    even = np.any(lin.gap.sin_part[:, 1::2]) or np.any(lin.gap.cos_part[:, 1::2])
    if even or np.any(lin.gap.blocks[..., COLUMN.load]) or not np.array_equal(lin.upper, lin.lower):
        raise ValueError("a symmetric orbit needs equal stops, no constant load and odd harmonics only")


class Turn(NamedTuple):
    """What ``turns`` finds of N orbits: see there."""

    signals: Array
    states: Array
    residuals: Array
    tangents: Array
    shifts: Array


@dataclass(frozen=True)
class Motion:
    """N orbits of one itinerary with their oscillators: times (N, m) of impacts, states just before the first of them.

    start (N, n, 2)  in block coordinates, forced response and rest position taken off; without impacts at time 0
    """

    lin: ModalOscillator
    itinerary: Itinerary
    times: Array
    start: Array

    @property
    def span(self) -> Array:
        """The length (N,) of a turn."""
        return self.itinerary.span(self.lin)

    @property
    def stops(self) -> Array:
        """Positions (N, m) of the stops of the impacts."""
        return np.where(np.array(self.itinerary.sides) > 0, self.lin.upper[:, None], -self.lin.lower[:, None])

    @property
    def unknowns(self) -> Array:
        """States, then times (N, 2n + m)."""
        return np.concatenate([self.start.reshape(len(self.start), -1), self.times], axis=1)

    @property
    def orbits(self) -> Orbit:
        """The orbits as a record of many."""
        return Orbit(self.itinerary, self.times, self.turn.signals[:, 1])

    @cached_property
    def turn(self) -> Turn:
        """One turn from the state just before the first impact."""
        lin = self.lin
        q, sign, stops = 1.0 + lin.R, float(self.itinerary.sign), self.stops
        return Turn(*turns(lin.gap, lin.tau, q, sign, self.span, stops, self.times, self.start))

    def at(self, s: Array) -> tuple[Array, Array]:
        """Block states (N, K, n, 2) at times s (N, K), and y with its first two derivatives (3, N, K).

        An impact at such a time counts as past.
        """
        lin, sign, s = self.lin, float(self.itinerary.sign), np.ascontiguousarray(s)
        states, y = between(lin.gap, lin.tau, sign, self.span, self.times, self.start, self.turn.states, s)
        return states, y

    def linearised(self, z: complex = 1) -> Table:
        """J_z (N, M, M): the equations linearised for perturbations of states and times that grow by z a turn.

        z = 1 is the Jacobian of the residuals of ``turn``. With r'_i = v_i just before each impact

            det J_z = det(DP - z I) prod_i r'_i:

        zero where z is a multiplier, and without poles.
        """
        found: Table = self.turn.tangents - z * self.turn.shifts
        return found

    def scale(self, least: float = 0.0) -> tuple[Array, Array]:
        """What makes unknowns comparable: of states (N, 2n), in the energy norm what an impact or the state itself
        amounts to; and the greatest speed (N,), which counts as ``least`` where it is less.
        """
        gap, n = self.lin.gap, self.start.shape[1]
        weight = np.where(gap.lam > 0.0, gap.lam, self.lin.omega[:, None] ** 2)[..., None] ** [0.5, 0.0]
        speed = np.maximum(np.max(np.abs(self.turn.signals[:, 1]), axis=1, initial=0.0), least)
        kicks = (speed * (1.0 + self.lin.R))[:, None, None] * gap.kick
        sizes = np.maximum(*(np.linalg.norm(weight * of, axis=2) for of in (kicks, self.start)))
        sizes = np.maximum(sizes, 1e-3 * sizes.max(axis=1, keepdims=True))
        return (sizes[..., None] / weight).reshape(-1, 2 * n), speed


def motion_of_unknowns(lin: ModalOscillator, itinerary: Itinerary, X: Array) -> Motion:
    """Motions of unknowns X (N, ...), of which states and times come first."""
    n = lin.gap.blocks.shape[1]
    start, times = np.split(X[:, : 2 * n + len(itinerary.sides)], [2 * n], axis=1)
    return Motion(lin, itinerary, np.ascontiguousarray(times), start.reshape(-1, n, 2))


def motion_of(lin: ModalOscillator, orbits: Orbit) -> Motion:
    """Motions with impacts at the times of a record of many orbits, and the states that solve the equations best.

    For given times these are linear in the state, 2n + m equations for 2n numbers.
    """
    times, n = np.ascontiguousarray(orbits.times), lin.gap.blocks.shape[1]
    still = Motion(lin, orbits.itinerary, times, np.zeros((len(times), n, 2)))
    J, right = still.linearised()[:, :, : 2 * n], still.turn.residuals[..., None]
    start = -stacked(np.linalg.pinv, J.swapaxes(1, 2).shape, J) @ right
    return Motion(lin, orbits.itinerary, times, start.reshape(-1, n, 2))
