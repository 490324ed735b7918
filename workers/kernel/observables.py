"""Observables of motions, value by value: impacts, turning points, states at a fixed forcing phase, and energy losses.

They are for machines with modes, whose law changes by more than one rigid contact. Nothing is sampled. Impacts are
events of the loop of ``hybrid/motion.py``. Turning points of an output are zeros of its rate, which the certified
search finds, or impacts that reverse the output.
"""

import math
from typing import NamedTuple

import numpy as np

from workers.kernel.borrow import row_of
from workers.kernel.by_reference import by_reference, row_in
from workers.kernel.excursion import next_turn, velocity_of
from workers.kernel.hybrid.leg_record import LEG, LEG_STATE
from workers.kernel.hybrid.measures import AROUND, MeasureTotals, read_legs, record_period
from workers.kernel.hybrid.outputs import LEVEL, mode_with, output_row
from workers.kernel.hybrid.state import enter, harmonics_at, product, read_number
from workers.kernel.jit import kernel, named_constants
from workers.kernel.linalg import copy_into
from workers.kernel.motion import MARCH_GAVE_UP, NOTHING_COUNTED, OVERDRAFT, RUNNING, STATUS, WORK, spend
from workers.kernel.signal import derivative_bounds, evaluate
from workers.model.observables import ENERGY_LOSS, IMPACT_PHASE, IMPACT_SPEED, KINDS, MAXIMUM, MINIMUM, SECTION
from workers.model.oscillator import NUMBER, Array, Rows

SECTION_STATE, PHASE, SPEED, HIGHEST, LOWEST, LOSS = (
    KINDS.index(kind) for kind in (SECTION, IMPACT_PHASE, IMPACT_SPEED, MAXIMUM, MINIMUM, ENERGY_LOSS)
)
"""Kinds of observables as numbers."""

LEAST_RISE = 1e-12
"""Share of an output's terms by which the output must rise or fall between two turning points for them to count."""


class ObservableSelection(NamedTuple):
    """The M observables that are wanted of each machine.

    kinds    (M,)  kind of each observable, see SECTION_STATE
    contacts (M,)  contact of each observable, -1 for all contacts
    sides    (M,)  side of the contact's stop, +-1, 0 for both sides
    """

    kinds: Rows
    contacts: Rows
    sides: Rows


class ObservedValues(NamedTuple):
    """Values observed of N motions so far, for M observables.

    values  (N, M, K)  the first K values of each observable, in the order of time
    counts  (N, M)     number of values
    endless (N, M)     1 if a chatter has added infinitely many
    course  (N, M, 5)  recent history of each output, see OutputHistory
    """

    values: Array
    counts: Rows
    endless: Rows
    course: Array


class OutputHistory(NamedTuple):
    """Columns of the recent history of an output, a measured displacement, velocity or acceleration.

    heading  1 while the output rises, -1 while it falls
    value    the last value
    size     the greatest sum of the moduli of its terms plus its possible change on a leg, the unit of its rounding
    turn     kind of the last turning point, which the next one confirms: 1 for a maximum, -1 for a minimum, 0 for none
             or one too early to count
    at       value at the last turning point

    A leg is the motion between two events.
    """

    heading: int
    value: int
    size: int
    turn: int
    at: int


COURSE = OutputHistory(*range(5))
named_constants(OutputHistory)


@kernel
def put(seen, m, value):
    """Count a value of observable m and, if there is room, append it to the values in ``seen``, in place."""
    if seen.counts[m] < seen.values.shape[1]:
        seen.values[m, seen.counts[m]] = value
    seen.counts[m] += 1


@kernel
def put_turn(seen, m, highest):
    """Append the last turning point of an output to the values of observable m in ``seen``, in place.

    It is appended only if it is of the kind wanted, a maximum if ``highest``, else a minimum. Then it is forgotten.
    """
    course = seen.course[m]
    if course[COURSE.turn] == (1.0 if highest else -1.0):
        put(seen, m, course[COURSE.at])
    course[COURSE.turn] = 0.0


