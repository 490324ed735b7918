"""The range of the gap coordinate over an orbit, over motion without impact, over some periods of chaos."""

import numpy as np

from workers.kernel.cells import excursions
from workers.kernel.motion import FREE, LOWER, UPPER
from workers.model.oscillator import Array, Oscillator, Rows

FOLLOWED = 64
"""Periods over which the range of a motion is looked for that neither closes nor reaches both stops."""

WORK_PER_PERIOD, LEAST_WORK = 1000, 100_000
"""Evaluations that this may cost for each period, and the least for all of them together."""


def impact_range(oscillators: Oscillator, tally: Array, h: Array, contact: Rows, periods: Rows) -> Array:
    """Greatest minus least y (N,) of motions with impacts, which have counted ``tally`` (N, TALLIES).

    It is the whole gap where impacts were counted at both stops; else y is followed from block states h (N, n, 2) with
    contacts (N, 1) over ``periods`` (N,), through every turning point. NaN where it cannot be followed.
    """
    if oscillators.has_modes:
        return np.full(len(tally), np.nan)  # there is no one coordinate that it is of
    both = (tally[:, UPPER] > 0.0) & (tally[:, LOWER] > 0.0)
    followed = _followed(oscillators, h, contact, periods, np.flatnonzero(~both))
    return np.where(both, oscillators.upper - oscillators.lower, followed)


def free_range(oscillators: Oscillator, h: Array) -> Array:
    """Greatest minus least y (N,) of motions without impact from block states h (N, n, 2).

    Twice the amplitude of the forced response where that is a single harmonic and all else has decayed, h = 0 but for
    the position of a rigid mode; the turning points of one period where it has several, of FOLLOWED periods where the
    motion does not decay.
    """
    N, harmonics = oscillators.gap.sin_part.shape
    steady = np.all((h[..., 1] == 0.0) & ((h[..., 0] == 0.0) | (oscillators.gap.lam == 0.0)), axis=1)
    closed = steady & (harmonics == 1)
    contact, periods = np.full((N, 1), FREE), np.where(steady, 1, FOLLOWED)
    followed = _followed(oscillators, h, contact, periods, np.flatnonzero(~closed))
    return np.where(closed, 2.0 * oscillators.gap.amplitude, followed)


def _followed(oscillators: Oscillator, h: Array, contact: Rows, periods: Rows, cells: Rows) -> Array:
    """The range that excursions finds of these cells, 0 for a motion that stays where it is; NaN of the others."""
    allowance = np.maximum(LEAST_WORK, WORK_PER_PERIOD * periods)
    ends = excursions(oscillators, h, contact, periods, allowance, cells)
    return np.where(ends[:, 0] > ends[:, 1], 0.0, ends[:, 1] - ends[:, 0])


def steady_state(oscillators: Oscillator, h: Array) -> Array:
    """Where block states h (N, n, 2) go without impact: a damped rigid mode comes to rest, what is undamped goes on."""
    eta, lam = oscillators.gap.eta, oscillators.gap.lam
    with np.errstate(divide="ignore", invalid="ignore"):
        end = np.where(lam == 0.0, h[..., 0] + h[..., 1] / (2.0 * eta), 0.0)
    return np.where((eta > 0.0)[..., None], np.stack([end, np.zeros_like(end)], axis=-1), h)
