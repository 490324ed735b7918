"""How far free flights pass beyond a stop, in double precision, by samples far below the fastest time scale."""

from math import factorial, inf, pi

import numpy as np
from mpmath import mp
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from tests.support.oracle.model import FLIGHT, Cell, pieces_of
from tests.support.oracle.piecewise.mode_law import ModeLaws

Array = NDArray[np.float64]

SAMPLES = 2000  # per 2 pi / rate, the fastest time scale
BLOCK = 256
DEGREE = 9  # of the Taylor polynomial between samples: (2 pi / SAMPLES)^9 / 9! is far below rounding


def dense_violation(cell: Cell, states: ArrayLike, starts: ArrayLike, durations: ArrayLike) -> Array:
    """Largest distance of each free flight beyond a stop: positive for a missed impact.

    ``states`` (N, 2n) at the flights' starts, ``starts`` their times since the section, ``durations`` (N) or a number.
    """
    flights = np.atleast_2d(np.asarray(states, dtype=float))
    begins, lasts = (np.broadcast_to(np.asarray(times, dtype=float), len(flights)) for times in (starts, durations))
    each = zip(flights, begins, lasts, strict=True)
    return np.array([_violation(cell, state, float(start), float(span)) for state, start, span in each])


def _violation(cell: Cell, state: Array, start: float, span: float) -> float:
    laws = ModeLaws(pieces_of(cell, mp.mpf(start)))
    system, size = laws.law(FLIGHT).system, laws.size
    B = np.zeros((size, size))
    for i, row in enumerate(system.rows):
        for j, entry in row.items():
            B[i, j] = float(entry)
    z = np.array([*state, *map(float, laws.drive(mp.zero))])
    contact, gap = laws.machine.contacts[0], np.zeros(size)
    gap[: laws.n] = [float(entry) for entry in contact.row]
    step = 2.0 * pi / (float(system.rate) * SAMPLES)
    fine = expm(B * step * np.arange(BLOCK + 1)[:, None, None])
    worst = -inf
    for first in range(0, int(np.ceil(span / step)), BLOCK):
        left = span - first * step
        whole = min(int(left / step), BLOCK)
        samples = fine[: whole + 1] @ (expm(B * step * first) @ z)
        if whole < BLOCK:  # the flight ends in this block, with a sample at its very end
            samples = np.vstack([samples, expm(B * (left - whole * step)) @ samples[-1]])
        for side, stop in contact.stops.items():
            worst = max(worst, _highest(B, side * gap, samples, step) - side * float(stop))
    return worst


def _highest(B: Array, gap: Array, samples: Array, step: float) -> float:
    """The largest gap . z among samples (m, states) and the maxima between them, where the velocity turns."""
    position, velocity = samples @ gap, samples @ (gap @ B)
    highest = float(position.max())
    bulge = step * np.abs(np.diff(velocity)) / 4  # h^2 a / 8, with room for changes of a
    may = np.maximum(position[:-1], position[1:]) + bulge >= highest
    for j in np.flatnonzero(may & (velocity[:-1] > 0) & (velocity[1:] <= 0)):
        powers = [samples[j]]
        for _ in range(DEGREE):
            powers.append(B @ powers[-1])
        polynomial = np.array([gap @ z / factorial(k) for k, z in enumerate(powers)])[::-1]
        low, high = 0.0, step
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if np.polyval(np.polyder(polynomial), middle) <= 0 else (middle, high)
        highest = max(highest, float(np.polyval(polynomial, high)))
    return highest


__all__ = ["dense_violation"]
