"""The tangent frames of a batch's lanes: through flights and impacts, and made orthonormal again."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.kernel.batch.layout import AT_SECTION, BLOCK, BLOCK_SIZE, COLUMN, LANE, LANE_SIZE, LEFT
from workers.kernel.batch.search import padded
from workers.kernel.flight import TINY
from workers.kernel.frame import graded_flow, orthonormalise, orthonormalise_pass
from workers.kernel.jit import inlined, kernel
from workers.kernel.motion import LOST
from workers.kernel.stroboscopic import MAX_SPREAD, impact_spread, needs_reset

Array = NDArray[np.float64]


@inlined
def flow_frame(a, i, frames):
    """Take the tangent vectors of lane i, frames[i] (m, n, 2), through the flight that it has just ended."""
    for j in range(frames.shape[2]):
        b = LANE_SIZE + j * BLOCK_SIZE + i
        f11, f12, f21, f22 = a[b + BLOCK.f11], a[b + BLOCK.f12], a[b + BLOCK.f21], a[b + BLOCK.f22]
        for k in range(frames.shape[1]):
            u0, u1 = frames[i, k, j, 0], frames[i, k, j, 1]
            frames[i, k, j, 0] = f11 * u0 + f12 * u1
            frames[i, k, j, 1] = f21 * u0 + f22 * u1


@inlined
def saltate_frame(blocks, r, restitution, ratio, frames, i):
    """Take the tangent vectors of lane i, cell r, through an impact, as impact.saltation does; blocks: see Batch."""
    for k in range(frames.shape[1]):
        dy, dv = 0.0, 0.0
        for j in range(frames.shape[2]):
            u0, u1 = frames[i, k, j, 0], frames[i, k, j, 1]
            dy += blocks[r, j, COLUMN.c0] * u0 + blocks[r, j, COLUMN.c1] * u1
            dv += blocks[r, j, COLUMN.cA0] * u0 + blocks[r, j, COLUMN.cA1] * u1
        along_k = -(1.0 + restitution) * (dv - ratio * dy)
        along_Ak = -(1.0 + restitution) * dy
        for j in range(frames.shape[2]):
            frames[i, k, j, 0] += along_k * blocks[r, j, COLUMN.k0] + along_Ak * blocks[r, j, COLUMN.Ak0]
            frames[i, k, j, 1] += along_k * blocks[r, j, COLUMN.k1] + along_Ak * blocks[r, j, COLUMN.Ak1]


class Workspace(NamedTuple):
    """Arrays in which the frames of some lanes are made orthonormal, as frame.orthonormalise_pass takes them.

    lanes (LANES,) are which they are.
    """

    lam: Array
    rank: Array
    frames: Array
    norms: Array
    work: Array
    lanes: NDArray[np.uint32]


@kernel
def reset_together(a, count, blocks, tally, frames, growths, space):
    """Make the frames of the first ``count`` of space.lanes orthonormal."""
    lam, rank, U, norms, work, lanes = space
    m, n = frames.shape[1], frames.shape[2]
    for e in range(count):
        i = lanes[e]
        r = int(a[LANE.cell + i])
        rank[e] = 2 * n - tally[r, LOST]
        for j in range(n):
            lam[j, e] = blocks[r, j, COLUMN.lam]
            for k in range(m):
                U[k, j, 0, e], U[k, j, 1, e] = frames[i, k, j, 0], frames[i, k, j, 1]
    orthonormalise_pass(lam, rank, U, norms, work, padded(count))
    for e in range(count):
        i = lanes[e]
        for k in range(m):
            growths[i, k] += math.log(norms[k, e])
            for j in range(n):
                frames[i, k, j, 0], frames[i, k, j, 1] = U[k, j, 0, e], U[k, j, 1, e]


@kernel
def fly_frame_far(a, i, blocks, tally, frames, growths):
    """As flow_frame, for a flight that spreads the frame far."""
    r = int(a[LANE.cell + i])
    rank = 2 * frames.shape[2] - int(tally[r, LOST])
    no_triangle = np.zeros((0, 0))
    graded_flow(blocks[r], a[LANE.flown + i], frames[i], growths[i], no_triangle, rank)
    orthonormalise(blocks[r, :, COLUMN.lam], frames[i], growths[i], no_triangle, rank)
    a[LANE.frame_spread + i] = 0.0


@kernel
def move_frames(a, events, blocks, tally, frames, growths, space):
    """Take these lanes' tangent vectors through the flight and impact just ended, as stroboscopic.propagate does."""
    lanes, count = space.lanes, np.int64(0)  # no literal, or Numba compiles for it what is called with it
    for i in events:
        side = a[LANE.event + i]
        ratio = a[LANE.a + i] / (side * max(side * a[LANE.v + i], TINY))
        jump = impact_spread(ratio, a[LANE.time_unit + i], a[LANE.loss_spread + i]) if abs(side) == 1.0 else 0.0
        a[LANE.ratio + i], a[LANE.impact_spread + i] = ratio, jump
        due = side != LEFT and needs_reset(a[LANE.frame_spread + i], a[LANE.flown + i] * a[LANE.spread_rate + i] + jump)
        lanes[count] = i
        count += int(due)
        a[LANE.frame_spread + i] = 0.0 if due else a[LANE.frame_spread + i]
    reset_together(a, count, blocks, tally, frames, growths, space)
    for i in events:
        spread = a[LANE.flown + i] * a[LANE.spread_rate + i]
        if a[LANE.event + i] == LEFT:
            continue
        if a[LANE.frame_spread + i] + spread > MAX_SPREAD:
            fly_frame_far(a, i, blocks, tally, frames, growths)
        else:
            flow_frame(a, i, frames)
            a[LANE.frame_spread + i] += spread
        if a[LANE.event + i] == AT_SECTION:
            continue
        saltate_frame(blocks, int(a[LANE.cell + i]), a[LANE.restitution + i], a[LANE.ratio + i], frames, i)
        a[LANE.frame_spread + i] += a[LANE.impact_spread + i]


@inlined
def copy_frame(V, growth, source, W, increase, target):
    """W[target] = V[source], with its growth (m,)."""
    for k in range(V.shape[1]):
        increase[target, k] = growth[source, k]
        for j in range(V.shape[2]):
            W[target, k, j, 0], W[target, k, j, 1] = V[source, k, j, 0], V[source, k, j, 1]
