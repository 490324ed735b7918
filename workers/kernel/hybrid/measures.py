"""Measures of a motion: means, squares and extremes of outputs, contacts, sticking, and energy losses.

The loop of ``hybrid/motion.py`` records the legs of each period; a leg is the motion between two events. On a leg every
output is a sum of exponentials and harmonics. Integrals of the output and of its square are sums over Gauss points
close enough to be exact to rounding. Extremes are at the ends or at turning points, which the certified search finds.
"""

import math
from typing import NamedTuple

import numpy as np

from workers.kernel.borrow import row_of
from workers.kernel.by_reference import by_reference, row_in
from workers.kernel.flow import flow
from workers.kernel.hybrid.leg_record import LEG, LEG_STATE
from workers.kernel.hybrid.motion import through_modes
from workers.kernel.hybrid.outputs import ACCELERATION, NODES, WEIGHTS, extremes, longest_panel, output_row
from workers.kernel.hybrid.state import (
    enter,
    harmonics_at,
    leave,
    product,
    read_number,
    reset,
    right_hand_side,
    write_harmonics,
)
from workers.kernel.jit import kernel
from workers.kernel.linalg import copy_into
from workers.kernel.motion import NOTHING_COUNTED, OVERDRAFT, RECORDED, RUNNING, STATUS, WORK, spend
from workers.model.hybrid_modes import OPEN, SIGNALS
from workers.model.oscillator import Array

EARLY = 0.3819660112501051
"""Share of a period after a section, by the golden ratio, at which a state is compared with the state half a turn
later. At the section itself orbits may impact, as many closed forms do."""

LEGS = 64
"""Initial room for the legs of one period; it grows fourfold until all legs fit."""

AROUND = 1e-9
"""Share of a period after a section in which an event counts as at the section: once per turn of an orbit."""


class MeasurePlan(NamedTuple):
    """What to measure of N machines with n coordinates, P phases, C contacts and F frictions.

    A phase is a part of the forcing period in which the machine has constants of its own.

    rows               (N, M, n)       weights of each output on the coordinates
    orders             (N, M)          order of the derivative of the displacements on which the weights act
    peaks              (N, M)          1 to measure extremes of the output, else 0
    damping            (N, P, n, n)    damping matrices
    contact_constants  (N, P, C, 3)    stiffness, damping and preload of soft contacts
    friction_constants (N, P, F, 2, 3) kinetic level, static level and slope of frictions
    contact_laws       (N, C, 2, S, 3) segments of the laws of contacts: start, slope and level
    friction_laws      (N, F, 2, S', 3) segments of the laws of frictions: start, slope and level

    The last five fields are those of Machines.
    """

    rows: Array
    orders: Array
    peaks: Array
    damping: Array
    contact_constants: Array
    friction_constants: Array
    contact_laws: Array
    friction_laws: Array


class MeasureTotals(NamedTuple):
    """Measured values of N motions so far.

    first, square (N, M)  integrals of each output and of its square
    low, high     (N, M)  extremes of each output
    hits     (N, C, 2)    number of contacts at the lower and at the upper stop
    endless  (N, C)       1 where contacts cannot be counted
    touching (N, C)       time for which a rigid contact sticks, or a soft one pushes
    stop     (N, C)       energy that the contact has taken
    depth    (N, C)       greatest depth of a soft contact
    force    (N, C)       greatest force of a soft contact
    stuck    (N, F)       time for which the friction sticks
    rubbed   (N, F)       energy that the friction has taken
    damped   (N, 1)       energy that the dampers have taken
    halves   (N, 2, 2n)   states EARLY after the start and half of all periods later, for an odd number of periods
    """

    first: Array
    square: Array
    low: Array
    high: Array
    hits: Array
    endless: Array
    touching: Array
    stop: Array
    depth: Array
    force: Array
    stuck: Array
    rubbed: Array
    damped: Array
    halves: Array


