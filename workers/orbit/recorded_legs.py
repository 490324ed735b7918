"""The events of a motion over some forcing periods from a given state, as recorded by the kernels of the solver."""

from collections.abc import Iterator
from itertools import count, islice
from typing import NamedTuple

import numpy as np

from workers.kernel.hybrid.leg_record import LEG, LEG_STATE
from workers.kernel.hybrid.motion import through_modes
from workers.kernel.motion import NOTHING_COUNTED, RUNNING, STATUS, WORK, WORK_OF_A_TRIAL
from workers.model.hybrid_modes import ON, OPEN, ModeCode, code_of
from workers.model.mode_table import ContactElements, ModeTable
from workers.model.oscillator import Array, Oscillator, Rows, take_one

RECORD = 512
"""Maximum number of events recorded in one period."""

AT_REST = 1e-10
"""Share of the largest displacement or velocity up to which a state counts as on a stop, or as not sliding."""


class RecordedLeg(NamedTuple):
    """One leg: the motion in one mode, a set of linear equations, and the event that begins it.

    time    time of the event since the start
    signal  number of the signal that reaches an end of its range; -1 if a phase of the machine or the motion begins
    side    end that the signal reaches, -1 or 1; 0 if a phase of the machine or the motion begins
    rate    rate of change of the signal at the event
    code    code of the mode after the event
    begun   (G,) for each signal of the mode, the end of its range at which it starts, 0 for none, see hybrid.events

    A phase is a part of the forcing period in which the machine has constants of its own.
    """

    time: float
    signal: int
    side: int
    rate: float
    code: ModeCode
    begun: tuple[int, ...]


def record_legs(oscillators: Oscillator, state: Array, periods: int) -> list[RecordedLeg]:
    """Return the legs of a motion of one machine with modes: its parts between two events, the first one first.

    oscillators  the machine, in a batch
    state        (2n,) displacements, then velocities, at t = k T
    periods      number of periods

    Raise ValueError if the motion cannot be followed.
    """
    state = np.array(state, dtype=np.float64)
    number = mode_code_of_state(oscillators.table.elements, state).number_of(*oscillators.table.machines.segments)
    rows = islice(legs_of_periods(oscillators, state, number), periods)
    return [leg_from_row(oscillators, row) for row in np.concatenate(list(rows))]


def legs_of_periods(oscillators: Oscillator, state: Array, number: int, tally: Array | None = None) -> Iterator[Array]:
    """Yield the legs of each period, an array (K, columns), of a motion of a single oscillator.

    oscillators  the oscillator, in a batch
    state        (2n,) displacements, then velocities, at the start
    number       number of the mode there, the set of linear equations that holds
    tally        (TALLIES,) counts of a motion; evaluations are subtracted from its remaining work

    A leg, a row of the array, is the motion in one mode until its first event; for the columns see
    leg_record.LegRecord. Times are counted from the first section. Raise ValueError if the motion cannot be followed,
    or no work remains.
    """
    table = take_one(oscillators, 0).table
    for k in count():
        if tally is not None and tally[WORK] < 0.0:
            raise ValueError("the evaluations allowed for this motion are spent")
        rows, state, number, work = _one_period(oscillators, table, state, number)
        if tally is not None:
            tally[WORK] -= work
        rows[:, LEG.start] += k * 2.0 * np.pi / oscillators.table.omega[0]
        yield rows


def leg_from_row(oscillators: Oscillator, row: Array) -> RecordedLeg:
    """Return the record of one leg as a RecordedLeg; ``row`` is a row of the legs of one oscillator in a batch.

    A leg is the motion between two events; for the columns of the row see leg_record.LegRecord.
    """
    machines = oscillators.table.machines
    begun = tuple(map(int, row[LEG_STATE + machines.dimension :]))
    code = code_of(int(row[LEG.number]), *machines.sizes[1:], *machines.segments)
    return RecordedLeg(
        float(row[LEG.start]), int(row[LEG.signal]), int(row[LEG.side]), float(row[LEG.rate]), code, begun
    )


def mode_code_of_state(elements: ContactElements, z: Array) -> ModeCode:
    """Return the code of the mode in which a machine starts at a state z (2n,), displacements and then velocities.

    elements  contacts and frictions of one machine, in a batch

    The mode, the set of equations that holds, is one of the machine's first phase, a part of the forcing period. A
    state that rests or sticks up to rounding counts as resting or sticking.
    """
    n = len(z) // 2
    x, v = z[:n], z[n:]
    far, fast = AT_REST * np.max(np.abs(z)) + 1e-300, AT_REST * np.max(np.abs(v)) + 1e-300
    contacts, slips = [], []
    for c, (row, stops, soft) in enumerate(zip(elements.row[0], elements.stops[0], elements.soft[0], strict=True)):
        y, rate = float(row @ x), float(row @ v)
        side = 1 if y > 0.5 * (max(stops[0], -1e300) + min(stops[1], 1e300)) else -1
        depth = side * (y - stops[1 if side > 0 else 0])
        on = depth > 0.0 if soft else abs(depth) <= far and abs(rate) <= fast
        contacts.append(side * (ON + 2 * _segment(elements.depths[0, c, 1 if side > 0 else 0], depth)) if on else OPEN)
    for e, (row, belt) in enumerate(zip(elements.friction_rows[0], elements.belt[0], strict=True)):
        sliding = float(row @ v) - belt
        slips.append(
            int(np.sign(sliding)) * (1 + _segment(elements.speeds[0, e, int(sliding > 0.0)], abs(sliding)))
            if abs(sliding) > fast
            else 0
        )
    return ModeCode(0, tuple(contacts), tuple(slips))


def _segment(starts: Array, at: float) -> int:
    """Return the index of the segment of a piecewise linear law that has the argument ``at``.

    starts  (S,) arguments at which the segments begin, ascending
    """
    return max(0, int(np.sum(starts < at)) - 1)


def _one_period(
    oscillators: Oscillator, table: ModeTable, state: Array, number: int
) -> tuple[Array, Array, int, float]:
    """Advance a motion of one oscillator by a period, from a state (2n,) in the mode of this number.

    Return the legs of the period, the parts between two events; the state and the mode's number after it; and the
    number of evaluations. A mode is a set of linear equations. Modes missing from the ``table`` are built.
    """
    legs = np.empty((RECORD, LEG_STATE + len(state) + table.pieces.ends.shape[1]))
    W, growth, triangle, hits = np.zeros((0, len(state))), np.zeros(0), np.zeros((0, 0)), np.zeros((0, 3))

    def followed(_: Rows) -> tuple[Array, Rows, Array]:
        z, code, tally = state.copy(), np.array([number]), NOTHING_COUNTED.copy()
        tally[WORK] = WORK_OF_A_TRIAL
        through_modes(table, z, W, code, growth, triangle, tally, hits, legs, 2.0 * np.pi / table.omega)
        return z, code, tally

    z, code, tally = oscillators.with_modes(followed, np.zeros(1, dtype=np.int64))
    known = legs[~np.isnan(legs[:, LEG.start])]
    if len(known) == RECORD:
        raise ValueError(f"events in one period of the motion: found {RECORD} or more, must be fewer")
    if tally[STATUS] != RUNNING:
        raise ValueError("the motion cannot be followed through one period of the force")
    return known, z, int(code[0]), float(WORK_OF_A_TRIAL - tally[WORK])
