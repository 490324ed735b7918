"""Many motions of machines with modes, advanced at once through whole periods.

A mode is one set of linear equations, and a leg the motion in one mode between two events. Vectorised loops search for
the events in lanes, slots that hold one motion each. A lane whose motion has finished takes the next one of the queue.
``hybrid/trajectory.py`` carries motions through their events, one at a time. A leg is searched as in
``hybrid/motion.py`` if it begins at rest at an end of a signal's range, hops in a chatter, or may grow.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.kernel.averages import add_growth
from workers.kernel.by_reference import by_reference, row_in
from workers.kernel.hybrid.motion import advance_leg, load_motion, store_motion
from workers.kernel.hybrid.state import write_harmonics
from workers.kernel.hybrid.trajectory import (
    CLOCK,
    INDEX,
    begin_leg,
    begin_trajectory,
    finish_leg,
    make_trajectories,
)
from workers.kernel.jit import inline_always, inlined, kernel
from workers.kernel.lanes.layout import GAP_SIZE, LANE, LANES, LEFT, room_for_vectors
from workers.kernel.lanes.legs import (
    LEG_FIELD,
    LEG_SIZE,
    copy_lane,
    empty_lane,
    load_leg,
    load_mode,
    read_flow,
    record_size,
    run_round,
)
from workers.kernel.lanes.run import MotionBatch, is_finished, keep_section
from workers.kernel.lanes.search import list_lanes, padded_count
from workers.kernel.motion import MODE_MISSING, RUNNING, STATUS, spend
from workers.kernel.signal import growth_rate
from workers.kernel.tangent import log_length
from workers.model.oscillator import Array, Rows

BEGINS, ARRIVES = 0, 1
"""Stages at which ``turn`` continues a lane: at the beginning of a period, or after its search."""


class LegSearch(NamedTuple):
    """Work arrays for the search for the events of many motions of n coordinates, each in a lane, a slot of the loops.

    records, legs       fields of the lanes, see ``legs.py``
    signals (U,)        numbers of the signals whose events are sought
    lane_cells (LANES,) cell of each lane
    lane_modes (LANES,) index of the mode (set of linear equations) whose constants the lane has, -1 for none
    slots (LANES,)      row of its trajectory in the batch of trajectories
    before (LANES,)     log of the length of the first tangent vector of each trajectory, at the start of the period
    turns (LANES, H, 2) harmonics of the force at the start of the period of each trajectory, see state.harmonics_at
    gathered            overwritten
    lane_list (LANES,)  overwritten
    scratch (n, 2)      overwritten
    none (0, 0)         records of the motion between events, not wanted
    """

    records: Array
    legs: Array
    signals: Rows
    lane_cells: Rows
    lane_modes: Rows
    slots: Rows
    before: Array
    turns: Array
    gathered: Array
    lane_list: NDArray[np.uint32]
    scratch: Array
    none: Array


def run_through_modes(batch: MotionBatch, cells: Rows, signals: Rows, enough: int, lanes: int) -> None:
    """Advance these cells of a batch by their periods, or until their motion or their evaluations end.

    batch         its arrays change, see lanes.run.MotionBatch
    signals (U,)  numbers of the machines' signals whose events are sought, at least one
    enough        minimum number of active cells; once fewer are active, each stops at its next section
    lanes         maximum number of active cells, at most LANES

    If the mode of a motion, a set of linear equations, is not built yet, the motion stays at its section, t = k T. The
    mode is built before the next call.
    """
    n, m = batch.motions.h.shape[1], batch.motions.V.shape[1]
    framed = batch.motions.growth.shape[1] > 0
    more = int(framed and batch.oscillators.drifts)
    trips = make_trajectories.py_func(row_in(batch.oscillators.table, 0), LANES, n, m + more, framed, False)
    search = _search_for(n, batch.oscillators.gap.waves.shape[1], signals)
    take_along(batch, cells, trips, search, enough, lanes, more)


def _search_for(n: int, harmonics: int, signals: Rows) -> LegSearch:
    """Return work arrays for the search for events, which hold no motion yet.

    n          number of coordinates
    harmonics  number of harmonics of the force
    signals    (U,) numbers of the signals whose events are sought
    """
    U, size = len(signals), record_size.py_func(n, harmonics)
    return LegSearch(
        room_for_vectors.py_func(U * size).reshape((U, size)), room_for_vectors.py_func(LEG_SIZE), signals,
        np.zeros(LANES, dtype=np.int64), np.zeros(LANES, dtype=np.int64), np.arange(LANES), np.zeros(LANES),
        np.zeros((LANES, harmonics, 2)), room_for_vectors.py_func(GAP_SIZE),
        np.empty(LANES, dtype=np.uint32), np.empty((n, 2)), np.empty((0, 0)),
    )  # fmt: skip


@kernel
def take_along(batch, cells, trajs, search, enough, lanes, more):
    """Apply ``run_through_modes``, the advance of cells by their periods, with work arrays ``trajs`` and ``search``.

    ``more`` is the number of tangent vectors added in front, for the direction of a drift.
    """
    batch, trajs, search = by_reference(batch), by_reference(trajs), by_reference(search)
    periods, completed, tally = batch.periods, batch.completed, batch.motions.tally
    legs, lane_cells, slots = search.legs, search.lane_cells, search.slots
    for i in range(LANES):
        empty_lane(search.records, i)
    n, harmonics = batch.motions.h.shape[1], batch.oscillators.gap.waves.shape[1]
    active = queued = np.int64(0)  # typed: a literal would compile the callees once more
    renewing = False
    while True:
        while active < lanes and queued < len(cells):
            r, slot = cells[queued], slots[active]
            queued += 1
            if tally[r, STATUS] == MODE_MISSING:
                tally[r, STATUS] = RUNNING
            if completed[r] == 0:
                batch.weighted[r, 0] = batch.weighted[r, 1] = 0.0
            if is_finished(r, completed, periods, tally):
                continue
            if batch.motions.V.shape[1] > 0:
                search.before[slot] = length_of(batch, r)
            write_harmonics(batch.oscillators.table.tau[r], search.turns[slot])
            begin_period(batch, trajs, search, r, slot, more)
            search.lane_modes[active] = -1
            if turn(batch, trajs, search, r, active, np.int64(BEGINS), np.bool_(False), more):
                lane_cells[active] = r
                active += 1
                renewing = True
        if active == 0:
            return
        ending, smooth = active < enough, True
        for i in range(active):
            smooth = smooth and legs[LEG_FIELD.oscillates + i] > 0.0
        renewing = run_round(
            search.records, legs, n, harmonics, smooth, renewing, padded_count(active), search.lane_list,
            search.gathered,
        )  # fmt: skip
        count = list_lanes(legs, LEG_FIELD.event, active, search.lane_list)
        for e in range(count - 1, -1, -1):  # backwards: the lane that moves into a freed one has been processed
            lane = np.int64(search.lane_list[e])
            if turn(batch, trajs, search, lane_cells[lane], lane, np.int64(ARRIVES), ending, more):
                renewing = True
                continue
            active -= 1
            copy_lane(search.records, active, lane)
            legs[LEG_FIELD.oscillates + lane] = legs[LEG_FIELD.oscillates + active]
            legs[LEG_FIELD.length + lane] = legs[LEG_FIELD.length + active]
            lane_cells[lane], search.lane_modes[lane] = lane_cells[active], search.lane_modes[active]
            slots[lane], slots[active] = slots[active], slots[lane]
            empty_lane(search.records, active)


@kernel
def length_of(batch, r):
    """Return the log of the length of the first tangent vector of cell r at the end of a period.

    It includes the growth removed so far, see tangent.log_length.
    """
    motions = batch.motions
    return log_length(batch.oscillators.gap.blocks[r], motions.V[r], motions.growth[r])


@kernel
def begin_period(batch, trajs, search, r, slot, more):
    """Begin a period of cell r: copy its motion into row ``slot`` of the trajectories ``trajs``.

    ``more`` is the number of tangent vectors added in front, for the direction of a drift.
    """
    oscillators = batch.oscillators
    trip, motion, table = row_in(trajs, slot), row_in(batch.motions, r), row_in(oscillators.table, r)
    load_motion(oscillators.to_physical[r], motion, trip, more)
    begin_trajectory(table, trip, motion.mode[0], search.turns[slot])


@inline_always
def pass_alone(batch, trajs, search, r, slot):
    """Advance cell r to the end of its current leg, and through the event there, by the kernels of one motion.

    Return True if its period is over. A leg is the motion in one mode, a set of linear equations, from one event to the
    next.
    """
    tables, hits, none = batch.oscillators.table, batch.motions.impacts[r], search.none
    return advance_leg(tables, r, trajs, slot, hits, none, search.scratch, 2.0 * np.pi / tables.omega[r])


@inline_always
def pass_found(batch, trajs, search, r, slot, i):
    """Advance cell r to the event that the search has found, the end of its current leg, and through the event.

    ``i`` is the lane in which the loops hold the cell. Return True if the period of the cell is over. A leg is the
    motion between two events.
    """
    tables, legs = batch.oscillators.table, search.legs
    hit, s, period = legs[LEG_FIELD.hit + i], search.records[0, LANE.time + i], 2.0 * np.pi / tables.omega[r]
    reached = search.signals[int(hit)] if hit >= 0.0 else np.int64(-1)
    end = np.int64(legs[LEG_FIELD.side + i]) if hit >= 0.0 else np.int64(0)
    read_flow(search.records, i, row_in(trajs, slot).flow)
    hits, none = batch.motions.impacts[r], search.none
    return finish_leg(tables, r, trajs, slot, s, reached, end, period, hits, none, np.bool_(True))


@kernel
def end_period(batch, trajs, search, r, slot, ending, more):
    """Copy the trajectory of cell r back into its motion at the end of a period, and begin the next period.

    slot    row of the trajectory
    ending  True to begin no other period
    more    number of tangent vectors added in front, for the direction of a drift

    Return True if a next period has begun.
    """
    oscillators, periods, completed, before = batch.oscillators, batch.periods, batch.completed, search.before
    motion, trip, k = row_in(batch.motions, r), row_in(trajs, slot), completed[r]
    table = oscillators.table
    store_motion(oscillators.to_blocks[r], table.omega[r], motion, trip, more, table.drifts[r] > 0.0)
    if batch.motions.V.shape[1] > 0:
        length = length_of(batch, r)
        add_growth(batch.levels[r], batch.weighted[r], length - before[slot], k, periods[r])
        before[slot] = length
    keep_section(batch.motions.h, r, k, periods[r], batch.sections)
    completed[r] = k + 1
    if ending or is_finished(r, completed, periods, batch.motions.tally):
        return False
    begin_period(batch, trajs, search, r, slot, more)
    return True


@kernel
def turn(batch, trajs, search, r, i, stage, ending, more):
    """Advance cell r until a leg begins whose event the vectorised loops can search.

    Return True if there is such a leg. A leg is the motion between two events.

    i       lane of the cell, its index in the loops
    stage   where to continue, see BEGINS
    ending  True to stop at the end of the period
    """
    slot, through = search.slots[i], False
    trip, table = row_in(trajs, slot), row_in(batch.oscillators.table, r)
    clock, tally = trip.clock, trip.tally
    if stage == ARRIVES:
        spend(tally, search.records[0, LANE.flight_evaluations + i])
        if search.legs[LEG_FIELD.event + i] == LEFT:
            through = pass_alone(batch, trajs, search, r, slot)
        else:
            through = pass_found(batch, trajs, search, r, slot, i)
    while True:
        if through and tally[STATUS] == RUNNING and not end_period(batch, trajs, search, r, slot, ending, more):
            return False
        clock[CLOCK.horizon] = begin_leg(table, trip, 2.0 * np.pi / table.omega)
        if tally[STATUS] != RUNNING:
            batch.motions.tally[r, STATUS] = tally[STATUS]
            return False
        if not (begins_at_rest(trip) or grows(table.pieces, trip.indices[INDEX.mode])):
            break
        through = pass_alone(batch, trajs, search, r, slot)
    k, records, signals = trip.indices[INDEX.mode], search.records, search.signals
    if search.lane_modes[i] != k:
        smooth = load_mode(records, i, table.pieces, signals, k, table.omega)
        search.legs[LEG_FIELD.oscillates + i], search.lane_modes[i] = 1.0 if smooth else 0.0, k
    search.legs[LEG_FIELD.length + i] = clock[CLOCK.until] - clock[CLOCK.time]
    load_leg(records, i, signals, trip.h, clock[CLOCK.phase], trip.turn, trip.begun, clock[CLOCK.horizon])
    return True


@inline_always
def begins_at_rest(traj):
    """Return True if a leg begins in a hop of a chatter, or with a signal at rest at an end of its range.

    A leg is the motion of a trajectory between two events.
    """
    rests = traj.clock[CLOCK.hop] > 0.0
    for order in traj.begun:
        rests = rests or abs(order) > 1
    return rests


@inlined
def grows(modes, k):
    """Return True if a block of mode k (a set of linear equations), one of its decoupled equations, grows.

    Bounds of a growing motion hold only for a while, see crossing.next_crossing.
    """
    return growth_rate(modes.blocks[k, 0]) > 0.0