@kernel
def head(seen, m, highest, direction, y, counts):
    """Record in ``seen`` that the output of observable m rises or falls from its value y on.

    direction  sign of the change, 0 if the output is constant
    highest    whether maxima are wanted, else minima
    counts     whether the turning point, if there is one here, counts

    If the direction changes, the point is a turning point, and the one before it is confirmed. A turning point of
    rounding size does not count.
    """
    course = seen.course[m]
    if course[COURSE.heading] * direction < 0.0:
        near = abs(y - course[COURSE.at]) <= LEAST_RISE * course[COURSE.size]
        if course[COURSE.turn] * course[COURSE.heading] < 0.0 and near:
            course[COURSE.turn] = 0.0
        else:
            put_turn(seen, m, highest)
            course[COURSE.turn], course[COURSE.at] = course[COURSE.heading] if counts else 0.0, y
    if direction != 0.0:
        course[COURSE.heading] = direction


@kernel
def see_output(modes, k, row, order, seen, m, highest, h, start, phase, s, begins, tally):
    """Record the turning points of the output of observable m in a flight of duration s in mode k, in ``seen``.

    modes, k     table of modes (sets of linear equations), and the index of the mode in it
    row, order   the output, see outputs.output_row
    highest      whether maxima are wanted, else minima
    h (n, 2)     block state at the start, (h, h') of each decoupled equation
    start        time at the start of the flight
    phase        forcing phase at the start
    begins       time up to which turning points do not count
    tally        counts of the motion, changed in place
    """
    full, direct = output_row(modes, k, row, order)
    mode, offset = mode_with(modes, k, full, direct)
    velocity, drift = velocity_of(mode)
    blocks, waves, omega, course = mode.blocks, mode.waves, mode.numbers[NUMBER.omega], seen.course[m]
    y, v, a, jerk, size = evaluate(blocks, waves, omega, h, 0.0, phase, offset)
    before, rate = course[COURSE.value], abs(drift) + derivative_bounds(velocity.blocks, velocity.numbers, h, s)[0]
    reach = min(rate, abs(v) + abs(a) * s) * s  # a load alone has no bound
    course[COURSE.size] = max(course[COURSE.size], size + reach)
    if abs(y - before) > LEAST_RISE * course[COURSE.size]:  # an impact makes velocities jump
        head(seen, m, highest, np.sign(y - before), before, start > begins)
    if rate * s > LEVEL * size:
        block_state, scratch, t, begun = h.copy(), np.empty(h.shape), 0.0, 0
        rises = v > 0.0 or (v == 0.0 and (a > 0.0 or (a == 0.0 and jerk > 0.0)))
        while tally[STATUS] == RUNNING:
            head(seen, m, highest, 1.0 if rises else -1.0, y, start + t > begins)
            at = phase + omega * t
            step, side, evaluations = next_turn(velocity, drift, block_state, at, not rises, begun, s - t, scratch)
            spend(tally, evaluations)
            t += step
            if side == 2:
                tally[STATUS] = MARCH_GAVE_UP
            if side == 0:
                break
            y, rises, begun = (
                evaluate(blocks, waves, omega, block_state, 0.0, phase + omega * t, offset)[0],
                not rises,
                side,
            )
    course[COURSE.value] = evaluate(blocks, waves, omega, h, s, phase, offset)[0]


