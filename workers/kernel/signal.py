"""The guard of a mode at any time: its value, its derivatives, and bounds of these."""

import math

import numpy as np

from workers.kernel.elementary import sin_cos
from workers.kernel.flow import block_flow, fall
from workers.kernel.fma import fma
from workers.kernel.jit import inlined, kernel
from workers.model.oscillator import COLUMN, NUMBER


@inlined
def forced(phase, w, sin_part, cos_part):
    """One harmonic of the forced part at its phase, of frequency w: value and derivatives in time."""
    sin, cos = sin_cos(phase)
    y, v = fma(sin_part, sin, cos_part * cos), w * fma(sin_part, cos, -cos_part * sin)
    return y, v, -w * w * y, -w * w * v


@inlined
def all_forced(waves, omega, phase):
    """The forced part at a phase, its first three derivatives, and the sum of the moduli that add up to it."""
    y, v, a, j3, scale = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(waves)):
        order = k + 1.0
        y_, v_, a_, j_ = forced(order * phase, order * omega, waves[k, 0], waves[k, 1])
        y, v, a, j3, scale = y + y_, v + v_, a + a_, j3 + j_, scale + abs(y_)
    return y, v, a, j3, scale


@inlined
def block_output(h0, h1, eta, lam, c0, c1, d0, d1):
    """A block's share q = c . (h, h') of the signal, q' = d . (h, h'), and two more: q'' = -2 eta q' - lam q."""
    q0 = fma(c0, h0, c1 * h1)
    q1 = fma(d0, h0, d1 * h1)
    q2 = fma(-2.0 * eta, q1, -lam * q0)
    return q0, q1, q2, fma(-2.0 * eta, q2, -lam * q1)


@inlined
def loaded_output(h0, h1, eta, lam, c0, c1, d0, d1, load):
    """block_output of a block under a load: q'' = -2 eta q' - lam q + c0 load."""
    q0 = fma(c0, h0, c1 * h1)
    q1 = fma(c1, load, fma(d0, h0, d1 * h1))
    q2 = fma(c0, load, fma(-2.0 * eta, q1, -lam * q0))
    return q0, q1, q2, fma(-2.0 * eta, q2, -lam * q1)


@kernel
def evaluate(blocks, waves, omega, h, s, phase, offset):
    """A guard and its first three derivatives a time s after block state h (n, 2) at a phase; scale of rounding.

    Of a mode of these blocks and waves; offset is added to the guard.
    """
    y, v, a, j3, scale = all_forced(waves, omega, fma(omega, s, phase))
    y, scale = y + offset, scale + abs(offset)
    for j in range(len(blocks)):
        block = blocks[j]
        h0, h1 = h[j, 0], h[j, 1]
        eta, lam, load = block[COLUMN.eta], block[COLUMN.lam], block[COLUMN.load]
        if s > 0.0:
            f11, f12, f21, f22 = block_flow(block, s)
            h0, h1 = fma(f11, h0, f12 * h1), fma(f21, h0, f22 * h1)
            if load != 0.0:
                h0, h1 = fma(load, fall(s, eta), h0), fma(load, f12, h1)
        c0, c1, cA0, cA1 = block[COLUMN.c0], block[COLUMN.c1], block[COLUMN.cA0], block[COLUMN.cA1]
        q0, q1, q2, q3 = loaded_output(h0, h1, eta, lam, c0, c1, cA0, cA1, load)
        y += q0
        v += q1
        a += q2
        j3 += q3
        scale += abs(q0)
    return y, v, a, j3, scale


@inlined
def amplitude_bounds(q0, q1, tilt, weight, grow2, grow3, grow4):
    """Bounds of one block's share q of the signal and of its second to fourth derivatives, for all later times.

    sqrt(q^2 + weight (q' + tilt q)^2) bounds q: with tilt = eta and weight = 1 / d it is the amplitude of the
    oscillation, with 0 and 1 / lam the energy, which never grows. The derivatives are at most grow2...grow4 times that.
    """
    turned = fma(tilt, q0, q1)
    b0 = math.sqrt(fma(q0, q0, weight * (turned * turned)))
    return b0, grow2 * b0, grow3 * b0, grow4 * b0


