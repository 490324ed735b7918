"""Exponents without averaging: for motion without impact, and by the law of their sum."""

from typing import Any

import numpy as np

from workers.kernel.motion import LOST, LOWER, MIN_SPEED, STUCK, UPPER
from workers.model.oscillator import COLUMN, Array, Oscillator


def free_exponents(oscillator: Oscillator) -> Array:
    """Return the exponents (2n,) per period of motion without impact, largest first; (N, 2n) for many oscillators.

    A decoupled equation h'' + 2 eta h' + lam h = 0 gives -eta T twice if it is underdamped, else -(eta -+ sqrt(eta^2 -
    lam)) T.
    """
    block = oscillator.gap.blocks
    rates = np.concatenate([block[..., COLUMN.slow], block[..., COLUMN.fast]], axis=-1)
    return -np.sort(rates, axis=-1) * np.asarray(oscillator.period)[..., None]


def sum_of_exponents(oscillator: Oscillator, impacts_per_period: Array | float) -> Any:
    """Return the exact sum of all exponents per period, -trace(M^-1 C) T + 2 ln(R) impacts_per_period; (N,) for many.

    The sum is NaN for impacts with R = 0, and for machines with other elements than one rigid contact.
    """
    if oscillator.has_modes:
        return np.full(np.shape(oscillator.period), np.nan)
    hits, R = np.asarray(impacts_per_period), np.asarray(oscillator.R)
    loss = 2.0 * np.log(np.where(R > 0.0, R, np.nan)) * hits
    return -oscillator.trace * oscillator.period + np.where(hits == 0.0, 0.0, loss)


def kaplan_yorke(spectrum: Array) -> Array:
    """Return the Kaplan-Yorke dimension j + (lam_1 + ... + lam_j) / |lam_(j+1)| of exponents (..., 2n), largest first.

    j is the largest number of exponents whose sum is not negative: 0 if all are negative, and 2n, with nothing added,
    if volume does not shrink. A lost direction, lam_(j+1) = -inf, adds nothing. The dimension is NaN if an exponent is
    NaN. The attractor of the stroboscopic map has this dimension; the motion in time has one more (Kaplan & Yorke
    1979).
    """
    size = spectrum.shape[-1]
    sums = np.concatenate([np.zeros((*spectrum.shape[:-1], 1)), np.cumsum(spectrum, axis=-1)], axis=-1)
    j = np.sum(np.cumsum(sums < 0.0, axis=-1) == 0, axis=-1) - 1
    total = np.take_along_axis(sums, j[..., None], axis=-1)[..., 0]
    following = np.take_along_axis(spectrum, np.minimum(j, size - 1)[..., None], axis=-1)[..., 0]
    dimension = j + np.where(j < size, total / np.abs(np.where(j < size, following, 1.0)), 0.0)
    return np.where(np.isnan(spectrum).any(axis=-1), np.nan, dimension)


def sum_law_holds(tally: Array) -> Any:
    """Return the mask of motions for which ``sum_of_exponents`` holds: without rest, without an impact with R = 0.

    ``tally`` (..., TALLIES) has the counts of the motions.
    """
    return (tally[..., LOST] == 0.0) & (tally[..., STUCK] == 0.0)


def impact_count(tally: Array) -> Any:
    """Return the number of impacts at both stops together, from the counts (..., TALLIES) of motions."""
    return tally[..., UPPER] + tally[..., LOWER]


def rests_on_stop(tally: Array) -> Any:
    """Return the mask of motions in which the mass has stuck to a rigid stop, from their counts (..., TALLIES).

    The mass usually sticks after a chatter of infinitely many impacts.
    """
    return tally[..., MIN_SPEED] == 0.0
