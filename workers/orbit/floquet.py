"""Floquet multipliers of an orbit without the product of its Jacobians, in which small multipliers would be lost.

A frame, a set of tangent vectors, is carried round the orbit instead.
"""

import math

import numpy as np

from workers.kernel.jit import inline_always, kernel
from workers.kernel.linalg import highest, identity, moduli
from workers.kernel.motion import RUNNING, STATUS, cosine_vectors
from workers.kernel.tangent import inner, reset_frame
from workers.orbit.map import iterate

SPLIT_COUPLING = 1e-13
"""Maximum coupling of the blocks of a Floquet frame that has split into invariant subspaces."""

NARROW = 2.0
"""Maximum log-spread of the multipliers of a block whose product may be formed without loss of significant digits."""


@kernel
def overlaps(blocks, before, after, m):
    """Return the inner products (m, m) of the first m tangent vectors of two frames, with the metric of ``blocks``.

    A frame is a set of tangent vectors. The products are an orthogonal matrix if both frames span the same space.
    """
    products = np.empty((m, m))
    for i in range(m):
        for k in range(m):
            products[i, k] = inner(blocks, before, i, after, k)
    return products


@kernel
def block_ends(rotation):
    """Return the indices at which the diagonal blocks of an orthogonal, block diagonal matrix end."""
    size = len(rotation)
    ends = np.empty(size, dtype=np.int64)
    count = 0
    for end in range(1, size + 1):
        coupling = 0.0
        for i in range(end, size):
            for k in range(end):
                coupling = max(coupling, abs(rotation[i, k]))
        if coupling < SPLIT_COUPLING:
            ends[count] = end
            count += 1
    return ends[:count]


@kernel
def spread_of(logs, ends):
    """Return the largest difference of ``logs``, logarithms of growth, within one diagonal block.

    ``ends`` are the indices at which the diagonal blocks end.
    """
    spread, start = 0.0, 0
    for end in ends:
        least = logs[start]
        for i in range(start + 1, end):
            least = min(least, logs[i])
        spread = max(spread, highest(logs, start, end) - least)
        start = end
    return spread


@kernel
def block_logs(rotation, growth, triangle, ends, size):
    """Return ln|eigenvalues| of the matrix rotation diag(exp(growth)) triangle, and the largest of their moduli.

    They are found for each diagonal block alone; ``ends`` are the indices at which the blocks end. The products are
    scaled against overflow. Missing eigenvalues up to ``size`` are -infinity: lost directions.
    """
    logs = np.full(size, -np.inf)
    largest, start = 0.0, 0
    for end in ends:
        top = highest(growth, start, end)
        product = np.zeros((end - start, end - start))
        for i in range(start, end):
            for k in range(start, end):
                for j in range(start, end):
                    product[i - start, k - start] += rotation[i, j] * math.exp(growth[j] - top) * triangle[j, k]
        for modulus in moduli(product):
            logs[start] = top + math.log(modulus)
            largest = max(largest, abs(logs[start]))
            start += 1
    return logs, largest


@inline_always
def floquet(oscillator, point, steps, half, limit):
    """Return the logs of the moduli of an orbit's multipliers, their rounding error, and the number of turns simulated.

    point        fixed point of the orbit
    steps, half  its turn: number of steps, each a period or with ``half`` the half-period map
    limit        maximum number of turns

    The order is any. The number of turns is 0 if ``limit`` < 2, or if the motion cannot be carried round the orbit.

    A frame, a set of tangent vectors, is carried round the orbit until it splits into invariant subspaces. The factors
    of QR are kept as logarithms, so multipliers of any spread keep their digits. Blocks that do not split have
    multipliers of nearly equal modulus, and their product can be formed. Lost directions are -infinity: a turn that
    loses directions shows only the remaining ones, and another turn may lose more.
    """
    size = point.h.size
    frame = cosine_vectors(point.h.shape[0])
    logs = np.full(size, -np.inf)
    rounding = np.inf
    turns = 0
    for turn in range(1, limit + 1):
        m = frame.shape[0]
        motion = iterate(oscillator, point.h, point.mode, frame.copy(), np.zeros(m), identity(m), steps, half)
        if motion.tally[STATUS] != RUNNING:
            break
        reset_frame(oscillator.gap.blocks, motion)
        rows = np.flatnonzero(motion.growth > -np.inf)
        before, frame = frame, motion.V[rows]
        if turn == 1 or len(rows) < m:
            continue
        rotation = overlaps(oscillator.gap.blocks, before, frame, m)
        ends = block_ends(rotation)
        spread = spread_of(motion.growth, ends)
        if spread < NARROW or turn == limit:
            logs, largest = block_logs(rotation, motion.growth, motion.triangle, ends, size)
            rounding = 1e-15 * (1.0 + largest) * math.exp(min(spread, 700.0))
            turns = turn
            break
    return logs, rounding, turns
