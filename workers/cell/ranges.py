"""The range of the gap coordinate over an orbit, over motion without impact, or over some periods of chaos."""

import numpy as np

from workers.kernel.cell_loops import excursions
from workers.kernel.motion import FLIGHT, LOWER, UPPER
from workers.model.oscillator import Array, GuardedFlow, Oscillator, Rows

FOLLOWED = 64
"""Number of periods over which the range of a motion is measured if the motion neither closes nor reaches both stops.
"""

WORK_PER_PERIOD, LEAST_WORK = 1000, 100_000
"""Number of evaluations allowed for each such period, and minimum for all periods together."""


def impact_range(oscillators: Oscillator, tally: Array, h: Array, mode: Rows, periods: Rows) -> Array:
    """Return maximum minus minimum (N,) of the gap coordinate y over motions with impacts.

    tally    (N, TALLIES) counts of the motions
    h, mode  (N, n, 2), (N, 1) states of the decoupled equations, and numbers of the modes (linear equations)
    periods  (N,) periods over which y is followed

    The range is the whole gap if impacts were counted at both stops. Otherwise y is followed through every turning
    point. The range is NaN if the motion cannot be followed.
    """
    if oscillators.has_modes:
        return np.full(len(tally), np.nan)  # there is no single gap coordinate
    both = (tally[:, UPPER] > 0.0) & (tally[:, LOWER] > 0.0)
    followed = _followed(oscillators, h, mode, periods, np.flatnonzero(~both))
    return np.where(both, oscillators.upper - oscillators.lower, followed)


def free_range(oscillators: Oscillator, h: Array) -> Array:
    """Return maximum minus minimum (N,) of the gap coordinate over motions without impact, from states h (N, n, 2).

    The range is twice the amplitude of the forced response if the response is a single harmonic and the rest has
    decayed: h = 0 except the position of a rigid mode. For several harmonics it is found from turning points over one
    period, and for motion that does not decay over FOLLOWED periods. If this takes more evaluations than allowed, free
    oscillations are so much faster than the force that they swing fully at its extremes. The range is then that of the
    forced response plus twice the amplitudes of the free oscillations.
    """
    gap, mode = oscillators.gap, np.full((len(h), 1), FLIGHT)
    still = np.where((gap.lam == 0.0)[..., None] & [True, False], h, 0.0)
    steady = np.all(h == still, axis=(1, 2))
    closed = gap.sin_part.shape[1] == 1
    rows = np.flatnonzero(~(steady & closed))
    reach = _followed(oscillators, h, mode, np.where(steady, 1, FOLLOWED), rows)
    forced = 2.0 * gap.amplitude
    reach = np.where(steady & closed, forced, reach)
    fast = ~steady & np.isnan(reach)
    if fast.any() and not closed:
        forced = _followed(oscillators, still, mode, np.ones(len(h), dtype=np.int64), np.flatnonzero(fast))
    return np.where(fast, forced + 2.0 * _free_amplitude(gap, h), reach)


@np.errstate(divide="ignore", invalid="ignore")
def _free_amplitude(gap: GuardedFlow, h: Array) -> Array:
    """Return the summed amplitudes (N,) of free, undamped oscillations of the gap coordinate, at states h (N, n, 2).

    The result is NaN if an oscillation is damped or rigid.
    """
    w = np.sqrt(gap.lam)
    swing = np.hypot(gap.c0 * h[..., 0] + gap.c1 * h[..., 1], gap.c0 * h[..., 1] / w - gap.c1 * h[..., 0] * w)
    swing = np.where((gap.eta == 0.0) & (gap.lam > 0.0), swing, np.nan)
    return np.sum(np.where(np.all(h == 0.0, axis=2) | (gap.lam == 0.0) & (h[..., 1] == 0.0), 0.0, swing), axis=1)


def _followed(oscillators: Oscillator, h: Array, mode: Rows, periods: Rows, cells: Rows) -> Array:
    """Return the range (N,) of the gap coordinate of these cells, found by ``excursions``; NaN for all other cells.

    h, mode  (N, n, 2), (N, 1) states of the decoupled equations, and numbers of the modes (linear equations)
    periods  (N,) periods over which motions are followed

    The range of a motion at rest is 0.
    """
    allowance = np.maximum(LEAST_WORK, WORK_PER_PERIOD * periods)
    ends = excursions(oscillators, h, mode, periods, allowance, cells)
    return np.where(ends[:, 0] > ends[:, 1], 0.0, ends[:, 1] - ends[:, 0])


def steady_state(oscillators: Oscillator, h: Array) -> Array:
    """Return the states (N, n, 2) in which motions without impact settle, from states h (N, n, 2).

    Damped rigid modes come to rest; undamped motion continues. States are those of decoupled equations.
    """
    eta, lam = oscillators.gap.eta, oscillators.gap.lam
    with np.errstate(divide="ignore", invalid="ignore"):
        end = np.where(lam == 0.0, h[..., 0] + h[..., 1] / (2.0 * eta), 0.0)
    return np.where((eta > 0.0)[..., None], np.stack([end, np.zeros_like(end)], axis=-1), h)
