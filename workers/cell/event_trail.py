"""Events of one motion, in order: whether and where the motion of a machine without a force returns.

Events of several signals at one time count as one event, since rounding decides their order.
"""

from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.cell.cell_batch import CellBatch
from workers.continuation.itinerary import Orbit
from workers.continuation.orbit_from_motion import orbit_from_turn
from workers.kernel.cell_loops import physical_states
from workers.kernel.hybrid.leg_record import LEG, LEG_STATE
from workers.model.family import OrbitMachines, with_modes
from workers.model.oscillator import Array, Oscillator, at_rows
from workers.orbit.recorded_legs import leg_from_row, legs_of_periods

MIN_EXAMINED_PERIODS = 64
"""Minimum number of natural periods over which a motion is examined event by event; it is examined for as long as it
has been simulated before, or until it closes."""

SPARSER = 0.25
"""Share of all periods so far after which the events are examined again, beyond MIN_EXAMINED_PERIODS periods. All
examinations together cost a few times the last one."""

AT_ONE_TIME = 1e-9
"""Share of a natural period within which events of different signals count as one: rounding decides their order."""


class EventTrail(NamedTuple):
    """The last G events of one motion; events of several signals at one time are one event.

    legs    (E, columns) the motion from each event of a signal to the next one, see leg_record.LegRecord
    first   (G,) index of the first leg of each event
    keys    (G,) key of each event: equal if signals, sides and the mode (linear equations) that follows are equal
    states  (G, 2n) states after the events, as shares of the range of each component

    A signal is a number computed from the state; it reaches an end of its range at its events.
    """

    legs: Array
    first: NDArray[np.int64]
    keys: NDArray[np.int64]
    states: Array

    @property
    def states_after(self) -> tuple[Array, NDArray[np.int64]]:
        """Physical states (E, 2n) just after the events, and the numbers (E,) of the modes that begin there.

        A mode is a set of linear equations of motion between two events.
        """
        size = self.states.shape[1]
        return self.legs[:, LEG_STATE : LEG_STATE + size], self.legs[:, LEG.number].astype(np.int64)

    def until(self, count: int) -> "EventTrail":
        """Return the first ``count`` events of the trail."""
        end = np.append(self.first, len(self.legs))[count]
        return EventTrail(self.legs[:end], self.first[:count], self.keys[:count], self.states[:count])

    def distance_between(self, last: int, first: int) -> float:
        """Return the distance of the states after the events with indices ``last`` and ``first``.

        It is the largest difference of a component, as a share of the range of that component.
        """
        return float(np.max(np.abs(self.states[last] - self.states[first])))


def trail_of(legs: Array, size: int, period: float) -> EventTrail:
    """Return the events of a motion, in order of time, from its legs (E, columns).

    legs    parts of the motion, each from one event to the next, see leg_record.LegRecord
    size    number of components of a state
    period  natural period
    """
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
    return EventTrail(events, first, keys, events[last, LEG_STATE : LEG_STATE + size] / ranges)


def _first_at_one_time(events: Array, period: float) -> NDArray[np.int64]:
    """Return the indices of ``events`` that come alone, or first of several that occur at one time.

    Events of the same signal, a number computed from the state, never count as one. ``period`` is the natural period.
    """
    later = np.diff(events[:, LEG.start], prepend=-np.inf) > AT_ONE_TIME * period
    for k in np.flatnonzero(~later).tolist():
        begin = k - 1
        while not later[begin]:
            begin -= 1
        later[k] = events[k, LEG.signal] in events[begin:k, LEG.signal]  # a signal occurs only once in an event
    return np.flatnonzero(later)


def trails(cells: CellBatch, r: int, start: tuple[Array, int] | None = None, limit: int = 0) -> Iterator[EventTrail]:
    """Yield the events of one motion as trails, ever longer, until it cannot be followed or costs too much.

    cells  the cells
    r      row of the motion
    start  physical state, and number of the mode (the linear equations) that holds there; None for the present state
    limit  maximum number of periods; 0 for as many as the motion has flown

    The motion costs too much if its allowed evaluations are spent. There is a trail for each number of periods up to
    MIN_EXAMINED_PERIODS, and for ever fewer beyond.
    """
    one = np.array([r])
    machine, size, motions = at_rows(cells.oscillators, one), cells.directions, cells.batch.motions
    state, number = start or (physical_states(cells.oscillators, motions, one)[0], int(motions.mode[r, 0]))
    legs, trail, period = list[Array](), None, float(cells.oscillators.period[r])
    limit, following = limit or max(MIN_EXAMINED_PERIODS, int(cells.periods_flown[r])), 1
    with suppress(ValueError):
        for k, rows in enumerate(legs_of_periods(machine, state, number, motions.tally[r]), 1):
            cells.periods_used[r] += 1
            legs.append(rows)
            if k < min(following, limit):
                continue
            following = k + max(1, int(SPARSER * k) if k >= MIN_EXAMINED_PERIODS else 1)
            legs = [np.concatenate(legs)]
            if trail is None or np.any(legs[0][:, LEG.signal] >= 0.0):
                trail = trail_of(legs[0], size, period)
            yield trail
            if k >= limit:
                return


def turn_from(
    machine: Oscillator, trail: EventTrail, m: int, first: int
) -> tuple[OrbitMachines, Orbit, NDArray[np.int64]]:
    """Return (machine, orbit, keys): the last m events of a motion as one turn that begins with event ``first``.

    machine  the machine, as the only row of a batch
    trail    the events of the motion
    m        number of events of the turn
    first    index of the event, among the last m

    The machine of the result has the length of the turn as its period. There is a key for each event, equal for events
    of the same kind. Of several events at one time the first has the key, the others have -1.
    """
    starts = np.append(trail.first, len(trail.legs))[len(trail.keys) - m :]
    rows = trail.legs[starts[0] :].copy()
    keys = np.full(len(rows), -1)
    keys[starts[:-1] - starts[0]] = trail.keys[-m:]
    T = trail.legs[trail.first[-1], LEG.start] - trail.legs[trail.first[-1 - m], LEG.start]
    begin = int(starts[first] - starts[0])
    before = leg_from_row(machine, rows[begin - 1]).code
    rows, keys = np.roll(rows, -begin, axis=0), np.roll(keys, -begin)
    rows[-begin or len(rows) :, LEG.start] += T
    rows[:, LEG.start] -= rows[0, LEG.start]
    turn_machine = with_modes(machine.table.machines._replace(omega=np.array([2.0 * np.pi / T])))
    return turn_machine, orbit_from_turn([leg_from_row(machine, row) for row in rows], before, 0, float(T)), keys


def passages(cells: CellBatch, r: int, count: int) -> Array:
    """Return the states (count, 2n) just after the commonest event of a motion, from the state in its results on.

    They are NaN from the event on at which the motion cannot be followed.
    """
    size, states = cells.directions, list[Array]()
    machine, number = at_rows(cells.oscillators, np.array([r])), int(cells.mode[r])
    key = None
    with suppress(ValueError):
        for rows in islice(
            legs_of_periods(machine, cells.results["state"][r], number), MIN_EXAMINED_PERIODS + 4 * count
        ):
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
