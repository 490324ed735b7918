"""The periodic answer of the linear oscillator to one kick a turn: what orbits with impacts are made of.

A turn has length ``span``; from turn to turn a kick is multiplied by zeta. The answer a time s after the latest one is
u(s) = (I - e^(A span) / zeta)^-1 e^(A s) k. Periodic kicks have zeta = 1; those of a symmetric orbit, one half period
after the other, zeta = -1; growing perturbations of orbits others.
"""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from workers.continuation.linear import flow_entries
from workers.kernel.jit import kernel

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
def repeated(lin, r, j, span, zeta):
    """(I - e^(A span) / zeta)^-1 k of block j of oscillator r; of a rigid mode with zeta = 1 zero."""
    e11, e12, e21, e22 = flow_entries(lin.eta[r, j], lin.lam[r, j], span)
    k0, k1 = lin.k[r, j, 0], lin.k[r, j, 1]
    if is_balanced(lin, r, j, zeta):
        return 0.0 * (k0 / zeta), 0.0 * (k1 / zeta)
    e11, e12, e21, e22 = e11 / zeta, e12 / zeta, e21 / zeta, e22 / zeta
    det = (1.0 - e11) * (1.0 - e22) - e12 * e21
    return ((1.0 - e22) * k0 + e12 * k1) / det, (e21 * k0 + (1.0 - e11) * k1) / det


@kernel
def is_balanced(lin, r, j, zeta):
    """Whether block j is a rigid mode whose kicks a constant load has to balance."""
    return lin.lam[r, j] == 0.0 and zeta == 1.0


@kernel
def answer(eta, lam, k1, span, balanced, first, s):
    """h and h' of a block a time s after a kick, turn after turn of length span; ``first`` is its ``repeated``.

    A rigid mode under kicks of zeta = 1, ``balanced``, answers to them, of size k1, and to the constant load that
    balances them, with mean zero.
    """
    if balanced:
        value, slope = _rigid_answer(eta, span, s)
        return k1 * value + first[0], k1 * slope + first[1]
    f11, f12, f21, f22 = flow_entries(eta, lam, s)
    return f11 * first[0] + f12 * first[1], f21 * first[0] + f22 * first[1]


@kernel
def add_green(lin, r, span, zeta, s, total):
    """Add g(s) = c . u(s), the answer of y of oscillator r, and its first three derivatives, to total (4, K) at s (K,).

    total is complex where zeta is. Inner functions take numbers: a record of arrays costs more to hand on than they do.
    """
    for j in range(lin.eta.shape[1]):
        eta, lam, c0, c1, k1 = lin.eta[r, j], lin.lam[r, j], lin.c[r, j, 0], lin.c[r, j, 1], lin.k[r, j, 1]
        first, balanced = repeated(lin, r, j, span, zeta), is_balanced(lin, r, j, zeta)
        pull = c0 * k1 / span if balanced else 0.0
        for i in range(len(s)):
            h, rate = answer(eta, lam, k1, span, balanced, first, s[i])
            q0 = c0 * h + c1 * rate
            q1 = (c0 - 2.0 * eta * c1) * rate - lam * c1 * h
            q2 = -2.0 * eta * q1 - lam * q0 - pull
            total[0, i] += q0
            total[1, i] += q1
            total[2, i] += q2
            total[3, i] += -2.0 * eta * q2 - lam * q1


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
