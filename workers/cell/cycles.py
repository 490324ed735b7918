"""Cells of machines without a force: their cycles, equilibria, tori and chaos, with results in units of time.

No period is given. The motion is followed over natural periods as any other, and examined event by event: it may be on
a cycle if an event repeats in the same mode at nearly the same state. The cycle is then solved by its equations, see
continuation/cycles.py, and the event loop has to close it. From then on the period of the cell is the period of the
cycle, so that all measures see an orbit of one period.
"""

import math
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from workers.cell.cells import ONCE_ROUND, RETURNS, CellCycle, Cells
from workers.cell.course import TORUS_RETURN, Course, Property, none_of
from workers.cell.exponents import kaplan_yorke
from workers.cell.orbits import end_on_orbits
from workers.cell.outcome import end_impact_free, put, put_averaged, put_periodic
from workers.cell.stretch import batch_of, begin, run
from workers.continuation.cycles import Cycle, cycle_near, cycle_through
from workers.continuation.itinerary import Itinerary, Orbit
from workers.continuation.legs import END, EVENT, MODE, NO_EVENT, SIGNAL
from workers.continuation.motion import OrbitMotion
from workers.continuation.recording import ASKED, halved, turned_orbit
from workers.continuation.stability import multipliers
from workers.kernel.cells import physical_states
from workers.kernel.hybrid.notes import LEG, LEG_STATE
from workers.kernel.motion import CONTRACTION, NOTHING_COUNTED, RUNNING, STATUS, STUCK, WORK, WORK_OF_A_TRIAL
from workers.model.clock import set_period
from workers.model.family import NoOscillatorError, OrbitMachines, with_modes
from workers.model.hybrid_modes import Pieces
from workers.model.oscillator import COLUMN, Array, Mask, Oscillator, Rows, at_rows, rates_of
from workers.orbit.passed import legs_of_periods, passed_by, shown_code
from workers.results import (
    APERIODIC,
    AT_EQUILIBRIUM,
    CENTRE,
    CHAOTIC,
    FREE_PHASE,
    NO_IMPACT,
    NO_REASON,
    PER_TIME,
    QUASIPERIODIC,
    REGIME,
    UNDETERMINED,
    Variable,
)

LEAST_LOOK = 64
"""Least natural periods over which a motion is examined: as long as all before, or until it closes."""

SPARSER = 0.25
"""Beyond LEAST_LOOK periods, the share of all periods so far until the events are examined again: the examinations
together cost a few times what the last one does."""

AT_ONE_TIME = 1e-9
"""Share of a natural period within which events of different signals count as one: rounding decides their order."""

NEAR = 1e-3
"""Largest distance of a return, relative to the motion, that may be the return of a cycle."""

STABLE = 1e-12
"""Least -ln|mu| from which a multiplier mu is certainly inside the unit circle, if its error is less."""

VERTEX, SAME_RAY = 1e-12, 1e-6
"""Rounding of rates and signals in an equilibrium, as a share of their terms; and by how much the direction from an
equilibrium may change in a turn round it, as a share of the distance."""

BRUSH = 1e-7
"""Largest share of rest in a cycle that is a touch, made longer by rounding: inside of it motions swing for ever."""

STEADY, LEAST_TORUS = 15.0, 3000
"""Largest logarithm of the shrinkage of a torus's second tangent vector, over at least this many natural periods of
averaging."""


BESIDE, FEW_TURNS = 1e-4, 8
"""How far beside an equilibrium a motion is begun, relative to its place; natural periods for which it is followed."""


class Trail(NamedTuple):
    """The last events of one motion, G of them; events of several signals at one time are one event.

    legs (E, columns): the leg from each event of a signal, see notes.LegRecord; first (G,): the first leg of each
    event; keys (G,): events have one key if signals, sides and next mode are the same; states (G, 2n) after them, over
    the range of each component.
    """

    legs: Array
    first: NDArray[np.int64]
    keys: NDArray[np.int64]
    states: Array

    @property
    def after(self) -> tuple[Array, NDArray[np.int64]]:
        """Physical states (E, 2n) after the signals' events, and the numbers (E,) of the modes from there on."""
        size = self.states.shape[1]
        return self.legs[:, LEG_STATE : LEG_STATE + size], self.legs[:, LEG.number].astype(np.int64)

    def until(self, count: int) -> "Trail":
        """The first events of the trail."""
        return Trail(self.legs[: np.append(self.first, len(self.legs))[count]], self.first[:count], self.keys[:count],
                     self.states[:count])  # fmt: skip

    def back(self, last: int, first: int) -> float:
        """The distance of the states after two events."""
        return float(np.max(np.abs(self.states[last] - self.states[first])))


