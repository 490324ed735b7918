"""Free flight in closed form, for decoupled equations h'' + 2 eta h' + lam h = load, called blocks.

A block may be underdamped, overdamped, without stiffness (rigid), or growing.
"""

import math

from workers.kernel.borrow import borrow
from workers.kernel.elementary import cosc_sinc, exp, exp_minus, sin_cos
from workers.kernel.fma import fma, horner
from workers.kernel.jit import inlined, kernel
from workers.model.oscillator import COLUMN

FALL = tuple(1.0 / math.factorial(k) for k in range(17, 1, -1))
"""Coefficients of the series of (x - 1 + e^-x) / x^2 in -x."""


@inlined
def oscillating_flow(s, eta, lam, w, inv_w):
    """Return (f11, f12, f21, f22), the matrix that takes (h, h') of an underdamped block over a time s.

    For the arguments see ``flow_entries``.
    """
    decay = exp_minus(eta * s)
    sin, cos = sin_cos(w * s)
    S = sin * inv_w
    f12 = decay * S
    return decay * fma(eta, S, cos), f12, -lam * f12, decay * fma(-eta, S, cos)


@inlined
def flow_entries(s, eta, lam, d, w, inv_w, slow, fast):
    """Return (f11, f12, f21, f22), the matrix f that takes (h, h') over a time s by h'' + 2 eta h' + lam h = 0.

    f = e^(-eta s) (C + eta S, S, -lam S, C - eta S), with d = lam - eta^2, w = sqrt|d| and inv_w = 1 / w.

    d > 0         C = cos(w s), S = sin(w s) / w
    d s^2 small   C and S by their series in d s^2
    otherwise     exponentials of the decay rates slow = lam / (eta + w) and fast = eta + w, which do not cancel
    """
    o11, o12, o21, o22 = oscillating_flow(s, eta, lam, w, inv_w)
    oscillates = d > 0.0
    e_slow = exp_minus(slow * s)
    e_w = exp_minus(w * s)
    x = d * s * s
    C, sinc = cosc_sinc(x)
    near = x > -0.1
    S = s * sinc
    decay = e_slow * e_w
    ratio = e_w * e_w
    half = 0.5 * e_slow * inv_w
    f11 = decay * fma(eta, S, C) if near else half * fma(-slow, ratio, fast)
    f12 = decay * S if near else half * (1.0 - ratio)
    f22 = decay * fma(-eta, S, C) if near else half * fma(fast, ratio, -slow)
    return (
        o11 if oscillates else f11,
        o12 if oscillates else f12,
        o21 if oscillates else -lam * f12,
        o22 if oscillates else f22,
    )


@kernel
def growing_flow(s, eta, lam, d, w, inv_w, slow, fast):
    """Return (f11, f12, f21, f22), the matrix that takes (h, h') of a growing block over a time s.

    A block grows if eta or lam is negative; then slow < 0. For the arguments see ``flow_entries``.
    """
    x = d * s * s
    if x > -0.1:
        growth = exp(-eta * s)
        C, S = cosc_sinc(min(x, 0.1))
        S *= s
        if d > 0.0:
            S, C = sin_cos(w * s)
            S *= inv_w
        f12 = growth * S
        return growth * fma(eta, S, C), f12, -lam * f12, growth * fma(-eta, S, C)
    ratio = exp_minus(2.0 * w * s)
    half = 0.5 * exp(-slow * s) * inv_w
    f12 = half * (1.0 - ratio)
    return half * fma(-slow, ratio, fast), f12, -lam * f12, half * fma(fast, ratio, -slow)


@inlined
def block_flow(block, s):
    """Return (f11, f12, f21, f22), the matrix that takes (h, h') of one block over a time s.

    A block, one decoupled equation of motion, is a row of GuardedFlow.blocks. See ``flow_entries``.
    """
    eta, lam, w, inv_w = block[COLUMN.eta], block[COLUMN.lam], block[COLUMN.w], block[COLUMN.inv_w]
    if block[COLUMN.slow] < 0.0:
        return growing_flow(s, eta, lam, block[COLUMN.d], w, inv_w, block[COLUMN.slow], block[COLUMN.fast])
    if block[COLUMN.d] > 0.0:
        return oscillating_flow(s, eta, lam, w, inv_w)
    return flow_entries(s, eta, lam, block[COLUMN.d], w, inv_w, block[COLUMN.slow], block[COLUMN.fast])


