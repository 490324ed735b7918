"""The first upward zero of a polynomial on [0, 1], isolated by Bernstein coefficients: none is missed.

Computed in integers, multiples of a unit so far below the working precision that rounding is negligible.
"""

import itertools
from functools import cache
from math import comb
from operator import mul

import numpy as np
from mpmath import mp

from tests.support.oracle.linear import Number, integer


@cache
def _to_bernstein_float(degree: int) -> np.ndarray:
    """Rows that turn monomial into Bernstein coefficients: entry (i, k) is C(i, k) / C(degree, k)."""
    return np.array([[comb(i, k) / comb(degree, k) for k in range(degree + 1)] for i in range(degree + 1)])


@cache
def _binomials(degree: int) -> tuple[tuple[int, ...], ...]:
    return tuple(tuple(comb(i, k) for k in range(i + 1)) for i in range(degree + 1))


def _bernstein(polynomial: list[int]) -> list[int]:
    """Bernstein coefficients on [0, 1]: sum_k C(i, k) / C(degree, k) p_k, too small by less than 2^degree units."""
    degree = len(polynomial) - 1
    parts = [value // comb(degree, k) for k, value in enumerate(polynomial)]
    return [sum(map(mul, row, parts)) for row in _binomials(degree)]


def _surely_negative(polynomial: list[Number]) -> bool:
    """A cheap sufficient test in double precision, with room for its rounding."""
    rough = np.array([float(value) for value in polynomial])
    room = 1e-14 * len(polynomial) * np.abs(rough).sum()
    return bool((_to_bernstein_float(len(polynomial) - 1) @ rough).max() < -room)


def _halves(coefficients: list[int]) -> tuple[list[int], list[int]]:
    """Bernstein coefficients on the two halves of the interval (de Casteljau)."""
    left, right, row = [coefficients[0]], [coefficients[-1]], coefficients
    while len(row) > 1:
        row = [(a + b) >> 1 for a, b in itertools.pairwise(row)]
        left.append(row[0])
        right.append(row[-1])
    return left, right[::-1]


def _value(polynomial: list[int], u: int, bits: int) -> tuple[int, int]:
    """The polynomial and its derivative at u / 2^bits."""
    value, slope = polynomial[-1], 0
    for coefficient in reversed(polynomial[:-1]):
        slope = (slope * u >> bits) + value
        value = (value * u >> bits) + coefficient
    return value, slope


def _refine(polynomial: list[int], low: int, high: int, bits: int) -> Number:
    """The only zero in (low, high) / 2^bits: Newton's method within a shrinking bracket."""
    settled = mp.prec // 2 + 8
    u = (low + high) >> 1
    for _ in range(4 * mp.prec):
        value, slope = _value(polynomial, u, bits)
        if value < 0:
            low = u
        else:
            high = u
        following = u - (value << bits) // slope if slope > 0 else low - 1
        if not low <= following <= high:
            following = (low + high) >> 1
        # Newton's error squares: after so short a step, the next one is below the working precision.
        if abs(following - u) << settled <= u:
            u = following
            break
        u = following
    return mp.ldexp(u, -bits)


def first_upward_zero(polynomial: list[Number], error: Number) -> Number | None:
    """Smallest u in (0, 1] at which a polynomial, negative before, becomes positive; None if it stays negative.

    The polynomial's Bernstein coefficients on an interval enclose its values there: all below -error means no zero,
    one change of sign means exactly one. Otherwise the interval is halved. A zero of even order (the polynomial
    touches zero to within half the working precision) is no crossing. ``error`` bounds the polynomial's error.
    """
    if _surely_negative(polynomial):
        return None
    degree = len(polynomial) - 1
    bits = mp.prec + 2 * degree
    unit = mp.ldexp(1, mp.frexp(max(map(abs, polynomial)))[1] - bits)
    values = [integer(value / unit) for value in polynomial]
    doubt = integer(mp.ceil(error / unit)) + (2 << degree)  # including the rounding above
    narrow = 1 << (bits - mp.prec // 2)
    pending = [(0, 1 << bits, _bernstein(values))]
    while pending:
        low, high, coefficients = pending.pop()
        if max(coefficients) < -doubt:
            continue
        signs = [value > 0 for value in coefficients]
        changes = sum(a != b for a, b in itertools.pairwise(signs))
        if signs[0]:
            return mp.ldexp(low, -bits)
        if changes == 1:
            return _refine(values, low, high, bits)
        if changes == 0 or high - low < narrow:
            continue
        middle = (low + high) >> 1
        left, right = _halves(coefficients)
        pending += [(middle, high, right), (low, middle, left)]
    return None
