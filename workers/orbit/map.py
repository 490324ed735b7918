"""The map of a motion over some steps, with its Jacobian, and distances between its states.

A step is one forcing period, map P, or half a period with a mirrored state, map G.

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
    """A fixed point of a map F over some periods.

    h, image  (n, 2) block state, (h, h') of each decoupled equation, and F(h)
    mode      number of the mode, the set of linear equations that holds there
    jacobian  (2n, 2n) Jacobian of F
    residual  |F(h) - h| in the energy norm
    """

    h: Array
    image: Array
    mode: int
    jacobian: Array
    residual: float


@kernel
def iterate(oscillator, h, mode, V, growth, triangle, steps, half):
    """Return the motion after ``steps`` steps of the map, from state h (n, 2) in the mode of this number.

    The mode is the set of linear equations of motion that holds, and h the state of its decoupled equations. A step is
    one period, or with ``half`` the half-period map. V, growth and triangle are the tangent vectors to carry, see
    Motion. The status of the motion is not RUNNING if the motion cannot be followed.
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
    """Return the motion after ``steps`` steps of the map from state h (n, 2), without tangent vectors; see iterate.

    h is the state of the decoupled equations of motion, (h, h') of each.
    """
    return iterate(oscillator, h, mode, np.zeros((0, h.shape[0], 2)), np.zeros(0), np.zeros((0, 0)), steps, half)


@kernel
def jacobian_of(V):
    """Return the Jacobian (2n, 2n) of a map whose columns are the tangent vectors V (2n, n, 2) after the map."""
    J = np.empty((len(V), len(V)))
    for i in range(len(V)):
        for k in range(len(V)):
            J[i, k] = V[k, i // 2, i % 2]
    return J


@kernel
def map_with_jacobian(oscillator, h, mode, steps, half):
    """Return the motion after ``steps`` steps of the map from state h (n, 2), and the Jacobian (2n, 2n) of the map.

    h is the state of the decoupled equations of motion, (h, h') of each. See iterate.
    """
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
    """Return the distance of two states h and g (n, 2): the energy norm of their difference, see Block.metric.

    The states are those of the decoupled equations of motion.
    """
    total = 0.0
    for j in range(len(blocks)):
        total += blocks[j, COLUMN.metric] * (h[j, 0] - g[j, 0]) ** 2 + (h[j, 1] - g[j, 1]) ** 2
    return math.sqrt(total)
