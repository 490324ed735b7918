"""The map of some steps, whole periods P or half periods G, with its Jacobian; distances between its states.

For a symmetric gap G o G = P.
"""

import math
from typing import NamedTuple

import numpy as np

from workers.kernel.borrow import borrow
from workers.kernel.hybrid.neutral import freeze
from workers.kernel.jit import inline_always, kernel
from workers.kernel.motion import RUNNING, STATUS, axes, has_modes, motion_with
from workers.kernel.period import step
from workers.model.oscillator import COLUMN, Array


class FixedPoint(NamedTuple):
    """A fixed point of some steps of the map: block state, its image, mode, Jacobian and residual |F(h) - h|."""

    h: Array
    image: Array
    mode: int
    jacobian: Array
    residual: float


@kernel
def iterate(oscillator, h, mode, V, growth, triangle, steps, half):
    """Return the motion after ``steps`` of the map, half or whole periods, from block state h; see motion_with.

    Its status is not RUNNING if the motion cannot be followed.
    """
    motion = motion_with(h, mode, V, growth, triangle)
    for _ in range(steps):
        step(oscillator, borrow(motion), half)
        if motion.tally[STATUS] != RUNNING:
            return motion
    if has_modes(oscillator):
        freeze(oscillator, motion)
    return motion


@kernel
def iterate_alone(oscillator, h, mode, steps, half):
    """Return the motion after ``steps`` of the map from block state h, without tangent vectors."""
    return iterate(oscillator, h, mode, np.zeros((0, h.shape[0], 2)), np.zeros(0), np.zeros((0, 0)), steps, half)


@kernel
def jacobian_of(V):
    """Return the Jacobian (2n, 2n) with tangent vectors V (2n, n, 2) as columns."""
    J = np.empty((len(V), len(V)))
    for i in range(len(V)):
        for k in range(len(V)):
            J[i, k] = V[k, i // 2, i % 2]
    return J


@kernel
def map_with_jacobian(oscillator, h, mode, steps, half):
    """Return the motion after ``steps`` of the map from h, and the Jacobian (2n, 2n) of the map there."""
    motion = iterate(oscillator, h, mode, axes(h.shape[0]), np.zeros(0), np.zeros((0, 0)), steps, half)
    return motion, jacobian_of(motion.V)


@inline_always
def squares(values):
    """Return the sum of the squares of all entries of an array."""
    total = 0.0
    for value in values.ravel():
        total += value * value
    return total


@kernel
def separation(blocks, h, g):
    """Return the energy norm of the difference of two block states (n, 2), see Block.metric."""
    total = 0.0
    for j in range(len(blocks)):
        total += blocks[j, COLUMN.metric] * (h[j, 0] - g[j, 0]) ** 2 + (h[j, 1] - g[j, 1]) ** 2
    return math.sqrt(total)
