"""The periodic answer of the linear oscillator to one kick a turn: what orbits with impacts are made of.

A turn has length ``span``; from turn to turn a kick is multiplied by zeta. The answer a time s after the latest one is
u(s) = (I - e^(A span) / zeta)^-1 e^(A s) k. Periodic kicks have zeta = 1; those of a symmetric orbit, one half period
after the other, zeta = -1; growing perturbations of orbits others.
"""

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.orbit.linear import Linear, flow_entries

Array = NDArray[np.float64]
Table = NDArray[Any]
"""Real numbers, complex ones where z is."""

TERMS = 24
"""Terms of the series for a rigid mode of little damping: 2 (2 eta span / 2 pi)^24 is below rounding."""


def answer(lin: Linear, span: Array, zeta: complex, s: Array) -> tuple[Table, Table]:
    """Block coordinates h and h' (N, n, K) a time s (N, K) after a kick, turn after turn of length span (N,).

    A rigid mode under kicks of zeta = 1 answers to them and to the constant load that balances them, with mean zero.
    """
    eta, lam = lin.eta[..., None], lin.lam[..., None]
    f11, f12, f21, f22 = flow_entries(eta, lam, s[:, None, :])
    k0, k1 = _repeated(lin, span, zeta)
    h, rate = f11 * k0 + f12 * k1, f21 * k0 + f22 * k1
    rigid = (lin.lam == 0.0) & (zeta == 1)
    if np.any(rigid):
        scaled, slope = _rigid_answer(eta, span[:, None, None], s[:, None, :])
        kick = lin.k[..., 1, None]
        h = np.where(rigid[..., None], kick * scaled, h)
        rate = np.where(rigid[..., None], kick * slope, rate)
    return h, rate


def green(lin: Linear, span: Array, zeta: complex, s: Array) -> tuple[Table, Table, Table, Table]:
    """g(s) = c . u(s), the answer of the gap coordinate, and its first three derivatives, at s (N, K)."""
    h, rate = answer(lin, span, zeta, s)
    eta, lam = lin.eta[..., None], lin.lam[..., None]
    c0, c1 = lin.c[..., 0, None], lin.c[..., 1, None]
    q0 = c0 * h + c1 * rate
    q1 = (c0 - 2.0 * eta * c1) * rate - lam * c1 * h
    q2 = -2.0 * eta * q1 - lam * q0
    if zeta == 1:
        q2 = q2 - np.where(lam == 0.0, c0 * lin.k[..., 1, None] / span[:, None, None], 0.0)
        q2_free = np.where(lam == 0.0, q2, 0.0)
        q3 = np.where(lam == 0.0, -2.0 * eta * q2_free, -2.0 * eta * q2 - lam * q1)
    else:
        q3 = -2.0 * eta * q2 - lam * q1
    return q0.sum(1), q1.sum(1), q2.sum(1), q3.sum(1)


def _repeated(lin: Linear, span: Array, zeta: complex) -> tuple[Table, Table]:
    """(I - e^(A span) / zeta)^-1 k, block by block, each (N, n, 1); of a rigid mode with zeta = 1 zero."""
    e11, e12, e21, e22 = (entry / zeta for entry in flow_entries(lin.eta, lin.lam, span[:, None]))
    det = (1.0 - e11) * (1.0 - e22) - e12 * e21
    det = np.where((lin.lam == 0.0) & (zeta == 1), np.inf, det)
    k0, k1 = lin.k[..., 0], lin.k[..., 1]
    return (((1.0 - e22) * k0 + e12 * k1) / det)[..., None], ((e21 * k0 + (1.0 - e11) * k1) / det)[..., None]


def _rigid_answer(eta: Array, span: Array, s: Array) -> tuple[Array, Array]:
    """(h, h') of h'' + 2 eta h' = (a unit kick a turn) - 1 / span, of mean zero.

    -e^(-x u) / (x (1 - e^-x)) - u / x + 1 / x^2 + 1 / (2 x) turns, x = 2 eta span and u = s / span; for small x the
    series - sum_(n >= 2) B_n(u) (-x)^(n - 2) / n! in Bernoulli polynomials, whose first term is u / 2 - u^2 / 2 - 1/12.
    """
    x, u = 2.0 * eta * span, s / span
    small = x < 1.0
    near = np.where(small, x, 0.0)
    value, slope = np.zeros(np.broadcast(x, u).shape), np.zeros(np.broadcast(x, u).shape)
    for n in range(TERMS, 1, -1):
        value = -near * value - _bernoulli(n, u) / math.factorial(n)
        slope = -near * slope - _bernoulli(n - 1, u) / math.factorial(n - 1)
    far = np.where(small, 1.0, x)
    decay = np.exp(-far * u) / -np.expm1(-far)
    direct = -decay / far - u / far + 1.0 / far**2 + 0.5 / far
    return span * np.where(small, value, direct), np.where(small, slope, decay - 1.0 / far)


def _bernoulli(n: int, u: Array) -> Array:
    """The Bernoulli polynomial B_n(u)."""
    return np.polynomial.polynomial.polyval(u, np.array(_coefficients(n)))


@cache
def _coefficients(n: int) -> tuple[float, ...]:
    """Coefficients of B_n, of u^0 first: B_0 = 1, B_n' = n B_(n-1), mean zero."""
    if n == 0:
        return (1.0,)
    higher = [n * a / (i + 1) for i, a in enumerate(_coefficients(n - 1))]
    return (-math.fsum(a / (i + 2) for i, a in enumerate(higher)), *higher)
