"""The one loop of mode, first guard and reset, of hybrid machines."""

import math

import numpy as np

from workers.kernel.chatter import UNKNOWN, chatter_end, fastest_rate, hop, with_estimate
from workers.kernel.contact import REBOUND, REST
from workers.kernel.crossing import TINY, next_crossing
from workers.kernel.elementary import log
from workers.kernel.flow import flow, flow_with_tangent
from workers.kernel.hybrid.events import (
    ENDLESS,
    MISSING,
    RESONATES,
    follow_jumps,
    friction_event,
    impact,
    release,
    soft_event,
    strikes_while_held,
)
from workers.kernel.hybrid.neutral import count_progress, keep_neighbours, note_slips, with_drift
from workers.kernel.hybrid.notes import note
from workers.kernel.hybrid.state import (
    enter,
    guard_rate,
    leave,
    product,
    read_number,
    reset,
    right_hand_side,
    transform,
)
from workers.kernel.jit import inline_always, kernel
from workers.kernel.motion import (
    CONTRACTION,
    ENDLESS_EVENTS,
    LOSS,
    LOST,
    MARCH_GAVE_UP,
    MAX_SPEED,
    MIN_SPEED,
    MODE_MISSING,
    NO_MODE,
    RESONANT_MODE,
    RUNNING,
    SIMULTANEOUS,
    STATUS,
    STUCK,
    count_contact,
    spend,
    write_down_rest,
)
from workers.kernel.tangent import MAX_SPREAD, drop_dependent, graded_flow, orthonormalise, spread_rate
from workers.model.hybrid import FIRST_NUMBER
from workers.model.hybrid_modes import ON, OPEN, SIGNALS
from workers.model.oscillator import HEAD, Mode

AT_SECTION = 1e-13
"""Share of a period after a section within which an event counts as at the section, and past there: rounding would
decide, from turn to turn, in which mode an orbit is where it changes its mode."""


@inline_always
def stop_at(table, tally, k, number):
    """Write why a motion cannot go on into a mode that is none, see events.mode_of."""
    if k == MISSING:
        tally[STATUS] = MODE_MISSING
        table.missing[0] = number
    else:
        tally[STATUS] = ENDLESS_EVENTS if k == ENDLESS else RESONANT_MODE if k == RESONATES else NO_MODE


@kernel
def first_event(pieces, k, h, phase, begun, H, scratch, tally):
    """(time, signal, side) of the first guard that is reached in [0, H]; signal -1 where none is."""
    s, hit, side = H, -1, 0
    for g in range(pieces.ends.shape[1]):
        low, high = pieces.ends[k, g, 0], pieces.ends[k, g, 1]
        if low == -np.inf and high == np.inf:
            continue
        mode = Mode(pieces.blocks[k, g], pieces.waves[k, g], pieces.numbers[k, g], pieces.forced[k])
        at, there, evaluations = next_crossing(mode, h, phase, pieces.offset[k, g], high, low, begun[g], s, scratch)
        spend(tally, evaluations)
        if there == 2:
            tally[STATUS] = MARCH_GAVE_UP
        if abs(there) == 1 and (at < s or hit < 0):
            s, hit, side = at, g, there
    return s, hit, side


@inline_always
def fly(pieces, k, s, h, V, growth, triangle, lost):
    """Move the block state and the tangent vectors on by s in mode k, of which ``lost`` directions are no more.

    A frame is orthonormal before it flies: what an event has taken of it is seen before the flight turns rounding into
    directions.
    """
    blocks, rank = pieces.blocks[k, 0], 2 * h.shape[0] - int(lost)
    framed = growth.shape[0] > 0
    if framed and lost > 0.0:
        drop_dependent(blocks, V, rank)
    if framed:
        orthonormalise(blocks, V, growth, triangle, rank)
    if framed and s * spread_rate(blocks) > MAX_SPREAD:
        flow(blocks, s, h)
        graded_flow(blocks, s, V, growth, triangle, rank)
    else:
        flow_with_tangent(blocks, s, h, V)


