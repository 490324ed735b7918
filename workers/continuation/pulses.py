"""The periodic answer of linear oscillators to one kick a turn: what orbits with impacts are made of.

A turn has length ``span``; from turn to turn a kick is multiplied by zeta. The answer a time s after the latest one is
u(s) = (I - e^(A span) / zeta)^-1 e^(A s) k. Periodic kicks have zeta = 1; those of a symmetric orbit, one half period
after the other, zeta = -1; growing perturbations of orbits others.

Everywhere N oscillators, span (N,).
"""

import math

import numpy as np

from workers.kernel.borrow import borrowed
from workers.kernel.flow import block_flow, fall
from workers.kernel.jit import kernel
from workers.kernel.signal import all_forced
from workers.model.oscillator import COLUMN, NUMBER


@kernel
def answers(blocks, span, zeta, since):
    """u = (h, h') (N, n, 2, K, m) of blocks (N, n, columns) at times ``since`` (N, K, m); their loads (N, n).

    A rigid mode under kicks of zeta = 1 answers to them and to the constant load that balances them, with mean zero.
    """
    blocks = borrowed(blocks)
    (N, K, m), n = since.shape, blocks.shape[1]
    found, loads = np.full((N, n, 2, K, m), 0.0 * zeta), np.zeros((N, n))
    for r, j in np.ndindex(N, n):
        block = blocks[r, j]
        u0, u1, load = _first(block, span[r], zeta)
        loads[r, j] = load
        for i, p in np.ndindex(K, m):
            f11, f12, f21, f22 = block_flow(block, since[r, i, p])
            found[r, j, 0, i, p] = f11 * u0 + f12 * u1
            found[r, j, 1, i, p] = f21 * u0 + f22 * u1
            if load != 0.0:
                found[r, j, 0, i, p] += load * fall(since[r, i, p], block[COLUMN.eta])
                found[r, j, 1, i, p] += load * f12
    return found, loads


@kernel
def _first(block, span, zeta):
    """u(0) = (h, h') of a block, and the load that balances its kicks: 0 but for a rigid mode under kicks of zeta = 1.

    That one has the velocity after a kick from which the load takes it to the velocity before the next one, and is
    where its mean is zero: -span / 4 (coth x - 1 / x) / x, x = eta span.
    """
    k0, k1 = block[COLUMN.k0], block[COLUMN.k1]
    f11, f12, f21, f22 = block_flow(block, span)
    if block[COLUMN.lam] == 0.0 and zeta == 1.0:
        eta = block[COLUMN.eta]
        after = fall(span, eta) / (span * f12)
        return k1 * (-0.25 * span * _langevin(eta * span) / zeta), k1 * (after / zeta), -k1 / span
    e11, e12, e21, e22 = f11 / zeta, f12 / zeta, f21 / zeta, f22 / zeta
    det = (1.0 - e11) * (1.0 - e22) - e12 * e21
    return ((1.0 - e22) * k0 + e12 * k1) / det, (e21 * k0 + (1.0 - e11) * k1) / det, 0.0


@kernel
def _langevin(x):
    """(coth x - 1 / x) / x, which is 1 / (3 + x^2 / (5 + x^2 / (7 + ...)))."""
    if x > 1.0:
        return (1.0 / math.tanh(x) - 1.0 / x) / x
    below = 21.0
    for odd in range(19, 1, -2):
        below = odd + x * x / below
    return 1.0 / below


@kernel
def forced_motion(waves, numbers, tau, s):
    """Y and its first two derivatives (3, N, K) at times s (N, K); the forcing phase at time 0 is tau (N,)."""
    waves, numbers = borrowed(waves), borrowed(numbers)
    found = np.empty((3, *s.shape))
    for r, i in np.ndindex(s.shape):
        omega = numbers[r, NUMBER.omega]
        y, v, a, _, _ = all_forced(waves[r], omega, omega * s[r, i] + tau[r])
        found[0, r, i], found[1, r, i], found[2, r, i] = y, v, a
    return found


@kernel
def pairs(blocks, q, span, zeta, t):
    """q g and its first two derivatives (3, N, m, m) at impact i of the kicks at impact j, at times t (N, m).

    g = row . u. Kicks are the latest before impact i, its own one turn ago. Impacts are ordered as in the itinerary, so
    that this is smooth in the times whatever they are.
    """
    (N, m), n = t.shape, blocks.shape[1]
    since = np.empty((N, m, m))
    for r, i, j in np.ndindex(N, m, m):
        since[r, i, j] = t[r, i] - t[r, j] + (span[r] if i <= j else 0.0)
    u, loads = answers(blocks, span, zeta, since)
    found = np.full((3, N, m, m), 0.0 * zeta)
    for r, b, i, j in np.ndindex(N, n, m, m):
        block, kick = blocks[r, b], q[r] / (zeta if i <= j else 1.0)
        h, rate = kick * u[r, b, 0, i, j], kick * u[r, b, 1, i, j]
        g, g1 = block[COLUMN.c0] * h + block[COLUMN.c1] * rate, block[COLUMN.cA0] * h + block[COLUMN.cA1] * rate
        g2 = kick * block[COLUMN.c0] * loads[r, b] - 2.0 * block[COLUMN.eta] * g1 - block[COLUMN.lam] * g
        found[0, r, i, j] += g
        found[1, r, i, j] += g1
        found[2, r, i, j] += g2
    return found


@kernel
def before_impacts(gap, tau, q, span, sign, t, v, offset):
    """y and its first two derivatives (3, N, m) just before impacts of times t and speeds v (N, m); q is 1 + R."""
    found, answer = forced_motion(gap.waves, gap.numbers, tau, t), pairs(gap.blocks, q, span, sign, t)
    for d, r, i in np.ndindex(found.shape):
        for j in range(t.shape[1]):
            found[d, r, i] -= answer[d, r, i, j] * v[r, j]
        found[d, r, i] += offset[r] if d == 0 else 0.0
    return found


@kernel
def jacobian(gap, tau, q, span, sign, t, v, offset, z, rigid):
    """J_z (N, M, M) of ``Motion.linearised``; rigid is the block of a rigid mode that borders it, -1 where none."""
    N, m = t.shape
    before = before_impacts(gap, tau, q, span, sign, t, v, offset)
    answer = pairs(gap.blocks, q, span, sign * z, t)
    size = 2 * m + (1 if rigid >= 0 else 0)
    J = np.full((N, size, size), 0.0 * z)
    for r, i in np.ndindex(N, m):
        for j in range(m):
            g0, g1, g2 = answer[0, r, i, j], answer[1, r, i, j], answer[2, r, i, j]
            J[r, i, j], J[r, i, m + j] = g1 * v[r, j], -g0
            J[r, m + i, j], J[r, m + i, m + j] = g2 * v[r, j], -g1
        J[r, i, i] += before[1, r, i]
        J[r, m + i, i] += before[2, r, i]
        J[r, m + i, m + i] -= 1.0
        if rigid >= 0:
            J[r, i, size - 1] = 1.0
            J[r, size - 1, m + i] = q[r] * gap.blocks[r, rigid, COLUMN.k1]
    return J
