"""A periodic orbit with m impacts as 2n + m equations by single shooting, and these linearised.

    sign h(t_0 + L) - h(t_0) = 0,  y(t_i) = +upper or -lower

Unknown are the block state h (2n) just before the first impact and the times t_i of all. Of a symmetric orbit,
y(t + L/2) = -y(t), only the impacts of one half are unknown: a turn is half the orbit, and sign is -1.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from workers.continuation.itinerary import Itinerary, Orbit
from workers.continuation.oscillator import Machine, ModalOscillator
from workers.continuation.shooting import between, turns
from workers.continuation.switching import SwitchingMotion
from workers.continuation.turn import Turn, TurnMotion
from workers.model.modes import stacked
from workers.model.oscillator import Array, Mask


def check_orbits(lin: Machine, itinerary: Itinerary) -> None:
    """ValueError, in one line, where these equations hold for no machine: see ``admit``."""
    for wrong, why in _faults(lin, itinerary):
        if np.all(wrong):
            raise ValueError(why)


def admit(lin: Machine, itinerary: Itinerary) -> Mask:
    """For which machines (N,) these equations hold: not for false symmetry; for machines with one rigid contact neither
    for R = 0, missing stops, nor two rigid modes, lam = 0, since one gap coordinate sees only one.
    """
    return ~np.any([np.broadcast_to(wrong, lin.omega.shape) for wrong, _ in _faults(lin, itinerary)], axis=0)


def _faults(lin: Machine, itinerary: Itinerary) -> Iterator[tuple[Mask, str]]:
    """For which machines (N,) the equations do not hold, and why."""
    if isinstance(lin, ModalOscillator):
        yield from _impact_faults(lin, itinerary)
    even = itinerary.symmetric and itinerary.periods % 2 == 0
    yield np.array(even), f"a symmetric orbit takes an odd number of periods, found {itinerary.periods}"
    uneven = ~lin.mirrored & itinerary.symmetric
    yield uneven, "a symmetric orbit needs equal stops, odd harmonics only, no constant load and no moving belt"


def _impact_faults(lin: ModalOscillator, itinerary: Itinerary) -> Iterator[tuple[Mask, str]]:
    rigid = np.count_nonzero(lin.gap.lam == 0.0, axis=1)
    yield rigid > 1, f"{rigid[0]} rigid modes; one gap coordinate sees only one: leave out what it does not see"
    rests = "an impact without rebound may rest on its stop, which these orbits exclude"
    yield lin.R <= 0.0, f"R = 0: {rests}; take R > 0"
    for side, name, stop in ((1, "upper", lin.upper), (-1, "lower", lin.lower)):
        absent = ~np.isfinite(stop) & (side in itinerary.sides)
        yield absent, f"an impact at the {name} stop, which is not there: b_{name} = {stop[0]}"
    unknown = itinerary.periods < 1 or any(side not in (1, -1) for side in itinerary.sides)
    yield np.array(unknown), f"itinerary {itinerary}: sides must be +1 or -1 and periods at least 1"


@dataclass(frozen=True)
class ImpactMotion(TurnMotion):
    """Orbits of impacts: states (N, n, 2) in block coordinates, forced response and rest position taken off."""

    lin: ModalOscillator

    @property
    def stops(self) -> Array:
        """Positions (N, m) of the stops of the impacts."""
        return np.where(np.array(self.itinerary.sides) > 0, self.lin.upper[:, None], -self.lin.lower[:, None])

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

    def touch(self, signal: int, side: int, s: Array) -> list[Array]:
        """How far y is from a stop (N, K) at times s (N, K), and y'."""
        y, v, _ = self.at(s)[1]
        return [y - (self.lin.upper if side > 0 else -self.lin.lower)[:, None], v]

    def scale(self) -> tuple[Array, Array]:
        """What makes unknowns comparable: of states (N, 2n), in the energy norm what an impact or the state itself
        amounts to; and of guards (N, m), the greatest speed, or a thousandth of force or gap, over one radian.
        """
        gap, size, gaps = self.lin.gap, self.lin.dimension, np.abs([self.lin.upper, self.lin.lower])
        forced = np.sum(np.abs([gap.sin_part, gap.cos_part]), axis=(0, 2))
        widest = np.max(gaps, axis=0, initial=1e-300, where=np.isfinite(gaps))
        least = 1e-3 * np.maximum(forced, widest) * self.lin.omega
        weight = np.where(gap.lam != 0.0, np.abs(gap.lam), self.lin.omega[:, None] ** 2)[..., None] ** [0.5, 0.0]
        speed = np.maximum(np.max(np.abs(self.turn.signals[:, 1]), axis=1, initial=0.0), least)
        kicks = (speed * (1.0 + self.lin.R))[:, None, None] * gap.kick
        sizes = np.maximum(*(np.linalg.norm(weight * of, axis=2) for of in (kicks, self.start)))
        sizes = np.maximum(sizes, 1e-3 * sizes.max(axis=1, keepdims=True))
        guards = np.repeat((speed / self.lin.omega)[:, None], self.times.shape[1], axis=1)
        return (sizes[..., None] / weight).reshape(-1, size), guards


Motion = ImpactMotion | SwitchingMotion
"""N orbits of one itinerary, of machines with one rigid contact or with modes."""


def motion_at(lin: Machine, itinerary: Itinerary, times: Array, start: Array) -> Motion:
    """Motions with events at times (N, m) from states (N, 2n) just before the first of them."""
    if isinstance(lin, ModalOscillator):
        return ImpactMotion(lin, itinerary, times, start.reshape(len(start), -1, 2))
    return SwitchingMotion(lin, itinerary, times, start)


def motion_of_unknowns(lin: Machine, itinerary: Itinerary, X: Array) -> Motion:
    """Motions of unknowns X (N, ...), of which states and times come first."""
    size = lin.dimension
    start, times = np.split(X[:, : size + len(itinerary.sides)], [size], axis=1)
    return motion_at(lin, itinerary, np.ascontiguousarray(times), np.ascontiguousarray(start))


def motion_of(lin: Machine, orbits: Orbit) -> Motion:
    """Motions with events at the times of a record of many orbits, and the states that solve the equations best.

    For given times these are linear in the state, 2n + m equations for 2n numbers.
    """
    times, size = np.ascontiguousarray(orbits.times), lin.dimension
    still = motion_at(lin, orbits.itinerary, times, np.zeros((len(times), size)))
    J, right = still.linearised()[:, :, :size], still.turn.residuals[..., None]
    start = -stacked(np.linalg.pinv, J.swapaxes(1, 2).shape, J) @ right
    return motion_at(lin, orbits.itinerary, times, np.ascontiguousarray(start[..., 0]))
