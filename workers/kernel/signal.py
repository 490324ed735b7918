"""The guard of a mode as a signal in time: its value, its derivatives, and bounds of them for all later times.

A mode is a set of linear equations of motion, decoupled into blocks; its guard is the signal that can end it.
"""

import math

import numpy as np

from workers.kernel.elementary import exp, sin_cos
from workers.kernel.flow import block_flow, moved_by_load
from workers.kernel.fma import fma
from workers.kernel.jit import inlined, kernel
from workers.model.oscillator import COLUMN, NUMBER


@inlined
def forced(phase, w, sin_part, cos_part):
    """Return the contribution of one harmonic of the force to a signal, and its first three derivatives in time.

    phase               phase of the harmonic
    w                   frequency of the harmonic
    sin_part, cos_part  amplitudes of its sine and cosine
    """
    sin, cos = sin_cos(phase)
    y, v = fma(sin_part, sin, cos_part * cos), w * fma(sin_part, cos, -cos_part * sin)
    return y, v, -w * w * y, -w * w * v


@inlined
def all_forced(waves, omega, phase):
    """Return the contribution of all harmonics of the force to a signal, and its first three derivatives in time.

    waves (H, 2)  amplitudes of sine and cosine of each harmonic
    omega, phase  forcing frequency and phase

    The sum of the moduli of its terms comes last. Orders that the force lacks cost no sine.
    """
    y, v, a, j3, scale = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(waves)):
        if waves[k, 0] == 0.0 and waves[k, 1] == 0.0:
            continue
        order = k + 1.0
        y_, v_, a_, j_ = forced(order * phase, order * omega, waves[k, 0], waves[k, 1])
        y, v, a, j3, scale = y + y_, v + v_, a + a_, j3 + j_, scale + abs(y_)
    return y, v, a, j3, scale


@inlined
def block_output(h0, h1, eta, lam, c0, c1, d0, d1):
    """Return the contribution q of one block to a signal, and the first three derivatives of q.

    A block is a decoupled equation of motion with state (h, h'). q = c . (h, h'), q' = d . (h, h'), q'' = -2 eta q' -
    lam q.
    """
    q0 = fma(c0, h0, c1 * h1)
    q1 = fma(d0, h0, d1 * h1)
    q2 = fma(-2.0 * eta, q1, -lam * q0)
    return q0, q1, q2, fma(-2.0 * eta, q2, -lam * q1)


@inlined
def loaded_output(h0, h1, eta, lam, c0, c1, d0, d1, load):
    """Return ``block_output``, the contribution of a decoupled equation to a signal, for one under a constant load.

    Then q'' = -2 eta q' - lam q + c0 load.
    """
    q0 = fma(c0, h0, c1 * h1)
    q1 = fma(c1, load, fma(d0, h0, d1 * h1))
    q2 = fma(c0, load, fma(-2.0 * eta, q1, -lam * q0))
    return q0, q1, q2, fma(-2.0 * eta, q2, -lam * q1)


