"""The periodic answer of linear oscillators to one kick a turn, compiled: what orbits with impacts are made of.

A turn has length ``span``; from turn to turn a kick is multiplied by zeta. The answer a time s after the latest one is
u(s) = (I - e^(A span) / zeta)^-1 e^(A s) k. Periodic kicks have zeta = 1; those of a symmetric orbit, one half period
after the other, zeta = -1; growing perturbations of orbits others.

Everywhere gap is the mode of N free flights and span (N,).
"""

import math
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from workers.kernel.borrow import borrowed
from workers.kernel.flow import block_flow
from workers.kernel.jit import kernel
from workers.kernel.signal import all_forced
from workers.model.oscillator import COLUMN, NUMBER

TERMS = 24
"""Terms of the series for a rigid mode of little damping: 2 (2 eta span / 2 pi)^24 is below rounding."""


def _bernoulli_polynomials() -> NDArray[np.float64]:
    """Coefficients of B_n(u) / n!, n by n, of u^0 first: b_(n-k) / k! of u^k, with x / (e^x - 1) = sum_n b_n x^n."""
    b, orders = [Fraction(1)], range(TERMS + 1)
    for n in orders[1:]:
        b.append(-sum((b[k] / math.factorial(n + 1 - k) for k in range(n)), Fraction(0)))
    return np.array([[float(b[n - k] / math.factorial(k)) if k <= n else 0.0 for k in orders] for n in orders])


BERNOULLI = _bernoulli_polynomials()


@kernel
def green(gap, span, zeta, since):
    """g = row . u and its first three derivatives (4, N, K, m) at times ``since`` (N, K, m); complex where zeta is."""
    blocks = borrowed(gap.blocks)
    N, K, m = since.shape
    found = np.full((4, N, K, m), 0.0 * zeta)
    for r in range(N):
        for j in range(blocks.shape[1]):
            block = blocks[r, j]
            eta, lam, c0, c1 = block[COLUMN.eta], block[COLUMN.lam], block[COLUMN.c0], block[COLUMN.c1]
            first, balanced = _first(block, span[r], zeta)
            pull = c0 * block[COLUMN.k1] / span[r] if balanced else 0.0
            for i, p in np.ndindex(K, m):
                h, rate = _answer(block, span[r], balanced, first, since[r, i, p])
                q0, q1 = c0 * h + c1 * rate, block[COLUMN.cA0] * h + block[COLUMN.cA1] * rate
                q2 = -2.0 * eta * q1 - lam * q0 - pull
                found[0, r, i, p] += q0
                found[1, r, i, p] += q1
                found[2, r, i, p] += q2
                found[3, r, i, p] += -2.0 * eta * q2 - lam * q1
    return found


@kernel
def pairs(gap, span, zeta, t):
    """g and its first three derivatives (4, N, m, m) at impact i of the kicks at impact j, at times t (N, m).

    Kicks are the latest before impact i, its own one turn ago. Impacts are ordered as in the itinerary, so that this is
    smooth in the times whatever they are.
    """
    N, m = t.shape
    since = np.empty((N, m, m))
    for r, i, j in np.ndindex(N, m, m):
        since[r, i, j] = t[r, i] - t[r, j] + (span[r] if i <= j else 0.0)
    found = green(gap, span, zeta, since)
    for d, r, i, j in np.ndindex(4, N, m, m):
        if i <= j:
            found[d, r, i, j] /= zeta
    return found


@kernel
def before_impacts(gap, tau, q, span, sign, t, v, offset):
    """y and its first three derivatives (4, N, m) just before impacts of times t and speeds v (N, m); q is 1 + R."""
    found, answer = forced_motion(gap, tau, t), pairs(gap, span, sign, t)
    for d, r, i in np.ndindex(found.shape):
        for j in range(t.shape[1]):
            found[d, r, i] -= q[r] * answer[d, r, i, j] * v[r, j]
        found[d, r, i] += offset[r] if d == 0 else 0.0
    return found


@kernel
def jacobian(gap, tau, q, span, sign, t, v, offset, z, rigid):
    """J_z (N, M, M) of ``equations.linearised``; rigid is the block of a rigid mode that borders it, -1 where none."""
    N, m = t.shape
    before = before_impacts(gap, tau, q, span, sign, t, v, offset)
    answer = pairs(gap, span, sign * z, t)
    size = 2 * m + (1 if rigid >= 0 else 0)
    J = np.full((N, size, size), 0.0 * z)
    for r, i in np.ndindex(N, m):
        for j in range(m):
            g0, g1, g2 = q[r] * answer[0, r, i, j], q[r] * answer[1, r, i, j], q[r] * answer[2, r, i, j]
            J[r, i, j], J[r, i, m + j] = g1 * v[r, j], -g0
            J[r, m + i, j], J[r, m + i, m + j] = g2 * v[r, j], -g1
        J[r, i, i] += before[1, r, i]
        J[r, m + i, i] += before[2, r, i]
        J[r, m + i, m + i] -= 1.0
        if rigid >= 0:
            J[r, i, size - 1] = 1.0
            J[r, size - 1, m + i] = q[r] * gap.blocks[r, rigid, COLUMN.k1]
    return J


