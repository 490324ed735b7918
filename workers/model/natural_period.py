"""The period of a machine without a force, which is unknown before its cycle is found.

Kernels simulate motions over periods of omega. For these machines omega is the lowest natural frequency. After the
proof of a cycle omega is 2 pi / its length, so that a period is one turn of the cycle.
"""

import numpy as np

from workers.model.block_decomposition import FREE, apply_stacked
from workers.model.oscillator import HEAD, NUMBER, Array, Oscillator, Rows


def natural_frequency(mass: Array, stiffness: Array) -> Array:
    """Return the least sqrt |lambda| (N,) above 0 of K x = lambda M x, of matrices (N, n, n); 2 pi if there is none."""
    stiff = apply_stacked(np.linalg.solve, mass.shape, mass, stiffness)
    known = np.isfinite(stiff).all(axis=(1, 2))[:, None, None]
    moduli = np.abs(np.linalg.eigvals(np.where(known, stiff, 0.0)))
    rounding = FREE * moduli.shape[1] * np.max(moduli, axis=1, keepdims=True)
    least = np.min(np.where(moduli > rounding, moduli, np.inf), axis=1)
    return np.where(np.isfinite(least), np.sqrt(least), 2.0 * np.pi)


def set_period(oscillators: Oscillator, rows: Rows, period: Array) -> None:
    """Set the length ``period`` (N,) of one period of these machines without a force; their motions stay the same."""
    omega, table = 2.0 * np.pi / period, oscillators.table
    oscillators.head[rows, HEAD.period] = period
    oscillators.gap.numbers[rows, NUMBER.omega] = omega
    table.omega[rows] = omega
    table.machines.omega[rows] = omega
    table.pieces.numbers[rows, ..., NUMBER.omega] = omega[:, None, None]
