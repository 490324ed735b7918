"""Many cells at a time through whole periods: each lane takes the next cell of the queue when its own is through."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.kernel.averages import add_growth
from workers.kernel.batch.frames import Workspace, copy_frame, move_frames
from workers.kernel.batch.layout import (
    AT_SECTION,
    BLOCK,
    BLOCK_CONSTANTS,
    BLOCK_SIZE,
    COLUMN,
    FLYING,
    GAP_SIZE,
    LANE,
    LANE_CONSTANTS,
    LANE_SIZE,
    LANES,
    LEFT,
    STRIDE,
    LaneFields,
)
from workers.kernel.batch.rounds import take_round
from workers.kernel.batch.search import list_lanes, padded
from workers.kernel.flight import forced
from workers.kernel.frame import log_length
from workers.kernel.jit import inlined, kernel
from workers.kernel.stroboscopic import (
    EVALUATIONS,
    LOWER,
    MIN_SPEED,
    SPREAD,
    UPPER,
    WORK,
    loss_spread,
    spread_rate,
)
from workers.model.oscillator import Oscillator

Array = NDArray[np.float64]


class Batch(NamedTuple):
    """Cells that are to go on by some periods each: N requests, every field stacked along its first axis.

    head       (N, LANE_CONSTANTS)      constants of the oscillators, see LaneFields
    blocks     (N, n, BLOCK_CONSTANTS)  constants of each of their blocks, see BlockFields
    periods    (N,)                     wanted; done (N,) completed, before and after
    left       (N,)                     set where the scalar kernels have to go on
    h          (N, n, 2), V (N, m, n, 2), growth (N, m), tally (N, TALLIES): as in Motion
    levels     (N, LEVELS, 4), weighted (N, 2): as in Averages
    sections   (N, K, n, 2)             the last K states
    """

    head: Array
    blocks: Array
    periods: NDArray[np.int64]
    done: NDArray[np.int64]
    left: NDArray[np.bool_]
    h: Array
    V: Array
    growth: Array
    tally: Array
    levels: Array
    weighted: Array
    sections: Array


def constants(osc: Oscillator) -> tuple[Array, Array]:
    """The rows of Batch.head and Batch.blocks of an oscillator."""
    gap = osc.gap
    y, v = forced(osc.tau, gap.omega, gap.sin_part, gap.cos_part)
    values = {
        "omega": gap.omega,
        "sin_part": gap.sin_part,
        "cos_part": gap.cos_part,
        "amplitude": gap.amplitude,
        "upper": osc.b_upper,
        "lower": -osc.b_lower,
        "restitution": osc.R,
        "cA2k": osc.cA2k,
        "period": osc.period,
        "tau": osc.tau,
        "forced_at_section": y,
        "forced_rate_at_section": v,
        "spread_rate": spread_rate(gap.block),
        "time_unit": 1.0 / math.sqrt(gap.lam[0]),
        "loss_spread": loss_spread(osc.R),
    }
    head = np.array([values[name] for name in LaneFields._fields[:LANE_CONSTANTS]])
    rows = zip(gap.block, gap.row, gap.row1, osc.kick, osc.kick1, strict=True)
    return head, np.array([[x for part in row for x in part] for row in rows])


@kernel
def load(a, i, r, head, blocks, h, tally):
    """Put the state of request r into lane i, at its section."""
    for f in range(LANE_CONSTANTS):
        a[f * STRIDE + i] = head[r, f]
    for j in range(h.shape[1]):
        b = LANE_SIZE + j * BLOCK_SIZE + i
        for f in range(BLOCK_CONSTANTS):
            a[b + f * STRIDE] = blocks[r, j, f]
        a[b + BLOCK.h0], a[b + BLOCK.h1] = h[r, j, 0], h[r, j, 1]
    a[LANE.flight_start + i], a[LANE.flight_phase + i], a[LANE.time + i] = 0.0, a[LANE.tau + i], 0.0
    a[LANE.own_stop + i], a[LANE.flight_evaluations + i] = 0.0, 0.0
    a[LANE.event + i], a[LANE.starts + i], a[LANE.renews + i] = FLYING, 1.0, 1.0
    a[LANE.forced + i], a[LANE.forced_rate + i] = a[LANE.forced_at_section + i], a[LANE.forced_rate_at_section + i]
    a[LANE.kick + i], a[LANE.shift + i] = 0.0, 0.0
    a[LANE.impacts_upper + i], a[LANE.impacts_lower + i] = tally[r, UPPER], tally[r, LOWER]
    a[LANE.slowest_impact + i], a[LANE.frame_spread + i] = tally[r, MIN_SPEED], tally[r, SPREAD]
    a[LANE.evaluations + i], a[LANE.period_cost + i] = tally[r, EVALUATIONS], 0.0
    a[LANE.request + i] = r


@inlined
def save(a, i, r, h, tally):
    """Write the section state of lane i back to its request."""
    for j in range(h.shape[1]):
        b = LANE_SIZE + j * BLOCK_SIZE + i
        h[r, j, 0], h[r, j, 1] = a[b + BLOCK.h0], a[b + BLOCK.h1]
    tally[r, UPPER], tally[r, LOWER] = a[LANE.impacts_upper + i], a[LANE.impacts_lower + i]
    tally[r, MIN_SPEED], tally[r, SPREAD] = a[LANE.slowest_impact + i], a[LANE.frame_spread + i]
    tally[r, EVALUATIONS] = a[LANE.evaluations + i]
    tally[r, WORK] -= a[LANE.period_cost + i]
    a[LANE.period_cost + i] = 0.0


@inlined
def keep_section(h, r, k, periods, sections):
    """Keep the state after period k if it is one of the last that are asked for."""
    row = k - (periods - sections.shape[1])
    if row >= 0:
        for j in range(h.shape[1]):
            sections[r, row, j, 0], sections[r, row, j, 1] = h[r, j, 0], h[r, j, 1]


@kernel
def move_lane(a, source, target):
    """Copy a lane."""
    for f in range(len(a) // STRIDE):
        a[f * STRIDE + target] = a[f * STRIDE + source]


@kernel
def park(a, i):
    """Give a lane that no cell needs a mass that nothing moves, for the passes to run over."""
    for f in range(len(a) // STRIDE):
        a[f * STRIDE + i] = 0.0
    a[LANE.upper + i], a[LANE.lower + i], a[LANE.period + i] = 1.0, -1.0, 1.0


@kernel
def run_batch(batch, enough, lanes):
    """Advance every request of a batch by its periods, or to a section from which the scalar kernels have to go on.

    Changes the arrays of the batch, see there. At most ``lanes`` <= LANES requests are under way at a time; once fewer
    than ``enough`` are, each stops at its next section.
    """
    # Taken out once: a field of a record costs a reference count at every use.
    head, blocks, periods, done, left, h, V, growth, tally, levels, weighted, sections = batch
    N, n, m = h.shape[0], h.shape[1], V.shape[1]
    a = np.zeros(LANE_SIZE + n * BLOCK_SIZE)
    gathered, chosen = np.zeros(GAP_SIZE), np.zeros(LANES, dtype=np.uint32)
    frames, growths = np.zeros((LANES, m, n, 2)), np.zeros((LANES, m))
    space = Workspace(
        lam=np.zeros((n, STRIDE)),
        rank=np.zeros(STRIDE),
        frames=np.zeros((m, n, 2, STRIDE)),
        norms=np.zeros((m, STRIDE)),
        work=np.zeros((2, STRIDE)),
        lanes=np.zeros(LANES, dtype=np.uint32),
    )
    oscillates = np.ones(n, dtype=np.bool_)
    for r in range(N):
        for j in range(n):
            oscillates[j] &= blocks[r, j, COLUMN.d] > 0.0
    for i in range(LANES):
        park(a, i)
    active = queued = np.int64(0)  # no literal, or Numba compiles for it what is called with it
    while True:
        while active < lanes and queued < N:
            load(a, active, queued, head, blocks, h, tally)
            copy_frame(V, growth, queued, frames, growths, active)
            if m > 0:
                a[LANE.log_length + active] = log_length(blocks[queued, :, COLUMN.lam], V[queued], growth[queued])
            if done[queued] == 0:
                weighted[queued, 0] = weighted[queued, 1] = 0.0
            active, queued = active + 1, queued + 1
        if active == 0:
            return
        ending = active < enough
        take_round(a, n, oscillates, padded(active), chosen, gathered)
        count = list_lanes(a, LANE.event, active, chosen)
        if m > 0:
            move_frames(a, chosen[:count], blocks, tally, frames, growths, space)
        for e in range(count - 1, -1, -1):  # from the last: the lane that moves into a freed one has been seen
            i = chosen[e]
            ended = a[LANE.event + i] == LEFT
            r = int(a[LANE.request + i])
            if ended:
                left[r] = True
            elif a[LANE.event + i] == AT_SECTION:
                k = done[r]
                if m > 0:
                    length = log_length(blocks[r, :, COLUMN.lam], frames[i], growths[i])
                    add_growth(levels[r], weighted[r], length - a[LANE.log_length + i], k, periods[r])
                    a[LANE.log_length + i] = length
                    copy_frame(frames, growths, i, V, growth, r)
                save(a, i, r, h, tally)
                keep_section(h, r, k, periods[r], sections)
                done[r] = k + 1
                ended = ending or k + 1 == periods[r] or tally[r, WORK] < 0.0
            if ended:
                active -= 1
                move_lane(a, active, i)
                copy_frame(frames, growths, active, frames, growths, i)
                park(a, active)
