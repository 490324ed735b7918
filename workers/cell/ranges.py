"""The range of the gap coordinate over an orbit, over motion without impact, or over some periods of chaos."""

import numpy as np

from workers.kernel.cells import excursions
from workers.kernel.motion import FLIGHT, LOWER, UPPER
from workers.model.oscillator import Array, Oscillator, Rows

FOLLOWED = 64
"""Periods over which the range is sought of a motion that neither closes nor reaches both stops."""

WORK_PER_PERIOD, LEAST_WORK = 1000, 100_000
"""Evaluations allowed for each such period, and the least for all together."""


def impact_range(oscillators: Oscillator, tally: Array, h: Array, mode: Rows, periods: Rows) -> Array:
    """Greatest minus least y (N,) of motions with impacts and counts ``tally`` (N, TALLIES).

    The whole gap if impacts were counted at both stops; else y is followed from block states h (N, n, 2) with contacts
    (N, 1) over ``periods`` (N,), through every turning point. NaN if it cannot be followed.
    """
    if oscillators.has_modes:
        return np.full(len(tally), np.nan)  # there is no single gap coordinate
    both = (tally[:, UPPER] > 0.0) & (tally[:, LOWER] > 0.0)
    followed = _followed(oscillators, h, mode, periods, np.flatnonzero(~both))
    return np.where(both, oscillators.upper - oscillators.lower, followed)


def free_range(oscillators: Oscillator, h: Array) -> Array:
    """Greatest minus least y (N,) of motions without impact from block states h (N, n, 2).

    Twice the amplitude of the forced response if that is a single harmonic and the rest has decayed, h = 0 except the
    position of a rigid mode. From turning points over one period for several harmonics, over FOLLOWED periods for
    motion that does not decay.
    """
    N, harmonics = oscillators.gap.sin_part.shape
    steady = np.all((h[..., 1] == 0.0) & ((h[..., 0] == 0.0) | (oscillators.gap.lam == 0.0)), axis=1)
    closed = steady & (harmonics == 1)
    mode, periods = np.full((N, 1), FLIGHT), np.where(steady, 1, FOLLOWED)
    followed = _followed(oscillators, h, mode, periods, np.flatnonzero(~closed))
    return np.where(closed, 2.0 * oscillators.gap.amplitude, followed)


def _followed(oscillators: Oscillator, h: Array, mode: Rows, periods: Rows, cells: Rows) -> Array:
    """The range of these cells by ``excursions``, 0 for a motion at rest; NaN for the others."""
    allowance = np.maximum(LEAST_WORK, WORK_PER_PERIOD * periods)
    ends = excursions(oscillators, h, mode, periods, allowance, cells)
    return np.where(ends[:, 0] > ends[:, 1], 0.0, ends[:, 1] - ends[:, 0])


def steady_state(oscillators: Oscillator, h: Array) -> Array:
    """Limits of block states h (N, n, 2) without impact: damped rigid modes come to rest, undamped motion continues."""
    eta, lam = oscillators.gap.eta, oscillators.gap.lam
    with np.errstate(divide="ignore", invalid="ignore"):
        end = np.where(lam == 0.0, h[..., 0] + h[..., 1] / (2.0 * eta), 0.0)
    return np.where((eta > 0.0)[..., None], np.stack([end, np.zeros_like(end)], axis=-1), h)
