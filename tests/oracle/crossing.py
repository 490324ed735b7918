"""The first upward zero of a polynomial on [0, 1], isolated by Bernstein coefficients: none is missed."""

import itertools
from functools import cache
from math import comb

import numpy as np
from mpmath import mp

from tests.oracle.linear import Number


@cache
def _to_bernstein(degree: int) -> tuple[tuple[Number, ...], ...]:
    """Rows that turn monomial into Bernstein coefficients: entry (i, k) is C(i, k) / C(degree, k)."""
    with mp.workdps(80):
        return tuple(tuple(mp.mpf(comb(i, k)) / comb(degree, k) for k in range(i + 1)) for i in range(degree + 1))


@cache
def _to_bernstein_float(degree: int) -> np.ndarray:
    table = np.zeros((degree + 1, degree + 1))
    for i, row in enumerate(_to_bernstein(degree)):
        table[i, : i + 1] = [float(value) for value in row]
    return table


def _surely_negative(polynomial: list[Number]) -> bool:
    """A cheap sufficient test in double precision, with room for its rounding."""
    rough = np.array([float(value) for value in polynomial])
    room = 1e-14 * len(polynomial) * np.abs(rough).sum()
    return bool((_to_bernstein_float(len(polynomial) - 1) @ rough).max() < -room)


def _halves(coefficients: list[Number]) -> tuple[list[Number], list[Number]]:
    """Bernstein coefficients on the two halves of the interval (de Casteljau)."""
    half = mp.mpf(0.5)
    left, right, row = [coefficients[0]], [coefficients[-1]], coefficients
    while len(row) > 1:
        row = [half * (a + b) for a, b in itertools.pairwise(row)]
        left.append(row[0])
        right.append(row[-1])
    return left, right[::-1]


def _value(polynomial: list[Number], u: Number) -> tuple[Number, Number]:
    """The polynomial and its derivative at u."""
    value, slope = polynomial[-1], mp.zero
    for coefficient in reversed(polynomial[:-1]):
        slope = slope * u + value
        value = value * u + coefficient
    return value, slope


def _refine(polynomial: list[Number], low: Number, high: Number) -> Number:
    """The one zero in (low, high): Newton's method, kept inside a bracket that shrinks."""
    settled = mp.ldexp(1, -(mp.prec // 2) - 8)
    u = (low + high) / 2
    for _ in range(4 * mp.prec):
        value, slope = _value(polynomial, u)
        if value < 0:
            low = u
        else:
            high = u
        following = u - value / slope if slope > 0 else low - 1
        if not low <= following <= high:
            following = (low + high) / 2
        # Newton's error squares: after so short a step, the next one is below the working precision.
        if abs(following - u) <= settled * u:
            return following
        u = following
    return u


def first_upward_zero(polynomial: list[Number], error: Number) -> Number | None:
    """Smallest u in (0, 1] at which a polynomial, negative before, becomes positive; None if it stays negative.

    The polynomial's Bernstein coefficients on an interval enclose its values there: all below -error means no zero,
    one change of sign means exactly one. Otherwise the interval is halved. A zero of even order (the polynomial
    touches zero to within half the working precision) counts as no crossing. ``error`` bounds the polynomial's error.
    """
    if _surely_negative(polynomial):
        return None
    table = _to_bernstein(len(polynomial) - 1)
    whole = [sum((f * c for f, c in zip(row, polynomial, strict=False)), mp.zero) for row in table]
    narrow = mp.mpf(2) ** (-(mp.prec // 2))
    pending = [(mp.zero, mp.one, whole)]
    while pending:
        low, high, coefficients = pending.pop()
        if max(coefficients) < -error:
            continue
        signs = [value > 0 for value in coefficients]
        changes = sum(a != b for a, b in itertools.pairwise(signs))
        if signs[0]:
            return low
        if changes == 1:
            return _refine(polynomial, low, high)
        if changes == 0 or high - low < narrow:
            continue
        middle = (low + high) / 2
        left, right = _halves(coefficients)
        pending += [(middle, high, right), (low, middle, left)]
    return None
