"""The tangent vectors of many cells at once: their change by flights and impacts, and their orthonormalisation.

A lane is a slot of loops over cells, which holds one cell. Its frame is the set of tangent vectors of that cell. Every
round loops over the first n lanes. A lane still in flight keeps its frame by a mask, which costs less than gathering
the other lanes. ``u`` are the fields of one vector, see ``entry``.

A block is one decoupled equation of the motion. Sums over blocks take two blocks at a time. The blocks before the last
two add up in ``partial``. The loop over the last two completes the sum and uses it at once; further loops then apply it
to the other blocks. Two blocks need only one loop. The number of blocks is even, see layout.padded_blocks. Frames of
four vectors of two blocks are handled by ``two_blocks.py``.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.kernel.crossing import TINY
from workers.kernel.elementary import log
from workers.kernel.fma import fma
from workers.kernel.jit import inline_always, inlined, kernel
from workers.kernel.lanes.layout import (
    AT_SECTION,
    BLOCK,
    BLOCK_SIZE,
    FLYING,
    LANE,
    LANE_SIZE,
    LEFT,
    STRIDE,
    padded_blocks,
    room_for_vectors,
)
from workers.kernel.lanes.search import list_lanes, padded_count
from workers.kernel.lanes.two_blocks import BLOCKS, VECTORS, orthonormalise_frames, transfer_frames
from workers.kernel.tangent import (
    MAX_SPREAD,
    MAX_SPREAD_OF_ONE,
    graded_flow,
    impact_spread,
    needs_reset,
    orthonormalise,
)
from workers.model.oscillator import Array


class Workspace(NamedTuple):
    """Work arrays in which the frames of some lanes are made orthonormal, with m vectors of n blocks.

    A frame is the set of tangent vectors of one lane, which holds one cell, and a block one decoupled equation of
    motion.

    frames  (m, 2 n STRIDE)  vectors, as those of the lanes
    growths (m, STRIDE)      growth of each vector
    metric  (2 n STRIDE,)    metric of each block, at the first number of the block
    rank    (STRIDE,)        number of directions that exist
    lanes   (STRIDE,)        numbers of the lanes
    partial (2 STRIDE,)      room for two sums over blocks
    """

    frames: Array
    growths: Array
    metric: Array
    rank: Array
    lanes: NDArray[np.uint32]
    partial: Array


@inlined
def entry(j, c, i):
    """Return an index into the array of one tangent vector of many cells: number c (0 or 1) of block j of cell i.

    A block is one decoupled equation of motion. The index is unsigned: a check for negative indices would prevent
    vector instructions in a loop over i.
    """
    return np.uint64((2 * j + c) * STRIDE + i)


@inlined
def last_two(u):
    """Return the index, in a vector u, of the first of its last two blocks.

    A block, one decoupled equation of motion, has two numbers in the vector.
    """
    return len(u) // (2 * STRIDE) - 2


@kernel
def clear(partial, count):
    """Set the first ``count`` entries of both rows of partial sums, ``partial``, to zero."""
    for i in range(count):
        partial[entry(0, 0, i)] = partial[entry(0, 1, i)] = 0.0


@inlined
def product_of_two(metric, u, w, j, i, total):
    """Return ``total`` plus the terms of blocks j and j + 1 in the product of tangent vectors u and w of cell i.

    A block is one decoupled equation of motion. For the product see ``tangent.inner``, and for the arrays
    ``normalise_pass``.
    """
    e0, e1, e2, e3 = entry(j, 0, i), entry(j, 1, i), entry(j, 2, i), entry(j, 3, i)
    total = fma(u[e1], w[e1], fma(metric[e0] * u[e0], w[e0], total))
    return fma(u[e3], w[e3], fma(metric[e2] * u[e2], w[e2], total))


@inlined
def scale_two(u, j, i, factor):
    """Multiply blocks j and j + 1 (decoupled equations) of tangent vector u of cell i by ``factor``, in place."""
    u[entry(j, 0, i)] *= factor
    u[entry(j, 1, i)] *= factor
    u[entry(j, 2, i)] *= factor
    u[entry(j, 3, i)] *= factor


@inlined
def subtract_two(u, w, j, i, factor):
    """Subtract ``factor`` times tangent vector u from w in blocks j and j + 1 of cell i, in place.

    A block is one decoupled equation of motion.
    """
    e0, e1, e2, e3 = entry(j, 0, i), entry(j, 1, i), entry(j, 2, i), entry(j, 3, i)
    w[e0] = fma(-factor, u[e0], w[e0])
    w[e1] = fma(-factor, u[e1], w[e1])
    w[e2] = fma(-factor, u[e2], w[e2])
    w[e3] = fma(-factor, u[e3], w[e3])


@kernel
def products(metric, u, w, partial, count):
    """Write the products of tangent vectors u and w of ``count`` cells to ``partial``, without their last two blocks.

    A block is one decoupled equation of the motion. For the product see ``tangent.inner``.
    """
    clear(partial, count)
    for j in range(0, last_two(u), 2):
        for i in range(count):
            partial[i] = product_of_two(metric, u, w, j, i, partial[i])


@kernel
def normalise_pass(metric, rank, k, u, growth, partial, count):
    """Scale tangent vector k of each of ``count`` cells to unit length, one step of tangent.orthonormalise.

    metric (2 n STRIDE,)  metric of each block (decoupled equation), at its first number
    rank   (STRIDE,)      number of directions of each cell that exist
    u      (2 n STRIDE,)  numbers of the vector, see ``entry``
    growth (STRIDE,)      growth of the vector in each cell
    """
    products(metric, u, u, partial, count)
    last = last_two(u)
    for i in range(count):
        square = product_of_two(metric, u, u, last, i, partial[i])
        exists, norm = k < rank[i], math.sqrt(square)
        growth[i] += log(norm if exists else 0.0)
        inverse = 1.0 / norm if exists else 0.0
        scale_two(u, last, i, inverse)
        partial[i] = inverse
    for j in range(0, last, 2):
        for i in range(count):
            scale_two(u, j, i, partial[i])


@kernel
def project_pass(metric, u, w, partial, count):
    """Make a later tangent vector w of each cell orthogonal to the unit vector u, one step of tangent.orthonormalise.

    The arguments are those of ``normalise_pass``.
    """
    products(metric, u, w, partial, count)
    last = last_two(u)
    for i in range(count):
        overlap = product_of_two(metric, u, w, last, i, partial[i])
        subtract_two(u, w, last, i, overlap)
        partial[i] = overlap
    for j in range(0, last, 2):
        for i in range(count):
            subtract_two(u, w, j, i, partial[i])


@inlined
def at(j, field, i):
    """Return the index of a field of block j of lane i in the array of all lanes' fields; unsigned, as in ``entry``.

    A lane holds one cell, and a block is one decoupled equation of motion.
    """
    return np.uint64(LANE_SIZE + j * BLOCK_SIZE + field + i)


@inline_always
def workspace(m, n):
    """Return work arrays for making m tangent vectors of n decoupled equations orthonormal in many cells.

    See Workspace.
    """
    size = 2 * padded_blocks(n) * STRIDE
    return Workspace(
        room_for_vectors(m * size).reshape((m, size)),
        room_for_vectors(m * STRIDE).reshape((m, STRIDE)),
        room_for_vectors(size),
        room_for_vectors(STRIDE),
        np.empty(STRIDE, dtype=np.uint32),
        room_for_vectors(2 * STRIDE),
    )


@kernel
def spread_pass(a, limit, n):
    """Decide for each lane (one cell) how its tangent vectors pass the flight and the impact just completed.

    a      fields of all lanes; those about the tangent vectors change
    limit  largest stretch of some tangent vectors relative to others, as a logarithm
    n      number of lanes

    Return the number of lanes whose tangent vectors must be made orthonormal first, since they would stretch beyond the
    limit.
    """
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


@inlined
def is_whole(vectors, blocks):
    """Return True if ``two_blocks.py`` handles the tangent vectors: each cell has four, of two decoupled equations."""
    return vectors == VECTORS and blocks == BLOCKS


@inline_always
def orthonormalise_due(a, count, frames, growths, space, blocks):
    """Make the tangent vectors of some cells orthonormal, see tangent.orthonormalise.

    a                 fields of all cells
    count             number of these cells; the indices of their fields come first in space.lanes
    frames, growths   tangent vectors of all cells and their growth, changed in place
    space             work arrays
    blocks            number of decoupled equations of motion
    """
    U, growing, metric, rank, lanes, partial = space
    m = len(frames)
    for e in range(count):
        i = np.int64(lanes[e])
        rank[e] = a[LANE.rank + i]
        for j in range(blocks):
            metric[entry(j, 0, e)] = a[at(j, BLOCK.metric, i)]
    for k in range(m):
        gather_vector(lanes, count, blocks, frames[k], growths[k], U[k], growing[k])
    if is_whole(m, blocks):
        orthonormalise_frames(metric, rank, U.ravel(), growing.ravel(), padded_count(count))
    else:
        for k in range(m):
            normalise_pass(metric, rank, k, U[k], growing[k], partial, padded_count(count))
            for later in range(k + 1, m):
                project_pass(metric, U[k], U[later], partial, padded_count(count))
    for k in range(m):
        scatter_vector(lanes, count, blocks, U[k], growing[k], frames[k], growths[k])


@kernel
def gather_vector(lanes, count, blocks, u, growth, w, growing):
    """Copy one tangent vector and its growth from the first ``count`` of these lanes to contiguous arrays.

    The vector u goes to w and its growth to ``growing``. ``lanes`` are numbers of lanes, slots that hold one cell each.
    """
    for e in range(count):
        growing[e] = growth[lanes[e]]
    for j in range(blocks):
        for e in range(count):
            i = np.int64(lanes[e])
            w[entry(j, 0, e)], w[entry(j, 1, e)] = u[entry(j, 0, i)], u[entry(j, 1, i)]


@kernel
def scatter_vector(lanes, count, blocks, w, growing, u, growth):
    """Undo ``gather_vector``: copy one tangent vector and its growth from w and ``growing`` back to its lanes.

    A lane is a slot of loops that holds one cell.
    """
    for e in range(count):
        growth[lanes[e]] = growing[e]
    for j in range(blocks):
        for e in range(count):
            i = np.int64(lanes[e])
            u[entry(j, 0, i)], u[entry(j, 1, i)] = w[entry(j, 0, e)], w[entry(j, 1, e)]


@inlined
def fly_block(a, u, j, i, dy, dv):
    """Carry block j of tangent vector u through the flight just completed in lane i, in place.

    Return (dy, dv), position and velocity of the gap coordinate in the vector, plus the contribution of the block. A
    lane holds one cell, and a block is one decoupled equation of motion.
    """
    flows, e0, e1 = a[LANE.flows + i] > 0.0, entry(j, 0, i), entry(j, 1, i)
    u0, u1 = u[e0], u[e1]
    w0 = fma(a[at(j, BLOCK.f11, i)], u0, a[at(j, BLOCK.f12, i)] * u1)
    w1 = fma(a[at(j, BLOCK.f21, i)], u0, a[at(j, BLOCK.f22, i)] * u1)
    w0, w1 = w0 if flows else u0, w1 if flows else u1
    u[e0], u[e1] = w0, w1
    dy = fma(a[at(j, BLOCK.c1, i)], w1, fma(a[at(j, BLOCK.c0, i)], w0, dy))
    return dy, fma(a[at(j, BLOCK.cA1, i)], w1, fma(a[at(j, BLOCK.cA0, i)], w0, dv))


@inlined
def kick_block(a, u, j, i, along_k, along_Ak):
    """Add the change by an impact in lane i to block j of tangent vector u, in place; see contact.saltation.

    A lane holds one cell, and a block is one decoupled equation of motion.
    """
    e0, e1 = entry(j, 0, i), entry(j, 1, i)
    u[e0] = fma(along_Ak, a[at(j, BLOCK.Ak0, i)], fma(along_k, a[at(j, BLOCK.k0, i)], u[e0]))
    u[e1] = fma(along_Ak, a[at(j, BLOCK.Ak1, i)], fma(along_k, a[at(j, BLOCK.k1, i)], u[e1]))


@kernel
def transfer_pass(a, u, partial, n):
    """Carry tangent vector u of each of n cells through the flight just completed, and through an impact at its end.

    The impact acts as in contact.saltation. ``a`` are the fields of the cells; ``partial`` is overwritten.
    """
    last = last_two(u)
    clear(partial, n)
    for j in range(0, last, 2):
        for i in range(n):
            first, second = entry(0, 0, i), entry(0, 1, i)
            dy, dv = fly_block(a, u, j, i, partial[first], partial[second])
            partial[first], partial[second] = fly_block(a, u, j + 1, i, dy, dv)
    for i in range(n):
        first, second = entry(0, 0, i), entry(0, 1, i)
        dy, dv = fly_block(a, u, last, i, partial[first], partial[second])
        dy, dv = fly_block(a, u, last + 1, i, dy, dv)
        along_k = -a[LANE.loss + i] * fma(-a[LANE.ratio + i], dy, dv)
        along_Ak = -a[LANE.loss + i] * dy
        kick_block(a, u, last, i, along_k, along_Ak)
        kick_block(a, u, last + 1, i, along_k, along_Ak)
        partial[first], partial[second] = along_k, along_Ak
    for j in range(0, last, 2):
        for i in range(n):
            first, second = entry(0, 0, i), entry(0, 1, i)
            kick_block(a, u, j, i, partial[first], partial[second])
            kick_block(a, u, j + 1, i, partial[first], partial[second])


@inline_always
def fly_frame_far(a, i, blocks, frames, growths):
    """Carry the tangent vectors of one cell through a long flight, which stretches some vectors far more than others.

    i                       lane that holds the cell
    blocks (N, n, columns)  constants of the decoupled equations of all cells

    The vectors become orthonormal. Otherwise ``transfer_pass`` does the work.
    """
    m, n = frames.shape[0], blocks.shape[1]
    constants, rank = blocks[int(a[LANE.cell + i])], int(a[LANE.rank + i])
    V, growth, no_triangle = np.empty((m, n, 2)), np.empty(m), np.zeros((0, 0))
    store_frame(frames, growths, i, V, growth)
    graded_flow(constants, a[LANE.flown + i], V, growth, no_triangle, rank)
    orthonormalise(constants, V, growth, no_triangle, rank)
    load_frame(V, growth, frames, growths, i)


@inline_always
def move_frames(a, n, blocks, frames, growths, space):
    """Carry the tangent vectors of the first n lanes (one cell each) through the flights and impacts just completed.

    blocks (N, n, columns)  constants of the decoupled equations of all cells
    """
    if spread_pass(a, MAX_SPREAD if len(frames) > 1 else MAX_SPREAD_OF_ONE, n) > 0:
        count = list_lanes(a, LANE.due, n, space.lanes)
        orthonormalise_due(a, count, frames, growths, space, blocks.shape[1])
        for i in space.lanes[:count]:
            if a[LANE.far + i] > 0.0:
                fly_frame_far(a, np.int64(i), blocks, frames, growths)
    if is_whole(len(frames), blocks.shape[1]):
        transfer_frames(a, frames.ravel(), n)
    else:
        for k in range(len(frames)):
            transfer_pass(a, frames[k], space.partial, n)


@inlined
def square_of_block(a, u, j, i, total):
    """Return ``total`` plus the contribution of block j to the squared length of tangent vector u in lane i.

    A lane holds one cell, and a block is one decoupled equation of motion.
    """
    u0, u1 = u[entry(j, 0, i)], u[entry(j, 1, i)]
    return fma(u1, u1, fma(a[at(j, BLOCK.metric, i)] * u0, u0, total))


@kernel
def measure_pass(a, u, growth, partial, n):
    """Set the growth of the first tangent vector over the period, in cells that end a period or have just started.

    LANE.log_length is tangent.log_length at the start of the period, NaN if unknown.
    """
    last = last_two(u)
    clear(partial, n)
    for j in range(0, last, 2):
        for i in range(n):
            partial[i] = square_of_block(a, u, j + 1, i, square_of_block(a, u, j, i, partial[i]))
    for i in range(n):
        before = a[LANE.log_length + i]
        square = square_of_block(a, u, last + 1, i, square_of_block(a, u, last, i, partial[i]))
        length = growth[i] + 0.5 * log(square)
        a[LANE.period_growth + i] = length - before
        a[LANE.log_length + i] = length if a[LANE.event + i] == AT_SECTION or before != before else before


@inlined
def load_frame(V, growth, frames, growths, i):
    """Copy tangent vectors V (m, n, 2) with their growth (m,) into lane i (one cell) of the arrays of all lanes."""
    for k in range(V.shape[0]):
        growths[k, i] = growth[k]
        for j in range(V.shape[1]):
            frames[k, entry(j, 0, i)], frames[k, entry(j, 1, i)] = V[k, j, 0], V[k, j, 1]


@inlined
def store_frame(frames, growths, i, V, growth):
    """Write the tangent vectors of lane i (one cell) to V (m, n, 2) and their growth to growth (m,)."""
    for k in range(V.shape[0]):
        growth[k] = growths[k, i]
        for j in range(V.shape[1]):
            V[k, j, 0], V[k, j, 1] = frames[k, entry(j, 0, i)], frames[k, entry(j, 1, i)]
