"""The least and the greatest value of the gap coordinate in a free flight, from its turning points.

The velocity y' is a signal like y, so the certified search for crossings finds its zeros. No turning point is missed.
"""

import math

import numpy as np

from workers.kernel.by_reference import by_reference
from workers.kernel.crossing import next_crossing
from workers.kernel.flow import flow
from workers.kernel.jit import inline_always
from workers.kernel.signal import evaluate
from workers.model.oscillator import COLUMN, NUMBER, GuardedFlow


@inline_always
def velocity_of(gap):
    """Return a free flight whose signal is the velocity y' in place of the gap coordinate y, and its offset.

    The offset is what a constant load adds to y': c1 load for each block (decoupled equation). The rows of the new
    signal are cA and cA^2, where c is the row of y and A the matrix of the flight. The forced part Y' has amplitudes

        sin_part' = -k omega cos_part,  cos_part' = k omega sin_part.
    """
    blocks, waves, numbers = gap.blocks.copy(), np.empty(gap.waves.shape), np.zeros(len(gap.numbers))
    offset = 0.0
    for j in range(len(blocks)):
        block = gap.blocks[j]
        offset += block[COLUMN.c1] * block[COLUMN.load]
        blocks[j, COLUMN.c0], blocks[j, COLUMN.c1] = block[COLUMN.cA0], block[COLUMN.cA1]
        blocks[j, COLUMN.cA0], blocks[j, COLUMN.cA1] = block[COLUMN.cAA0], block[COLUMN.cAA1]
    omega = gap.numbers[NUMBER.omega]
    numbers[NUMBER.omega] = omega
    for k in range(len(waves)):
        w = (k + 1.0) * omega
        waves[k, 0], waves[k, 1] = -w * gap.waves[k, 1], w * gap.waves[k, 0]
        size = math.hypot(waves[k, 0], waves[k, 1])
        numbers[NUMBER.amplitude] += size
        for power in range(3):
            numbers[NUMBER.swing2 + power] += size * w ** (power + 2.0)
    return GuardedFlow(blocks, waves, numbers, gap.forced), offset


@inline_always
def next_turn(velocity, offset, h, phase, falls, signal_starts, remaining, scratch):
    """Return (time, side, evaluations) of the next turning point of y within ``remaining``, as ``next_crossing`` does.

    velocity, offset  flight whose signal is y', and what is added to the signal, see ``velocity_of``
    h (n, 2)          state of the decoupled equations at the start; moved to the turning point, or to the end
    falls             True if y falls at the start, else y rises
    signal_starts     argument ``start`` of ``next_crossing``

    The zero of y' is a stop of the signal y': the upper stop if y falls, the lower if y rises.
    """
    upper, lower = (0.0, -np.inf) if falls else (np.inf, 0.0)
    signal = by_reference(velocity)
    s, side, evaluations = next_crossing(signal, h, phase, offset, upper, lower, signal_starts, remaining, scratch)
    flow(velocity.blocks, s, h)
    return s, side, evaluations


@inline_always
def turning_points(gap, state, phase, duration, start, low, high, allowance):
    """Return (low, high) widened to include y - y0 at every turning point of a flight, and the number of evaluations.

    gap              free flight with the gap coordinate y - y0 as its signal
    state (n, 2)     block state at the start, (h, h') of each decoupled equation
    phase, duration  forcing phase at the start, and duration of the flight
    start            as in ``next_crossing``, for y
    allowance        maximum number of evaluations

    ``high`` is NaN if the search gave up or exceeded ``allowance``.
    """
    velocity, offset = velocity_of(gap)
    h, scratch = state.copy(), np.empty(state.shape)
    blocks, waves, omega = gap.blocks, gap.waves, gap.numbers[NUMBER.omega]
    _, v, a, _, _ = evaluate(blocks, waves, omega, h, 0.0, phase, 0.0)
    falls = start > 0 or (start == 0 and (v < 0.0 or (v == 0.0 and a < 0.0)))
    begun = start - np.sign(start)  # the first nonzero derivative of y' has one order less
    t, spent = 0.0, 0
    while True:
        s, side, evaluations = next_turn(velocity, offset, h, phase, falls, begun, duration - t, scratch)
        spent += max(1, evaluations)
        phase += omega * s
        t += s
        if side == 0:
            return low, high, spent
        if side == 2 or spent > allowance:
            return low, np.nan, spent
        y = evaluate(blocks, waves, omega, h, 0.0, phase, 0.0)[0]
        low, high = min(low, y), max(high, y)
        falls = not falls
        begun = np.int64(side)
