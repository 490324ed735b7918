"""A trajectory of a machine with modes: start of a period and of a leg, end of a leg, and the event at its end.

A mode is one set of linear equations, and a leg the motion in one mode between two events.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from workers.kernel.by_reference import by_value, row_in
from workers.kernel.chatter import UNKNOWN, chatter_end, fastest_rate, hop, with_estimate
from workers.kernel.contact import REBOUND, REST
from workers.kernel.crossing import TINY
from workers.kernel.elementary import log
from workers.kernel.external import FLOATS, INTEGERS, external
from workers.kernel.flow import flow, flow_block, flow_vectors
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
from workers.kernel.hybrid.leg_record import write_leg
from workers.kernel.hybrid.neutral import record_slips, remove_held_motion
from workers.kernel.hybrid.state import (
    enter,
    guard_rate,
    leave,
    read_number,
    reset,
    right_hand_side,
    row_product,
    write_harmonics,
)
from workers.kernel.jit import inline_always, inlined, kernel, named_constants
from workers.kernel.linalg import copy_into
from workers.kernel.motion import (
    CONTRACTION,
    ENDLESS_EVENTS,
    LOSS,
    LOST,
    MAX_SPEED,
    MIN_SPEED,
    MODE_MISSING,
    NO_MODE,
    RESONANT_MODE,
    RUNNING,
    SIMULTANEOUS,
    SPREAD,
    STATUS,
    STUCK,
    TABLES,
    TALLIES,
    count_contact,
    record_type,
    write_down_rest,
)
from workers.kernel.tangent import (
    MAX_SPREAD,
    MAX_SPREAD_OF_ONE,
    drop_dependent,
    graded_flow,
    impact_spread,
    orthonormalise,
    spread_rate,
)
from workers.model.hybrid_modes import ON, OPEN, SIGNALS
from workers.model.oscillator import Array

SECTION_WIDTH = 1e-13
"""Share of a period around a section within which an event counts as at the section and passed. Otherwise rounding
would decide, from turn to turn, the mode of an orbit that changes its mode there."""


class TrajectoryTimes(NamedTuple):
    """Real numbers of a trajectory, the columns of ``clock``. A leg is the motion between two events.

    time          time at the start of the leg, since the start of the period
    phase         forcing phase at the start of the leg
    until         end of the current part of the forcing period, see TrajectoryIndices, or of the trajectory
    horizon       longest time in which to seek the leg's first event
    rate          rate of the signal that the leg begins with
    end1 ... end3 last estimates of a chatter's end, see chatter.chatter_end
    chatter       remaining time of hops, if the leg begins at the end of a chatter
    hop           speed of the rebound at the start of the leg in a chatter, else 0
    """

    time: int
    phase: int
    until: int
    horizon: int
    rate: int
    end1: int
    end2: int
    end3: int
    chatter: int
    hop: int


class TrajectoryIndices(NamedTuple):
    """Whole numbers of a trajectory, the columns of ``indices``. A mode is one set of linear equations of motion.

    mode    index of the mode in the table; negative if there is no mode, see events.mode_of
    number  number of the mode
    where   phase of the machine, a part of the forcing period with constants of its own
    hit     signal whose event begins the leg, the motion in one mode, -1 for none
    side    end of the range of that signal
    legs    number of legs so far
    """

    mode: int
    number: int
    where: int
    hit: int
    side: int
    legs: int


CLOCKS, INDICES = len(TrajectoryTimes._fields), len(TrajectoryIndices._fields)
CLOCK, INDEX = (
    TrajectoryTimes(*range(len(TrajectoryTimes._fields))),
    TrajectoryIndices(*range(len(TrajectoryIndices._fields))),
)
named_constants(TrajectoryTimes, TrajectoryIndices)


class HybridTrajectory(NamedTuple):
    """A motion of n coordinates on its way through a period, event by event, with m tangent vectors and G signals.

    A leg is the motion between two events, in one mode, a set of linear equations.

    clock                     times, see TrajectoryTimes
    indices                   whole numbers, see TrajectoryIndices
    h (n, 2), V (m, n, 2)     state of the decoupled equations, and tangent vectors, at the start of the leg
    flow (n, 6)               flow of each equation over the leg, see flow.flow_entries, and (h, h') after it
    z (2n,), W (m, 2n)        physical state and tangent vectors at an event
    turn (H, 2)               harmonics of the force at the event, see state.harmonics_at
    before, after (2n,)       rates of z before and after the event
    slopes (m,)               time by which each vector is early at the event
    states (C,), slips (F,)   states of contacts and of friction
    begun (G,)                start of each signal, see ``events.py``
    growth (m,), triangle     see tangent.orthonormalise; empty for vectors that stay as they are
    tally (TALLIES,)          counts, see motion.Motion
    """

    clock: Array
    indices: NDArray[np.int64]
    h: Array
    V: Array
    flow: Array
    z: Array
    W: Array
    turn: Array
    before: Array
    after: Array
    slopes: Array
    states: NDArray[np.int64]
    slips: NDArray[np.int64]
    begun: NDArray[np.int64]
    growth: Array
    triangle: Array
    tally: Array


TRIPS = record_type(
    HybridTrajectory, 2, INTEGERS[2], 3, 4, 3, 2, 3, 3, 2, 2, 2, INTEGERS[2], INTEGERS[2], INTEGERS[2], 2, 3, 2
)
"""Type of a batch of trajectories in kernels."""


@inline_always
def make_trajectories(table, N, n, m, framed, square):
    """Return a batch of N trajectories for machines like the one of ``table``, see HybridTrajectory.

    n       number of coordinates
    m       number of tangent vectors
    framed  whether the tangent vectors have growth, which is kept when they are made orthonormal
    square  whether the factors of the orthonormalisation are kept too
    """
    C, F, G = table.elements.row.shape[0], table.elements.friction_rows.shape[0], table.pieces.ends.shape[1]
    size, harmonics, r = 2 * n, table.pieces.waves.shape[2], m if square else 0
    return HybridTrajectory(
        np.zeros((N, CLOCKS)), np.zeros((N, INDICES), dtype=np.int64), np.empty((N, n, 2)), np.empty((N, m, n, 2)),
        np.empty((N, n, 6)),
        np.empty((N, size)), np.empty((N, m, size)), np.empty((N, harmonics, 2)),
        np.empty((N, size)), np.empty((N, size)), np.empty((N, m)),
        np.zeros((N, C), dtype=np.int64), np.zeros((N, F), dtype=np.int64), np.zeros((N, G), dtype=np.int64),
        np.zeros((N, m if framed else 0)), np.zeros((N, r, r)), np.zeros((N, TALLIES)),
    )  # fmt: skip


@inline_always
def stop_at(table, tally, k, number):
    """Set the status of a motion, in its counts ``tally``, that cannot continue since there is no next mode.

    k       negative code in place of the mode's index, see events.mode_of
    number  number of the mode; if the mode is not built, its number is written to the table

    A mode is one set of linear equations of motion.
    """
    if k == MISSING:
        tally[STATUS] = MODE_MISSING
        table.missing[0] = number
    else:
        tally[STATUS] = ENDLESS_EVENTS if k == ENDLESS else RESONANT_MODE if k == RESONATES else NO_MODE


@inlined
def fly(modes, k, s, traj, drifts, flown):
    """Advance the state and the tangent vectors of a trajectory by a flight of duration s in mode k, in place.

    ``drifts`` is 1 if a coordinate drifts, else 0. With ``flown``, traj.flow already holds the flow over s. A mode is a
    set of linear equations.

    The frame, the set of tangent vectors, is made orthonormal before the flight if it may have spread far. With lost
    directions, or a triangle, it is made so before every flight. Directions removed by an event are therefore detected
    before the flight turns rounding into directions. Multipliers are then known to rounding.
    """
    blocks, h, V, growth, flows, tally = modes.blocks[k, 0], traj.h, traj.V, traj.growth, traj.flow, traj.tally
    if growth.shape[0] > 0:
        spread, limit = s * spread_rate(blocks), MAX_SPREAD if len(V) > 1 else MAX_SPREAD_OF_ONE
        keeps = traj.triangle.shape[0] == 0 and tally[LOST] == 0.0 and 0.0 < tally[SPREAD] <= limit - spread
        if not keeps:
            lost = tally[LOST] - drifts
            rank = 2 * h.shape[0] - int(lost)
            if lost > 0.0:
                drop_dependent(blocks, V, rank)
            orthonormalise(blocks, V, growth, traj.triangle, rank)
            tally[SPREAD] = 0.0
            if spread > MAX_SPREAD:
                flow(blocks, s, h)
                graded_flow(blocks, s, V, growth, traj.triangle, rank)
                return
        tally[SPREAD] += spread + TINY
    for j in range(h.shape[0]):
        if flown:
            f11, f12, f21, f22 = flows[j, 0], flows[j, 1], flows[j, 2], flows[j, 3]
            h[j, 0], h[j, 1] = flows[j, 4], flows[j, 5]
        else:
            f11, f12, f21, f22 = flow_block(blocks[j], s, h[j])
        flow_vectors(V, j, f11, f12, f21, f22)


@inline_always
def count_rest(elements, states, lost, s, chatter, tally):
    """Add the time at rest in a flight of duration s to the counts ``tally`` of a motion.

    states (C,)  states of the contacts
    lost         number of dimensions that the motion lacks, since coordinates stick
    chatter      first part of the flight, in which the mass still hops; it does not count if nothing else rests
    """
    count = 0.0
    for c in range(len(states)):
        if abs(states[c]) == ON and elements.soft[c] == 0.0:
            count += 1.0
    if count > 0.0:
        tally[MIN_SPEED] = 0.0
    tally[STUCK] += s if lost > 2.0 else max(s - chatter, min(s, TINY))  # sticking counts, however short


@inline_always
def keep_held(elements, states, slips, z):
    """Remove rounding from a state z (2n,), in place, in coordinates that stick on a stop or by friction.

    states (C,), slips (F,)  states of contacts and of friction, see hybrid_modes.ModeCode
    """
    n = len(z) // 2
    for c in range(len(states)):
        if abs(states[c]) == ON and elements.soft[c] == 0.0:
            row, kick, stop = elements.row[c], elements.kick[c], elements.stops[c, 1 if states[c] > 0 else 0]
            reset(z, 0, row, kick, stop, 1.0)
            reset(z, n, row, kick, 0.0, 1.0)
    for e in range(len(slips)):
        if slips[e] == 0:
            reset(z, n, elements.friction_rows[e], elements.friction_kick[e], elements.belt[e], 1.0)


@kernel
def follow(table, traj):
    """Find the mode in which a motion continues after an event, and write its index and number into the trajectory.

    A mode is one set of linear equations between two events. For signals that a jump has left beyond their ranges see
    events.follow_jumps.
    """
    indices = traj.indices
    k, number = follow_jumps(
        table, traj.states, traj.slips, indices[INDEX.where], traj.z, traj.turn, traj.begun
    )  # fmt: skip
    indices[INDEX.mode], indices[INDEX.number] = k, number


@kernel
def begin_trajectory(table, traj, number, turn):
    """Begin a trajectory at the start of a period, in place, in the mode of this number.

    Its physical state and tangent vectors are set already. A mode is one set of linear equations. For ``turn``, of the
    start of the period, see state.harmonics_at.
    """
    clock, indices = traj.clock, traj.indices
    read_number(table.elements, number, traj.states, traj.slips)
    traj.begun[:] = 0
    clock[:] = 0.0
    clock[CLOCK.phase] = table.tau
    copy_into(traj.turn, turn)
    clock[CLOCK.end1], clock[CLOCK.end2], clock[CLOCK.end3] = UNKNOWN
    indices[:] = 0
    indices[INDEX.hit] = -1
    keep_held(table.elements, traj.states, traj.slips, traj.z)
    follow(table, traj)


@inlined
def begin_leg(table, traj, duration):
    """Begin a leg of a trajectory, the motion between two events, and return the longest time to seek the next event.

    ``duration`` is that of the whole trajectory. If the trajectory cannot continue, set tally[STATUS] and return 0.
    """
    clock, indices, tally = traj.clock, traj.indices, traj.tally
    k, t, period = indices[INDEX.mode], clock[CLOCK.time], 2.0 * math.pi / table.omega
    if k < 0:
        stop_at(table, tally, k, indices[INDEX.number])
    if tally[STATUS] != RUNNING:
        return 0.0
    lost = table.pieces.lost[k]
    tally[LOST] = max(tally[LOST], lost + table.drifts)
    until = min(duration, period, table.elements.starts[indices[INDEX.where] + 1] * period)
    clock[CLOCK.until] = until
    enter(table.pieces, k, traj.z, traj.W, traj.turn, traj.h, traj.V)
    if t == 0.0 and lost > 0.0:
        remove_held_motion(table.elements, traj.states, lost, traj.V)
    record_slips(traj.slips, tally)
    return until - t + (SECTION_WIDTH * period if until >= min(duration, period) else 0.0)


@kernel
def end_hop(table, traj, end, s):
    """Return the duration of a hop in a chatter and the speed at its end, more exactly than the certified search.

    end  side of the stop
    s    duration that the search has found

    See chatter.hop.
    """
    clock, pieces, k, g = traj.clock, table.pieces, traj.indices[INDEX.mode], traj.indices[INDEX.hit]
    blocks, waves = pieces.blocks[k, g], pieces.waves[k, g]
    fastest = fastest_rate(blocks, waves, table.omega)
    return hop(blocks, waves, table.omega, traj.h, clock[CLOCK.phase], end, clock[CLOCK.hop], s, fastest)


@kernel
def record_leg(traj, legs, s):
    """Record a leg, the motion between two events, in the next row of ``legs``; s is its duration.

    For the row see leg_record.write_leg.
    """
    clock, indices = traj.clock, traj.indices
    write_leg(
        legs[indices[INDEX.legs]], clock[CLOCK.time], indices[INDEX.hit], indices[INDEX.side], clock[CLOCK.rate],
        indices[INDEX.number], indices[INDEX.mode], s, clock[CLOCK.chatter], traj.z, traj.begun,
    )  # fmt: skip
    indices[INDEX.legs] += 1


@inlined
def leave_leg(table, traj, s, reached, end, duration, legs, flown):
    """Advance a trajectory by the duration s of its leg, to just before the event at the leg's end.

    A leg is the motion between two events. Return True if the trajectory is over.

    reached  signal that has reached an end of its range, -1 for none
    end      the end of its range
    legs     records of legs, see motion.through_modes
    duration duration of the whole trajectory
    flown    whether traj.flow is the flow over s

    The event itself follows, see ``strike_soft`` and ``strike_hard``.
    """
    clock, indices, tally, pieces, h = traj.clock, traj.indices, traj.tally, table.pieces, traj.h
    k, t, until, w = indices[INDEX.mode], clock[CLOCK.time], clock[CLOCK.until], clock[CLOCK.hop]
    last = until >= min(duration, 2.0 * math.pi / table.omega)
    searched, again, speed = s, w > 0.0 and reached == indices[INDEX.hit] and end == indices[INDEX.side], 0.0
    if again:
        s, speed = end_hop(table, traj, end, s)
    else:
        clock[CLOCK.end1], clock[CLOCK.end2], clock[CLOCK.end3] = UNKNOWN
    s = min(s, until - t)
    if indices[INDEX.legs] < legs.shape[0]:
        record_leg(traj, legs, s)
    fly(pieces, k, s, traj, table.drifts, flown and s == searched)
    tally[CONTRACTION] -= pieces.trace[k] * s
    if pieces.lost[k] > 0.0:
        count_rest(table.elements, traj.states, pieces.lost[k], s, clock[CLOCK.chatter], tally)
    if s > 0.0:
        traj.begun[:] = 0
    t = until if reached < 0 else min(t + s, until)
    phase = table.tau + table.omega * t
    clock[CLOCK.time], clock[CLOCK.phase], clock[CLOCK.chatter] = t, phase, 0.0
    indices[INDEX.hit], indices[INDEX.side] = reached, end
    write_harmonics(phase, traj.turn)
    leave(pieces, k, h, traj.V, traj.turn, traj.z, traj.W)
    if reached < 0:
        clock[CLOCK.rate], clock[CLOCK.hop] = 0.0, 0.0
        return last
    right_hand_side(pieces, k, traj.z, traj.turn, traj.before)
    rate = speed if speed > 0.0 else end * guard_rate(pieces, k, reached, traj.before, table.omega, traj.turn)
    rate = end * max(rate, TINY)
    clock[CLOCK.rate] = rate
    row = pieces.rows[k, reached]
    for e in range(len(traj.W)):
        traj.slopes[e] = row_product(row, traj.W[e]) / rate
    return False


@inlined
def is_soft(table, reached):
    """Return True if a signal at an end of its range, ``reached``, belongs to a soft contact of the machine."""
    c = reached // SIGNALS
    return c < len(table.elements.soft) and table.elements.soft[c] > 0.0


@inlined
def strike_soft(table, traj, contacts):
    """Carry a trajectory through the event of a soft contact that it has reached, and count a contact that begins.

    ``contacts`` (K, 3) are records of contacts, see motion.through_modes. See also events.soft_event.
    """
    clock, indices = traj.clock, traj.indices
    g, side = indices[INDEX.hit], indices[INDEX.side]
    c = g // SIGNALS
    if traj.states[c] == OPEN and table.elements.counted[c] > 0.0:
        count_contact(traj.tally, contacts, clock[CLOCK.time], side * (1.0 + c), abs(clock[CLOCK.rate]))
    soft_event(g, c, side, traj.states, traj.begun)
    clock[CLOCK.hop] = 0.0


@inline_always
def strike_hard(table, traj, contacts):
    """Carry a trajectory through the event of friction or of a rigid contact that it has reached.

    Return True if the next mode, the set of linear equations that holds next, is still to be found. ``contacts`` (K, 3)
    are records of contacts, see motion.through_modes.
    """
    elements, clock, indices = table.elements, traj.clock, traj.indices
    g, side, C = indices[INDEX.hit], indices[INDEX.side], len(traj.states)
    c = g // SIGNALS
    if c >= C:
        clock[CLOCK.hop] = 0.0
        k, number = friction_event(
            table, g, g - SIGNALS * C, side, traj.states, traj.slips, indices[INDEX.where], traj.z, traj.before, traj.W,
            traj.turn, traj.begun,
        )  # fmt: skip
        if k < 0:
            indices[INDEX.mode], indices[INDEX.number] = k, number
            return False
    elif strikes_while_held(elements, c, traj.states):
        traj.tally[STATUS] = SIMULTANEOUS
        return False
    elif traj.states[c] != OPEN:
        release(elements, g, c, indices[INDEX.where], traj.states, traj.slips, traj.begun, np.int64(3))
        clock[CLOCK.hop] = 0.0
    else:
        strike_stop(table, traj, g, c, side, contacts)
    return True


@inline_always
def strike_stop(table, traj, g, c, side, contacts):
    """Carry a trajectory through an impact on rigid contact c, count it, and estimate the rest of a chatter.

    g, side   number of the signal that has reached a stop, and the side of the stop
    contacts  records of impacts, see motion.through_modes
    """
    clock, tally, t, rate = traj.clock, traj.tally, traj.clock[CLOCK.time], traj.clock[CLOCK.rate]
    R, energy = table.elements.R[c], table.elements.weight[c] * rate * rate
    following, remaining = impact(
        table, traj.indices[INDEX.mode], g, c, side, rate, traj.h, traj.states, traj.slips, traj.indices[INDEX.where],
        traj.z, traj.before, traj.W, clock[CLOCK.phase], traj.turn, traj.begun,
    )  # fmt: skip
    clock[CLOCK.hop] = 0.0
    ends = with_estimate((clock[CLOCK.end1], clock[CLOCK.end2], clock[CLOCK.end3]), t + remaining)
    clock[CLOCK.end1], clock[CLOCK.end2], clock[CLOCK.end3] = ends
    if following != REBOUND:
        tally[LOST] = max(tally[LOST], 1.0 + table.drifts)
    if following == REST:  # the impacts at the end of a chatter cannot be counted
        tally[MAX_SPEED] = max(tally[MAX_SPEED], abs(rate))
        tally[LOSS] += energy
        clock[CLOCK.chatter] = chatter_end(ends, remaining, R) - t if R > 0.0 else 0.0
        write_down_rest(tally, contacts, t, side * (1.0 + c), abs(rate), clock[CLOCK.chatter])
        return
    count_contact(tally, contacts, t, side * (1.0 + c), abs(rate))
    tally[LOSS] += (1.0 - R * R) * energy
    tally[CONTRACTION] += 2.0 * log(max(R, TINY))
    clock[CLOCK.hop] = R * abs(rate) if remaining > 0.0 else 0.0


@kernel
def carry(table, traj, mode):
    """Carry the tangent vectors of a trajectory through the event that it has just passed, by the saltation matrix.

    ``mode`` is the index of the mode (set of linear equations) before the event. The change of volume is added to the
    counts.
    """
    indices, pieces = traj.indices, table.pieces
    f, after, k, g = traj.before, traj.after, indices[INDEX.mode], indices[INDEX.hit]
    soft = is_soft(table, g)
    if k < 0 or (len(traj.W) == 0 and soft and g % SIGNALS == 0):  # a soft contact reached changes no volume
        return
    right_hand_side(pieces, k, traj.z, traj.turn, after)
    for i in range(len(after)):
        after[i] -= f[i]
        for e in range(len(traj.W)):
            traj.W[e, i] += after[i] * traj.slopes[e]
    if g >= SIGNALS * len(traj.states) or soft:  # det S = 1 + r.(f+ - f-) / r'
        change = row_product(pieces.rows[mode, g], after) / traj.clock[CLOCK.rate]
        if change != 0.0:
            traj.tally[CONTRACTION] += log(max(abs(1.0 + change), TINY))
    if traj.tally[SPREAD] > 0.0:
        sees = g < SIGNALS * len(traj.states) and g % SIGNALS == 0
        traj.tally[SPREAD] = traj.tally[SPREAD] + event_spread(table, traj, mode) if sees else 0.0


@inlined
def event_spread(table, traj, mode):
    """Return the largest stretch of some tangent vectors relative to others by a contact's event, as a logarithm.

    The event is a soft contact's or an impact that the motion has just passed from the mode (set of linear equations)
    of this index. See tangent.impact_spread; the energy norms of both modes are changed into each other by way of the
    norm of (omega x, v).
    """
    elements, pieces, jump, g = table.elements, table.pieces, traj.after, traj.indices[INDEX.hit]
    row, c, n, push, seen = pieces.rows[mode, g], g // SIGNALS, len(jump) // 2, 0.0, 0.0
    for i in range(n):
        push, seen = push + jump[n + i] * jump[n + i], seen + row[i] * row[i]
    R = 1.0 if elements.soft[c] > 0.0 else max(elements.R[c], TINY)
    ratio = math.sqrt(push * seen) / (R * abs(traj.clock[CLOCK.rate]))
    skews = pieces.skew[mode] + pieces.skew[traj.indices[INDEX.mode]]
    return impact_spread(ratio, 1.0 / table.omega, elements.turned[c] + skews)


@external(
    TABLES, types.int64, TRIPS, types.int64, types.float64, types.int64, types.int64, types.float64, FLOATS[2],
    FLOATS[2], types.boolean, result=types.boolean, modes=True,
)  # fmt: skip
def finish_leg(tables, r, trajs, slot, s, reached, end, duration, contacts, legs, flown):
    """Advance machine r by the time s to the end of its leg, through the event there, if any, and to the next mode.

    A leg is the motion in one mode, a set of linear equations, between two events.

    slot            row of the trajectory in ``trajs``, a batch of trajectories
    reached, end    signal that has reached an end of its range, -1 for none, and that end
    contacts, legs  records, see motion.through_modes
    flown           whether the trajectory's flow is the flow over s

    Return True if the trajectory is over.
    """
    table, trip, contacts, legs = row_in(tables, r), row_in(trajs, slot), by_value(contacts), by_value(legs)
    mode, follows = trip.indices[INDEX.mode], True
    over = leave_leg(table, trip, s, reached, end, duration, legs, flown)
    if reached < 0:
        follows = not over
        trip.indices[INDEX.where] += int(follows)
    elif is_soft(table, reached):
        strike_soft(table, trip, contacts)
    else:
        follows = strike_hard(table, trip, contacts)
    if follows:
        follow(table, trip)
    if reached >= 0 and trip.tally[STATUS] == RUNNING:
        carry(table, trip, mode)
    return over
