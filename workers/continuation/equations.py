"""A periodic orbit with m impacts as 2m equations for their times and speeds, and these linearised.

    y(t_i) = +upper or -lower,  y'(t_i^-) = v_i,  with  y(t) = Y(t) - (1 + R) sum_j v_j g(t - t_j)

A rigid mode adds the offset of y, and (1 + R) k sum_i v_i = load span. Of a symmetric orbit, y(t + L/2) = -y(t), only
the impacts of one half are unknown: a turn is half the orbit, and kicks change sign from turn to turn.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation.oscillator import Array, ModalOscillator, rigid_mode
from workers.continuation.pulses import answers, before_impacts, forced_motion, jacobian
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
        """What kicks are multiplied by from turn to turn: -1 for symmetric orbits, else +1."""
        return -1 if self.symmetric else 1

    def span(self, lin: ModalOscillator) -> Array:
        """The length (N,) of a turn."""
        return (0.5 if self.symmetric else 1.0) * self.periods * 2.0 * math.pi / lin.omega

    def impacts(self, side: int) -> int:
        """Impacts at this stop in the whole orbit."""
        return len(self.sides) if self.symmetric else self.sides.count(side)


class Orbit(NamedTuple):
    """A periodic orbit: times (m,) of its impacts in one turn after a section, signed speeds (m,) before them.

    ``offset`` of y is that of a rigid mode, 0 without one. Many orbits of one itinerary are one record with another
    axis in front of all three.
    """

    itinerary: Itinerary
    times: Array
    speeds: Array
    offset: Any = 0.0

    def taken(self, rows: Any) -> "Orbit":
        """These rows of a record of many, in their order; of a number, that one orbit."""
        return Orbit(self.itinerary, *(np.take(field, rows, axis=0) for field in self[1:]))


def many_orbits(orbits: Sequence[Orbit]) -> Orbit:
    """Orbits of one itinerary as one record."""
    return Orbit(orbits[0].itinerary, *(np.array(fields) for fields in list(zip(*orbits, strict=True))[1:]))


def unpacked(itinerary: Itinerary, X: Array, shift: int) -> Orbit:
    """Many orbits of unknowns X (N, ...): m times, m speeds and, where ``shift`` is 1, the offset come first."""
    m = len(itinerary.sides)
    return Orbit(itinerary, X[:, :m], X[:, m : 2 * m], X[:, 2 * m] if shift else np.zeros(len(X)))


def in_one_turn(orbit: Orbit, span: float) -> Orbit:
    """The same orbit with its times in the turn that begins at the section, 0 <= t < span, in order."""
    turns = np.floor(orbit.times / span)
    flips = np.where(turns % 2 == 0, 1, orbit.itinerary.sign)
    times = orbit.times - turns * span
    order = np.argsort(times, kind="stable")
    sides = (flips * np.array(orbit.itinerary.sides))[order]
    itinerary = orbit.itinerary._replace(sides=tuple(int(side) for side in sides))
    return Orbit(itinerary, times[order], (flips * orbit.speeds)[order], orbit.offset)


def check_orbits(lin: ModalOscillator, itinerary: Itinerary) -> None:
    """ValueError, in one line, where these equations do not hold: R = 0, stops that are not there, false symmetry."""
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


class Motion(NamedTuple):
    """N orbits of one itinerary, a record of many, with their oscillators."""

    lin: ModalOscillator
    orbits: Orbit

    @property
    def span(self) -> Array:
        """The length (N,) of a turn."""
        return self.orbits.itinerary.span(self.lin)

    @property
    def stops(self) -> Array:
        """Positions (N, m) of the stops of the impacts."""
        return np.where(np.array(self.orbits.itinerary.sides) > 0, self.lin.upper[:, None], -self.lin.lower[:, None])

    @property
    def shift(self) -> int:
        """1 where the offset of y is an unknown, of a rigid mode and an orbit that is not symmetric; else 0."""
        return int(not self.orbits.itinerary.symmetric and rigid_mode(self.lin) is not None)

    def at_impacts(self) -> Array:
        """y and its first two derivatives (3, N, m) just before each impact."""
        found: Array = before_impacts(self.lin.gap, *self._plain())
        return found

    def _plain(self) -> tuple[Any, ...]:
        """Phase, 1 + R, span and sign, times, speeds and offsets as kernels take them."""
        itinerary, *plain = self.orbits
        fields = (np.ascontiguousarray(field) for field in plain)
        return self.lin.tau, 1.0 + self.lin.R, self.span, float(itinerary.sign), *fields

    def at(self, s: Array) -> Array:
        """y and its first two derivatives (3, N, K) at times s (N, K), any times but those of impacts."""
        u, gap = self.block_state(s), self.lin.gap
        y, v = (np.sum(row[..., None] * u, axis=2) for row in (gap.row, gap.row1))
        a = (gap.c0 * gap.load)[..., None] - 2.0 * gap.eta[..., None] * v - gap.lam[..., None] * y
        found: Array = forced_motion(gap.waves, gap.numbers, self.lin.tau, np.ascontiguousarray(s))
        return found + np.sum([y, v, a], axis=2)

    def block_state(self, s: Array) -> Array:
        """Block coordinates (h, h') (N, n, 2, K) at times s (N, K), forced response and rest position taken off."""
        (lin, (itinerary, times, speeds, offset)), span = self, self.span[:, None, None]
        apart, sign = s[..., None] - times[:, None], float(itinerary.sign)
        turns = np.floor(apart / span)
        kicks = (1.0 + lin.R)[:, None, None] * speeds[:, None] * sign**turns
        u, _ = answers(lin.gap.blocks, self.span, sign, apart - turns * span)
        found: Array = -np.sum(kicks[:, None, None] * u, axis=4)
        rigid = rigid_mode(lin)
        if rigid is not None:
            found[:, rigid, 0] += (offset / lin.gap.row[:, rigid, 0])[:, None]
        return found

    def residual(self) -> Array:
        """The equations (N, 2m): y(t_i) - stop_i, then y'(t_i^-) - v_i; (N, 2m + 1) where the offset is unknown."""
        lin, speeds = self.lin, self.orbits.speeds
        y, v, _ = self.at_impacts()
        parts = [y - self.stops, v - speeds]
        if self.shift:  # (1 + R) k sum_i v_i - load span of the rigid mode
            rigid = lin.gap.blocks[:, rigid_mode(lin)]
            kicks = (1.0 + lin.R) * rigid[:, COLUMN.k1] * speeds.sum(1)
            parts.append((kicks - rigid[:, COLUMN.load] * self.span)[:, None])
        return np.concatenate(parts, axis=1)

    def linearised(self, z: complex = 1) -> Table:
        """J_z: the equations linearised for perturbations of times and speeds that grow by z from turn to turn.

        z = 1 is the Jacobian (N, M, M) of ``residual`` by times, speeds and offset. Where perturbed kicks are the same
        each turn, a rigid mode adds the perturbed offset and the balance of the kicks; without that

            det J_z = prod_i (-v_i) det(z I - DP) / det(z I - e^(A span)):

        zero where z is a multiplier, and without poles.
        """
        rigid = rigid_mode(self.lin) if self.orbits.itinerary.sign * z == 1 else None
        given = *self._plain(), z if isinstance(z, complex) else float(z)
        found: Table = jacobian(self.lin.gap, *given, -1 if rigid is None else rigid)
        return found
