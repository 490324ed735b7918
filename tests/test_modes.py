"""Blocks of machines whose damping couples their modes, against eigenvalues in multiprecision."""

import mpmath as mp
import numpy as np
import pytest

from workers.model.modes import split

MASS = np.array([[1.86, -0.022, -1.44], [-0.022, 3.4, -0.4], [-1.44, -0.4, 3.98]])
DAMPING = np.array([[46.97, -46.97, -11.06], [-46.97, 46.97, 11.06], [-11.06, 11.06, 46.88]])
STIFFNESS = np.array([[6.59e6, -1.52e3, 5.32e5], [-1.52e3, 5.63e6, 1.39e6], [5.32e5, 1.39e6, 7.23e5]])
"""Three masses, frequencies from 270 to 2300, damping that is not classical."""


def true_values(mass: np.ndarray, damping: np.ndarray, stiffness: np.ndarray) -> list[tuple[mp.mpf, mp.mpf]]:
    """eta and lam of each pair of complex eigenvalues, by lam."""
    n = len(mass)
    with mp.workdps(40):
        inverse = mp.matrix(mass.tolist()) ** -1
        A = mp.zeros(2 * n)
        A[:n, n:] = mp.eye(n)
        A[n:, :n], A[n:, n:] = -inverse * mp.matrix(stiffness.tolist()), -inverse * mp.matrix(damping.tolist())
        values, _ = mp.eig(A)
        return sorted(((-v.real, abs(v) ** 2) for v in values if v.imag > 0), key=lambda pair: pair[1])


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e3])
def test_rates_of_coupled_damping_are_as_exact_in_any_unit_of_time(unit: float) -> None:
    mass, damping, stiffness = MASS, DAMPING * unit, STIFFNESS * unit**2
    found = split(mass[None], damping[None], stiffness[None])
    assert not found.inseparable[0]
    order = np.argsort(found.lam[0])
    for place, (eta, lam) in zip(order, true_values(mass, damping, stiffness), strict=True):
        assert abs(found.lam[0, place] / lam - 1) < 1e-13
        assert abs(found.eta[0, place] / eta - 1) < 1e-12


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e3])
def test_blocks_of_coupled_damping_move_as_the_machine_does(unit: float) -> None:
    """to_blocks A to_physical has the blocks [[0, 1], [-lam, -2 eta]] on its diagonal, in the unit of the fastest."""
    mass, damping, stiffness = MASS, DAMPING * unit, STIFFNESS * unit**2
    found = split(mass[None], damping[None], stiffness[None])
    n = len(mass)
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, :n], A[n:, n:] = -np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)
    blocks = np.zeros((2 * n, 2 * n))
    for j in range(n):
        blocks[2 * j, 2 * j + 1], blocks[2 * j + 1, 2 * j] = 1.0, -found.lam[0, j]
        blocks[2 * j + 1, 2 * j + 1] = -2.0 * found.eta[0, j]
    moved = found.to_blocks[0] @ A @ found.to_physical[0]
    times = np.tile([np.sqrt(found.lam[0].max()), 1.0], n)  # (h, h') as velocities
    scaled = times[:, None] * (moved - blocks) / times[None, :]
    assert np.max(np.abs(scaled)) < 1e-12 * np.sqrt(found.lam[0].max())
