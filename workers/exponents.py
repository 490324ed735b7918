"""What is known of exponents without averaging: those of motion without impact, and the law of their sum."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.kernel.motion import LOST, LOWER, STUCK, UPPER
from workers.model.oscillator import COLUMN, Oscillator

Array = NDArray[np.float64]


def free_exponents(osc: Oscillator) -> Array:
    """Exponents (2n,) per period of motion without impact, largest first; of many oscillators (N, 2n).

    -eta_j T twice for an underdamped block, -(eta_j -+ sqrt(eta_j^2 - lam_j)) T for another.
    """
    block = osc.gap.block
    rates = np.concatenate([block[..., COLUMN.slow], block[..., COLUMN.fast]], axis=-1)
    return -np.sort(rates, axis=-1) * np.asarray(osc.period)[..., None]


def sum_of_exponents(osc: Oscillator, impacts_per_period: Array | float) -> Any:
    """The exact sum of all exponents per period, -trace(M^-1 C) T + 2 ln(R) impacts_per_period; of many (N,).

    NaN for impacts with R = 0.
    """
    hits, R = np.asarray(impacts_per_period), np.asarray(osc.R)
    loss = 2.0 * np.log(np.where(R > 0.0, R, np.nan)) * hits
    return -osc.trace * osc.period + np.where(hits == 0.0, 0.0, loss)


def sum_law_holds(tally: Array) -> Any:
    """Whether sum_of_exponents holds over what motions have counted (..., TALLIES): no rest, no impact with R = 0."""
    return (tally[..., LOST] == 0.0) & (tally[..., STUCK] == 0.0)


def impact_count(tally: Array) -> Any:
    """Impacts that motions have counted (..., TALLIES), at both stops."""
    return tally[..., UPPER] + tally[..., LOWER]
