"""The loop that moves a machine with modes: solve one mode, find its first event, jump there, change the mode.

A mode is one set of linear equations of motion. It ends at an event, where a signal of the state, its guard, reaches an
end of its range. The jump of the state there is called the reset map.
"""

import numpy as np
from numba import types

from workers.kernel.by_reference import as_many, by_reference, by_value, row_in
from workers.kernel.crossing import next_crossing
from workers.kernel.external import FLOATS, external
from workers.kernel.hybrid.neutral import count_progress
from workers.kernel.hybrid.state import harmonics_at, product, product_of_blocks
from workers.kernel.hybrid.trajectory import (
    CLOCK,
    INDEX,
    TRIPS,
    begin_leg,
    begin_trajectory,
    finish_leg,
    make_trajectories,
)
from workers.kernel.jit import kernel
from workers.kernel.linalg import copy_into, identity
from workers.kernel.motion import MARCH_GAVE_UP, MOTION, OSCILLATOR, RUNNING, STATUS, TABLES, spend
from workers.model.oscillator import HEAD, GuardedFlow


@kernel
def first_event(modes, k, h, phase, signal_starts, H, scratch, tally):
    """Return time, signal and side of the first event in [0, H] of a flight in mode k, one set of linear equations.

    An event is a signal at an end of its range: side +1 for the upper end, -1 for the lower. Without an event the
    signal is -1 and the time H.

    h       (n, 2)        block state at the start, (h, h') of each decoupled equation
    phase                 forcing phase at the start
    signal_starts (G,)    start of each signal, see ``events.py``
    scratch (n, 2)        overwritten
    """
    s, hit, side = H, -1, 0
    for g in range(modes.ends.shape[1]):
        low, high = modes.ends[k, g, 0], modes.ends[k, g, 1]
        if low == -np.inf and high == np.inf:
            continue
        mode = by_reference(GuardedFlow(modes.blocks[k, g], modes.waves[k, g], modes.numbers[k, g], modes.forced[k]))
        at, crossed, evaluations = next_crossing(
            mode, h, phase, modes.offset[k, g], high, low, signal_starts[g], s, scratch
        )
        spend(tally, evaluations)
        if crossed == 2:
            tally[STATUS] = MARCH_GAVE_UP
        if abs(crossed) == 1 and (at < s or hit < 0):
            s, hit, side = at, g, crossed
    return s, hit, side


@external(
    TABLES, types.int64, TRIPS, types.int64, FLOATS[2], FLOATS[2], FLOATS[2], types.float64,
    result=types.boolean, modes=True,
)  # fmt: skip
def advance_leg(tables, r, trajs, slot, contacts, legs, scratch, duration):
    """Advance machine r to its next event, the end of its current leg, and through the event.

    trajs, slot  batch of trajectories, and the row of the machine's trajectory

    A leg is the motion between two events. Return True if the trajectory is over. Return False if it continues, or if
    it cannot be followed. For the other arguments see ``through_modes``.
    """
    table, trip = row_in(tables, r), row_in(trajs, slot)
    k, phase, H = trip.indices[INDEX.mode], trip.clock[CLOCK.phase], trip.clock[CLOCK.horizon]
    s, reached, end = first_event(table.pieces, k, trip.h, phase, trip.begun, H, by_value(scratch), trip.tally)
    if trip.tally[STATUS] != RUNNING:
        return False
    return finish_leg(tables, r, trajs, slot, s, reached, end, duration, contacts, legs, np.bool_(False))


