"""Periodic orbits as 2n + m equations of their states and the times of their m events, by single shooting.

    sign z(t_0 + L) - z(t_0) = 0,  r_i(z(t_i^-), t_i) = its end

Here r_i is the signal, a number computed from the state, that reaches an end of its range at event i. The unknowns are
the physical state z = (x, v) just before the first event, relative to the rest of the machine, and the times t_i of all
events. A cycle without a force has L in place of t_1, which is 0. Of a symmetric orbit, z(t + L/2) = -z(t), only the
events of one half are unknown: a turn is half the orbit, and sign is -1. Phases change at given times, which are no
unknowns.
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.continuation.itinerary import Itinerary, Leg, Orbit, mirror_sign
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
from workers.model.block_decomposition import apply_stacked
from workers.model.family import OrbitMachines
from workers.model.hybrid_modes import OPEN, SIGNALS, HybridModes, ModeCode
from workers.model.oscillator import Array

Table = NDArray[Any]
"""Array of real numbers, or of complex numbers if the growth factor z is complex."""

LEAST = 1e-3
"""Minimum size of a motion, as a share of the displacement of the masses by the force alone."""

NO_RATE = 1e-9
"""Rate of a number that decides an event, as a share of its size over one radian of the force, that counts as 0."""

PLANS = 256
"""Maximum number of plans of turns, see ``TurnPlan``, in the cache. Itineraries, sequences of events, are few, since
all points of a branch share one."""


class TurnPlan(NamedTuple):
    """The properties of a turn that its itinerary, the sequence of events and linear equations, alone determines.

    legs     motions between events, each with the event at its end or NO_EVENT; the one before event 0 has no length
    turning  events at which friction turns round, each with its signal and the mode in which the friction would stick
    codes    modes of the legs, and those in which friction that turns round would stick
    table    (L, PLAN) legs as ``turns_of_modes`` takes them
    reached  (m, PLAN) legs that end at events
    signs    (m,) factors on the rates of signals that give them the signs of the events' labels
    impacts  True if all events are rebounds, with a flight from each to the next
    slows    True if friction begins to stick at any event

    A mode is a set of linear equations; a signal is a number computed from the state that decides an event.
    """

    legs: tuple[tuple[Leg, int], ...]
    turning: tuple[tuple[int, int, ModeCode], ...]
    codes: tuple[ModeCode, ...]
    table: NDArray[np.int64]
    reached: NDArray[np.int64]
    signs: NDArray[np.int64]
    impacts: bool
    slows: bool


def plan_of(machines: OrbitMachines, itinerary: Itinerary) -> TurnPlan:
    """Return the events and the motions between them in one turn of orbits with this itinerary, for ``machines``."""
    return _plan_of(itinerary, tuple(machines.elements.soft[0].tolist()))


@lru_cache(PLANS)
def _plan_of(itinerary: Itinerary, soft: tuple[float, ...]) -> TurnPlan:
    """Return the events and the motions between them in one turn of orbits with this itinerary, see ``plan_of``.

    ``soft`` is 1 for each contact of the machines that is soft, else 0. An itinerary is a sequence of events.
    """
    m, chains = len(itinerary.sides), itinerary.chains
    legs = [(leg, NO_EVENT) for leg in chains[0]]
    if m:
        last = chains[-1][-1] if itinerary.sign > 0 else chains[-1][-1].mirrored
        legs = [(last, 0)]
        for i, chain in enumerate(chains):
            legs += [(leg, NO_EVENT) for leg in chain[:-1]] + [(chain[-1], i + 1 if i + 1 < m else NO_EVENT)]
    turning = []
    for (before, event), (after, _) in pairwise(legs):
        f = after.signal - SIGNALS * len(after.code.contacts)
        if event != NO_EVENT and f >= 0 and before.code.slips[f] == -after.code.slips[f] != 0:
            slips = tuple(0 if e == f else slip for e, slip in enumerate(after.code.slips))
            turning.append((event, after.signal, after.code._replace(slips=slips)))
    codes = list(dict.fromkeys([leg.code for leg, _ in legs] + [stuck for _, _, stuck in turning]))
    table = np.zeros((len(legs), PLAN), dtype=np.int64)
    for k, (leg, event) in enumerate(legs):
        table[k, MODE], table[k, EVENT] = codes.index(leg.code), event
        if event != NO_EVENT:
            after = legs[k + 1][0]
            table[k, SIGNAL], table[k, END], table[k, ACT] = after.signal, after.side > 0, _act(leg.code, after, soft)
    reached = table[table[:, EVENT] != NO_EVENT]
    signs = np.sign(itinerary.sides).astype(np.int64) * (2 * reached[:, END] - 1)
    impacts = len(legs) == max(m + 1, 1) and bool(np.all(reached[:, ACT] == REBOUNDS))
    slows = bool(np.any(reached[:, ACT] == SLOWS))
    return TurnPlan(tuple(legs), tuple(turning), tuple(codes), table, reached, signs, impacts, slows)


def _act(before: ModeCode, after: Leg, soft: tuple[float, ...]) -> int:
    c, f = after.signal // SIGNALS, after.signal - SIGNALS * len(before.contacts)
    if f >= 0:
        return SLOWS if before.slips[f] != 0 and after.code.slips[f] == 0 else NOTHING
    if soft[c] or before.contacts[c] != OPEN:
        return NOTHING
    return REBOUNDS if after.code.contacts[c] == OPEN else RESTS


class TurnResult(NamedTuple):
    """The result of ``legs.turns_of_modes`` for N orbits; the fields are explained there.

    ``maps`` are the Jacobians DP of a turn, products of flows and saltation matrices. A turn of a symmetric orbit is
    half of it, and the map is -DP of this half, whose square is the map of the whole orbit.
    """

    signals: Array
    states: Array
    residuals: Array
    tangents: Array
    shifts: Array
    maps: Array


@dataclass(frozen=True)
class OrbitMotion:
    """The motions of N orbits with one sequence of events, and their machines.

    lin        the machines
    itinerary  the sequence of events, and the linear equations between them
    times      (N, m) times of the events
    start      (N, 2n) states before the first event; without events, at time 0
    """

    lin: OrbitMachines
    itinerary: Itinerary
    times: Array
    start: Array

    @property
    def span(self) -> Array:
        """Length (N,) of a turn."""
        return self.itinerary.span(self.lin)

    @property
    def unknowns(self) -> Array:
        """Unknowns (N, 2n + m): states, then times, see ``Orbit.unknown_times``."""
        times = Orbit(self.itinerary, self.times, self.times, self.span).unknown_times
        return np.concatenate([self.start, times], axis=1)

    @cached_property
    def plan(self) -> TurnPlan:
        """The events of a turn, and the motions between them."""
        return plan_of(self.lin, self.itinerary)

    @property
    def orbits(self) -> Orbit:
        """The orbits, with the speeds at their events, as one batch."""
        speeds = self.plan.signs * self.turn.signals[:, 1]
        return Orbit(self.itinerary, self.times, speeds, *[self.span][: self.itinerary.is_cycle])

    @cached_property
    def pieces(self) -> HybridModes:
        """The modes of the orbit, sets of linear equations between events, along an axis after the first."""
        modes = [self.lin.mode(code) for code in self.plan.codes]
        if len(modes) == 1:
            return HybridModes(*(field[:, None] for field in modes[0]))
        return HybridModes(*(np.stack(fields, axis=1) for fields in zip(*modes, strict=True)))

    @cached_property
    def ends(self) -> Array:
        """Time (N, L) at which each leg, the motion between two events or changes of phase, ends."""
        table, starts, period = self.plan.table, self.lin.elements.starts, 2.0 * math.pi / self.lin.omega
        times, events = np.empty((len(self.start), len(table))), table[:, EVENT] != NO_EVENT
        times[:, events] = self.times
        times[:, -1] = (self.times[:, 0] if self.itinerary.sides else 0.0) + self.span
        turns = None
        for k in np.flatnonzero(~events[:-1]).tolist():
            phase, before = self.plan.legs[k][0].code.phase, times[:, k - 1] if k else 0.0 * period
            low, high = starts[:, phase], starts[:, phase + 1]
            if turns is None or events[k - 1]:  # turns of the phase of the event, or of the next phase
                turns = np.round(before / period - 0.5 * (low + high))
            times[:, k] = (high + turns) * period
            turns = turns + (phase + 2 == starts.shape[1])
        return times

    @cached_property
    def begins(self) -> Array:
        """Time (N, L) at which each leg, the motion between two events or changes of phase, begins."""
        first = self.times[:, :1] if self.itinerary.sides else np.zeros((len(self.start), 1))
        return np.concatenate([first, self.ends[:, :-1]], axis=1)

    @cached_property
    def turn(self) -> TurnResult:
        """The result of one turn from the state just before the first event."""
        machines, plan, sign = self.lin, self.plan.table, float(self.itinerary.sign)
        arguments = (
            self.pieces,
            machines.elements,
            plan,
            self.ends,
            machines.tau,
            machines.omega,
            sign,
            self.times,
            self.start,
        )
        return TurnResult(*turns_of_modes(*arguments, self._least))

    @property
    def _least(self) -> Array:
        """Rates (N, m) up to which the numbers that decide events count as constant.

        At such a rate a number changes by its size in 1 / NO_RATE radians of the force. Friction that begins to stick
        at such a rate has f+ = R f-. Other events do not need these rates.
        """
        if not self.plan.slows:
            return np.zeros_like(self.times)
        n, omega = self.start.shape[1] // 2, self.lin.omega[:, None]
        x, v = (np.abs(part).max(axis=1, keepdims=True) for part in np.split(self.start, [n], axis=1))
        size = np.maximum(np.maximum(x, v / omega), LEAST * self._pushed[:, None])
        rows = self._rows
        positions, velocities = rows[..., :n].sum(axis=2), rows[..., n:].sum(axis=2)
        return np.ascontiguousarray(NO_RATE * omega * size * (positions + omega * velocities))

    @property
    def _rows(self) -> Array:
        """Moduli (N, m, 2n) of the weights of states in the numbers that decide the events, such as displacements."""
        modes, signals = self.plan.reached[:, MODE], self.plan.reached[:, SIGNAL]
        return np.abs(self.pieces.rows[:, modes, signals, : self.start.shape[1]])

    @property
    def forced_sizes(self) -> Array:
        """Sizes (N, M) of the forced parts of states and of the numbers that decide events.

        Forced parts are subtracted and added again, with rounding. With light damping or a low frequency they are far
        larger than the motion.
        """
        pieces, (modes, signals) = self.pieces, self.plan.reached[:, [MODE, SIGNAL]].T
        blocks = np.abs(pieces.forced).sum(axis=(-2, -1)).reshape(*pieces.to_physical.shape[:-1], 1)
        states = (np.abs(pieces.to_physical) @ blocks)[..., 0].max(axis=1)
        return np.concatenate([states, np.abs(pieces.waves[:, modes, signals]).sum(axis=(-2, -1))], axis=1)

    def linearised(self, z: complex = 1) -> Table:
        """Return J_z (N, M, M): the equations linearised for perturbations that grow by z in a turn.

        The perturbations are those of states and times. z = 1 gives the Jacobian of the residuals of ``turn``. With
        r'_i the rate of the number that decides event i, just before the event (v_i for an impact),

            det J_z = det(DP - z I) prod_i r'_i.

        The determinant is zero if z is a multiplier, and has no poles. A cycle has the multiplier 1. For z = 1 the
        length of its turn is unknown instead of the time of the first event. Its other multipliers are those of the map
        from one passage of that event to the next, det J_1 = -det(P - I) prod_i r'_i.
        """
        jacobian: Table = self.turn.tangents - z * self.turn.shifts
        if z == 1 and self.itinerary.is_cycle:
            jacobian[:, :, self.start.shape[1]] = -self.turn.shifts[:, :, self.start.shape[1]]
        return jacobian

    def states_at(self, s: Array, signal: int = 0) -> tuple[Array, Array]:
        """Return the states (N, K, 2n) at times s (N, K), and value, rate and ends (4, N, K) of a signal then.

        A signal is a number computed from the state, which has a range with two ends. An event at such a time counts as
        past.
        """
        machines, sign = self.lin, float(self.itinerary.sign)
        mirror = 1.0 if sign > 0.0 else float(mirror_sign(signal, machines.elements.soft.shape[1]))
        arguments = (
            self.pieces,
            self.plan.table,
            self.begins,
            self.turn.states,
            machines.tau,
            machines.omega,
            sign,
            self.span,
        )
        states, signals = between_events(*arguments, signal, mirror, np.ascontiguousarray(s))
        return states, signals

    def distance_to_end(self, signal: int, side: int, s: Array) -> list[Array]:
        """Return the distance (N, K) of a signal from an end of its range at times s (N, K), and its rate (N, K).

        A signal is a number computed from the state, with an event at each end. ``side`` is +1 for the upper and -1 for
        the lower end.
        """
        _, (value, rate, low, high) = self.states_at(s, signal)
        return [value - (high if side > 0 else low), rate]

    def holding_margin(self, event: int, signal: int, side: int) -> Array:
        """Return the distance (N,) of a signal just after an event, such as a holding force, from an end of its range.

        event   index of the event
        signal  index of the signal, a number computed from the state; that of friction is the force that holds it
        side    +1 for the upper and -1 for the lower end

        If the friction does not stick there, the force is the one that would hold it.
        """
        code = next((code for i, g, code in self.plan.turning if (i, g) == (event, signal)), None)
        leg = next(k for k, (_, i) in enumerate(self.plan.legs) if i == event)
        code = code or self.plan.legs[leg + 1][0].code
        mode, phase = self.lin.mode(code), self.lin.tau + self.lin.omega * self.times[:, event]
        orders, parts = np.arange(1.0, mode.direct.shape[2] + 1.0), mode.direct[:, signal]
        waves = parts[..., 0] * np.sin(phase[:, None] * orders) + parts[..., 1] * np.cos(phase[:, None] * orders)
        row, states = mode.rows[:, signal], self.turn.states[:, leg + 1]
        value = np.vecdot(row[:, :-1], states) + row[:, -1] + waves.sum(axis=1)
        return np.asarray(value - mode.ends[:, signal, 1 if side > 0 else 0])

    def unknowns_along(self, change: Array) -> Array:
        """Return the change (N, 2n + m) of the unknowns that goes with a ``change`` (N, 2n) of the state.

        The state is changed at the time of the first event. If the time of the event changes, the state just before the
        event moves by f-, its rate of change there.
        """
        size, turn = change.shape[1], self.turn
        before, tangents = -turn.shifts[:, :size, size : size + 1], turn.tangents[:, size:]
        Hz, Ht = tangents[..., :size], tangents[..., size:].copy()
        Ht[..., :1] += Hz @ before
        right = -Hz @ change[..., None]
        delays = apply_stacked(np.linalg.solve, right.shape, Ht, right) if self.itinerary.sides else right
        return np.concatenate([change[..., None] + before @ delays[:, :1], delays], axis=1)[..., 0]

    @property
    def n_zero_multipliers(self) -> int:
        """Number of multipliers that are zero: the largest number of dimensions that sticking removes on the orbit."""
        return int(max(self.lin.mode(leg.code).lost[0] for leg, _ in self.plan.legs))

    @cached_property
    def _pushed(self) -> Array:
        """Displacement (N,) of free masses by the force alone; 1 without a force."""
        machines = self.lin.machines
        force = np.hypot(machines.force_sin, machines.force_cos).max(axis=(1, 2))
        reach = np.abs(np.linalg.solve(machines.mass, force[..., None])[..., 0]).max(axis=1) / machines.omega**2
        return np.where(reach > 0.0, reach, 1.0)

    def scale(self) -> tuple[Array, Array]:
        """Return scales that make unknowns comparable.

        The scale of states (N, 2n) is the largest displacement and the largest velocity of any coordinate. The second
        scale (N, m) is that of the signals at events, in such a state.
        """
        states, n = np.abs(self.turn.states), self.start.shape[1] // 2
        omega = self.lin.omega
        size = np.maximum(states[:, :, :n].max(axis=(1, 2)), states[:, :, n:].max(axis=(1, 2)) / omega)
        size = np.maximum(size, LEAST * self._pushed)  # the motion may be at rest
        sizes = np.repeat(np.stack([size, size * omega], axis=1), n, axis=1)
        return sizes, np.vecdot(self._rows, sizes[:, None])
