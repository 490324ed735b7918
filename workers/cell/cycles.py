"""Cells of machines without a force: their cycles, equilibria, tori and chaos, with results in units of time.

No period is given. The motion is followed over natural periods as any other, and examined event by event: it may be on
a cycle if an event repeats in the same mode at nearly the same state. The cycle is then solved by its equations, see
continuation/cycles.py, and the event loop has to close it. From then on the period of the cell is the period of the
cycle, so that all measures see an orbit of one period.
"""

from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.cell.cells import ONCE_ROUND, RETURNS, CellCycle, Cells
from workers.cell.course import TORUS_RETURN, Course, Property, none_of
from workers.cell.exponents import kaplan_yorke
from workers.cell.orbits import end_on_orbits
from workers.cell.outcome import put, put_averaged, put_periodic
from workers.cell.stretch import batch_of, begin, run
from workers.continuation.cycles import Cycle, cycle_near
from workers.continuation.itinerary import Itinerary, Orbit
from workers.continuation.recording import ASKED, halved, turned_orbit
from workers.kernel.cells import physical_states
from workers.kernel.hybrid.notes import LEG, LEG_STATE
from workers.kernel.motion import RUNNING, STATUS, STUCK, WORK, WORK_OF_A_TRIAL
from workers.model.clock import set_period
from workers.model.family import NoOscillatorError, OrbitMachines, with_modes
from workers.model.oscillator import Array, Mask, Oscillator, Rows, at_rows
from workers.orbit.passed import legs_of_periods, passed_by
from workers.results import (
    APERIODIC,
    CENTRE,
    CHAOTIC,
    NO_REASON,
    PER_TIME,
    QUASIPERIODIC,
    REGIME,
    UNDETERMINED,
    Variable,
)

LEAST_LOOK = 64
"""Least natural periods over which a motion is examined: as long as all before, or until it closes."""

NEAR = 1e-3
"""Largest distance of a return, relative to the motion, that may be the return of a cycle."""

STABLE = 1e-12
"""-ln|mu| above which a multiplier mu is certainly inside the unit circle: its rounding is less."""

BRUSH = 1e-7
"""Largest share of rest in a cycle that is a touch, made longer by rounding: inside of it motions swing for ever."""

STEADY, LEAST_TORUS = 15.0, 3000
"""Largest logarithm of the shrinkage of a torus's second tangent vector, over at least this many natural periods of
averaging."""


class Trail(NamedTuple):
    """The last E events of one motion.

    Their legs (E, columns), see notes.LegRecord; their keys (E,): events have one key if signal, side and next mode
    are the same; the states (E, 2n) after them, over the range of each component.
    """

    legs: Array
    keys: NDArray[np.int64]
    states: Array

    @property
    def after(self) -> tuple[Array, NDArray[np.int64]]:
        """Physical states (E, 2n) after the events, and the numbers (E,) of the modes from there on."""
        size = self.states.shape[1]
        return self.legs[:, LEG_STATE : LEG_STATE + size], self.legs[:, LEG.number].astype(np.int64)

    def back(self, last: int, first: int) -> float:
        """The distance of the states after two events."""
        return float(np.max(np.abs(self.states[last] - self.states[first])))


