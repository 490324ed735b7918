"""The tangent frame, the set of tangent vectors that a motion carries along: its flow, and its orthonormalisation.

Gram-Schmidt orthonormalisation keeps the logarithms of its factors, from which Lyapunov exponents follow (Li & Tan
2011).
"""

import math

import numpy as np
from numba import types

from workers.kernel.by_reference import by_value
from workers.kernel.crossing import TINY
from workers.kernel.elementary import cosc_sinc, exp, log, sin_cos
from workers.kernel.external import FLOATS, external
from workers.kernel.flow import flow
from workers.kernel.jit import inline_always, inlined, kernel
from workers.kernel.motion import LOST, SPREAD
from workers.model.oscillator import COLUMN

MAX_SPREAD = 8.0
"""Maximum |log| of the stretch of a frame by flights and impacts before it is made orthonormal again. The limit keeps
12 digits of the most contracted direction. One flight with its impact may exceed it."""

MAX_SPREAD_OF_ONE = 100.0
"""MAX_SPREAD of a frame of one vector: no other vector can drown it, and its square stays in range."""


DEPENDENT = 1e-12
"""Share of a vector that may be rounding of a sum of other vectors, after an event that removes directions."""


@inlined
def inner(blocks, V, i, W, k):
    """Return the inner product sum_j metric_j u_j w_j + u_j' w_j' of u = V[i] and w = W[k].

    For vectors in block coordinates, j numbers the decoupled equations of motion. Undamped flight conserves this
    product.
    """
    total = 0.0
    for j in range(len(blocks)):
        total += blocks[j, COLUMN.metric] * V[i, j, 0] * W[k, j, 0] + V[i, j, 1] * W[k, j, 1]
    return total


@external(FLOATS[2], FLOATS[3], FLOATS[1], FLOATS[2], types.int64)
def orthonormalise(blocks, V, growth, triangle, rank):
    """Make V (m, n, 2) orthonormal in the product of ``inner`` and add the log of each norm to growth (m,).

    rank             number of directions that exist; others are lost, such as that of a mass at rest on a stop
    triangle (m, m)  product of all factors r so far, with rows divided by exp(growth), which keeps it in range; (0, 0)
                     if not wanted

    V = Q r by modified Gram-Schmidt. Vectors beyond the first ``rank`` ones, and zero vectors, are structurally lost:
    their entries become zero and their growth -infinity.
    """
    blocks, V, growth, triangle = by_value(blocks), by_value(V), by_value(growth), by_value(triangle)
    m = V.shape[0]
    for i in range(min(rank, m)):
        norm = math.sqrt(inner(blocks, V, i, V, i))
        if norm == 0.0:
            growth[i] = -np.inf
            continue
        inverse = 1.0 / norm
        for j in range(len(blocks)):
            V[i, j, 0] *= inverse
            V[i, j, 1] *= inverse
        for k in range(i + 1, m):
            overlap = inner(blocks, V, i, V, k)
            for j in range(len(blocks)):
                V[k, j, 0] -= overlap * V[i, j, 0]
                V[k, j, 1] -= overlap * V[i, j, 1]
            if triangle.shape[0] > 0:
                add_row(triangle, growth, i, k, overlap * inverse)
        growth[i] += log(norm)
    for i in range(rank, m):
        for j in range(len(blocks)):
            V[i, j, 0] = V[i, j, 1] = 0.0
        growth[i] = -np.inf


@kernel
def drop_dependent(blocks, V, rank):
    """Set to zero each of the first ``rank`` vectors of V (m, n, 2) that is, to rounding, a sum of earlier vectors.

    If masses do not couple, an event that removes directions may leave fewer independent vectors than directions.
    """
    U, m = V.copy(), min(rank, V.shape[0])
    lengths = np.empty(m)
    for i in range(m):
        lengths[i] = math.sqrt(inner(blocks, V, i, V, i))
    for i in range(m):
        square = inner(blocks, U, i, U, i)
        if not math.sqrt(square) > DEPENDENT * lengths[i]:
            for j in range(len(blocks)):
                V[i, j, 0] = V[i, j, 1] = 0.0
            continue
        for k in range(i + 1, m):
            share = inner(blocks, U, i, U, k) / square
            for j in range(len(blocks)):
                U[k, j, 0] -= share * U[i, j, 0]
                U[k, j, 1] -= share * U[i, j, 1]