def trail_of(legs: Array, size: int, period: float) -> Trail:
    """The trail of legs in order of time; ``period`` is the natural one."""
    events = legs[legs[:, LEG.signal] >= 0.0]
    columns = events[:, [LEG.number, LEG.signal, LEG.side]].astype(np.int64)
    first = _first_at_one_time(events, period)
    last = np.append(first, len(events))[1:] - 1
    _, keys = np.unique(columns[last], axis=0, return_inverse=True)
    keys, names = keys.reshape(-1).astype(np.int64), dict[tuple[object, ...], int]()
    for k in np.flatnonzero(last > first).tolist():
        several = sorted(map(tuple, columns[first[k] : last[k] + 1, 1:].tolist()))
        keys[k] = len(columns) + names.setdefault((columns[last[k], 0], *several), len(names))
    ranges = np.ptp(legs[:, LEG_STATE : LEG_STATE + size].reshape(-1, 2, size // 2), axis=0).max(axis=1, initial=0.0)
    ranges = np.repeat(np.where(ranges > 0.0, ranges, 1.0), size // 2)
    return Trail(events, first, keys, events[last, LEG_STATE : LEG_STATE + size] / ranges)


def _first_at_one_time(events: Array, period: float) -> NDArray[np.int64]:
    """The places of events that do not follow an event of another signal at once."""
    later = np.diff(events[:, LEG.start], prepend=-np.inf) > AT_ONE_TIME * period
    for k in np.flatnonzero(~later).tolist():
        begin = k - 1
        while not later[begin]:
            begin -= 1
        later[k] = events[k, LEG.signal] in events[begin:k, LEG.signal]  # a signal is not twice in one event
    return np.flatnonzero(later)


def course_of(cells: Cells, is_known: Property = none_of, leaves: Property = none_of) -> Course:
    """The adaptive schedule of cells, see Course."""
    kind = CycleCourse if cells.unforced else VertexCourse if np.any(without_force(cells)) else Course
    return kind(cells, is_known, leaves)


def without_force(cells: Cells) -> Mask:
    """Mask of machines with modes that no force moves and no phase changes."""
    if not cells.oscillators.has_modes:
        return np.zeros(len(cells.used), dtype=np.bool_)
    own = cells.oscillators.table.machines
    still = np.all((own.force_sin == 0.0) & (own.force_cos == 0.0), axis=(1, 2, 3))
    return np.asarray(still & (own.sizes[0] == 1))


class VertexCourse(Course):
    """The adaptive schedule for machines of which some have a force of amplitude 0."""

    def end_on_orbits(self, rows: Rows, budget: Rows, near: Array) -> Rows:
        """Write the results of cells that converge to an orbit, or to an equilibrium at a vertex."""
        rests, still = dict[int, Rest](), without_force(self.cells)
        for r in rows[still[rows]].tolist():
            rest = rest_without_events(self.cells, r) or rest_of_turns(self.cells, r)
            rests |= {r: rest} if rest else {}
        put_rests(self.cells, rests)
        rows = super().end_on_orbits(rows[self.cells.going[rows]], budget, near)
        stands = [still[r] and _repeats(self.cells, r) and _stands(self.cells, r) for r in rows.tolist()]
        self.end_standing(rows[np.array(stands, dtype=np.bool_)])
        return rows[self.cells.going[rows]]

    def end_standing(self, rows: Rows) -> None:
        """Write the results of cells that stand in an equilibrium."""
        rests = {r: rest for r in rows.tolist() if (rest := _rest_beside(self.cells, r)) is not None}
        put_rests(self.cells, rests)
        put_centres(self.cells, end_impact_free(self.cells, rows[self.cells.going[rows]]))


class CycleCourse(VertexCourse):
    """The adaptive schedule for machines without a force."""

    def end_on_orbits(self, rows: Rows, budget: Rows, near: Array) -> Rows:
        """Write the results of cells that fall into a cycle or an equilibrium; returns the others that are not known.

        An equilibrium is an orbit of the map over a natural period, without events.
        """
        known = self.is_known(rows)
        self.cells.going[rows[known]] = False
        rows, still = rows[~known], list[int]()
        cycles, rests = dict[int, tuple[Cycle, Array]](), dict[int, Rest]()
        for r in rows.tolist():
            cycle, quiet = self._look(r)
            if cycle is not None:
                cycles[r] = cycle
            elif quiet and (rest := rest_without_events(self.cells, r)) is not None:
                rests[r] = rest
            elif quiet:
                still.append(r)
        left = end_on_orbits(self.cells, np.array(still, dtype=np.int64), budget, near)
        for r in rows[self.cells.going[rows]].tolist():
            if r not in cycles and r not in rests and (rest := rest_of_turns(self.cells, r)) is not None:
                rests[r] = rest
        put_rests(self.cells, rests)
        left = np.array([r for r in left.tolist() if self.cells.going[r] and _repeats(self.cells, r)], dtype=np.int64)
        stands = np.array([_stands(self.cells, r) for r in left.tolist()], dtype=np.bool_)
        put_centres(self.cells, left[~stands])
        self.end_standing(left[stands])
        put_cycles(self.cells, cycles)
        return rows[self.cells.going[rows]]

    def end_on_long_orbits(self, rows: Rows) -> Rows:
        """The cells that continue: cycles of any length are sought at every stretch."""
        return rows[self.cells.going[rows]]

    def never_closes(self, rows: Rows) -> Mask:
        """Mask of cells that have not returned to their last event in RETURNS passages of it, and have not shrunk."""
        if not len(rows):
            return none_of(rows)
        motions, periods = self.cells.batch.motions, self.cells.flown[rows] - self.cells.began[rows]
        endless = (motions.growth[rows, 1] > -STEADY) & (periods >= LEAST_TORUS)
        for k in np.flatnonzero(endless).tolist():
            endless[k] = self._returns_far(int(rows[k]))
        return np.asarray(endless)

    def _returns_far(self, r: int) -> bool:
        trail = None
        for trail in trails(self.cells, r):
            if np.sum(trail.keys == trail.keys[-1:]) > RETURNS:
                break
        if trail is None or np.sum(trail.keys == trail.keys[-1:]) <= RETURNS:
            return False
        last = len(trail.keys) - 1
        same = np.flatnonzero(trail.keys[:-1] == trail.keys[-1])[-RETURNS:]
        return min(trail.back(last, int(k)) for k in same) > TORUS_RETURN

    def _look(self, r: int) -> tuple[tuple[Cycle, Array] | None, bool]:
        """The cycle into which one motion falls, with the times of its rarest event, if any; and whether it has no
        more events."""
        tried, trail, most = set[int](), None, 4 * self.settings.max_period
        machine = at_rows(self.cells.oscillators, np.array([r]))
        for trail in trails(self.cells, r):
            for m in turns_of(trail):
                if m in tried:
                    continue
                tried.add(m)
                cycle = cycle_of(machine, trail, m)
                if cycle is not None:
                    return cycle, False
            if len(trail.keys) and np.max(np.bincount(trail.keys)) > most:
                break
        return None, trail is not None and not len(trail.keys)


def trails(cells: Cells, r: int, start: tuple[Array, int] | None = None, most: int = 0) -> Iterator[Trail]:
    """Trails of one motion from its present state, or from ``start``, a physical state and the number of its mode; ever
    longer, until it cannot be followed or its work is spent.

    They are of each number of periods up to LEAST_LOOK and ever rarer ones beyond, of at most as many as the motion has
    flown, or ``most``.
    """
    one = np.array([r])
    machine, size, motions = at_rows(cells.oscillators, one), cells.directions, cells.batch.motions
    state, number = start or (physical_states(cells.oscillators, motions, one)[0], int(motions.mode[r, 0]))
    legs, trail, period = list[Array](), None, float(cells.oscillators.period[r])
    most, following = most or max(LEAST_LOOK, int(cells.flown[r])), 1
    with suppress(ValueError):
        for k, rows in enumerate(legs_of_periods(machine, state, number, motions.tally[r]), 1):
            cells.used[r] += 1
            legs.append(rows)
            if k < min(following, most):
                continue
            following = k + max(1, int(SPARSER * k) if k >= LEAST_LOOK else 1)
            legs = [np.concatenate(legs)]
            if trail is None or np.any(legs[0][:, LEG.signal] >= 0.0):
                trail = trail_of(legs[0], size, period)
            yield trail
            if k >= most:
                return


def turns_of(trail: Trail) -> list[int]:
    """The numbers of events in which a motion has nearly returned, nearer than a turn before.

    At most three, each return ten times nearer than any shorter one.
    """
    turns, last, record = list[int](), len(trail.keys) - 1, NEAR
    distances = np.max(np.abs(trail.states[-1:] - trail.states[last - last // 2 : last]), axis=1)[::-1]
    for m in (1 + np.flatnonzero(distances < NEAR)).tolist():
        away = float(distances[m - 1])
        if away < record and np.array_equal(trail.keys[last - m + 1 :], trail.keys[last - 2 * m + 1 : last - m + 1]):
            if away <= trail.back(last - m, last - 2 * m) or away < ONCE_ROUND:
                turns.append(m)
            record = 0.1 * away
    return turns[:3]


def cycle_of(machine: Oscillator, trail: Trail, m: int) -> tuple[Cycle, Array] | None:
    """The cycle near the last m events of a trail of a single machine, in a record of many, that is stable, or on which
    the motion is and of which a multiplier is 1; None without one.

    With the times (p,) of its rarest event: the event with the fewest passages, of several the first by signal, side
    and mode. A turn begins there, but not among the hops that end a chatter: they would count as rest.
    """
    keys = trail.keys[-m:]
    counts = np.bincount(keys)
    rarest = int(np.flatnonzero(counts == counts[counts > 0].min())[0])
    first = min(np.flatnonzero(keys == rarest), key=lambda i: tuple(trail.states[len(trail.keys) - m + i]))
    chatter = trail.legs[trail.first[-m:], LEG.chatter]
    while np.any(chatter == 0.0) and chatter[first] != 0.0:
        first = (first + 1) % m
    own, turn, keys = turn_from(machine, trail, m, int(first))
    returns = trail.back(len(trail.keys) - 1, len(trail.keys) - 1 - m) < ONCE_ROUND
    try:
        half = halved(own, turn, ASKED)
        cycle = cycle_near(own, half) if half is not turn else None
        cycle = cycle or cycle_near(own, turn)
        if cycle is None and returns:
            cycle = cycle_through(own, turn)
            return (cycle, cycle.motion.times[0]) if is_neutral(cycle) and cycle.error < ONCE_ROUND else None
        cycle = once_round(own, cycle) if cycle is not None and is_stable(cycle) else cycle
    except NoOscillatorError:
        return None
    if cycle is None or not (is_stable(cycle) or (is_neutral(cycle) and returns)):
        return None
    times = cycle.motion.times[0]
    if cycle.motion.itinerary.symmetric:
        times = np.concatenate([times, times + 0.5 * cycle.period])
    return cycle, times[keys[: len(times)] == rarest]


def turn_from(machine: Oscillator, trail: Trail, m: int, first: int) -> tuple[OrbitMachines, Orbit, NDArray[np.int64]]:
    """The last m events of a trail as a turn from one of them on, with its machine and the key of each signal's event.

    Of several signals at one time the first has the key, and the others have -1.
    """
    starts = np.append(trail.first, len(trail.legs))[len(trail.keys) - m :]
    rows = trail.legs[starts[0] :].copy()
    keys = np.full(len(rows), -1)
    keys[starts[:-1] - starts[0]] = trail.keys[-m:]
    T = trail.legs[trail.first[-1], LEG.start] - trail.legs[trail.first[-1 - m], LEG.start]
    begin = int(starts[first] - starts[0])
    before = passed_by(machine, rows[begin - 1]).code
    rows, keys = np.roll(rows, -begin, axis=0), np.roll(keys, -begin)
    rows[-begin or len(rows) :, LEG.start] += T
    rows[:, LEG.start] -= rows[0, LEG.start]
    own = with_modes(machine.table.machines._replace(omega=np.array([2.0 * np.pi / T])))
    return own, turned_orbit([passed_by(machine, row) for row in rows], before, 0, float(T)), keys


def is_stable(cycle: Cycle) -> bool:
    """Whether all multipliers of a cycle are certainly inside the unit circle."""
    return bool(cycle.logs[0] < -max(STABLE, cycle.error))


def is_neutral(cycle: Cycle) -> bool:
    """Whether the largest multiplier of a cycle is 1 within its error."""
    return bool(abs(cycle.logs[0]) <= max(STABLE, cycle.error))


def once_round(machine: OrbitMachines, cycle: Cycle) -> Cycle | None:
    """One turn of a cycle that may go round several times: a motion may seem to return after two turns first.

    None if Newton's method does not converge to it.
    """
    motion, times = cycle.motion, cycle.motion.times[0]
    itinerary, states, span = motion.itinerary, motion.turn.states[0, 1:], float(motion.span[0])
    sign, chains, count = itinerary.sign, itinerary.chains, len(times)
    first = np.flatnonzero(np.diff(times, prepend=-span) > AT_ONE_TIME * span)
    last = np.append(first, count)[1:] - 1
    several = [sorted(itinerary.sides[i : j + 1]) for i, j in zip(first, last, strict=True)]
    modes = [chains[j][-1] for j in last]
    for k in range(1, len(first) // 2 + 1):
        turns = len(first) // k
        if len(first) % k or (itinerary.symmetric and turns % 2 == 0):
            continue
        alike = all(several[i] == sorted(sign * side for side in several[i - k]) for i in range(k, len(first)))
        before = [leg if sign > 0 else leg.mirrored for leg in modes]
        alike = alike and all(modes[i].code == before[i - k].code for i in range(k, len(first)))
        late = np.abs(times[first[k:]] - times[first[:-k]] - span / turns).max()
        away = np.abs(states[last[k:]] - sign * states[last[:-k]]).max()
        if alike and late <= ONCE_ROUND * span and away <= ONCE_ROUND * np.abs(states).max():
            end = int(first[k])
            one = Itinerary(itinerary.sides[:end], itinerary.periods, itinerary.symmetric, itinerary.legs[:end])
            return cycle_near(machine, Orbit(one, times[:end], motion.orbits.speeds[0, :end], np.array(span / turns)))
    return cycle


class Rest(NamedTuple):
    """An equilibrium at a vertex, where events go on for ever while the motion shrinks by a factor each turn.

    Its physical state (2n,), the number of a mode there, the exponents (2n,) of the motion per unit of time, and their
    error.
    """

    state: Array
    number: int
    exponents: Array
    error: float


def rest_of_turns(cells: Cells, r: int) -> Rest | None:
    """The equilibrium at a vertex round which a cell's motion shrinks, if any, from the first known section on."""
    sections = sections_of(cells, r)
    if len(sections) < 8:
        return None
    quarters = [float(np.ptp(quarter, axis=0).max()) for quarter in np.array_split(sections, 4)]
    if not quarters[0] > quarters[3] or np.any(np.diff(quarters) > 0.0):
        return None  # it does not shrink
    return _rest_from(cells, r, sections[0], min(len(sections), LEAST_LOOK))


def _rest_beside(cells: Cells, r: int) -> Rest | None:
    """The equilibrium of one mass at a vertex in which a cell's motion stands, if motion from beside it shrinks round
    it: then it does so from all sides."""
    if cells.directions > 2:
        return None
    state = physical_states(cells.oscillators, cells.batch.motions, np.array([r]))[0]
    push = BESIDE * (1.0 + abs(state[0])) * 2.0 * np.pi / cells.oscillators.period[r]
    rest = _rest_from(cells, r, state + np.array([0.0, push]), FEW_TURNS)
    return rest if rest is not None and abs(rest.state[0] - state[0]) <= ONCE_ROUND * abs(state[0]) else None


def _rest_from(cells: Cells, r: int, state: Array, periods: int) -> Rest | None:
    """The equilibrium at a vertex round which the motion of a cell's machine from a physical state shrinks, if any."""
    machine, (number,) = at_rows(cells.oscillators, np.array([r])), numbers_of(cells, r, state[None])
    last = deque(trails(cells, r, (state, int(number)), periods), maxlen=1)
    count, rests = len(last[0].keys) if last else 0, list[Rest]()
    while count > 2:  # rounding hides the turns about a rest away from the origin in the end
        rest = rest_of(machine, last[0].until(count))
        rests += [rest] if rest else []
        count //= 2
    return min(rests, key=lambda rest: rest.error, default=None)


def sections_of(cells: Cells, r: int) -> Array:
    """The known physical sections (K, 2n) of a cell's last stretch."""
    h = cells.batch.sections[r, -int(cells.kept()[r]) :].reshape(-1, cells.directions)
    return np.asarray(h @ cells.oscillators.to_physical[r].T)


def numbers_of(cells: Cells, r: int, states: Array) -> NDArray[np.int64]:
    """The numbers (K,) of the modes of physical states (K, 2n) of a cell."""
    own = cells.oscillators.table
    elements = at_rows(own.elements, np.array([r]))
    return np.array([shown_code(elements, z).number_of(*own.machines.segments) for z in states])


def rest_without_events(cells: Cells, r: int) -> Rest | None:
    """The equilibrium at the end of a signal to which a cell's motion comes in one mode, from one side, by its slowest
    decay; None without one."""
    sections = sections_of(cells, r)
    numbers = numbers_of(cells, r, sections)
    machine = at_rows(cells.oscillators, np.array([r]))
    rests = (_rest_in_mode(machine, sections, numbers == number, number) for number in dict.fromkeys(numbers.tolist()))
    return next((rest for rest in rests if rest is not None), None)


def _rest_in_mode(machine: Oscillator, sections: Array, inside: Mask, number: int) -> Rest | None:
    """The equilibrium of ``rest_without_events`` in the mode of this number; ``inside`` (K,): sections in it."""
    slot, size = np.flatnonzero(machine.table.codes[0] == number), sections.shape[1]
    if not len(slot) or machine.table.pieces.lost[0, slot[0]] > 0.0:
        return None
    pieces, period = Pieces(*(field[0, slot[0]] for field in machine.table.pieces)), float(machine.period[0])
    rest = pieces.to_physical @ pieces.blocks[0, :, COLUMN.rest0 : COLUMN.rest1 + 1].reshape(-1)
    logs = np.sort(rates_of(pieces.blocks[0]).real.reshape(-1))[::-1]
    away, decay = sections - rest, math.exp(min(logs[0], 0.0) * period)
    linear = away[:-1] @ expm(_rates(pieces.acceleration) * period).T
    x, v = np.split(np.abs(away[:-1]), 2, axis=1)
    far = np.maximum(x.max(axis=1), v.max(axis=1) * period / (2.0 * np.pi))
    misses = np.maximum(np.abs(linear - decay * away[:-1]), np.abs(away[1:] - decay * away[:-1])).max(axis=1)
    straight = (misses <= SAME_RAY * decay * far) & inside[:-1] & inside[1:]
    if not (logs[0] < 0.0 and np.any(straight)):
        return None
    there = away[int(np.argmax(straight))]
    rows, (low, high) = pieces.rows, pieces.ends.T
    value, change = rows[:, :size] @ rest + rows[:, size], rows[:, :size] @ there
    rounding = VERTEX * (np.abs(rows[:, :size]) @ (np.abs(rest) + np.abs(there)) + np.abs(rows[:, size]))
    within = (value + change < high + rounding) & (value + change > low - rounding)
    within &= (value <= high + rounding) & (value >= low - rounding)
    rest[size // 2 :] = 0.0
    ends = np.abs(np.stack([value - low, value - high])) <= rounding
    return Rest(rest, number, logs, 1e-15 * abs(logs[0])) if np.all(within) and np.any(ends) else None


def _rates(acceleration: Array) -> Array:
    """The matrix (2n, 2n) of z' = A z round the rest of a mode, from its accelerations (n, 2n + 1)."""
    n = len(acceleration)
    return np.concatenate([np.eye(n, 2 * n, n), acceleration[:, : 2 * n]])


def rest_of(machine: Oscillator, trail: Trail) -> Rest | None:
    """The equilibrium to which the motion of a trail shrinks through ever the same events, of a single machine in a
    record of many; None without one.

    If each mode of a turn is at rest in one state, and each signal of an event is at its end there, then the motion
    round it has no scale: what a turn multiplies by a factor, every turn does. Motion along itself grows by this
    factor, and so does the distance; the turn tells the other multipliers.
    """
    last, size = len(trail.keys) - 1, trail.states.shape[1]
    again = last - np.flatnonzero(trail.keys[:-1] == trail.keys[-1:])[::-1]
    turns = (int(m) for m in again if 2 * m <= last and np.array_equal(trail.keys[-m:], trail.keys[-2 * m : -m]))
    m = next(turns, 0)
    if m == 0:
        return None
    own, orbit, _ = turn_from(machine, trail, m, 0)
    begins = trail.legs[np.append(trail.first, len(trail.legs))[[last - m + 1, last + 1]] - 1]
    before, after = begins[:, LEG_STATE : LEG_STATE + size]
    try:
        motion = OrbitMotion(own, orbit.itinerary, orbit.times[None], before[None])
        rest = _state_at_rest(motion, _sizes(trail.legs[trail.first[last - m] :], 0.0, orbit.length, size))
    except NoOscillatorError:
        return None
    if rest is None or motion.plan.slows:
        return None
    scale = _sizes(trail.legs[trail.first[last - m] :], rest, orbit.length, size)
    there, back = (before - rest) / scale, (after - rest) / scale
    factor = float(there @ back / (there @ there))
    turned = float(np.max(np.abs(back - factor * there))) / abs(factor)
    if not (0.0 < factor < 1.0 - SAME_RAY and turned <= SAME_RAY):
        return None
    flight = trail.legs[trail.first[last - m + 1], LEG.start] - begins[0, LEG.start]
    rate = _rates(motion.pieces.acceleration[0, motion.plan.table[0, MODE]])
    start = rest + expm(rate * flight) @ (before - rest)
    others = np.abs(multipliers(OrbitMotion(own, orbit.itinerary, orbit.times[None], start[None]))[0])
    if not np.all(others <= factor * (1.0 + SAME_RAY)):
        return None  # rounding leads away from such a turn
    logs = np.log(np.sort(np.append(others, factor)))[::-1]
    rounding = float(np.max(np.abs(rest) / scale)) / factor
    error = turned + 1e-14 * (1.0 + abs(logs[0]) + rounding)
    return Rest(rest, int(begins[1, LEG.number]), logs / orbit.span(own), error / orbit.span(own))


def _sizes(legs: Array, rest: Array | float, length: float | Array, size: int) -> Array:
    """The largest distance of the states where legs begin from ``rest``, as displacements and as velocities (2n,)."""
    x, v = np.split(np.max(np.abs(legs[:, LEG_STATE : LEG_STATE + size] - rest), axis=0), 2)
    omega = 2.0 * np.pi / float(length)
    far = max(x.max(), v.max() / omega)
    return np.repeat([far, omega * far], size // 2)


def _state_at_rest(motion: OrbitMotion, size: Array) -> Array | None:
    """The state (2n,) in which each mode of a turn is at rest and each event's signal is at its end, or None.

    size (2n,): of states in the turn.
    """
    pieces, plan, n = motion.pieces, motion.plan.table, len(size) // 2
    events = plan[plan[:, EVENT] != NO_EVENT]
    modes, signals, ends = events[:, MODE], events[:, SIGNAL], events[:, END]
    for k in range(pieces.lost.shape[1]):
        blocks = pieces.blocks[0, k, 0]
        rest = pieces.to_physical[0, k] @ blocks[:, COLUMN.rest0 : COLUMN.rest1 + 1].reshape(-1)
        there, most = np.append(rest, 1.0), np.append(np.maximum(np.abs(rest), size), 1.0)
        forces, terms = pieces.acceleration[0] @ there, np.abs(pieces.acceleration[0]) @ most
        rows, end = pieces.rows[0, modes, signals], pieces.ends[0, modes, signals, ends]
        misses, sizes = rows @ there - end, np.abs(rows) @ most + np.abs(end)
        still = np.all(np.abs(rest[n:]) <= VERTEX * size[n:]) and np.all(np.abs(forces) <= VERTEX * terms)
        if still and np.all(np.abs(misses) <= VERTEX * sizes):
            rest[n:] = 0.0
            return rest
    return None


def put_rests(cells: Cells, rests: dict[int, Rest]) -> None:
    """Write the results of cells that come to rest at a vertex; ``rests`` gives them by row."""
    if not rests:
        return
    rows, orbits = np.array(list(rests), dtype=np.int64), cells.orbits
    for r, rest in rests.items():
        period = cells.oscillators.period[r]
        orbits.h[r] = (cells.oscillators.to_blocks[r] @ rest.state).reshape(orbits.h[r].shape)
        orbits.mode[r, 0], orbits.period[r] = rest.number, 1
        orbits.exponents[r], orbits.error[r] = rest.exponents * period, rest.error * period
        orbits.tally[r] = NOTHING_COUNTED
        orbits.tally[r, CONTRACTION] = np.nan  # of no turn
    put_periodic(cells, rows)
    put(cells, rows, regime=NO_IMPACT)


def _repeats(cells: Cells, r: int) -> bool:
    """Whether the sections of one motion are one state over all of its stretch."""
    kept = cells.batch.sections[r, -int(cells.kept()[r]) :]
    return len(kept) > 1 and float(np.ptp(kept, axis=0).max()) <= ONCE_ROUND * float(np.abs(kept).max())


def _stands(cells: Cells, r: int) -> bool:
    """Whether nothing moves or accelerates in the present state of a cell."""
    motions, table = cells.batch.motions, cells.oscillators.table
    state = physical_states(cells.oscillators, motions, np.array([r]))[0]
    slot = np.flatnonzero(table.codes[r] == motions.mode[r, 0])
    if np.any(state[len(state) // 2 :] != 0.0) or not len(slot):
        return False
    rows, there = table.pieces.acceleration[r, slot[0]], np.append(state, 1.0)
    return bool(np.all(np.abs(rows @ there) <= VERTEX * (np.abs(rows) @ np.abs(there))))


def put_centres(cells: Cells, rows: Rows) -> None:
    """Write the results of cells whose sections are one state without attracting: they stand in an equilibrium, or
    swing about a centre without damping."""
    if not len(rows):
        return
    reasons = np.where([_stands(cells, r) for r in rows.tolist()], np.int8(AT_EQUILIBRIUM), np.int8(CENTRE))
    put_averaged(cells, rows)
    put(cells, rows, regime=UNDETERMINED, error=np.nan, reason=reasons)


def put_cycles(cells: Cells, cycles_of: dict[int, tuple[Cycle, Array]]) -> None:
    """Write the results of cells that fall into cycles; ``cycles_of`` gives them by row, with their times."""
    free = np.array([r for r, (cycle, _) in cycles_of.items() if not is_stable(cycle)], dtype=np.int64)
    put_averaged(cells, free)
    put(cells, free, regime=UNDETERMINED, error=np.nan, reason=FREE_PHASE)
    cycles_of = {r: there for r, there in cycles_of.items() if is_stable(there[0])}
    if not cycles_of:
        return
    rows, every = np.array(list(cycles_of), dtype=np.int64), np.arange(len(cycles_of))
    cycles = [cycle for cycle, _ in cycles_of.values()]
    periods = np.array([cycle.period for cycle in cycles])
    natural = cells.oscillators.period[rows].copy()
    set_period(cells.oscillators, rows, periods)
    begins = [_after_first(cycle) for cycle in cycles]
    own = at_rows(cells.oscillators, rows)
    codes = [cycle.motion.plan.legs[k][0].code for cycle, k in zip(cycles, begins, strict=True)]
    segments = own.table.machines.segments
    mode = np.array([code.number_of(*segments) for code in codes])
    states = np.stack([cycle.motion.turn.states[0, k] for cycle, k in zip(cycles, begins, strict=True)])
    motions, reasons = begin(own, np.full(len(rows), NO_REASON, dtype=np.int8), states, mode)
    start, batch = motions.h.copy(), batch_of(own, motions)
    motions.tally[:, WORK], batch.periods[:] = WORK_OF_A_TRIAL, 1
    run(batch, every)
    after = physical_states(own, motions, every)
    size = np.abs(states).max(axis=1)
    closes = (motions.tally[:, STATUS] == RUNNING) & (reasons == NO_REASON) & (motions.mode[:, 0] == mode)
    closes &= np.abs(after - states).max(axis=1) <= ONCE_ROUND * size
    stuck = motions.tally[:, STUCK]
    edge = closes & (stuck > 0.0) & (stuck <= BRUSH * periods)
    closes &= ~edge
    set_period(cells.oscillators, rows[~closes], natural[~closes])
    put_centres(cells, rows[edge])
    kept = np.flatnonzero(closes)
    rows, orbits = rows[kept], cells.orbits
    for r in rows.tolist():
        cycle, times = cycles_of[r]
        cells.cycles[r] = _as_passed(own, cycle, times)
        orbits.exponents[r] = -np.sort(-np.append(cycle.logs, 0.0))
        orbits.symmetric[r], orbits.error[r] = cycle.motion.itinerary.symmetric, 1e-14 * (1.0 + abs(cycle.logs[0]))
    orbits.h[rows], orbits.mode[rows, 0], orbits.period[rows] = start[kept], mode[kept], 1
    orbits.tally[rows] = motions.tally[kept]
    put_periodic(cells, rows)
    largest = np.array([cycles_of[r][0].logs[0] for r in rows.tolist()])
    put(cells, rows, largest=largest)  # beside the 0 along the cycle
    put(cells, rows[np.isneginf(largest)], error=0.0)


def _after_first(cycle: Cycle) -> int:
    """The leg that begins after the first event, and after all that happen at the same time."""
    lengths = (cycle.motion.ends - cycle.motion.begins)[0, 1:]
    return 1 + int(np.argmax(lengths > AT_ONE_TIME * cycle.period))


def _as_passed(machines: Oscillator, cycle: Cycle, times: Array) -> CellCycle:
    """A cycle of a cell with the times (p,) of its rarest event; ``machines`` are of the same elements."""
    motion, segments = cycle.motion, machines.table.machines.segments
    legs, states = [leg for leg, _ in motion.plan.legs[1:]], motion.turn.states[0, 1:]
    if motion.itinerary.symmetric:
        legs, states = legs + [leg.mirrored for leg in legs], np.concatenate([states, -states])
    numbers = np.array([leg.code.number_of(*segments) for leg in legs])
    return CellCycle(cycle.period, motion.at(times[None])[0][0], states, numbers)


def convert_to_time(cells: Cells, variables: tuple[Variable, ...]) -> None:
    """Convert the results of all cells from periods to units of time, and write the periods of cycles.

    The exponent along a motion is set to 0, its exact value: of chaos the exponent nearest to 0, of a torus the second.
    Sections are the passages of an event.
    """
    results = cells.results
    for variable in variables:
        if PER_TIME in variable.long_name:
            values = results[variable.name]
            values /= cells.oscillators.period.reshape(-1, *[1] * (values.ndim - 1))
    for r, cycle in cells.cycles.items():
        results["cycle_period"][r], results["period"][r] = cycle.period, len(cycle.section)
        if "section" in results:
            results["section"][r] = cycle.section[np.arange(results["section"].shape[1]) % len(cycle.section)]
    for r in np.flatnonzero(np.isin(results[REGIME.name], (CHAOTIC, QUASIPERIODIC, APERIODIC))).tolist():
        if "section" in results:
            results["section"][r] = passages(cells, r, results["section"].shape[1])
        if "spectrum" in results:
            spectrum = results["spectrum"][r]
            torus = results[REGIME.name][r] == QUASIPERIODIC  # the first exponent of a torus is 0, too
            spectrum[1 if torus else np.argmin(np.abs(spectrum))] = 0.0
            known = np.where(torus & (np.arange(len(spectrum)) == 0), 0.0, spectrum)
            results["kaplan_yorke"][r] = kaplan_yorke(-np.sort(-known))


def passages(cells: Cells, r: int, count: int) -> Array:
    """The states (count, 2n) just after the commonest event of a motion that does not close, from its result on.

    NaN from the event on at which it cannot be followed.
    """
    size, states = cells.directions, list[Array]()
    machine, number = at_rows(cells.oscillators, np.array([r])), int(cells.mode[r])
    key = None
    with suppress(ValueError):
        for rows in islice(legs_of_periods(machine, cells.results["state"][r], number), LEAST_LOOK + 4 * count):
            events = rows[rows[:, LEG.signal] >= 0.0]
            keys = events[:, [LEG.signal, LEG.side, LEG.number]]
            if key is None and len(keys):
                kinds, counts = np.unique(keys, axis=0, return_counts=True)
                key = kinds[np.argmax(counts)]
            states += list(events[np.all(keys == key, axis=1), LEG_STATE : LEG_STATE + size]) if len(keys) else []
            if len(states) >= count:
                break
    passed = np.full((count, size), np.nan)
    passed[: len(states)] = np.reshape(states[:count], (-1, size))
    return passed
