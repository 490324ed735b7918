"""A periodic orbit of a machine with modes as 2n + m equations by single shooting: see equations.Motion.

    sign z(t_0 + L) - z(t_0) = 0,  r_i(z(t_i^-), t_i) = its end

Unknown are the physical state z = (x, v) just before the first event and the times t_i of all. Phases change at given
times, which are no unknowns.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from workers.continuation.itinerary import Leg, Orbit
from workers.continuation.legs import (
    ACT,
    END,
    EVENT,
    MODE,
    NO_EVENT,
    NOTHING,
    PLAN,
    REBOUNDS,
    RESTS,
    SIGNAL,
    SLOWS,
    between_events,
    turns_of_modes,
)
from workers.continuation.oscillator import NoOscillatorError
from workers.continuation.turn import Turn, TurnMotion
from workers.model.hybrid import Elements, elements_of
from workers.model.hybrid_machines import HybridMachines
from workers.model.hybrid_modes import OPEN, SIGNALS, Code, Pieces, pieces_of
from workers.model.modes import stacked
from workers.model.oscillator import Array

LEAST = 1e-3
"""The least size of a motion, as a share of what the force alone would move the masses by."""

NO_RATE = 1e-9
"""Share of its size over one radian below which the rate of a signal is none."""


def signal_of(pieces: Pieces, k: int, signal: int, z: Array, phase: Array) -> Array:
    """A signal (N,) of mode k of machines at physical states z (N, 2n) and phases (N,) of the force."""
    row, parts = pieces.rows[:, k, signal], pieces.direct[:, k, signal]
    orders = np.arange(1.0, parts.shape[1] + 1.0)
    waves = parts[..., 0] * np.sin(phase[:, None] * orders) + parts[..., 1] * np.cos(phase[:, None] * orders)
    return np.asarray(np.vecdot(row[:, :-1], z) + row[:, -1] + waves.sum(axis=1))


@dataclass(frozen=True)
class SwitchingMotion(TurnMotion):
    """Orbits of machines with modes: physical states (N, 2n)."""

    lin: HybridMachines

    @property
    def orbits(self) -> Orbit:
        """The orbits as a record of many."""
        signs = np.sign(np.array(self.itinerary.sides, dtype=np.float64))
        return Orbit(self.itinerary, self.times, signs * np.abs(self.turn.signals[:, 1]))

    @cached_property
    def legs(self) -> list[tuple[Leg, int]]:
        """The legs of a turn, each with the event at its end, NO_EVENT for none; that before event 0 has no length."""
        m, (_, _, _, legs) = len(self.itinerary.sides), self.itinerary
        if not m:
            return [(leg, NO_EVENT) for leg in legs[0]]
        last = legs[-1][-1] if self.itinerary.sign > 0 else legs[-1][-1].mirrored
        found = [(last, 0)]
        for i, after in enumerate(legs):
            found += [(leg, NO_EVENT) for leg in after[:-1]] + [(after[-1], i + 1 if i + 1 < m else NO_EVENT)]
        return found

    @cached_property
    def codes(self) -> list[Code]:
        """The modes of the orbit, and those in which friction that turns round would stick."""
        found = [leg.code for leg, _ in self.legs]
        found += [stuck for _, _, stuck in self.turning]
        return list(dict.fromkeys(found))

    @cached_property
    def turning(self) -> list[tuple[int, int, Code]]:
        """Events at which friction turns round, each with its signal and the mode in which it would stick."""
        found, legs = list[tuple[int, int, Code]](), self.legs
        for (before, event), (after, _) in pairwise(legs):
            f = after.signal - SIGNALS * len(after.code.contacts)
            if event != NO_EVENT and f >= 0 and before.code.slips[f] == -after.code.slips[f] != 0:
                slips = tuple(0 if e == f else each for e, each in enumerate(after.code.slips))
                found.append((event, after.signal, after.code._replace(slips=slips)))
        return found

    @cached_property
    def pieces(self) -> Pieces:
        """The modes of the orbit, with an axis for them after the first."""
        made = [pieces_of(self.lin, code) for code in self.codes]
        wrong = np.any([wrong for _, wrong in made], axis=0)
        if np.any(wrong):
            raise NoOscillatorError("a mode of this orbit has no bounded motion there")
        return Pieces(*(np.stack(fields, axis=1) for fields in zip(*(pieces for pieces, _ in made), strict=True)))

    @cached_property
    def elements(self) -> Elements:
        """Contacts and friction as kernels need them."""
        return elements_of(self.lin)

    @cached_property
    def plan(self) -> NDArray[np.int64]:
        """The legs (L, PLAN) as ``turns_of_modes`` takes them."""
        found = np.zeros((len(self.legs), PLAN), dtype=np.int64)
        for k, (leg, event) in enumerate(self.legs):
            found[k, MODE], found[k, EVENT] = self.codes.index(leg.code), event
            if event != NO_EVENT:
                after = self.legs[k + 1][0]
                found[k, SIGNAL], found[k, END] = after.signal, after.side > 0
                found[k, ACT] = self._act(leg.code, after)
        return found

    def _act(self, before: Code, after: Leg) -> int:
        c, f = after.signal // SIGNALS, after.signal - SIGNALS * len(before.contacts)
        if f >= 0:
            return SLOWS if before.slips[f] != 0 and after.code.slips[f] == 0 else NOTHING
        if self.lin.soft[0, c] or before.contacts[c] != OPEN:
            return NOTHING
        return REBOUNDS if after.code.contacts[c] == OPEN else RESTS

    @cached_property
    def ends(self) -> Array:
        """When each leg ends (N, L)."""
        period, starts = 2.0 * math.pi / self.lin.omega, self.lin.starts
        now = self.times[:, 0] if self.itinerary.sides else 0.0 * period
        found, last = [], len(self.legs) - 1
        begin = now
        turns = None
        for k, (leg, event) in enumerate(self.legs):
            if k == last:
                now = begin + self.span
            elif event != NO_EVENT:
                now, turns = self.times[:, event], None
            else:
                low, high = starts[:, leg.code.phase], starts[:, leg.code.phase + 1]
                if turns is None:  # of the phase that the event is in, or next to
                    turns = np.round(now / period - 0.5 * (low + high))
                now = (high + turns) * period
                turns = turns + (leg.code.phase + 2 == starts.shape[1])
            found.append(now)
        return np.stack(found, axis=1)

    @property
    def begins(self) -> Array:
        """When each leg begins (N, L)."""
        first = self.times[:, :1] if self.itinerary.sides else np.zeros((len(self.start), 1))
        return np.concatenate([first, self.ends[:, :-1]], axis=1)

    @property
    def turn(self) -> Turn:
        """One turn from the state just before the first event."""
        return self._turned[0]

    @cached_property
    def _turned(self) -> tuple[Turn, Array]:
        """One turn, and its map at a time."""
        own, sign = self.lin, float(self.itinerary.sign)
        given = self.pieces, self.elements, self.plan, self.ends, own.tau, own.omega, sign
        *turn, maps = turns_of_modes(*given, *map(np.ascontiguousarray, (self.times, self.start, self._least)))
        return Turn(*turn), maps

    @property
    def _least(self) -> Array:
        """Of each event (N, m) the rate below which it has none: the guard changes as it would in 1 / NO_RATE radians.

        Friction that begins to stick so has f+ = R f-.
        """
        n, omega = self.start.shape[1] // 2, self.lin.omega[:, None]
        x, v = (np.abs(part).max(axis=1, keepdims=True) for part in np.split(self.start, [n], axis=1))
        size = np.maximum(np.maximum(x, v / omega), LEAST * self._pushed[:, None])
        rows = np.abs(self.pieces.rows[:, self._reached[:, MODE], self._reached[:, SIGNAL], : 2 * n])
        positions, velocities = rows[..., :n].sum(axis=2), rows[..., n:].sum(axis=2)
        return NO_RATE * omega * size * (positions + omega * velocities)

    @property
    def _reached(self) -> NDArray[np.int64]:
        """The legs of the plan that end at events."""
        return self.plan[self.plan[:, EVENT] != NO_EVENT]

    def at(self, s: Array, signal: int = 0) -> tuple[Array, Array]:
        """Physical states (N, K, 2n) at times s (N, K); of a signal its value, rate, lower and upper end (4, N, K)."""
        own, sign = self.lin, float(self.itinerary.sign)
        given = self.pieces, self.plan, self.begins, self.turn.states, own.tau, own.omega, sign, self.span
        states, signals = between_events(*given, signal, np.ascontiguousarray(s))
        return states, signals

    def touch(self, signal: int, side: int, s: Array) -> list[Array]:
        """How far a signal is from an end (N, K) at times s (N, K), and its rate."""
        _, (value, rate, low, high) = self.at(s, signal)
        return [value - (high if side > 0 else low), rate]

    def holding(self, event: int, signal: int, side: int) -> Array:
        """How far the force (N,) that holds friction just after an event is from an end of its range; or would be."""
        code = next((code for i, g, code in self.turning if (i, g) == (event, signal)), None)
        leg = next(k for k, (_, i) in enumerate(self.legs) if i == event)
        code = code or self.legs[leg + 1][0].code
        k, phase = self.codes.index(code), self.lin.tau + self.lin.omega * self.times[:, event]
        value = signal_of(self.pieces, k, signal, self.turn.states[:, leg + 1], phase)
        return np.asarray(value - self.pieces.ends[:, k, signal, 1 if side > 0 else 0])

    def turn_map(self) -> Array:
        """DP (N, 2n, 2n) over a turn, the product of flows and saltations; of symmetric orbits D_G = -DP of half."""
        return self._turned[1]

    def unknowns_along(self, change: Array) -> Array:
        """How the unknowns (N, 2n + m) of orbits change with the state (N, 2n) at the time of the first event.

        That at the event moves by f- with its time.
        """
        size, turn = change.shape[1], self.turn
        before, tangents = -turn.shifts[:, :size, size : size + 1], turn.tangents[:, size:]
        Hz, Ht = tangents[..., :size], tangents[..., size:].copy()
        Ht[..., :1] += Hz @ before
        right = -Hz @ change[..., None]
        delays = stacked(np.linalg.solve, right.shape, Ht, right) if self.itinerary.sides else right
        return np.concatenate([change[..., None] + before @ delays[:, :1], delays], axis=1)[..., 0]

    @cached_property
    def lost(self) -> int:
        """How many multipliers are zero: the dimensions that the mode with the least of them lacks."""
        return int(np.max(self.pieces.lost[0, self.plan[:, MODE]]))

    @cached_property
    def _pushed(self) -> Array:
        """How far (N,) the force alone would move free masses; 1 without a force."""
        own = self.lin
        force = np.hypot(own.force_sin, own.force_cos).max(axis=(1, 2))
        found = np.abs(np.linalg.solve(own.mass, force[..., None])[..., 0]).max(axis=1) / own.omega**2
        return np.where(found > 0.0, found, 1.0)

    def scale(self) -> tuple[Array, Array]:
        """What makes unknowns comparable: of states (N, 2n) the largest displacement and the largest velocity of any
        coordinate; and of guards (N, m), what such a state amounts to."""
        states, n = np.abs(self.turn.states), self.start.shape[1] // 2
        omega = self.lin.omega
        size = np.maximum(states[:, :, :n].max(axis=(1, 2)), states[:, :, n:].max(axis=(1, 2)) / omega)
        size = np.maximum(size, LEAST * self._pushed)  # it may be at rest
        sizes = np.repeat(np.stack([size, size * omega], axis=1), n, axis=1)
        rows = np.abs(self.pieces.rows[:, self._reached[:, MODE], self._reached[:, SIGNAL], : 2 * n])
        return sizes, np.vecdot(rows, sizes[:, None])