@kernel
def through_modes(table, z, W, code, growth, triangle, tally, contacts, legs, duration):
    """Advance a state z (2n,) and tangent vectors W (m, 2n) from a section, t = k T, by ``duration`` <= one period.

    z has displacements, then velocities. A mode is one set of linear equations, and a leg the motion in one mode
    between two events. All of these change in place, besides z and W:

    code (1,)                     number of the mode
    growth (m,), triangle         see tangent.orthonormalise; empty for vectors that stay as they are
    tally (TALLIES,)              counts, see motion.Motion
    contacts (K, 3)               the first K contacts: time, +-(1 + contact) with the side's sign, speed
    legs (K, LEG_STATE + 2n + G)  the first K legs, see leg_record.LegRecord

    With growth, the first vector is the drift direction if a coordinate drifts, see ``load_motion``. The motion stops
    early, with tally[STATUS] set, if it cannot continue.
    """
    trips = make_trajectories(table, 1, len(z) // 2, len(W), len(growth) > 0, len(triangle) > 0)
    take_through(table, trips, z, W, code, growth, triangle, tally, contacts, legs, duration)


@kernel
def take_through(table, trajs, z, W, code, growth, triangle, tally, contacts, legs, duration):
    """Apply ``through_modes``, the advance of a state through its events, with work arrays ``trajs``.

    It is a kernel of its own, since references live as long as the function that created them.
    """
    trajs = by_reference(trajs)
    trip = row_in(trajs, 0)
    copy_into(trip.z, z)
    copy_into(trip.W, W)
    copy_into(trip.growth, growth)
    copy_into(trip.triangle, triangle)
    copy_into(trip.tally, tally)
    code[0] = go_through(as_many(table), trajs, code[0], contacts, legs, duration)
    copy_into(z, trip.z)
    copy_into(W, trip.W)
    copy_into(growth, trip.growth)
    copy_into(triangle, trip.triangle)
    copy_into(tally, trip.tally)


@external(TABLES, TRIPS, types.int64, FLOATS[2], FLOATS[2], types.float64, result=types.int64, modes=True)
def go_through(tables, trajs, number, contacts, legs, duration):
    """Advance the only trajectory of a batch from a section, t = k T, beginning in the mode of this number.

    Return the number of its last mode; a mode is one set of linear equations. For the other arguments see
    ``through_modes``.
    """
    table, trip, contacts, legs = row_in(tables, 0), row_in(trajs, 0), by_value(contacts), by_value(legs)
    tally, scratch = trip.tally, np.empty_like(trip.h)
    legs[:] = np.nan
    begin_trajectory(table, trip, number, harmonics_at(table.tau, len(trip.turn)))
    while True:
        trip.clock[CLOCK.horizon] = begin_leg(table, trip, duration)
        if tally[STATUS] != RUNNING:
            return number
        last = trip.indices[INDEX.number]
        if advance_leg(tables, 0, trajs, 0, contacts, legs, scratch, duration):
            return last


@kernel
def load_motion(to_physical, motion, traj, more):
    """Copy a motion at a section, t = k T, into a trajectory: state, tangent vectors and counts.

    State and vectors become physical, displacements and velocities. ``more`` is 1 if the direction of a drifting
    coordinate precedes all other vectors, with growth 0, else 0. Components along this direction only change the
    position and do not count. As the first vector of the frame it is removed from all others, however short they
    become.
    """
    size, V = len(traj.z), motion.V
    for i in range(size):
        traj.z[i] = product_of_blocks(to_physical[i], motion.h)
        if more > 0:
            traj.W[0, i] = to_physical[i, size - 1]
        for e in range(len(V)):
            traj.W[more + e, i] = product_of_blocks(to_physical[i], V[e])
    if len(traj.growth) > 0:
        traj.growth[0] = 0.0
        for e in range(len(motion.growth)):
            traj.growth[more + e] = motion.growth[e]
    if len(traj.triangle) > 0:
        copy_into(traj.triangle, identity(len(traj.triangle)))
        for e in range(len(motion.triangle)):
            for i in range(len(motion.triangle)):
                traj.triangle[more + e, more + i] = motion.triangle[e, i]
    copy_into(traj.tally, motion.tally)


@kernel
def store_motion(to_blocks, omega, motion, traj, more, resets):
    """Copy the end of a trajectory back into its motion, as states of the decoupled equations; undo ``load_motion``.

    omega   forcing frequency
    resets  True to reset a drifting coordinate to 0
    """
    size, V, h = len(traj.z), motion.V, traj.h
    for i in range(size):
        h[i // 2, i % 2] = product(to_blocks[i], traj.z, 0)
        for e in range(len(V)):
            V[e, i // 2, i % 2] = product(to_blocks[i], traj.W[more + e], 0)
    copy_into(motion.tally, traj.tally)
    if resets:
        count_progress(motion, h, omega)
    for j in range(len(h)):
        motion.h[j, 0], motion.h[j, 1] = h[j, 0], h[j, 1]
    motion.mode[0] = traj.indices[INDEX.number]
    for e in range(len(motion.growth)):
        motion.growth[e] = traj.growth[more + e]
    for e in range(len(motion.triangle)):
        for i in range(len(motion.triangle)):
            motion.triangle[e, i] = traj.triangle[more + e, more + i]


@kernel
def take_on(oscillator, motion, trajs, more, duration):
    """Apply ``through_events``, the advance of a motion, with work arrays ``trajs`` for one trajectory.

    It is a kernel of its own, since references live as long as the function that created them.
    """
    tables, motion, trajs = as_many(oscillator.table), row_in(as_many(motion), 0), by_reference(trajs)
    table, trip = row_in(tables, 0), row_in(trajs, 0)
    load_motion(oscillator.to_physical, motion, trip, more)
    go_through(tables, trajs, motion.mode[0], motion.impacts, np.empty((0, 0)), duration)
    if trip.tally[STATUS] != RUNNING:
        motion.tally[STATUS] = trip.tally[STATUS]
        return
    resets = table.drifts > 0.0 and duration >= oscillator.head[HEAD.period]
    store_motion(oscillator.to_blocks, table.omega, motion, trip, more, resets)


@external(OSCILLATOR, MOTION, types.float64, modes=True)
def through_events(oscillator, motion, duration):
    """Advance a motion of a machine with modes by ``duration``, in place, through all its events.

    This is ``period.propagate`` for a machine with modes: sets of linear equations that hold between two events. If a
    mode is not built yet, the motion stays unchanged.
    """
    framed, square = motion.growth.shape[0] > 0, motion.triangle.shape[0] > 0
    more = 1 if oscillator.table.drifts > 0.0 and framed else 0
    n, m = motion.h.shape[0], motion.V.shape[0] + more
    take_on(oscillator, motion, make_trajectories(oscillator.table, 1, n, m, framed, square), more, duration)