@kernel
def integrate(table, meter, reading, k, phase_index, states, slips, h, phase, s, tally):
    """Add integrals over a flight of duration s in mode k, one set of linear equations, to ``reading`` in place.

    The integrals are those of each output, of its square, and of the powers of dampers and of friction.

    table           ModeTable of the machine
    meter, reading  MeasurePlan and MeasureTotals of the machine
    phase_index     phase of the machine, a part of the forcing period with constants of its own
    states, slips   states of contacts and of friction in the mode
    h (n, 2)        block state at the start, (h, h') of each decoupled equation
    phase           forcing phase at the start
    tally           counts of the motion, changed in place
    """
    pieces, elements = table.pieces, table.elements
    blocks, n = pieces.blocks[k, 0], len(h)
    top = table.omega * pieces.waves.shape[2]
    block_state, nothing, flat = h.copy(), np.empty((0, n, 2)), np.empty((0, 2 * n))
    z, f, turn, since = np.empty(2 * n), np.empty(2 * n), np.empty((pieces.waves.shape[2], 2)), 0.0
    accelerates = np.any(meter.orders == ACCELERATION)
    while since < s and tally[STATUS] == RUNNING:
        step = min(s - since, longest_panel(blocks, top, since))
        spend(tally, len(NODES))
        for g in range(len(NODES)):
            at, weight = since + 0.5 * step * (1.0 + NODES[g]), 0.5 * step * WEIGHTS[g]
            copy_into(block_state, h)
            flow(blocks, at, block_state)
            write_harmonics(phase + table.omega * at, turn)
            leave(pieces, k, block_state, nothing, turn, z, flat)
            if accelerates:
                right_hand_side(pieces, k, z, turn, f)
            for m in range(len(meter.rows)):
                order = int(meter.orders[m])
                y = product(meter.rows[m], f, n) if order == ACCELERATION else product(meter.rows[m], z, order * n)
                reading.first[m] += weight * y
                reading.square[m] += weight * y * y
            for i in range(n):
                for j in range(n):
                    reading.damped[0] += weight * z[n + i] * meter.damping[phase_index, i, j] * z[n + j]
            for c in range(len(states)):
                if states[c] % 2 != 0 and elements.soft[c] > 0.0:
                    reading.stop[c] += (
                        weight * meter.contact_constants[phase_index, c, 1] * product(elements.row[c], z, n) ** 2
                    )
            for e in range(len(slips)):
                if slips[e] != 0:
                    sliding = product(elements.friction_rows[e], z, n) - elements.belt[e]
                    ahead, segment = 1 if slips[e] > 0 else 0, abs(slips[e]) - 1
                    slope = (
                        meter.friction_constants[phase_index, e, ahead, 2] + meter.friction_laws[e, ahead, segment, 1]
                    )
                    reading.rubbed[e] += weight * slope * sliding * sliding
        since += step


@kernel
def read_chatter(modes, meter, reading, before, k, c, elements, states, slips, h, phase, omega, chatter, rate):
    """Correct the measures of the motion between two events if it begins with the last hops of a chatter, in place.

    The measures in ``reading`` are as if the mass had rested on the stop from the start. The hops start at state h (n,
    2) of the decoupled equations and last for ``chatter``. Their time is taken from the sticking times of contact c and
    of friction. While it hops, the mass flies in mode ``before``, with another acceleration than in mode k (a set of
    linear equations). The difference is integrated by Simpson's rule. An extreme lies at the end, or at the rebound
    from the impact at the velocity ``rate``, with which sticking begins.
    """
    n, along = len(h), elements.along
    reading.touching[c] -= chatter
    for e in range(len(slips)):
        if slips[e] == 0 and along[e, c] != 0.0:
            reading.stuck[e] -= chatter
    z, flying, resting = np.empty(2 * n), np.empty(2 * n), np.empty(2 * n)
    for node in range(3):
        since, weight = 0.5 * node * chatter, chatter * (4.0 if node == 1 else 1.0) / 6.0
        flown, at = h.copy(), harmonics_at(phase + omega * since, modes.waves.shape[2])
        flow(modes.blocks[k, 0], since, flown)
        leave(modes, k, flown, np.empty((0, n, 2)), at, z, np.empty((0, 2 * n)))
        right_hand_side(modes, before, z, at, flying)
        right_hand_side(modes, k, z, at, resting)
        for m in range(len(meter.rows)):
            if meter.orders[m] == ACCELERATION:
                flight_value, stuck_value = product(meter.rows[m], flying, n), product(meter.rows[m], resting, n)
                reading.first[m] += weight * (flight_value - stuck_value)
                reading.square[m] += weight * (flight_value * flight_value - stuck_value * stuck_value)
        if node == 0:
            reset(z, n, elements.row[c], elements.kick[c], -elements.R[c] * rate, 1.0)
            right_hand_side(modes, before, z, at, flying)
        for m in range(len(meter.rows)):
            if meter.orders[m] == ACCELERATION and meter.peaks[m] > 0.0:
                flight_value = product(meter.rows[m], flying, n)
                reading.low[m], reading.high[m] = min(reading.low[m], flight_value), max(reading.high[m], flight_value)


