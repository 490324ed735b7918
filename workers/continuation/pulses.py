"""The periodic answer of linear oscillators to one kick a turn, compiled: what orbits with impacts are made of.

A turn has length ``span``; from turn to turn a kick is multiplied by zeta. The answer a time s after the latest one is
u(s) = (I - e^(A span) / zeta)^-1 e^(A s) k. Periodic kicks have zeta = 1; those of a symmetric orbit, one half period
after the other, zeta = -1; growing perturbations of orbits others.

Everywhere gap is the signal of N oscillators, kick (N, n, 2) the column that impacts kick along and span (N,).
"""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from workers.kernel.borrow import borrowed
from workers.kernel.flow import block_flow
from workers.kernel.jit import kernel
from workers.kernel.signal import all_forced
from workers.model.oscillator import COLUMN

TERMS = 24
"""Terms of the series for a rigid mode of little damping: 2 (2 eta span / 2 pi)^24 is below rounding."""


@cache
def _coefficients(n: int) -> tuple[float, ...]:
    """Coefficients of B_n, of u^0 first: B_0 = 1, B_n' = n B_(n-1), mean zero."""
    if n == 0:
        return (1.0,)
    higher = [n * a / (i + 1) for i, a in enumerate(_coefficients(n - 1))]
    return (-math.fsum(a / (i + 2) for i, a in enumerate(higher)), *higher)


def _table() -> NDArray[np.float64]:
    """Coefficients of B_n(u) / n!, n by n, of u^0 first."""
    found = np.zeros((TERMS + 1, TERMS + 1))
    for n in range(TERMS + 1):
        found[n, : n + 1] = np.array(_coefficients(n)) / math.factorial(n)
    return found


BERNOULLI = _table()


@kernel
def green(gap, kick, span, zeta, since):
    """g = row . u and its first three derivatives (4, N, K, m) at times ``since`` (N, K, m); complex where zeta is."""
    gap, kick = borrowed(gap), borrowed(kick)
    N, K, m = since.shape
    found = np.full((4, N, K, m), 0.0 * zeta)
    for r in range(N):
        for j in range(kick.shape[1]):
            block, c0, c1, k1 = gap.block[r, j], gap.row[r, j, 0], gap.row[r, j, 1], kick[r, j, 1]
            eta, lam = block[COLUMN.eta], block[COLUMN.lam]
            balanced = lam == 0.0 and zeta == 1.0
            first = _first(block, kick[r, j, 0], k1, span[r], zeta, balanced)
            pull = c0 * k1 / span[r] if balanced else 0.0
            for i, p in np.ndindex(K, m):
                h, rate = _answer(block, k1, span[r], balanced, first, since[r, i, p])
                q0 = c0 * h + c1 * rate
                q1 = (c0 - 2.0 * eta * c1) * rate - lam * c1 * h
                q2 = -2.0 * eta * q1 - lam * q0 - pull
                found[0, r, i, p] += q0
                found[1, r, i, p] += q1
                found[2, r, i, p] += q2
                found[3, r, i, p] += -2.0 * eta * q2 - lam * q1
    return found


@kernel
def block_answers(gap, kick, span, zeta, since):
    """u = (h, h') of the blocks (2, N, n, K, m) at times ``since`` (N, K, m)."""
    gap, kick = borrowed(gap), borrowed(kick)
    (N, K, m), n = since.shape, kick.shape[1]
    found = np.empty((2, N, n, K, m))
    for r in range(N):
        for j in range(n):
            block, k1 = gap.block[r, j], kick[r, j, 1]
            balanced = block[COLUMN.lam] == 0.0 and zeta == 1.0
            first = _first(block, kick[r, j, 0], k1, span[r], zeta, balanced)
            for i, p in np.ndindex(K, m):
                u = _answer(block, k1, span[r], balanced, first, since[r, i, p])
                found[0, r, j, i, p], found[1, r, j, i, p] = u
    return found


@kernel
def _first(block, k0, k1, span, zeta, balanced):
    """u(0) = (I - e^(A span) / zeta)^-1 k of a block; 0 where a constant load balances the kicks."""
    if balanced:
        return 0.0 * (k0 / zeta), 0.0 * (k1 / zeta)
    f11, f12, f21, f22 = block_flow(block, span)
    e11, e12, e21, e22 = f11 / zeta, f12 / zeta, f21 / zeta, f22 / zeta
    det = (1.0 - e11) * (1.0 - e22) - e12 * e21
    return ((1.0 - e22) * k0 + e12 * k1) / det, (e21 * k0 + (1.0 - e11) * k1) / det


@kernel
def _answer(block, k1, span, balanced, first, s):
    """u(s) = (h, h') of a block, ``first`` its u(0).

    A rigid mode under kicks of zeta = 1, ``balanced``, answers to them, of size k1, and to the constant load that
    balances them, with mean zero.
    """
    if balanced:
        value, slope = _rigid_answer(block[COLUMN.eta], span, s)
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
            phase = gap.omega[r] * s[r, i] + tau[r]
            y, v, a, j, _ = all_forced(gap.sin_part[r], gap.cos_part[r], gap.omega[r], phase)
            found[0, r, i], found[1, r, i], found[2, r, i], found[3, r, i] = y, v, a, j
    return found


@kernel
def flights(gap, s):
    """e^(A s) (N, K, 2n, 2n) of times s (N, K)."""
    gap = borrowed(gap)
    (N, K), n = s.shape, gap.block.shape[1]
    E = np.zeros((N, K, 2 * n, 2 * n))
    for r in range(N):
        for j in range(n):
            for i in range(K):
                f11, f12, f21, f22 = block_flow(gap.block[r, j], s[r, i])
                E[r, i, 2 * j, 2 * j], E[r, i, 2 * j, 2 * j + 1] = f11, f12
                E[r, i, 2 * j + 1, 2 * j], E[r, i, 2 * j + 1, 2 * j + 1] = f21, f22
    return E