@inlined
def log_length(blocks, V, growth):
    """Return the log of the length of the first tangent vector, including ``growth``, the log removed so far."""
    first = np.int64(0)  # typed, as in run_batch
    return growth[0] + 0.5 * log(inner(blocks, V, first, V, first))


@kernel
def add_row(triangle, growth, i, k, factor):
    """Record in ``triangle`` that ``factor`` times tangent vector i was subtracted from vector k.

    The triangle is the product of all factors of the orthonormalisation so far. Its rows are scaled by ``growth``, the
    log of the length removed from each vector so far.
    """
    if factor != 0.0:  # exp(...) may be infinite between uncoupled blocks
        factor *= exp(growth[k] - growth[i])
        for c in range(k, triangle.shape[1]):
            triangle[i, c] += factor * triangle[k, c]


@external(FLOATS[2], types.float64, FLOATS[3], FLOATS[1], FLOATS[2], types.int64)
def graded_flow(blocks, s, V, growth, triangle, rank):
    """Advance the tangent vectors V (m, n, 2) by a flight of any duration s, without loss of contracted directions.

    The result is the product V exp(growth) triangle, whose three factors change in place.

    blocks            constants of the decoupled equations of motion, see Block
    growth, triangle  see ``orthonormalise``
    rank              number of directions that exist

    In coordinates of one decay rate each, a flight is X -> D X, with D = diag(exp(-rate s)) times a rotation. Gaussian
    elimination with pivots by the size in D X gives D X = L U. The well-conditioned L is the new frame, to be made
    orthonormal next; U goes into growth and triangle. No entry of D is multiplied out.
    """
    blocks, V, growth, triangle = by_value(blocks), by_value(V), by_value(growth), by_value(triangle)
    n, m = len(blocks), V.shape[0]
    X = np.empty((2 * n, m))
    back = np.zeros((2 * n, 2))
    decay = np.empty(2 * n)
    for j in range(n):
        eta, lam = blocks[j, COLUMN.eta], blocks[j, COLUMN.lam]
        w2 = eta * eta - lam
        w = math.sqrt(max(w2, 0.0))
        if w * s > 1.0:
            slow, fast = blocks[j, COLUMN.slow], blocks[j, COLUMN.fast]
            # h = a (1, -slow) + b (1, -fast)
            for i in range(m):
                h0, h1 = V[i, j, 0], V[i, j, 1]
                X[2 * j, i] = (fast * h0 + h1) / (2.0 * w)
                X[2 * j + 1, i] = -(slow * h0 + h1) / (2.0 * w)
            decay[2 * j], decay[2 * j + 1] = slow * s, fast * s
            back[2 * j, 0], back[2 * j, 1] = 1.0, -slow
            back[2 * j + 1, 0], back[2 * j + 1, 1] = 1.0, -fast
        else:
            # exp(eta s) times the flow: C and S without their decay
            d = -w2
            x = d * s * s
            if abs(x) < 0.1:
                C, S = cosc_sinc(x)
                S *= s
            elif d > 0.0:
                wd = math.sqrt(d)
                S, C = sin_cos(wd * s)
                S /= wd
            else:
                power = exp(w * s)
                C, S = 0.5 * (power + 1.0 / power), 0.5 * (power - 1.0 / power) / w
            for i in range(m):
                h0, h1 = V[i, j, 0], V[i, j, 1]
                X[2 * j, i] = (C + eta * S) * h0 + S * h1
                X[2 * j + 1, i] = -lam * S * h0 + (C - eta * S) * h1
            decay[2 * j] = decay[2 * j + 1] = eta * s
            back[2 * j, 0] = back[2 * j + 1, 1] = 1.0
    used = np.zeros(2 * n, dtype=np.bool_)
    for i in range(m):
        for j in range(n):
            V[i, j, 0] = V[i, j, 1] = 0.0
    for k in range(min(rank, m)):
        pivot, best = -1, -np.inf
        for i in range(2 * n):
            if not used[i] and X[i, k] != 0.0:
                norm = math.sqrt(blocks[i // 2, COLUMN.metric] * back[i, 0] ** 2 + back[i, 1] ** 2)
                size = log(abs(X[i, k]) * norm) - decay[i]
                if size > best:
                    pivot, best = i, size
        if pivot < 0:
            continue
        used[pivot] = True
        p = X[pivot, k]
        gain = log(abs(p)) - decay[pivot]
        for i in range(2 * n):
            if X[i, k] != 0.0 and (i == pivot or not used[i]):
                share = math.copysign(exp(log(abs(X[i, k])) - decay[i] - gain), X[i, k])
                V[k, i // 2, 0] += share * back[i, 0]
                V[k, i // 2, 1] += share * back[i, 1]
        for later in range(k + 1, m):
            f = X[pivot, later] / p
            for i in range(2 * n):
                if not used[i]:
                    X[i, later] -= f * X[i, k]
            if triangle.shape[0] > 0:
                add_row(triangle, growth, k, later, f)
        growth[k] += gain


@kernel
def spread_rate(blocks):
    """Return the rate, per time, at which a flight stretches some tangent vectors of a frame relative to others.

    The rate is the largest contraction rate of the blocks (the decoupled equations) plus the largest growth rate. The
    flow of a rigid mode of vibration is also a shear, (h, h') -> (h + h' s, h'). It spreads by at most sqrt(metric) per
    time. The flow of a growing block is a shear in the norm of metric = nu^2. It spreads by at most |nu - lam / nu| / 2
    besides eta.
    """
    rate, growth = 0.0, 0.0
    for j in range(len(blocks)):
        eta, lam, root = blocks[j, COLUMN.eta], blocks[j, COLUMN.lam], math.sqrt(blocks[j, COLUMN.metric])
        if blocks[j, COLUMN.slow] < 0.0:
            reach = math.sqrt(eta * eta + 0.25 * (root - lam / root) ** 2)
            rate, growth = max(rate, reach + eta), max(growth, reach - eta)
        else:
            rate = max(rate, blocks[j, COLUMN.fast] + (root if lam == 0.0 else 0.0))
    return rate + growth


@inline_always
def fly_far(oscillator, motion, s):
    """Advance the state and the tangent vectors of a motion by a free flight of any duration s, in place.

    The frame of tangent vectors is made orthonormal at the end.
    """
    blocks = oscillator.gap.blocks
    rank = 2 * len(blocks) - int(motion.tally[LOST])
    flow(blocks, s, motion.h)
    graded_flow(blocks, s, motion.V, motion.growth, motion.triangle, rank)
    reset_frame(blocks, motion)


@kernel
def reset_frame(blocks, motion):
    """Make the tangent vectors of a motion, its frame, orthonormal in place.

    The logarithm of the length of each vector is added to its growth.
    """
    V, growth, tally = motion.V, motion.growth, motion.tally
    if growth.shape[0] > 0:
        orthonormalise(blocks, V, growth, motion.triangle, 2 * V.shape[1] - int(tally[LOST]))
    tally[SPREAD] = 0.0


@inlined
def needs_reset(spread, more, limit):
    """Return True if a frame of tangent vectors must be made orthonormal before the next flight and impact.

    spread  largest stretch so far of some vectors relative to others, as a logarithm
    more    stretch by the flight and the impact
    limit   largest stretch allowed
    """
    return spread > 0.0 and spread + more > limit


@inlined
def impact_spread(ratio, unit, loss):
    """Return the largest stretch by an impact of some tangent vectors relative to others, as a logarithm.

    ratio  a / v, acceleration by velocity of the gap coordinate just before the impact
    unit   time_unit of the oscillator
    loss   value of ``loss_spread``

    The stretch is at most 2 ln(1 + u) + |ln R| with u = |ratio| unit. The bound ln x < (x - 1) / sqrt(x) avoids the
    logarithms.
    """
    u = abs(ratio) * unit
    return 2.0 * u / math.sqrt(1.0 + u) + loss


@inlined
def loss_spread(R):
    """Return the contribution of the coefficient of restitution R to ``impact_spread``: at least |ln R|."""
    return abs(1.0 - R) / math.sqrt(max(R, TINY))