def trail_of(legs: Array, size: int) -> Trail:
    """The trail of legs in order of time."""
    events = legs[legs[:, LEG.signal] >= 0.0]
    columns = events[:, [LEG.signal, LEG.side, LEG.number]].astype(np.int64)
    _, keys = np.unique(columns, axis=0, return_inverse=True)
    states = events[:, LEG_STATE : LEG_STATE + size]
    ranges = np.ptp(legs[:, LEG_STATE : LEG_STATE + size].reshape(-1, 2, size // 2), axis=0).max(axis=1, initial=0.0)
    ranges = np.repeat(np.where(ranges > 0.0, ranges, 1.0), size // 2)
    return Trail(events, keys.reshape(-1).astype(np.int64), states / ranges)


def course_of(cells: Cells, is_known: Property = none_of, leaves: Property = none_of) -> Course:
    """The adaptive schedule of cells, see Course."""
    return (CycleCourse if cells.unforced else Course)(cells, is_known, leaves)


class CycleCourse(Course):
    """The adaptive schedule for machines without a force."""

    def end_on_orbits(self, rows: Rows, budget: Rows, near: Array) -> Rows:
        """Write the results of cells that fall into a cycle or an equilibrium; returns the others that are not known.

        An equilibrium is an orbit of the map over a natural period, without events.
        """
        known = self.is_known(rows)
        self.cells.going[rows[known]] = False
        rows, cycles, still = rows[~known], dict[int, tuple[Cycle, Array]](), list[int]()
        for r in rows.tolist():
            cycle, quiet = self._look(r)
            if cycle is not None:
                cycles[r] = cycle
            elif quiet:
                still.append(r)
        rest = end_on_orbits(self.cells, np.array(still, dtype=np.int64), budget, near)
        put_centres(self.cells, np.array([r for r in rest.tolist() if self._repeats(r)], dtype=np.int64))
        put_cycles(self.cells, cycles)
        return rows[self.cells.going[rows]]

    def _repeats(self, r: int) -> bool:
        """Whether the sections of one motion without events are one state over all of its stretch."""
        kept = self.cells.batch.sections[r, -int(self.cells.kept()[r]) :]
        return len(kept) > 1 and float(np.ptp(kept, axis=0).max()) <= ONCE_ROUND * float(np.abs(kept).max())

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
        for trail in self.trails(r):
            if np.sum(trail.keys == trail.keys[-1:]) > RETURNS:
                break
        if trail is None or np.sum(trail.keys == trail.keys[-1:]) <= RETURNS:
            return False
        last = len(trail.keys) - 1
        same = np.flatnonzero(trail.keys[:-1] == trail.keys[-1])[-RETURNS:]
        return min(trail.back(last, int(k)) for k in same) > TORUS_RETURN

    def trails(self, r: int) -> Iterator[Trail]:
        """Trails of one motion from its present state, each a natural period longer, until it cannot be followed."""
        cells, one = self.cells, np.array([r])
        machine, size = at_rows(cells.oscillators, one), cells.directions
        state = physical_states(cells.oscillators, cells.batch.motions, one)[0]
        number = int(cells.batch.motions.mode[r, 0])
        legs, most, trail = list[Array](), max(LEAST_LOOK, int(cells.flown[r])), None
        try:
            for k, rows in enumerate(legs_of_periods(machine, state, number)):
                cells.used[r] += 1
                legs.append(rows)
                if trail is None or len(trail.keys) or np.any(rows[:, LEG.signal] >= 0.0):
                    trail = trail_of(np.concatenate(legs), size)
                yield trail
                if k + 1 == most:
                    return
        except ValueError:
            return

    def _look(self, r: int) -> tuple[tuple[Cycle, Array] | None, bool]:
        """The cycle into which one motion falls, with the times of its rarest event, if any; and whether it has no
        more events."""
        tried, trail, most = set[int](), None, 4 * self.settings.max_period
        for trail in self.trails(r):
            for m in turns_of(trail):
                if m in tried:
                    continue
                tried.add(m)
                cycle = cycle_of(at_rows(self.cells.oscillators, np.array([r])), trail, m)
                if cycle is not None:
                    return cycle, False
            if len(trail.keys) and np.max(np.bincount(trail.keys)) > most:
                break
        return None, trail is not None and not len(trail.keys)


def turns_of(trail: Trail) -> list[int]:
    """The numbers of events in which a motion has nearly returned, nearer than a turn before.

    At most three, each return ten times nearer than any shorter one.
    """
    turns, last, record = list[int](), len(trail.keys) - 1, NEAR
    for m in range(1, last // 2 + 1):
        away = trail.back(last, last - m)
        if away < record and np.array_equal(trail.keys[last - m + 1 :], trail.keys[last - 2 * m + 1 : last - m + 1]):
            if away <= trail.back(last - m, last - 2 * m) or away < ONCE_ROUND:
                turns.append(m)
            record = 0.1 * away
    return turns[:3]


def cycle_of(machine: Oscillator, trail: Trail, m: int) -> tuple[Cycle, Array] | None:
    """The stable cycle near the last m events of a trail of a single machine, in a record of many; None without one.

    With the times (p,) of its rarest event: the event with the fewest passages, of several the first by signal, side
    and mode. A turn begins there, but not among the hops that end a chatter: they would count as rest.
    """
    rows, keys = trail.legs[-m:].copy(), trail.keys[-m:]
    T = rows[-1, LEG.start] - trail.legs[-1 - m, LEG.start]
    counts = np.bincount(keys)
    rarest = int(np.flatnonzero(counts == counts[counts > 0].min())[0])
    first = min(np.flatnonzero(keys == rarest), key=lambda i: tuple(trail.states[len(trail.keys) - m + i]))
    while np.any(rows[:, LEG.chatter] == 0.0) and rows[first, LEG.chatter] != 0.0:
        first = (first + 1) % m
    before = passed_by(machine, rows[first - 1]).code
    rows, keys = np.roll(rows, -first, axis=0), np.roll(keys, -first)
    rows[:, LEG.start] = np.mod(rows[:, LEG.start] - rows[0, LEG.start], T)
    turn = turned_orbit([passed_by(machine, row) for row in rows], before, 0, T)
    own = with_modes(machine.table.machines._replace(omega=np.array([2.0 * np.pi / T])))
    try:
        half = halved(own, turn, ASKED)
        cycle = cycle_near(own, half) if half is not turn else None
        cycle = cycle or cycle_near(own, turn)
        cycle = cycle and once_round(own, cycle)
    except NoOscillatorError:
        return None
    if cycle is None or not cycle.logs[0] < -STABLE:
        return None
    times = cycle.motion.times[0]
    if cycle.motion.itinerary.symmetric:
        times = np.concatenate([times, times + 0.5 * cycle.period])
    return cycle, times[keys[: len(times)] == rarest]


def once_round(machine: OrbitMachines, cycle: Cycle) -> Cycle | None:
    """One turn of a cycle that may go round several times: a motion may seem to return after two turns first.

    None if Newton's method does not converge to it.
    """
    motion, times = cycle.motion, cycle.motion.times[0]
    itinerary, states, span = motion.itinerary, motion.turn.states[0, 1:], float(motion.span[0])
    for k in range(1, len(times) // 2 + 1):
        turns = len(times) // k
        if len(times) % k or (itinerary.symmetric and turns % 2 == 0) or not itinerary.repeats(k, itinerary.sign):
            continue
        late = np.abs(times[k:] - times[:-k] - span / turns).max()
        away = np.abs(states[k:] - itinerary.sign * states[:-k]).max()
        if late <= ONCE_ROUND * span and away <= ONCE_ROUND * np.abs(states).max():
            one = Itinerary(itinerary.sides[:k], itinerary.periods, itinerary.symmetric, itinerary.legs[:k])
            return cycle_near(machine, Orbit(one, times[:k], motion.orbits.speeds[0, :k], np.array(span / turns)))
    return cycle


def put_centres(cells: Cells, rows: Rows) -> None:
    """Write the results of cells that swing about a centre without damping: none of their motions attracts."""
    if len(rows):
        put_averaged(cells, rows)
        put(cells, rows, regime=UNDETERMINED, error=np.nan, reason=CENTRE)


def put_cycles(cells: Cells, cycles_of: dict[int, tuple[Cycle, Array]]) -> None:
    """Write the results of cells that fall into cycles; ``cycles_of`` gives them by row, with their times."""
    if not cycles_of:
        return
    rows, every = np.array(list(cycles_of), dtype=np.int64), np.arange(len(cycles_of))
    cycles = [cycle for cycle, _ in cycles_of.values()]
    periods = np.array([cycle.period for cycle in cycles])
    natural = cells.oscillators.period[rows].copy()
    set_period(cells.oscillators, rows, periods)
    own, codes = at_rows(cells.oscillators, rows), [cycle.motion.plan.legs[1][0].code for cycle in cycles]
    segments = own.table.machines.segments
    mode = np.array([code.number_of(*segments) for code in codes])
    states = np.stack([cycle.motion.turn.states[0, 1] for cycle in cycles])
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