@inlined
def fall(s, eta):
    """Return the displacement after a time s, under a unit load from zero state, of a rigid mode of vibration.

    The mode has no stiffness, and the damping rate eta >= 0. The displacement is s^2 (x - 1 + e^-x) / x^2 with x = 2
    eta s.
    """
    x = 2.0 * eta * s
    p = horner(FALL, -x)
    far = ((x - 1.0) + exp_minus(x)) / (x * x)
    return s * s * (p if x < 1.0 else far)


@kernel
def rise(s, eta):
    """Return ``fall`` for eta < 0: the displacement after s, under a unit load, of a rigid mode of vibration."""
    x = 2.0 * eta * s
    return fall(s, eta) if x > -1.0 else s * s * (((x - 1.0) + exp(-x)) / (x * x))


@inlined
def moved_by_load(s, eta):
    """Return ``fall`` for any eta: the displacement after s, under a unit load, of a rigid mode of vibration."""
    if eta < 0.0:
        return rise(s, eta)
    return fall(s, eta)


@kernel
def flow(block, s, h):
    """Advance the block state h (n, 2), rows (h, h') of the decoupled equations ``block``, by a time s, in place."""
    block, h = borrow(block), borrow(h)
    for j in range(len(block)):
        flow_block(block[j], s, h[j])


@inlined
def flow_block(block, s, h):
    """Advance the state h (2,) = (h, h') of one decoupled equation by a time s, in place.

    Return the matrix of the flow, see ``flow_entries``.
    """
    f11, f12, f21, f22 = block_flow(block, s)
    h0, h1, load = h[0], h[1], block[COLUMN.load]
    h[0], h[1] = fma(f11, h0, f12 * h1), fma(f21, h0, f22 * h1)
    if load != 0.0:
        h[0], h[1] = fma(load, moved_by_load(s, block[COLUMN.eta]), h[0]), fma(load, f12, h[1])
    return f11, f12, f21, f22


@inlined
def flow_vectors(V, j, f11, f12, f21, f22):
    """Multiply the parts of tangent vectors V (m, n, 2) in decoupled equation j by a matrix f (2, 2), in place."""
    for i in range(V.shape[0]):
        v0, v1 = V[i, j, 0], V[i, j, 1]
        V[i, j, 0], V[i, j, 1] = fma(f11, v0, f12 * v1), fma(f21, v0, f22 * v1)


@kernel
def flow_with_tangent(block, s, h, V):
    """Advance the block state h (n, 2) and the tangent vectors V (m, n, 2) by a time s, in place.

    The rows of h are (h, h') of the decoupled equations ``block``.
    """
    block, h, V = borrow(block), borrow(h), borrow(V)
    for j in range(len(block)):
        f11, f12, f21, f22 = flow_block(block[j], s, h[j])
        flow_vectors(V, j, f11, f12, f21, f22)


@kernel
def guard_of(blocks, h):
    """Return the value c . h of a guard, a signal that can end the present law of motion.

    h (n, 2) is the state of the decoupled equations of motion, and ``blocks`` holds c in its columns.
    """
    total = 0.0
    for j in range(len(blocks)):
        total = fma(blocks[j, COLUMN.c1], h[j, 1], fma(blocks[j, COLUMN.c0], h[j, 0], total))
    return total


@kernel
def guard_rate_of(blocks, h):
    """Return the rate of change cA . h of a guard, a signal that can end the present law of motion.

    h (n, 2) is the state of the decoupled equations of motion, and ``blocks`` holds cA in its columns.
    """
    total = 0.0
    for j in range(len(blocks)):
        total = fma(blocks[j, COLUMN.cA1], h[j, 1], fma(blocks[j, COLUMN.cA0], h[j, 0], total))
    return total