@kernel
def see_outputs(table, meter, selection, seen, leg, since, begins, flies, tally):
    """Record turning points of outputs on one leg of a motion, and their values at t = k T, in ``seen``.

    table   ModeTable of the machine
    meter   MeasurePlan of the machine, with the outputs
    leg     row of a LegRecord: the motion between two events
    since   time at the start of the period
    begins  time up to which turning points do not count
    flies   whether values at t = k T, the start of the period, count
    tally   counts of the motion, changed in place
    """
    pieces, size, s, k = table.pieces, 2 * meter.rows.shape[1], leg[LEG.duration], int(leg[LEG.mode])
    t, harmonics = leg[LEG.start], table.pieces.waves.shape[2]
    h, nothing, flat = np.empty((size // 2, 2)), np.empty((0, size // 2, 2)), np.empty((0, size))
    phase = table.tau + table.omega * t
    enter(pieces, k, leg[LEG_STATE : LEG_STATE + size], flat, harmonics_at(phase, harmonics), h, nothing)
    for m in range(len(selection.kinds)):
        kind, row, order = selection.kinds[m], meter.rows[m], meter.orders[m]
        if kind == SECTION_STATE and t == 0.0 and flies and leg[LEG.signal] < 0.0:
            full, direct = output_row(pieces, k, row, order)
            mode, offset = mode_with(pieces, k, full, direct)
            put(seen, m, evaluate(mode.blocks, mode.waves, table.omega, h, 0.0, phase, offset)[0])
        if kind in (HIGHEST, LOWEST) and s > 0.0:
            see_output(pieces, k, row, order, seen, m, kind == HIGHEST, h, since + t, phase, s, begins, tally)


@kernel
def see_impact(table, selection, seen, hit, since, begins):
    """Record phase and speed of an impact for the observables that want them, in ``seen``.

    hit     (3,) time, contact and speed, see hybrid.motion.through_modes
    since   time at the start of the period
    begins  time up to which impacts do not count

    Speed 0 marks the start of sticking. If the contact bounces, infinitely many impacts precede it.
    """
    t, which, speed = hit[0], hit[1], hit[2]
    c, side = int(abs(which)) - 1, np.sign(which)
    if since + t <= begins:
        return
    for m in range(len(selection.kinds)):
        kind, contact, meant = selection.kinds[m], selection.contacts[m], selection.sides[m]
        if kind not in (PHASE, SPEED) or (contact >= 0 and contact != c) or meant * side < 0.0:
            continue
        if speed == 0.0:
            seen.endless[m] = max(seen.endless[m], 1 if table.elements.R[c] > 0.0 else 0)
        else:
            put(seen, m, (table.tau + table.omega * t) % (2.0 * math.pi) if kind == PHASE else speed)


@kernel
def stored(table, meter, z, number):
    """Return the energy stored in the soft contacts that push, at a state z (2n,) in the mode of this number.

    A mode is one set of linear equations, for given states of all contacts.
    """
    elements, total = table.elements, 0.0
    states = np.zeros(len(elements.row), dtype=np.int64)
    read_number(elements, number, states, np.zeros(len(elements.friction_rows), dtype=np.int64))
    for c in range(len(states)):
        if states[c] % 2 != 0 and elements.soft[c] > 0.0 and elements.counted[c] > 0.0:
            stop = elements.stops[c, 1 if states[c] > 0 else 0]
            depth = np.sign(states[c]) * (product(elements.row[c], z, 0) - stop)
            total += (meter.contact_constants[0, c, 2] + 0.5 * meter.contact_constants[0, c, 0] * depth) * depth
            law = meter.contact_laws[c, 1 if states[c] > 0 else 0]
            for j in range((abs(states[c]) + 1) // 2):
                end = depth if j == (abs(states[c]) - 1) // 2 else law[j + 1, 0]
                total += (law[j, 2] + 0.5 * law[j, 1] * (end + law[j, 0])) * (end - law[j, 0])
    return total


@kernel
def loss_in(table, meter, legs, end, tally):
    """Return the energy taken by contacts, friction and dampers on the legs of a period.

    table, meter    ModeTable and MeasurePlan of the machine
    legs            (K, columns) legs, the parts of the motion between two events, see LegRecord
    end             (2n,) state at the end of the last leg
    tally           counts of the motion, changed in place
    """
    n, C, F, M = len(end) // 2, meter.contact_constants.shape[1], meter.friction_constants.shape[1], len(meter.orders)
    reading = MeasureTotals(
        np.zeros(M), np.zeros(M), np.zeros(M), np.zeros(M), np.zeros((C, 2)), np.zeros(C), np.zeros(C), np.zeros(C),
        np.zeros(C), np.zeros(C), np.zeros(F), np.zeros(F), np.zeros(1), np.zeros((2, 2 * n)),
    )  # fmt: skip
    read_legs(table, meter, reading, legs, end, -1.0, np.full(2, np.nan), True, tally)
    return np.sum(reading.stop) + np.sum(reading.rubbed) + reading.damped[0]


@kernel
def see_period(table, meter, selection, seen, z, code, tally, since, duration, begins, flies):
    """Advance a motion by ``duration``, at most a period, and record its observables in ``seen``.

    z (2n,)        displacements, then velocities; changed in place
    code (1,)      number of the mode, the set of linear equations that holds; changed in place
    flies          whether values at the start of the period and energy losses count

    For the other arguments see ``see_outputs``. If a mode is not built yet, the motion stays unchanged and nothing is
    recorded.
    """
    final, number, legs, hits = record_period(table, z, code, tally, duration)
    if tally[STATUS] != RUNNING:
        return
    for i in range(len(legs)):
        see_outputs(table, meter, selection, seen, legs[i], since, begins, flies, tally)
    for i in range(len(hits)):
        see_impact(table, selection, seen, hits[i], since, begins)
    if flies and np.any(selection.kinds == LOSS):
        stored_change = stored(table, meter, final, number[0]) - stored(table, meter, z, code[0])
        lost = loss_in(table, meter, legs, final, tally) - stored_change
        for m in range(len(selection.kinds)):
            if selection.kinds[m] == LOSS:
                put(seen, m, lost)
    copy_into(z, final)
    code[0] = number[0]


@kernel
def observe_motions(
    oscillators, meters, selection, seen, starts, states, codes, completed, periods, closes, allowance, cells
):
    """Advance motions by their remaining periods, record observables, and return the status (N,) of each.

    oscillators        batch of machines
    meters             MeasurePlan of the machines
    selection, seen    the observables, and their values, changed in place
    starts             states (N, 2n) and mode numbers (N, 1) from which the counted motion begins
    states    (N, 2n)  displacements, then velocities, changed in place
    codes     (N, 1)   numbers of their modes, changed in place
    completed (N,)     number of periods completed, of ``periods`` (N,); changed in place
    closes    (N,)     1 if the periods are one turn of an orbit, where events at the section count once
    allowance (N,)     number of evaluations allowed, changed in place
    cells              rows to advance, of machines with modes

    A section is an instant of fixed phase of the force, and a mode a set of linear equations that holds between two
    events. A negative ``completed`` is a turn before the one that counts. It shows whether outputs rise or fall where
    they are constant at the section. Then the motion begins again from ``starts``. If a mode is not built yet, the
    motion continues at the next call.
    """
    status = np.full(len(states), RUNNING)
    for r in cells:
        table = row_in(by_reference(oscillators), r).table
        meter, row = row_of(meters, r), row_of(seen, r)
        period, turn, tally = 2.0 * math.pi / table.omega, closes[r] > 0, NOTHING_COUNTED.copy()
        begins = AROUND * period if turn else -1.0
        while completed[r] < periods[r] + (1 if turn else 0) and status[r] == RUNNING:
            flies = completed[r] < periods[r]
            if completed[r] == 0:
                copy_into(states[r], starts[0][r])
                codes[r, 0] = starts[1][r, 0]
                row.course[:, COURSE.value] = np.nan
            tally[WORK] = allowance[r] - OVERDRAFT
            duration, since, counts = (
                period if flies else AROUND * period,
                completed[r] * period,
                flies and completed[r] >= 0,
            )
            see_period(table, meter, selection, row, states[r], codes[r], tally, since, duration, begins, counts)
            allowance[r], status[r] = tally[WORK] + OVERDRAFT, int(tally[STATUS])
            completed[r] += 1 if status[r] == RUNNING else 0
        for m in range(len(selection.kinds)):
            if status[r] == RUNNING and selection.kinds[m] in (HIGHEST, LOWEST):
                put_turn(row, m, selection.kinds[m] == HIGHEST)
    return status