@kernel
def evaluate(blocks, waves, omega, h, s, phase, offset):
    """Return a guard plus ``offset`` at a time s, its first three derivatives, and the scale of its rounding.

    blocks, waves  decoupled equations of motion, and forced part of the guard, see GuardedFlow
    omega          forcing frequency
    h      (n, 2)  state at the start, (h, h') of each equation
    phase          forcing phase at the start

    A guard is a signal that can end the present law of motion.
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
                h0, h1 = fma(load, moved_by_load(s, eta), h0), fma(load, f12, h1)
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
    """Return bounds, for all later times, of a block's contribution q to a signal and of its 2nd to 4th derivatives.

    A block is a decoupled equation of motion.

    q0 and q1 are q and q' now. sqrt(q^2 + weight (q' + tilt q)^2) bounds q. With tilt = eta and weight = 1 / d it is
    the amplitude of the oscillation. With tilt = 0 and weight = 1 / lam it is the energy, which never grows. The
    derivatives are at most grow2...grow4 times that bound.
    """
    turned = fma(tilt, q0, q1)
    b0 = math.sqrt(fma(q0, q0, weight * (turned * turned)))
    return b0, grow2 * b0, grow3 * b0, grow4 * b0


@inlined
def block_bounds(q0, q1, pull, eta, lam, d, inv_w, slow, fast, tilt, weight, grow2, grow3, grow4):
    """Return bounds, for all later times, of a block's contribution q to a signal and of its 2nd to 4th derivative.

    A block is a decoupled equation of motion.

    q0, q1  q and q' now
    pull    contribution of the load to q'', see ``loaded_output``

    For the other arguments see Block. The bounds are those of ``amplitude_bounds`` for an oscillating block, d > 0. For
    other blocks each is the smaller of two bounds.

    The first bound is sqrt(q^2 + q'^2 / lam) of each derivative q, since the energy never grows. The second holds in a
    well overdamped block: the moduli of both exponentials, |alpha| slow^k + |beta| fast^k.

    A rigid mode of vibration, lam = 0, is unbounded under a load or without damping, unless it stands still. Otherwise
    it goes straight from q to q + q' / (2 eta) = +-alpha, and its second and later derivatives never grow.
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


DERIVATIVE_ROUNDING = 4.0 * float(np.finfo(np.float64).eps)
"""Relative error of a derivative of a signal, as a share of its terms. Along a direction in which a block seems not to
move, the lost digits grow by the block's rate in each derivative."""

FINEST = 1e6
"""Maximum useful ratio of the frequency of a norm to those of its block; any frequency gives a bound."""


@kernel
def growing_bounds(q0, q1, size0, size1, pull, eta, lam, d, inv_w, slow, fast, H):
    """Return bounds, for times up to H, of a growing block's contribution q to a signal and of three derivatives.

    A block is a decoupled equation of motion; it grows if slow < 0.

    q0, q1        q and q' at the start
    size0, size1  sums of moduli of the terms of q and q'
    pull          contribution of the load to q''

    The derivatives are the second to fourth. The k-th derivative is at most each of

        d > 0:   sqrt(q^2 + (q' + eta q)^2 / d) lam^(k/2) e^(-eta H)
        d < 0:   |a| |r+|^k e^(max(0, r+) H) + |b| |r-|^k e^(max(0, r-) H),  q = a e^(r+ s) + b e^(r- s)
        any nu:  sqrt(q(k)^2 + (q(k+1) / nu)^2) e^(max(0, m) H),  m = -eta + sqrt(eta^2 + (nu - lam / nu)^2 / 4)
        d >= 0:  (|q(k)| + |q(k+1) + eta q(k)| H) e^(-eta H)

    each widened by rounding.
    """
    if size0 + size1 == 0.0 and pull == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    if np.inf == H:
        return np.inf, np.inf, np.inf, np.inf
    q2 = pull - 2.0 * eta * q1 - lam * q0
    e0, e1 = DERIVATIVE_ROUNDING * size0, DERIVATIVE_ROUNDING * size1
    e2 = 2.0 * abs(eta) * e1 + abs(lam) * e0 + DERIVATIVE_ROUNDING * (abs(pull) + abs(2.0 * eta * q1) + abs(lam * q0))
    if pull != 0.0:  # lam = 0: q'' grows by e^(-2 eta s)
        b2 = (abs(q2) + e2) * exp(-2.0 * eta * H)
        b0 = abs(q0) + e0 + (abs(q1) + e1) * H + 0.5 * b2 * H * H
        return b0, b2, 2.0 * abs(eta) * b2, 4.0 * eta * eta * b2
    b0, b2, b3, b4 = np.inf, np.inf, np.inf, np.inf
    if d > 0.0:
        turned = (abs(q1 + eta * q0) + e1 + abs(eta) * e0) * inv_w
        b0 = math.sqrt((abs(q0) + e0) ** 2 + turned * turned) * exp(-eta * H)
        b2, b3, b4 = lam * b0, lam * math.sqrt(lam) * b0, lam * lam * b0
    elif d < 0.0:
        alpha = 0.5 * inv_w * (abs(q1 + fast * q0) + e1 + abs(fast) * e0) * exp(-slow * H)
        beta = 0.5 * inv_w * (abs(q1 + slow * q0) + e1 + abs(slow) * e0) * exp(max(0.0, -fast) * H)
        b0, b2 = alpha + beta, alpha * slow**2 + beta * fast**2
        b3, b4 = alpha * abs(slow) ** 3 + beta * abs(fast) ** 3, alpha * slow**4 + beta * fast**4
    largest = max(math.sqrt(abs(lam)), abs(eta))
    first = math.sqrt(abs(lam)) if lam != 0.0 else largest
    second = min(max(largest, 1.0 / max(H, 1e-300)), FINEST * largest)
    for nu in (first, second):
        m = -eta + math.sqrt(eta * eta + 0.25 * (nu - lam / nu) ** 2)
        growth = exp(max(0.0, m) * H)
        k0, k1, r0, r1 = q0, q1, e0, e1
        for order in range(5):
            size, rate = abs(k0) + r0, abs(k1) + r1
            bound = math.sqrt(size * size + (rate / nu) ** 2) * growth
            if d >= 0.0:
                bound = min(bound, (size + (abs(k1 + eta * k0) + r1 + abs(eta) * r0) * H) * exp(-eta * H))
            if order == 0:
                b0 = min(b0, bound)
            elif order == 2:
                b2 = min(b2, bound)
            elif order == 3:
                b3 = min(b3, bound)
            elif order == 4:
                b4 = min(b4, bound)
            following = -2.0 * eta * k1 - lam * k0
            lost = 2.0 * abs(eta) * r1 + abs(lam) * r0 + DERIVATIVE_ROUNDING * (abs(2.0 * eta * k1) + abs(lam * k0))
            k0, k1, r0, r1 = k1, following, r1, lost
    return b0, b2, b3, b4


@inlined
def growth_rate(blocks):
    """Return the largest growth rate of any of the blocks, the decoupled equations of motion; 0 if none grows."""
    rate = 0.0
    for j in range(len(blocks)):
        rate = max(rate, -blocks[j, COLUMN.slow])
    return rate


@kernel
def bounds_while_growing(blocks, numbers, h, H):
    """Return ``derivative_bounds`` of a signal if a block, one of the decoupled equations of motion, grows."""
    M0, M2, M3, M4 = numbers[NUMBER.amplitude], numbers[NUMBER.swing2], numbers[NUMBER.swing3], numbers[NUMBER.swing4]
    for j in range(len(blocks)):
        block = blocks[j]
        load, c0, c1, d0, d1 = (
            block[COLUMN.load], block[COLUMN.c0], block[COLUMN.c1], block[COLUMN.cA0], block[COLUMN.cA1]
        )  # fmt: skip
        if block[COLUMN.slow] < 0.0:
            b0, b2, b3, b4 = growing_bounds(
                c0 * h[j, 0] + c1 * h[j, 1], d0 * h[j, 0] + d1 * h[j, 1] + c1 * load,
                abs(c0 * h[j, 0]) + abs(c1 * h[j, 1]), abs(d0 * h[j, 0]) + abs(d1 * h[j, 1]) + abs(c1 * load),
                c0 * load, block[COLUMN.eta], block[COLUMN.lam], block[COLUMN.d], block[COLUMN.inv_w],
                block[COLUMN.slow], block[COLUMN.fast], H,
            )  # fmt: skip
        else:
            b0, b2, b3, b4 = bounds_of(block, h[j, 0], h[j, 1])
        M0, M2, M3, M4 = M0 + b0, M2 + b2, M3 + b3, M4 + b4
    return M0, M2, M3, M4


@inlined
def bounds_of(block, h0, h1):
    """Return ``block_bounds`` of a decoupled equation that does not grow, in the state (h0, h1).

    ``block`` are its constants, a row of GuardedFlow.blocks.
    """
    load, c0, c1 = block[COLUMN.load], block[COLUMN.c0], block[COLUMN.c1]
    q0 = c0 * h0 + c1 * h1
    q1 = block[COLUMN.cA0] * h0 + block[COLUMN.cA1] * h1 + c1 * load
    return block_bounds(
        q0, q1, c0 * load, block[COLUMN.eta], block[COLUMN.lam], block[COLUMN.d], block[COLUMN.inv_w],
        block[COLUMN.slow], block[COLUMN.fast], block[COLUMN.tilt], block[COLUMN.weight],
        block[COLUMN.grow2], block[COLUMN.grow3], block[COLUMN.grow4],
    )  # fmt: skip


@kernel
def derivative_bounds(blocks, numbers, h, H):
    """Return bounds M0, M2, M3, M4, for times up to H, of the modulus of a signal and of its 2nd to 4th derivative.

    blocks, numbers  decoupled equations of motion, and sizes of the forced part, see GuardedFlow
    h        (n, 2)  block state at the start, (h, h') of each equation

    If no block grows, the bounds hold for all later times.
    """
    if growth_rate(blocks) > 0.0:
        return bounds_while_growing(blocks, numbers, h, H)
    M0, M2, M3, M4 = numbers[NUMBER.amplitude], numbers[NUMBER.swing2], numbers[NUMBER.swing3], numbers[NUMBER.swing4]
    for j in range(len(blocks)):
        b0, b2, b3, b4 = bounds_of(blocks[j], h[j, 0], h[j, 1])
        M0, M2, M3, M4 = M0 + b0, M2 + b2, M3 + b3, M4 + b4
    return M0, M2, M3, M4
