"""Outputs of a motion: their extremes, and step lengths with which Gauss integration is exact to rounding.

An output is a displacement, velocity or acceleration to be measured. In a mode, a set of linear equations, it is a sum
of exponentials and harmonics.
"""

import math

import numpy as np

from workers.kernel.elementary import exp_minus
from workers.kernel.excursion import turning_points, velocity_of
from workers.kernel.jit import kernel
from workers.kernel.motion import MARCH_GAVE_UP, OVERDRAFT, STATUS, WORK, spend
from workers.kernel.signal import derivative_bounds, evaluate
from workers.model.oscillator import COLUMN, NUMBER, OF_FLOW, OF_GUARD, GuardedFlow

NODES, WEIGHTS = (np.ascontiguousarray(array) for array in np.polynomial.legendre.leggauss(10))
"""Gauss points and weights on [-1, 1], exact for polynomials of degree 19."""

REACH = 2.0
"""Maximum rate times step for which the points are exact to rounding. For a product of two exponentials of that rate
the error is (2 REACH)^20 (10!)^4 / (21 (20!)^3) = 6e-19 of the greatest value."""

DEGREE = 20
"""Order of the derivative in the error of the rule: after a decay by e^-x steps may be longer by e^(x / DEGREE)."""

LEVEL = 1e-15
"""Relative change on a leg, as a share of its terms, below which an output counts as constant."""

POSITION, RATE, ACCELERATION = range(3)
"""Order of the derivative of the displacements that an output acts on."""


@kernel
def longest_panel(blocks, top, since):
    """Return the longest step of Gauss integration on which the integral of a squared output is exact to rounding.

    blocks  decoupled equations of the mode, the set of linear equations that holds
    top     greatest forcing frequency
    since   time from the start of the motion in the mode to the start of the step

    An exponential e^(r s) with decay rate q has decayed by e^(-q since), which allows a longer step. See REACH.
    """
    longest = REACH / top
    for j in range(len(blocks)):
        eta, lam = blocks[j, COLUMN.eta], blocks[j, COLUMN.lam]
        if blocks[j, COLUMN.d] > 0.0:
            longest = min(longest, REACH / math.sqrt(lam) / exp_minus(max(eta, 0.0) * since / DEGREE))
            continue
        for rate in (blocks[j, COLUMN.slow], blocks[j, COLUMN.fast]):
            if rate != 0.0:
                longest = min(longest, REACH / abs(rate) / exp_minus(max(rate, 0.0) * since / DEGREE))
    return longest


@kernel
def mode_with(modes, k, row, direct):
    """Return mode k with an output as its signal, and the output at equilibrium without forced response.

    modes, k        table of modes (sets of linear equations), and the index of the mode in it
    row    (2n + 1,)  the output as a row on (x, v, 1)
    direct (H, 2)     contribution of the force to the output
    """
    blocks, forced, waves = modes.blocks[k, 0].copy(), modes.forced[k], direct.copy()
    size = 2 * len(blocks)
    blocks[:, OF_FLOW:OF_GUARD] = 0.0
    offset = row[size]
    for i in range(size):
        weight = 0.0
        for j in range(size):
            weight += row[j] * modes.to_physical[k, j, i]
        blocks[i // 2, COLUMN.c0 + i % 2] = weight
        offset += weight * blocks[i // 2, COLUMN.rest0 + i % 2]
        for w in range(len(waves)):
            waves[w, 0] += weight * forced[i // 2, i % 2, w, 0]
            waves[w, 1] += weight * forced[i // 2, i % 2, w, 1]
    for j in range(len(blocks)):
        eta, lam, block = blocks[j, COLUMN.eta], blocks[j, COLUMN.lam], blocks[j]
        block[COLUMN.cA0], block[COLUMN.cA1] = -lam * block[COLUMN.c1], block[COLUMN.c0] - 2.0 * eta * block[COLUMN.c1]
        block[COLUMN.cAA0], block[COLUMN.cAA1] = (
            -lam * block[COLUMN.cA1], block[COLUMN.cA0] - 2.0 * eta * block[COLUMN.cA1]
        )  # fmt: skip
    return GuardedFlow(blocks, waves, modes.numbers[k, 0], forced), offset


@kernel
def output_row(modes, k, row, order):
    """Return an output in mode k as a row (2n + 1,) on (x, v, 1), and what the force adds to the output (H, 2).

    row   (n,)  weights of the output on the displacements x, or on their derivatives
    order       order of the derivative: 0 for x, 1 for v, 2 for the acceleration

    The mode, a set of linear equations, decides the acceleration.
    """
    n = len(row)
    full, direct = np.zeros(2 * n + 1), np.zeros(modes.direct.shape[2:])
    for i in range(n):
        if order < ACCELERATION:
            full[int(order) * n + i] = row[i]
            continue
        for j in range(2 * n + 1):
            full[j] += row[i] * modes.acceleration[k, i, j]
        for w in range(len(direct)):
            direct[w, 0] += row[i] * modes.drive[k, i, w, 0]
            direct[w, 1] += row[i] * modes.drive[k, i, w, 1]
    return full, direct


@kernel
def extremes(modes, k, row, direct, h, phase, s, tally):
    """Return the least and the greatest value of an output in a flight of duration s in mode k.

    A mode is a set of linear equations of motion.

    row, direct  the output, see ``mode_with``
    h (n, 2)     block state at the start, (h, h') of each decoupled equation
    phase        forcing phase at the start
    tally        counts of the motion, changed in place

    The output counts as constant if a bound of its rate limits its change to LEVEL.
    """
    mode, offset = mode_with(modes, k, row, direct)
    omega = mode.numbers[NUMBER.omega]
    begin_value, _, _, _, size = evaluate(mode.blocks, mode.waves, omega, h, 0.0, phase, 0.0)
    end_value = evaluate(mode.blocks, mode.waves, omega, h, s, phase, 0.0)[0]
    low, high = min(begin_value, end_value), max(begin_value, end_value)
    velocity, drift = velocity_of(mode)
    rate = abs(drift) + derivative_bounds(velocity.blocks, velocity.numbers, h, s)[0]
    if not rate * s <= LEVEL * (size + abs(offset)):
        allowance = tally[WORK] + OVERDRAFT
        low, high, evaluations = turning_points(mode, h, phase, s, 0, low, high, allowance)
        spend(tally, evaluations)
        if math.isnan(high):
            tally[STATUS] = MARCH_GAVE_UP
    return low + offset, high + offset