@kernel
def read_contact(table, meter, reading, k, phase_index, c, side, state, z, end, h, phase, s, tally):
    """Add the measures of a contact that is not open on a leg, from state z to ``end``, to ``reading`` in place.

    The loss of its damper is not included.

    phase_index     phase of the machine, a part of the forcing period with constants of its own
    c, side, state  the contact, the side of its stop, and its state without that side's sign, see hybrid_modes.ON
    h (n, 2)        state of the decoupled equations at the start
    phase           forcing phase at the start
    s               duration of the leg

    A leg is the motion between two events, in one mode k, a set of linear equations.
    """
    row, stop = table.elements.row[c], table.elements.stops[c, 1 if side > 0 else 0]
    n, pushes = len(row), state % 2 != 0
    if pushes:
        reading.touching[c] += s
    if table.elements.soft[c] == 0.0:
        return
    law, damping = (
        meter.contact_laws[c, 1 if side > 0 else 0, (state - 1) // 2],
        meter.contact_constants[phase_index, c, 1],
    )
    stiffness, preload = (
        meter.contact_constants[phase_index, c, 0] + law[1],
        meter.contact_constants[phase_index, c, 2] + law[2],
    )
    full, direct = np.zeros(2 * n + 1), np.zeros(table.pieces.direct.shape[2:])
    copy_into(full[:n], row)
    low, high = extremes(table.pieces, k, full, direct, h, phase, s, tally)
    reading.depth[c] = max(reading.depth[c], side * ((high if side > 0 else low) - stop))
    if not pushes:
        return
    for i in range(n):
        full[i], full[n + i] = side * stiffness * row[i], side * damping * row[i]
    full[2 * n] = preload - side * stiffness * stop
    reading.force[c] = max(reading.force[c], extremes(table.pieces, k, full, direct, h, phase, s, tally)[1])
    before, after = side * (product(row, z, 0) - stop), side * (product(row, end, 0) - stop)
    reading.stop[c] += (preload + 0.5 * stiffness * (after + before)) * (after - before)


@kernel
def read_impact(elements, reading, c, end, following, counts):
    """Count an impact on contact c, and the energy that the contact takes, in ``reading`` in place.

    end, following  (2n,) states before and after the impact
    counts          False for an impact at the start of an orbit's turn, which counts at the end of the turn
    """
    n = len(end) // 2
    before, after = product(elements.row[c], end, n), product(elements.row[c], following, n)
    reaches_upper = before > 0.0
    if not counts or elements.counted[c] == 0.0:
        return
    if elements.soft[c] > 0.0:
        reading.hits[c, 1 if reaches_upper else 0] += 1.0
        return
    reading.stop[c] += 0.5 * elements.weight[c] * (before * before - after * after)
    if elements.R[c] > 0.0 and abs(after) < 0.5 * elements.R[c] * abs(before):
        reading.endless[c] = 1.0  # the end of a chatter
    else:
        reading.hits[c, 1 if reaches_upper else 0] += 1.0


@kernel
def read_leg(table, meter, reading, before, leg, signal, following, begins, marks, flies, tally):
    """Add what is measured on one leg, the motion in one mode between two events, to ``reading`` in place.

    A mode is a set of linear equations.

    table           ModeTable of the machine
    meter, reading  MeasurePlan and MeasureTotals of the machine
    before          mode of the previous leg
    leg             row of legs, see leg_record.LegRecord
    signal          number of the signal whose event ends the leg, -1 for none
    following (2n,) state at the start of the next leg
    begins          time before which events do not count
    marks     (2,)  times at which to record the states of ``halves``, NaN for none in this period
    flies           whether to measure everything; if false, only contacts are counted
    """
    pieces, elements = table.pieces, table.elements
    n, z = len(following) // 2, leg[LEG_STATE : LEG_STATE + len(following)]
    t, s, k = leg[LEG.start], leg[LEG.duration], int(leg[LEG.mode])
    states = np.zeros(len(elements.row), dtype=np.int64)
    slips = np.zeros(len(elements.friction_rows), dtype=np.int64)
    where = read_number(elements, table.codes[k], states, slips)
    phase, harmonics = table.tau + table.omega * t, pieces.waves.shape[2]
    h, nothing, flat, end = np.empty((n, 2)), np.empty((0, n, 2)), np.empty((0, 2 * n)), np.empty(2 * n)
    enter(pieces, k, z, flat, harmonics_at(phase, harmonics), h, nothing)
    for m in range(2):
        if t <= marks[m] <= t + s:
            block_state = h.copy()
            flow(pieces.blocks[k, 0], marks[m] - t, block_state)
            turn = harmonics_at(table.tau + table.omega * marks[m], harmonics)
            leave(pieces, k, block_state, nothing, turn, reading.halves[m], flat)
    block_state = h.copy()
    flow(pieces.blocks[k, 0], s, block_state)
    leave(pieces, k, block_state, nothing, harmonics_at(phase + table.omega * s, harmonics), end, flat)
    c = signal // SIGNALS
    if signal >= 0 and c < len(states) and signal % SIGNALS == 0 and states[c] == OPEN:
        read_impact(elements, reading, c, end, following, t + s > begins)
    if not flies or s <= 0.0:
        return
    integrate(table, meter, reading, k, where, states, slips, h, phase, s, tally)
    if leg[LEG.chatter] != 0.0:
        at, chatter = int(leg[LEG.signal]) // SIGNALS, min(leg[LEG.chatter], s)
        rate = leg[LEG.rate]
        read_chatter(
            pieces, meter, reading, before, k, at, elements, states, slips, h, phase, table.omega, chatter, rate
        )
    for m in range(len(meter.rows)):
        if meter.peaks[m] > 0.0:
            row, direct = output_row(pieces, k, meter.rows[m], meter.orders[m])
            low, high = extremes(pieces, k, row, direct, h, phase, s, tally)
            reading.low[m], reading.high[m] = min(reading.low[m], low), max(reading.high[m], high)
    for c in range(len(states)):
        if states[c] != OPEN and elements.counted[c] > 0.0:
            side = np.sign(states[c])
            read_contact(table, meter, reading, k, where, c, side, abs(states[c]), z, end, h, phase, s, tally)
    for e in range(len(slips)):
        if slips[e] == 0:
            reading.stuck[e] += s
            continue
        path = (
            product(elements.friction_rows[e], end, 0) - product(elements.friction_rows[e], z, 0) - elements.belt[e] * s
        )
        ahead = 1 if slips[e] > 0 else 0
        reading.rubbed[e] += (
            meter.friction_constants[where, e, ahead, 0] + meter.friction_laws[e, ahead, abs(slips[e]) - 1, 2]
        ) * abs(path)


@kernel
def record_period(table, z, code, tally, duration):
    """Advance a motion by ``duration``, at most a period, and return its state, mode number, legs and contacts.

    table       ModeTable of the machine
    z    (2n,)  displacements, then velocities, at the start; not changed
    code (1,)   number of the mode at the start, the set of linear equations that holds; not changed
    tally       counts of the motion, changed in place

    The legs, one row for each stay in a mode, and the contacts are those of ``through_modes``, with room for all. If a
    mode is not built yet, there are no legs.
    """
    size, room = len(z), LEGS
    flat, line, square = np.empty((0, size)), np.empty(0), np.empty((0, 0))
    columns = LEG_STATE + size + table.pieces.ends.shape[1]
    while True:
        final, number, spent = z.copy(), code.copy(), tally.copy()
        spent[RECORDED] = 0.0
        hits, legs = np.empty((room, 3)), np.empty((room, columns))  # a contact ends a leg
        through_modes(table, final, flat, number, line, square, spent, hits, legs, duration)
        if spent[STATUS] != RUNNING or math.isnan(legs[room - 1, 0]):
            break
        room *= 4
    copy_into(tally, spent)
    count = 0
    while tally[STATUS] == RUNNING and not math.isnan(legs[count, 0]):
        count += 1
    return final, number, legs[:count], hits[: int(tally[RECORDED]) if tally[STATUS] == RUNNING else 0]


@kernel
def read_legs(table, meter, reading, legs, end, begins, marks, flies, tally):
    """Add what is measured on ``legs`` to ``reading`` in place; the last leg ends in the state ``end`` (2n,).

    legs (K, columns) are the parts of a motion between two events, see LegRecord. For the other arguments see
    ``read_leg``.
    """
    before = np.int64(-1)  # typed: a literal would compile the callees once more
    for i in range(len(legs)):
        last = i + 1 == len(legs)
        signal = -1 if last else int(legs[i + 1, LEG.signal])
        following = end if last else legs[i + 1, LEG_STATE : LEG_STATE + len(end)]
        read_leg(table, meter, reading, before, legs[i], signal, following, begins, marks, flies, tally)
        before = np.int64(legs[i, LEG.mode])


@kernel
def read_period(table, meter, reading, z, code, tally, duration, begins, marks, flies):
    """Advance a motion by ``duration``, at most a period, and add what is measured to ``reading``.

    State z (2n,) and the number of its mode in code (1,) change in place; see ``read_leg``. If a mode (a set of linear
    equations) is not built yet, the motion stays unchanged and nothing is added.
    """
    final, number, legs, _ = record_period(table, z, code, tally, duration)
    if tally[STATUS] != RUNNING:
        return
    read_legs(table, meter, reading, legs, final, begins, marks, flies, tally)
    copy_into(z, final)
    code[0] = number[0]


@kernel
def read_motions(oscillators, meters, readings, states, codes, completed, periods, closes, allowance, cells):
    """Advance motions by their remaining periods, add what is measured to ``readings``, and return the status (N,).

    oscillators        batch of machines
    meters, readings   MeasurePlan and MeasureTotals of the machines
    states    (N, 2n)  displacements, then velocities, changed in place
    codes     (N, 1)   numbers of their modes, the sets of linear equations that hold, changed in place
    completed (N,)     number of periods completed, of ``periods`` (N,); changed in place
    closes    (N,)     1 if the periods are one turn of an orbit, where an impact at its ends counts once
    allowance (N,)     number of evaluations allowed, changed in place
    cells              rows to advance, of machines with modes

    If a mode is not built yet, the motion continues at the next call.
    """
    status = np.full(len(states), RUNNING)
    for r in cells:
        table = row_in(by_reference(oscillators), r).table
        meter, reading = row_of(meters, r), row_of(readings, r)
        period, turn = 2.0 * math.pi / table.omega, closes[r] > 0
        tally, marks = NOTHING_COUNTED.copy(), np.empty(2)
        while completed[r] < periods[r] + (1 if turn else 0) and status[r] == RUNNING:
            flies, begins = completed[r] < periods[r], AROUND * period if turn and completed[r] == 0 else -1.0
            marks[0] = EARLY * period if completed[r] == 0 else np.nan
            marks[1] = (EARLY + 0.5) * period if completed[r] == periods[r] // 2 else np.nan
            tally[WORK] = allowance[r] - OVERDRAFT
            duration = period if flies else AROUND * period
            read_period(table, meter, reading, states[r], codes[r], tally, duration, begins, marks, flies)
            allowance[r], status[r] = tally[WORK] + OVERDRAFT, int(tally[STATUS])
            completed[r] += 1 if status[r] == RUNNING else 0
    return status
