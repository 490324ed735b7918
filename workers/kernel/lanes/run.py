"""Many cells at once through whole periods, in lanes: slots of vectorised loops that hold one cell each.

A lane whose cell has finished takes the next cell of the queue.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.kernel.averages import add_growth
from workers.kernel.borrow import row_of
from workers.kernel.by_reference import by_reference, without_mode_table
from workers.kernel.jit import inline_always, inlined, kernel
from workers.kernel.lanes.frames import load_frame, measure_pass, move_frames, store_frame, workspace
from workers.kernel.lanes.layout import (
    BLOCK,
    BLOCK_SIZE,
    FLYING,
    GAP_SIZE,
    HARMONIC,
    HARMONIC_SIZE,
    LANE,
    LANE_SIZE,
    LANES,
    LEFT,
    STRIDE,
    padded_blocks,
    room_for_vectors,
)
from workers.kernel.lanes.rounds import run_round
from workers.kernel.lanes.search import list_lanes, padded_count
from workers.kernel.lanes.signal import fields_of_harmonic
from workers.kernel.motion import (
    EVALUATIONS,
    FLIGHT,
    LOSS,
    LOST,
    LOWER,
    MAX_SPEED,
    MIN_SPEED,
    RECORDED,
    RUNNING,
    SPEEDS,
    SPREAD,
    STATUS,
    UPPER,
    WORK,
    Motion,
)
from workers.kernel.period import through_impacts
from workers.kernel.signal import all_forced
from workers.kernel.tangent import log_length, loss_spread, spread_rate
from workers.model.oscillator import COLUMN, HEAD, NUMBER, OF_LANE, Array, Oscillator

NUMBERS = len(NUMBER)


class MotionBatch(NamedTuple):
    """N cells to advance by some periods each; every field has the cells along its first axis.

    oscillators  batch of oscillators
    motions      batch of motions
    periods      (N,)               number of periods wanted
    completed    (N,)               number of periods completed, changed in place
    levels       (N, LEVELS, 4)     averages of tangent growth, see averages.add_growth
    weighted     (N, 2)             weighted averages of tangent growth, see averages.add_growth
    sections     (N, K, n, 2)       the last K states of the decoupled equations at sections, the instants t = k T
    """

    oscillators: Oscillator
    motions: Motion
    periods: NDArray[np.int64]
    completed: NDArray[np.int64]
    levels: Array
    weighted: Array
    sections: Array


@inline_always
def load(a, i, r, head, tau, blocks, waves, numbers, h, tally):
    """Load cell r into lane i (one cell) at the start of a period, with the constants of its machine.

    a      fields of all lanes
    h      (N, n, 2) states of the decoupled equations of all cells
    tally  (N, TALLIES) counts of all cells

    The other arguments are fields of the batch of machines, see Oscillator and GuardedFlow.
    """
    for f in range(NUMBERS):
        a[LANE.omega + f * STRIDE + i] = numbers[r, f]
    for f in range(OF_LANE):
        a[LANE.upper + f * STRIDE + i] = head[r, f]
    a[LANE.tau + i], a[LANE.sin_part + i], a[LANE.cos_part + i] = tau[r], waves[r, 0, 0], waves[r, 0, 1]
    for j in range(h.shape[1]):
        b = LANE_SIZE + j * BLOCK_SIZE + i
        for f in range(COLUMN.cAA0):
            a[b + f * STRIDE] = blocks[r, j, f]
        a[b + BLOCK.h0], a[b + BLOCK.h1] = h[r, j, 0], h[r, j, 1]
    for k in range(1, waves.shape[1]):
        fields = fields_of_harmonic(a, padded_blocks(h.shape[1]), k - 1)
        fields[HARMONIC.sin_part + i], fields[HARMONIC.cos_part + i] = waves[r, k, 0], waves[r, k, 1]
    y, v, second, third, _ = all_forced(waves[r], a[LANE.omega + i], a[LANE.tau + i])
    a[LANE.forced_at_section + i], a[LANE.forced_rate_at_section + i] = y, v
    a[LANE.forced_second_at_section + i], a[LANE.forced_third_at_section + i] = second, third
    a[LANE.forced + i], a[LANE.forced_rate + i] = y, v
    a[LANE.forced_second + i], a[LANE.forced_third + i] = second, third
    a[LANE.spread_rate + i] = spread_rate(blocks[r])
    a[LANE.loss_spread + i] = loss_spread(a[LANE.restitution + i])
    a[LANE.flight_start + i], a[LANE.flight_phase + i], a[LANE.time + i] = 0.0, a[LANE.tau + i], 0.0
    a[LANE.own_stop + i], a[LANE.flight_evaluations + i] = 0.0, 0.0
    a[LANE.event + i], a[LANE.starts + i], a[LANE.renews + i] = FLYING, 1.0, 1.0
    a[LANE.kick + i], a[LANE.shift + i] = 0.0, 0.0
    a[LANE.impacts_upper + i], a[LANE.impacts_lower + i] = tally[r, UPPER], tally[r, LOWER]
    a[LANE.slowest_impact + i], a[LANE.fastest_impact + i] = tally[r, MIN_SPEED], tally[r, MAX_SPEED]
    a[LANE.impact_speeds + i], a[LANE.impact_loss + i] = tally[r, SPEEDS], tally[r, LOSS]
    a[LANE.frame_spread + i] = tally[r, SPREAD]
    a[LANE.evaluations + i], a[LANE.period_cost + i] = tally[r, EVALUATIONS], 0.0
    a[LANE.rank + i], a[LANE.log_length + i] = 2 * h.shape[1] - tally[r, LOST], np.nan
    a[LANE.recorded + i], a[LANE.cell + i] = tally[r, RECORDED], r


@inlined
def save(a, i, r, h, tally):
    """Write state and counts of lane i (one cell), at the end of a period, back to cell r.

    h      (N, n, 2) states of the decoupled equations of all cells, changed in place
    tally  (N, TALLIES) counts of all cells, changed in place
    """
    for j in range(h.shape[1]):
        b = LANE_SIZE + j * BLOCK_SIZE + i
        h[r, j, 0], h[r, j, 1] = a[b + BLOCK.h0], a[b + BLOCK.h1]
    tally[r, UPPER], tally[r, LOWER] = a[LANE.impacts_upper + i], a[LANE.impacts_lower + i]
    tally[r, MIN_SPEED], tally[r, MAX_SPEED] = a[LANE.slowest_impact + i], a[LANE.fastest_impact + i]
    tally[r, SPEEDS], tally[r, LOSS] = a[LANE.impact_speeds + i], a[LANE.impact_loss + i]
    tally[r, SPREAD] = a[LANE.frame_spread + i]
    tally[r, EVALUATIONS], tally[r, RECORDED] = a[LANE.evaluations + i], a[LANE.recorded + i]
    tally[r, WORK] -= a[LANE.period_cost + i]
    a[LANE.period_cost + i] = 0.0


@inlined
def record(a, i, impacts):
    """Write the impact that lane i (one cell) has reached to the next row of ``impacts`` (K, 3), if there is room."""
    row = int(a[LANE.recorded + i])
    if row < impacts.shape[0]:
        impacts[row, 0], impacts[row, 1] = a[LANE.flight_start + i], a[LANE.event + i]
        impacts[row, 2] = abs(a[LANE.v + i])
        a[LANE.recorded + i] += 1.0


@inlined
def keep_section(h, r, k, periods, sections):
    """Copy the state of cell r after period k to ``sections`` (N, K, n, 2) if the period is one of the last K."""
    row = k - (periods - sections.shape[1])
    if row >= 0:
        for j in range(h.shape[1]):
            sections[r, row, j, 0], sections[r, row, j, 1] = h[r, j, 0], h[r, j, 1]


@kernel
def move_lane(a, source, target):
    """Copy all fields of the cell in lane ``source``, a slot of the loops, to lane ``target``."""
    for f in range(len(a) // STRIDE):
        a[f * STRIDE + target] = a[f * STRIDE + source]


@kernel
def park(a, i):
    """Fill lane i, which holds no cell, with a mass at rest without forces, over which the loops can run.

    A lane is a slot of the loops.
    """
    for f in range(len(a) // STRIDE):
        a[f * STRIDE + i] = 0.0
    a[LANE.upper + i], a[LANE.lower + i], a[LANE.period + i] = 1.0, -1.0, 1.0


@inlined
def is_finished(r, completed, periods, tally):
    """Return True if cell r is finished: its periods, its motion or its evaluations have ended."""
    return completed[r] >= periods[r] or tally[r, STATUS] != RUNNING or tally[r, WORK] < 0.0


@inline_always
def go_alone(batch, r):
    """Advance cell r by a period in which it sticks on a stop or needs many steps, by the kernels of one cell.

    Its periods continue in this way until the cell is in free flight at the end of a period; vectorised loops then take
    it again.
    """
    motion, osc = row_of(batch.motions, r), row_of(without_mode_table(batch.oscillators), r)
    vectors = motion.growth.shape[0] > 0
    before = log_length(osc.gap.blocks, motion.V, motion.growth) if vectors else 0.0
    while not is_finished(r, batch.completed, batch.periods, batch.motions.tally):
        through_impacts(osc, motion, osc.head[HEAD.period])
        if motion.tally[STATUS] != RUNNING:
            return
        k = batch.completed[r]
        if vectors:
            length = log_length(osc.gap.blocks, motion.V, motion.growth)
            add_growth(batch.levels[r], batch.weighted[r], length - before, k, batch.periods[r])
            before = length
        keep_section(batch.motions.h, r, k, batch.periods[r], batch.sections)
        batch.completed[r] = k + 1
        if motion.mode[0] == FLIGHT:
            return


@kernel
def run_alone(batch, cells):
    """Apply ``run_batch``, the advance of cells by their periods, to cells whose motion may grow, one by one."""
    batch = by_reference(batch)
    for r in cells:
        if batch.completed[r] == 0:
            batch.weighted[r, 0] = batch.weighted[r, 1] = 0.0
        while not is_finished(r, batch.completed, batch.periods, batch.motions.tally):
            go_alone(batch, r)


@kernel
def run_batch(batch, cells, enough, lanes, oscillates):
    """Advance these cells of a batch by their periods, or until their motion or their evaluations end.

    batch       its arrays change, see MotionBatch
    enough      minimum number of active cells; once fewer are active, each stops at the end of its period
    lanes       maximum number of active cells, at most LANES, the number of slots of the loops
    oscillates  whether all blocks, the decoupled equations, of all these cells are underdamped
    """
    batch = by_reference(batch)
    gap, head, tau = batch.oscillators.gap, batch.oscillators.head, batch.oscillators.tau
    blocks, waves, numbers = gap.blocks, gap.waves, gap.numbers
    periods, completed, sections = batch.periods, batch.completed, batch.sections
    h, V, growth, tally, mode = (
        batch.motions.h, batch.motions.V, batch.motions.growth, batch.motions.tally, batch.motions.mode
    )  # fmt: skip
    impacts, levels, weighted = batch.motions.impacts, batch.levels, batch.weighted
    n, m, harmonics = h.shape[1], V.shape[1], waves.shape[1] - 1
    wide = padded_blocks(n)
    vectors = LANE_SIZE + wide * BLOCK_SIZE + harmonics * HARMONIC_SIZE
    growing = vectors + m * wide * 2 * STRIDE
    a = room_for_vectors(growing + m * STRIDE)
    frames, growths = a[vectors:growing].reshape((m, 2 * wide * STRIDE)), a[growing:].reshape((m, STRIDE))
    gathered, lane_list = room_for_vectors(GAP_SIZE), np.empty(LANES, dtype=np.uint32)
    space = workspace(m, n)
    departed = np.empty(LANES, dtype=np.uint32)  # the cells that have left their lanes
    for i in range(LANES):
        park(a, i)
    active = queued = leaving = np.int64(0)  # typed: a literal would compile the callees once more
    begun, ending, renewing = False, False, 0
    while True:
        while leaving > 0 or (active < lanes and queued < len(cells)):
            if leaving > 0:
                leaving -= 1
                r, alone = np.int64(departed[leaving]), True
            else:
                r = cells[queued]
                queued += 1
                alone = mode[r, 0] != FLIGHT
                if completed[r] == 0:
                    weighted[r, 0] = weighted[r, 1] = 0.0
            if alone:
                go_alone(batch, r)
            if not (ending or is_finished(r, completed, periods, tally)):
                load(a, active, r, head, tau, blocks, waves, numbers, h, tally)
                load_frame(V[r], growth[r], frames, growths, active)
                begun = True
                active += 1
        if active == 0:
            return
        if m > 0 and begun:
            measure_pass(a, frames[0], growths[0], space.partial, padded_count(active))
        ending = active < enough
        stopping, renewing = run_round(
            a, n, harmonics, oscillates, begun or renewing > 0, padded_count(active), lane_list, gathered
        )
        begun = False
        if m > 0:
            move_frames(a, padded_count(active), blocks, frames, growths, space)
        if impacts.shape[1] > 0:
            for i in range(active):
                if abs(a[LANE.event + i]) == 1.0:
                    record(a, i, impacts[int(a[LANE.cell + i])])
        if stopping == 0:
            continue
        if m > 0:
            measure_pass(a, frames[0], growths[0], space.partial, padded_count(active))
        count = list_lanes(a, LANE.stops, active, lane_list)
        for e in range(count - 1, -1, -1):  # backwards: the lane that moves into a freed one has been processed
            lane = np.int64(lane_list[e])
            r = np.int64(a[LANE.cell + lane])
            leaves = a[LANE.event + lane] == LEFT
            if leaves:
                departed[leaving] = r
                leaving += 1
            else:
                k = completed[r]
                if m > 0:
                    add_growth(levels[r], weighted[r], a[LANE.period_growth + lane], k, periods[r])
                    store_frame(frames, growths, lane, V[r], growth[r])
                save(a, lane, r, h, tally)
                keep_section(h, r, k, periods[r], sections)
                completed[r] = k + 1
            if leaves or ending or is_finished(r, completed, periods, tally):
                active -= 1
                move_lane(a, active, lane)
                park(a, active)
