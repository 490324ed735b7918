"""The tangent frames of a batch's lanes: through flights and impacts, and made orthonormal again.

Loops over the first n lanes, all of them in every round: a lane whose flight goes on keeps its frame by a mask, which
costs less than to pick the others out. u are the fields of one vector, see entry.
modes is a tuple with one entry per block: its length is known when a kernel is compiled, so that loops over blocks
inside one over lanes are unrolled.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.kernel.batch.layout import AT_SECTION, BLOCK, BLOCK_SIZE, COLUMN, FLYING, LANE, LANE_SIZE, LEFT, STRIDE
from workers.kernel.batch.search import list_lanes, padded
from workers.kernel.elementary import log
from workers.kernel.flight import TINY
from workers.kernel.fma import fma
from workers.kernel.frame import graded_flow, orthonormalise
from workers.kernel.jit import inlined, kernel
from workers.kernel.stroboscopic import MAX_SPREAD, impact_spread, needs_reset

Array = NDArray[np.float64]

MAX_SPREAD_OF_ONE = 100.0
"""MAX_SPREAD of a frame of one vector, which no other can drown: its square stays in range."""


class Workspace(NamedTuple):
    """Where the frames of some lanes are made orthonormal, as normalise_pass takes them; lanes are which.

    frames (m, 2 n STRIDE) and growths (m, STRIDE) as those of the lanes, lam (2 n STRIDE,), rank (STRIDE,).
    """

    frames: Array
    growths: Array
    lam: Array
    rank: Array
    lanes: NDArray[np.uint32]


@inlined
def entry(j, c, i):
    """Where number c (0 or 1) of block j of frame i is in the numbers of one vector of many frames.

    Unsigned: the check of a negative index would keep a loop over i from becoming vector instructions.
    """
    return np.uint64((2 * j + c) * STRIDE + i)


@kernel
def normalise_pass(lam, rank, k, u, growth, modes, count):
    """The part of frame.orthonormalise that makes vector k a unit vector, for ``count`` frames at once.

    u (2 n STRIDE,) are its numbers, see entry, and lam (2 n STRIDE,) stands where the first of each two does; rank and
    growth (STRIDE,) have one number for each frame; modes is a tuple of length n.
    """
    for i in range(count):
        square = 0.0
        for j in range(len(modes)):
            u0, u1 = u[entry(j, 0, i)], u[entry(j, 1, i)]
            square = fma(u1, u1, fma(lam[entry(j, 0, i)] * u0, u0, square))
        exists, norm = k < rank[i], math.sqrt(square)
        growth[i] += log(norm if exists else 0.0)
        inverse = 1.0 / norm if exists else 0.0
        for j in range(len(modes)):
            u[entry(j, 0, i)] *= inverse
            u[entry(j, 1, i)] *= inverse


@kernel
def project_pass(lam, u, w, modes, count):
    """The part of frame.orthonormalise that takes the unit vector u out of the later vector w; see normalise_pass."""
    for i in range(count):
        overlap = 0.0
        for j in range(len(modes)):
            e0, e1 = entry(j, 0, i), entry(j, 1, i)
            overlap = fma(u[e1], w[e1], fma(lam[e0] * u[e0], w[e0], overlap))
        for j in range(len(modes)):
            e0, e1 = entry(j, 0, i), entry(j, 1, i)
            w[e0] = fma(-overlap, u[e0], w[e0])
            w[e1] = fma(-overlap, u[e1], w[e1])


@inlined
def at(j, field, i):
    """Where a field of block j of lane i is; unsigned as entry is."""
    return np.uint64(LANE_SIZE + j * BLOCK_SIZE + field + i)


@kernel
def workspace(m, n):
    """A workspace for m vectors of n blocks."""
    return Workspace(
        np.zeros((m, 2 * n * STRIDE)),
        np.zeros((m, STRIDE)),
        np.zeros(2 * n * STRIDE),
        np.zeros(STRIDE),
        np.zeros(STRIDE, dtype=np.uint32),
    )


@kernel
def spread_pass(a, limit, n):
    """What happens to each frame; how many are to be orthonormal first, also those that the flight spreads far."""
    count = 0
    for i in range(n):
        side, v, before = a[LANE.event + i], a[LANE.v + i], a[LANE.frame_spread + i]
        hit = abs(side) == 1.0
        moves = side != FLYING and side != LEFT
        ratio = a[LANE.a + i] / (side * max(side * v, TINY))
        ratio = ratio if hit else 0.0
        jump = impact_spread(ratio, a[LANE.time_unit + i], a[LANE.loss_spread + i])
        jump = jump if hit else 0.0
        spread = a[LANE.flown + i] * a[LANE.spread_rate + i]
        due = moves and needs_reset(before, spread + jump, limit)
        start = 0.0 if due else before
        far = moves and start + spread > limit
        after = (0.0 if far else start + spread) + jump
        a[LANE.frame_spread + i] = after if moves else before
        a[LANE.ratio + i] = ratio
        a[LANE.loss + i] = 1.0 + a[LANE.restitution + i] if hit else 0.0
        a[LANE.due + i] = 1.0 if due or far else 0.0
        count += int(due or far)
        a[LANE.far + i] = 1.0 if far else 0.0
        a[LANE.flows + i] = 1.0 if moves and not far else 0.0
    return count


@kernel
def orthonormalise_due(a, count, frames, growths, space, modes):
    """frame.orthonormalise of the frames of the first ``count`` of space.lanes."""
    U, growing, lam, rank, lanes = space
    m = len(frames)
    for e in range(count):
        i = lanes[e]
        rank[e] = a[LANE.rank + i]
        for j in range(len(modes)):
            lam[entry(j, 0, e)] = a[at(j, BLOCK.lam, i)]
        for k in range(m):
            growing[k, e] = growths[k, i]
            for j in range(len(modes)):
                U[k, entry(j, 0, e)], U[k, entry(j, 1, e)] = frames[k, entry(j, 0, i)], frames[k, entry(j, 1, i)]
    for k in range(m):
        normalise_pass(lam, rank, k, U[k], growing[k], modes, padded(count))
        for later in range(k + 1, m):
            project_pass(lam, U[k], U[later], modes, padded(count))
    for e in range(count):
        i = lanes[e]
        for k in range(m):
            growths[k, i] = growing[k, e]
            for j in range(len(modes)):
                frames[k, entry(j, 0, i)], frames[k, entry(j, 1, i)] = U[k, entry(j, 0, e)], U[k, entry(j, 1, e)]


@kernel
def transfer_pass(a, u, modes, n):
    """Take one vector through the flights that have ended, and through the impacts, as impact.saltation does."""
    for i in range(n):
        flows, dy, dv = a[LANE.flows + i] > 0.0, 0.0, 0.0
        for j in range(len(modes)):
            e0, e1 = entry(j, 0, i), entry(j, 1, i)
            u0, u1 = u[e0], u[e1]
            w0 = fma(a[at(j, BLOCK.f11, i)], u0, a[at(j, BLOCK.f12, i)] * u1)
            w1 = fma(a[at(j, BLOCK.f21, i)], u0, a[at(j, BLOCK.f22, i)] * u1)
            w0, w1 = w0 if flows else u0, w1 if flows else u1
            u[e0], u[e1] = w0, w1
            dy = fma(a[at(j, BLOCK.c1, i)], w1, fma(a[at(j, BLOCK.c0, i)], w0, dy))
            dv = fma(a[at(j, BLOCK.cA1, i)], w1, fma(a[at(j, BLOCK.cA0, i)], w0, dv))
        along_k = -a[LANE.loss + i] * fma(-a[LANE.ratio + i], dy, dv)
        along_Ak = -a[LANE.loss + i] * dy
        for j in range(len(modes)):
            e0, e1 = entry(j, 0, i), entry(j, 1, i)
            u[e0] = fma(along_Ak, a[at(j, BLOCK.Ak0, i)], fma(along_k, a[at(j, BLOCK.k0, i)], u[e0]))
            u[e1] = fma(along_Ak, a[at(j, BLOCK.Ak1, i)], fma(along_k, a[at(j, BLOCK.k1, i)], u[e1]))


@kernel
def fly_frame_far(a, i, blocks, frames, growths):
    """As transfer_pass for the flight of lane i, which spreads its frame far; blocks: see Batch."""
    m, n = frames.shape[0], blocks.shape[1]
    constants, rank = blocks[int(a[LANE.cell + i])], int(a[LANE.rank + i])
    V, growth, no_triangle = np.empty((m, n, 2)), np.empty(m), np.zeros((0, 0))
    take_frame(frames, growths, i, V, growth)
    graded_flow(constants, a[LANE.flown + i], V, growth, no_triangle, rank)
    orthonormalise(constants[:, COLUMN.lam], V, growth, no_triangle, rank)
    give_frame(V, growth, frames, growths, i)


@kernel
def move_frames(a, n, blocks, frames, growths, space, modes):
    """Take the tangent vectors of all lanes through the flights and impacts just ended, as stroboscopic.propagate does.

    blocks: see Batch.
    """
    if spread_pass(a, MAX_SPREAD if len(frames) > 1 else MAX_SPREAD_OF_ONE, n) > 0:
        count = list_lanes(a, LANE.due, n, space.lanes)
        orthonormalise_due(a, count, frames, growths, space, modes)
        for i in space.lanes[:count]:
            if a[LANE.far + i] > 0.0:
                fly_frame_far(a, i, blocks, frames, growths)
    for k in range(len(frames)):
        transfer_pass(a, frames[k], modes, n)


@kernel
def measure_pass(a, u, growth, modes, n):
    """The growth over the period of the first vector, where a lane is at its section or has just begun.

    LANE.log_length, NaN where it is yet unknown, is frame.log_length at the last section.
    """
    for i in range(n):
        before, square = a[LANE.log_length + i], 0.0
        for j in range(len(modes)):
            u0, u1 = u[entry(j, 0, i)], u[entry(j, 1, i)]
            square = fma(u1, u1, fma(a[at(j, BLOCK.lam, i)] * u0, u0, square))
        length = growth[i] + 0.5 * log(square)
        a[LANE.period_growth + i] = length - before
        a[LANE.log_length + i] = length if a[LANE.event + i] == AT_SECTION or before != before else before


@inlined
def give_frame(V, growth, frames, growths, i):
    """Put tangent vectors V (m, n, 2) with their growth (m,) into lane i."""
    for k in range(V.shape[0]):
        growths[k, i] = growth[k]
        for j in range(V.shape[1]):
            frames[k, entry(j, 0, i)], frames[k, entry(j, 1, i)] = V[k, j, 0], V[k, j, 1]


@inlined
def take_frame(frames, growths, i, V, growth):
    """Write the tangent vectors of lane i to V (m, n, 2) and their growth (m,)."""
    for k in range(V.shape[0]):
        growth[k] = growths[k, i]
        for j in range(V.shape[1]):
            V[k, j, 0], V[k, j, 1] = frames[k, entry(j, 0, i)], frames[k, entry(j, 1, i)]
