"""Waveforms, linear from point to point over a period, as sums of harmonics with an error bound."""

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from workers.model.oscillator import Array

WAVEFORMS = {"triangle": ((0.0, 0.0), (0.25, 1.0), (0.75, -1.0))}
"""Waveforms by name, as points (share of the period, value)."""

LOOKED_AT = 2**14
"""Number of shares of the period at which the error is computed; between them the error is bounded."""

ROUNDING = 1e-14
"""Share of the largest value up to which an amplitude of a harmonic, or the mean, is rounding."""

DIGITS = 12
"""Number of digits of an amplitude. The last digits of a sine depend on the computer, and the digest of a store
includes all digits.
"""


class HarmonicAmplitudes(NamedTuple):
    """Amplitudes of the sine and of the cosine of a harmonic."""

    sine: float
    cosine: float


class Waveform:
    """A function of period 1, linear between points (share, value), the shares in [0, 1) and rising.

    largest  its largest modulus
    mean     its mean
    """

    def __init__(self, points: ArrayLike) -> None:
        self._shares, self._values = np.asarray(points, dtype=np.float64).T
        self._lengths = np.diff(self._shares, append=self._shares[0] + 1.0)
        after = np.roll(self._values, -1)
        self.largest = float(np.abs(self._values).max())
        self.mean = self._kept(math.fsum(0.5 * (self._values + after) * self._lengths))
        slopes = (after - self._values) / self._lengths
        self._bends = slopes - np.roll(slopes, 1)

    def _kept(self, number: float) -> float:
        return float(f"{number:.{DIGITS}g}") if abs(number) > ROUNDING * self.largest else 0.0

    def evaluate(self, shares: Array) -> Array:
        """Return the values at these shares of the period."""
        return np.interp(shares, self._shares, self._values, period=1.0)

    def harmonic(self, k: int) -> HarmonicAmplitudes:
        """Return the Fourier coefficients of order k, from the bends J of the slope at shares x.

        -(2 pi k)^2 (sine, cosine) = 2 sum J (sin 2 pi k x, cos 2 pi k x)
        """
        angles = 2.0 * np.pi * np.fmod(k * self._shares, 1.0)
        unit = -2.0 / (2.0 * np.pi * k) ** 2
        return HarmonicAmplitudes(*(self._kept(unit * math.fsum(self._bends * of(angles))) for of in (np.sin, np.cos)))

    def error(self, harmonics: Mapping[int, HarmonicAmplitudes]) -> float:
        """Return a bound of the largest error of the mean and these harmonics, relative to the largest value.

        The bound is the largest error r at shares a step d apart, the points included, plus d^2 / 8 max |r''| for the
        shares between. There the waveform is linear, and r'' is that of the harmonics.
        """
        shares = np.union1d(np.arange(LOOKED_AT) / LOOKED_AT, self._shares)
        sums = np.full(shares.size, self.mean)
        bound = 0.0
        for k, (sine, cosine) in harmonics.items():
            angles = 2.0 * np.pi * np.fmod(k * shares, 1.0)
            sums += sine * np.sin(angles) + cosine * np.cos(angles)
            bound += (2.0 * math.pi * k) ** 2 * math.hypot(sine, cosine)
        r = sums - self.evaluate(shares)
        return (float(np.abs(r).max()) + bound / (8.0 * LOOKED_AT**2)) / self.largest

    def fewest(self, within: float, orders: Iterable[int], limit: int) -> tuple[dict[int, HarmonicAmplitudes], float]:
        """Return the fewest of the largest harmonics of these orders within an error, and the error that they have.

        within  largest error
        orders  orders of the harmonics
        limit   maximum number of harmonics

        If ``limit`` harmonics do not reach the error, return the best approximation.
        """
        every = {k: part for k in orders if any(part := self.harmonic(k))}
        ranked = sorted(every, key=lambda k: (-math.hypot(*every[k]), k))
        parts, best = dict[int, HarmonicAmplitudes](), math.inf
        for count in range(min(limit, len(ranked)) + 1):
            tried = {k: every[k] for k in sorted(ranked[:count])}
            if (error := self.error(tried)) < best:
                parts, best = tried, error
            if best <= within:
                break
        return parts, best