@inlined
def block_bounds(q0, q1, pull, eta, lam, d, inv_w, slow, fast, tilt, weight, grow2, grow3, grow4):
    """amplitude_bounds where the block oscillates, d > 0; else the smaller of two.

    sqrt(q^2 + q'^2 / lam) of each derivative q, since the energy never grows; and where well overdamped the moduli of
    the two exponentials, |alpha| slow^k + |beta| fast^k. A rigid mode, lam = 0, goes anywhere if under a load or
    undamped, unless it stands still, else straight from q to q + q' / (2 eta) = +-alpha; its second and later
    derivatives never grow. pull is what a load adds to q'': see loaded_output.
    """
    a0, a2, a3, a4 = amplitude_bounds(q0, q1, tilt, weight, grow2, grow3, grow4)
    q2 = pull - 2.0 * eta * q1 - lam * q0
    q3 = -2.0 * eta * q2 - lam * q1
    q4 = -2.0 * eta * q3 - lam * q2
    q5 = -2.0 * eta * q4 - lam * q3
    b2 = math.sqrt(q2 * q2 + q3 * q3 * weight)
    b3 = math.sqrt(q3 * q3 + q4 * q4 * weight)
    b4 = math.sqrt(q4 * q4 + q5 * q5 * weight)
    rigid = lam == 0.0
    split = d < -0.5 * lam and not rigid
    alpha = 0.5 * inv_w * abs(fast * q0 + q1)
    beta = 0.5 * inv_w * abs(slow * q0 + q1)
    b0 = min(a0, alpha + beta) if split else a0
    coasts = pull == 0.0 and (eta > 0.0 or q1 == 0.0)
    b0 = (max(abs(q0), alpha) if coasts else np.inf) if rigid else b0
    alpha, beta = alpha * slow * slow, beta * fast * fast
    b2 = min(b2, alpha + beta) if split else b2
    alpha, beta = alpha * slow, beta * fast
    b3 = min(b3, alpha + beta) if split else b3
    alpha, beta = alpha * slow, beta * fast
    b4 = min(b4, alpha + beta) if split else b4
    oscillates = d > 0.0
    return b0, a2 if oscillates else b2, a3 if oscillates else b3, a4 if oscillates else b4


@kernel
def derivative_bounds(blocks, numbers, h):
    """Bounds M0, M2, M3, M4 of a guard's modulus and of its second to fourth derivative, for all times after h (n, 2).

    Of a mode of these blocks and numbers.
    """
    M0, M2, M3, M4 = numbers[NUMBER.amplitude], numbers[NUMBER.swing2], numbers[NUMBER.swing3], numbers[NUMBER.swing4]
    for j in range(len(blocks)):
        block = blocks[j]
        load, c0, c1 = block[COLUMN.load], block[COLUMN.c0], block[COLUMN.c1]
        q0 = c0 * h[j, 0] + c1 * h[j, 1]
        q1 = block[COLUMN.cA0] * h[j, 0] + block[COLUMN.cA1] * h[j, 1] + c1 * load
        b0, b2, b3, b4 = block_bounds(
            q0, q1, c0 * load, block[COLUMN.eta], block[COLUMN.lam], block[COLUMN.d], block[COLUMN.inv_w],
            block[COLUMN.slow], block[COLUMN.fast], block[COLUMN.tilt], block[COLUMN.weight],
            block[COLUMN.grow2], block[COLUMN.grow3], block[COLUMN.grow4],
        )  # fmt: skip
        M0, M2, M3, M4 = M0 + b0, M2 + b2, M3 + b3, M4 + b4
    return M0, M2, M3, M4
