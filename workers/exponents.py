"""What is known of exponents without averaging: those of motion without impact, and the law of their sum."""

import math

import numpy as np
from numpy.typing import NDArray

from workers.kernel.stroboscopic import LOST, LOWER, STUCK, UPPER, Motion
from workers.model.oscillator import Oscillator


def free_exponents(osc: Oscillator) -> NDArray[np.float64]:
    """Exponents (2n,) per period of motion without impact, largest first.

    -eta_j T twice for an underdamped block, -(eta_j -+ sqrt(eta_j^2 - lam_j)) T for another.
    """
    rates: list[float] = []
    for eta, lam in zip(osc.gap.eta, osc.gap.lam, strict=True):
        if eta * eta <= lam:
            rates += [eta, eta]
        else:
            fast = eta + math.sqrt(eta * eta - lam)
            rates += [lam / fast, fast]
    return -np.sort(rates) * osc.period


def sum_of_exponents(osc: Oscillator, impacts_per_period: float) -> float:
    """The exact sum of all exponents per period, -trace(M^-1 C) T + 2 ln(R) impacts_per_period.

    R > 0 unless there are no impacts, else ValueError.
    """
    loss = 2.0 * math.log(osc.R) * impacts_per_period if impacts_per_period else 0.0
    return -osc.trace * osc.period + loss


def sum_law_holds(osc: Oscillator, motion: Motion) -> bool:
    """Whether sum_of_exponents holds over what a motion has counted: nothing stuck, no impact with R = 0."""
    return bool(motion.tally[LOST] == 0.0 and motion.tally[STUCK] == 0.0)


def impact_count(motion: Motion) -> float:
    """Impacts that a motion has counted, at both stops."""
    return float(motion.tally[UPPER] + motion.tally[LOWER])