@kernel
def pass_contact(table, k, g, c, side, rate, t, ends, h, where, states, slips, z, f, W, phase, begun, tally, hits):
    """Signal g of contact c is at the end of its range: what happens, and what is counted of it.

    How long it still hops where it comes to rest, estimates of when a chatter ends, see chatter.chatter_end, and the
    speed of a rebound in one.
    """
    elements = table.elements
    if elements.soft[c] > 0.0:
        if states[c] == OPEN:
            count_contact(tally, hits, t, side * (1.0 + c), abs(rate))
        soft_event(g, c, side, states, begun)
        return 0.0, UNKNOWN, 0.0
    if states[c] != OPEN:
        release(elements, g, c, where, states, slips, begun, 3)
        return 0.0, UNKNOWN, 0.0
    R, energy = elements.R[c], elements.weight[c] * rate * rate
    following, left = impact(table, k, g, c, side, rate, h, states, slips, where, z, f, W, phase, begun)
    ends = with_estimate(ends, t + left)
    if following != REBOUND:
        tally[LOST] = max(tally[LOST], 1.0 + table.drifts)
    if following == REST:  # at the end of a chatter, whose impacts cannot be counted
        tally[MAX_SPEED] = max(tally[MAX_SPEED], abs(rate))
        tally[LOSS] += energy
        chatter = chatter_end(ends, left, R) - t if R > 0.0 else 0.0
        write_down_rest(tally, hits, t, side * (1.0 + c), abs(rate), chatter)
        return chatter, UNKNOWN, 0.0
    count_contact(tally, hits, t, side * (1.0 + c), abs(rate))
    tally[LOSS] += (1.0 - R * R) * energy
    tally[CONTRACTION] += 2.0 * log(max(R, TINY))
    return 0.0, ends, R * abs(rate) if left > 0.0 else 0.0


@inline_always
def count_rest(elements, states, lost, s, chatter, tally):
    """Count a flight of s in a mode that has lost dimensions as time at rest, but for the end of a chatter in it."""
    held = 0.0
    for c in range(len(states)):
        if abs(states[c]) == ON and elements.soft[c] == 0.0:
            held += 1.0
    if held > 0.0:
        tally[MIN_SPEED] = 0.0
    if lost > 0.0:
        tally[STUCK] += s if lost > 2.0 else max(s - chatter, min(s, TINY))  # a rest counts, however short


@inline_always
def keep_held(elements, states, slips, z):
    """Take off what rounding has moved of what a stop holds or of what sticks."""
    n = len(z) // 2
    for c in range(len(states)):
        if abs(states[c]) == ON and elements.soft[c] == 0.0:
            row, kick, stop = elements.row[c], elements.kick[c], elements.stops[c, 1 if states[c] > 0 else 0]
            reset(z, 0, row, kick, stop, 1.0)
            reset(z, n, row, kick, 0.0, 1.0)
    for e in range(len(slips)):
        if slips[e] == 0:
            reset(z, n, elements.slide[e], elements.brake[e], elements.belt[e], 1.0)


