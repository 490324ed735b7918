"""exp, log, sin and cos without a branch or a call, so that loops over cells compile to vector instructions.

Each function reduces its argument and sums a Taylor series, with an error of about one unit in the last place.
"""

import math

import numpy as np

from workers.kernel.fma import fma, horner
from workers.kernel.jit import inlined

_TO_INTEGER = 1.5 * 2.0**52
"""Adding and subtracting this number rounds to the nearest integer."""

_LARGEST_EXPONENT = 708.0
"""Maximum exponent: exp(-708) is about the smallest number of full precision; smaller values count as zero."""

_EXPONENT_BITS = 52
_EXPONENT_OF_ONE = 1023 << _EXPONENT_BITS
_LOG2_E = 1.0 / math.log(2.0)
_LN2_HIGH = float.fromhex("0x1.62e42feep-1")
_LN2_LOW = float.fromhex("0x1.a39ef35793c76p-33")
"""ln 2 in two parts. The first part has 32 bits, so its product with any exponent is exact."""

_FRACTION = (1 << _EXPONENT_BITS) - 1
_BITS_OF_2_52 = (1023 + 52) << _EXPONENT_BITS
_HALF_ROOT = 0x3FE6A09E667F3BCD
"""The bits of 1 / sqrt(2)."""

_TWO_OVER_PI = 2.0 / math.pi
_PI2_HIGH = float.fromhex("0x1.921fb54p0")
_PI2_MIDDLE = float.fromhex("0x1.10b4610p-30")
_PI2_LOW = float.fromhex("0x1.a62633145c06ep-58")
"""pi / 2 in three parts. The first two parts have 28 bits, so their products with integers below 2^25 are exact."""

EXP = tuple(1.0 / math.factorial(k) for k in range(13, 1, -1))
LOG = tuple(2.0 / k for k in range(23, 1, -2))
SIN = tuple((-1.0) ** (k // 2) / math.factorial(k) for k in range(17, 1, -2))
COS = tuple((-1.0) ** (k // 2) / math.factorial(k) for k in range(18, 3, -2))
COSC = tuple((-1.0) ** (k // 2) / math.factorial(k) for k in range(12, 1, -2))
SINC = tuple((-1.0) ** (k // 2) / math.factorial(k) for k in range(13, 1, -2))
"""Coefficients of the series from the highest power down; the lowest terms are added separately."""


@inlined
def exp_minus(x):
    """Return exp(-x) for x >= 0, computed as 2^-k e^r with k the integer nearest to x / ln 2; 0 for x > 708."""
    reduced = min(x, _LARGEST_EXPONENT)
    shifted = fma(reduced, _LOG2_E, _TO_INTEGER)  # its last bits, below the exponent, are k
    k = shifted - _TO_INTEGER
    power = np.int64(_EXPONENT_OF_ONE - (np.float64(shifted).view(np.int64) << _EXPONENT_BITS)).view(np.float64)
    r = fma(k, _LN2_LOW, fma(k, _LN2_HIGH, -reduced))
    p = horner(EXP, r)
    return 0.0 if x > _LARGEST_EXPONENT else (1.0 + fma(r * r, p, r)) * power


@inlined
def exp(x):
    """Return exp(x) of either sign, by ``exp_minus``; infinity for x >= 708."""
    power = exp_minus(abs(x))
    return 1.0 / power if x > 0.0 else power


@inlined
def log(x):
    """Return log x of a normal number x > 0; -inf at 0.

    log x = k ln 2 + log(1 + f) with 1 / sqrt(2) < 1 + f < sqrt(2).
    """
    bits = np.float64(x).view(np.int64) + (_EXPONENT_OF_ONE - _HALF_ROOT)
    k = np.int64((bits >> _EXPONENT_BITS) | _BITS_OF_2_52).view(np.float64) - (2.0**52 + 1023.0)
    f = np.int64((bits & _FRACTION) + _HALF_ROOT).view(np.float64) - 1.0
    s = f / (2.0 + f)
    z = s * s
    p = horner(LOG, z)
    half = 0.5 * f * f
    value = fma(k, _LN2_HIGH, f - (half - fma(s, fma(z, p, half), k * _LN2_LOW)))
    value = value if x < np.inf else x
    return -np.inf if x == 0.0 else value


@inlined
def sin_cos(x):
    """Return (sin x, cos x) for |x| <= 3e7, the limit oscillator.LARGEST_ANGLE.

    Both are computed from r = x - k pi / 2 with |r| <= pi / 4.
    """
    k = fma(x, _TWO_OVER_PI, _TO_INTEGER) - _TO_INTEGER
    r = fma(-k, _PI2_LOW, fma(-k, _PI2_MIDDLE, fma(-k, _PI2_HIGH, x)))
    z = r * r
    p = horner(SIN, z)
    s = fma(r * z, p, r)
    q = horner(COS, z)
    c = fma(z * z, q, fma(-0.5, z, 1.0))
    quarter = fma(-4.0, math.floor(0.25 * k), k)
    odd = quarter == 1.0 or quarter == 3.0
    sin = c if odd else s
    cos = s if odd else c
    return -sin if quarter >= 2.0 else sin, -cos if quarter == 1.0 or quarter == 2.0 else cos


@inlined
def cosc_sinc(x):
    """Return (cos(sqrt x), sin(sqrt x) / sqrt x) for |x| <= 0.1 of either sign, by their series in x."""
    return fma(x, horner(COSC, x), 1.0), fma(x, horner(SINC, x), 1.0)