@kernel
def answers(blocks, span, zeta, since):
    """u = (h, h') (2, N, n, K, m) of blocks (N, n, columns) at times ``since`` (N, K, m)."""
    (N, K, m), n = since.shape, blocks.shape[1]
    found = np.empty((2, N, n, K, m))
    for r, j in np.ndindex(N, n):
        first, balanced = _first(blocks[r, j], span[r], zeta)
        for i, p in np.ndindex(K, m):
            u = _answer(blocks[r, j], span[r], balanced, first, since[r, i, p])
            found[0, r, j, i, p], found[1, r, j, i, p] = u
    return found


@kernel
def _first(block, span, zeta):
    """u(0) = (I - e^(A span) / zeta)^-1 k of a block, 0 where a load balances the kicks; and whether one does."""
    k0, k1 = block[COLUMN.k0], block[COLUMN.k1]
    if block[COLUMN.lam] == 0.0 and zeta == 1.0:
        return (0.0 * (k0 / zeta), 0.0 * (k1 / zeta)), True
    f11, f12, f21, f22 = block_flow(block, span)
    e11, e12, e21, e22 = f11 / zeta, f12 / zeta, f21 / zeta, f22 / zeta
    det = (1.0 - e11) * (1.0 - e22) - e12 * e21
    return (((1.0 - e22) * k0 + e12 * k1) / det, (e21 * k0 + (1.0 - e11) * k1) / det), False


@kernel
def _answer(block, span, balanced, first, s):
    """u(s) = (h, h') of a block, ``first`` its u(0).

    A rigid mode under kicks of zeta = 1, ``balanced``, answers to them and to the constant load that
    balances them, with mean zero.
    """
    if balanced:
        value, slope = _rigid_answer(block[COLUMN.eta], span, s)
        k1 = block[COLUMN.k1]
        return k1 * value + first[0], k1 * slope + first[1]
    f11, f12, f21, f22 = block_flow(block, s)
    return f11 * first[0] + f12 * first[1], f21 * first[0] + f22 * first[1]


@kernel
def _rigid_answer(eta, span, s):
    """(h, h') of h'' + 2 eta h' = (a unit kick a turn) - 1 / span, of mean zero.

    -e^(-x u) / (x (1 - e^-x)) - u / x + 1 / x^2 + 1 / (2 x) turns, x = 2 eta span and u = s / span; for small x the
    series - sum_(n >= 2) B_n(u) (-x)^(n - 2) / n! in Bernoulli polynomials, whose first term is u / 2 - u^2 / 2 - 1/12.
    """
    x, u = 2.0 * eta * span, s / span
    if x < 1.0:
        value, slope = 0.0, 0.0
        for n in range(TERMS, 1, -1):
            value = -x * value - _bernoulli(n, u)
            slope = -x * slope - _bernoulli(n - 1, u)
        return span * value, slope
    decay = math.exp(-x * u) / -math.expm1(-x)
    return span * (-decay / x - u / x + 1.0 / x**2 + 0.5 / x), decay - 1.0 / x


@kernel
def _bernoulli(n, u):
    """The Bernoulli polynomial B_n(u) / n!."""
    total = 0.0
    for i in range(n, -1, -1):
        total = total * u + BERNOULLI[n, i]
    return total


@kernel
def forced_motion(gap, tau, s):
    """Y and its first three derivatives (4, N, K) at times s (N, K); the forcing phase at time 0 is tau (N,)."""
    gap = borrowed(gap)
    N, K = s.shape
    found = np.empty((4, N, K))
    for r in range(N):
        for i in range(K):
            omega = gap.numbers[r, NUMBER.omega]
            y, v, a, j, _ = all_forced(gap.waves[r], omega, omega * s[r, i] + tau[r])
            found[0, r, i], found[1, r, i], found[2, r, i], found[3, r, i] = y, v, a, j
    return found


@kernel
def flights(gap, s):
    """e^(A s) (N, K, 2n, 2n) of times s (N, K)."""
    blocks = borrowed(gap.blocks)
    (N, K), n = s.shape, blocks.shape[1]
    E = np.zeros((N, K, 2 * n, 2 * n))
    for r in range(N):
        for j in range(n):
            for i in range(K):
                f11, f12, f21, f22 = block_flow(blocks[r, j], s[r, i])
                E[r, i, 2 * j, 2 * j], E[r, i, 2 * j, 2 * j + 1] = f11, f12
                E[r, i, 2 * j + 1, 2 * j], E[r, i, 2 * j + 1, 2 * j + 1] = f21, f22
    return E