@kernel
def through_modes(table, z, W, code, growth, triangle, tally, hits, legs, duration):
    """Take a physical state z (2n,) and tangent vectors W (m, 2n) from a section on by ``duration`` <= one period.

    All in place:
    code (1,)                   number of their mode
    growth (m,), triangle       see tangent.orthonormalise; of no length where the vectors are not to be orthonormal.
                                Else the first vector is what drifts, if anything does, see neutral.with_drift
    hits (K, 3)                 the first K contacts: time, +-(1 + contact) with the side's sign, speed
    legs (K, LEG_STATE + 2n + G)  the first K legs, see notes.Leg
    Stops early with tally[STATUS] set where it cannot go on.
    """
    pieces, elements = table.pieces, table.elements
    n, m = len(z) // 2, W.shape[0]
    C, F = elements.row.shape[0], elements.slide.shape[0]
    states, slips = np.zeros(C, dtype=np.int64), np.zeros(F, dtype=np.int64)
    begun = np.zeros(pieces.ends.shape[1], dtype=np.int64)
    h, scratch, V = np.empty((n, 2)), np.empty((n, 2)), np.empty((m, n, 2))
    f, after, slopes = np.empty(2 * n), np.empty(2 * n), np.empty(m)
    t, phase, period, seen = 0.0, table.tau, 2.0 * math.pi / table.omega, 0
    legs[:] = np.nan
    read_number(code[0], states, slips)
    where = 0  # a section is where the first phase begins
    keep_held(elements, states, slips, z)
    k, number = follow_jumps(table, states, slips, where, z, phase, begun)
    hit, side, rate, ends, chatter, w = -1, 0, 0.0, UNKNOWN, 0.0, 0.0
    while True:
        if k < 0:
            stop_at(table, tally, k, number)
        if tally[STATUS] != RUNNING:
            return
        tally[LOST] = max(tally[LOST], pieces.lost[k] + table.drifts)
        until = min(duration, period, elements.starts[where + 1] * period)
        enter(pieces, k, z, W, phase, h, V)
        if t == 0.0:
            keep_neighbours(elements, states, pieces.lost[k], V)
        note_slips(slips, tally)
        last = until >= min(duration, period)
        margin = AT_SECTION * period if last else 0.0
        s, reached, end = first_event(pieces, k, h, phase, begun, until - t + margin, scratch, tally)
        if tally[STATUS] != RUNNING:
            return
        again, speed = w > 0.0 and reached == hit and end == side, 0.0
        if again:
            blocks, waves = pieces.blocks[k, hit], pieces.waves[k, hit]
            fastest = fastest_rate(blocks, waves, table.omega)
            s, speed = hop(blocks, waves, table.omega, h, phase, side, w, s, fastest)
        s = min(s, until - t)
        if seen < legs.shape[0]:
            note(legs[seen], t, hit, side, rate, number, k, s, chatter, z, begun)
            seen += 1
        hit, side = reached, end
        fly(pieces, k, s, h, V, growth, triangle, tally[LOST] - table.drifts)
        tally[CONTRACTION] -= pieces.trace[k] * s
        count_rest(elements, states, pieces.lost[k], s, chatter, tally)
        chatter = 0.0
        if s > 0.0:
            begun[:] = 0
        t = until if hit < 0 else min(t + s, until)
        phase = table.tau + table.omega * t
        leave(pieces, k, h, V, phase, z, W)
        if hit < 0 and last:
            code[0] = number
            return
        if hit < 0:
            rate, w = 0.0, 0.0
            where += 1
            k, number = follow_jumps(table, states, slips, where, z, phase, begun)
            continue
        right_hand_side(pieces, k, z, phase, f)
        rate = side * (speed if speed > 0.0 else max(side * guard_rate(pieces, k, hit, f, table.omega, phase), TINY))
        row = pieces.rows[k, hit, : 2 * n]
        for e in range(m):
            slopes[e] = product(row, W[e], 0) / rate
        c = hit // SIGNALS
        if c >= C:
            w = 0.0
            k, number = friction_event(table, hit, hit - SIGNALS * C, side, states, slips, where, z, f, W, phase, begun)
            if k < 0:
                continue
        elif strikes_while_held(elements, c, states):
            tally[STATUS] = SIMULTANEOUS
            return
        else:
            ends = ends if again else UNKNOWN
            chatter, ends, w = pass_contact(
                table, k, hit, c, side, rate, t, ends, h, where, states, slips, z, f, W, phase, begun, tally, hits
            )
        k, number = follow_jumps(table, states, slips, where, z, phase, begun)
        if k < 0:
            continue
        right_hand_side(pieces, k, z, phase, after)
        for i in range(2 * n):
            after[i] -= f[i]
            for e in range(m):
                W[e, i] += after[i] * slopes[e]
        if c >= C or elements.soft[c] > 0.0:  # det S = 1 + r.(f+ - f-) / r'
            tally[CONTRACTION] += log(max(abs(1.0 + product(row, after, 0) / rate), TINY))


@kernel
def propagate_hybrid(osc, motion, duration):
    """period.propagate of a machine with modes. Where a mode is missing the motion stays where it was."""
    size = 2 * motion.h.shape[0]
    h, z, tally = motion.h.copy().reshape((1, size // 2, 2)), np.zeros((1, size)), motion.tally.copy()
    more = 1 if osc.table.drifts > 0.0 and motion.growth.shape[0] > 0 else 0
    V, growth, triangle = with_drift(motion, more)
    W = np.zeros((len(V), size))
    transform(osc.to_physical, h, z)
    transform(osc.to_physical, V, W)
    code = motion.contact - FIRST_NUMBER
    through_modes(osc.table, z[0], W, code, growth, triangle, tally, motion.impacts, np.empty((0, 0)), duration)
    if tally[STATUS] == RUNNING:
        transform(osc.to_blocks, z, h)
        transform(osc.to_blocks, W[more:], motion.V)
        motion.tally[:] = tally
        if osc.table.drifts > 0.0 and duration >= osc.head[HEAD.period]:
            count_progress(motion, h[0], osc.table.omega)
        motion.h[:] = h[0]
        motion.contact[0] = code[0] + FIRST_NUMBER
        motion.growth[:] = growth[more:]
        if motion.triangle.shape[0] > 0:
            motion.triangle[:] = triangle[more:, more:]
    else:
        motion.tally[STATUS] = tally[STATUS]
