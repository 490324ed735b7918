"""Blocks of machines whose damping couples their modes, against eigenvalues in multiprecision."""

import mpmath as mp
import numpy as np
import pytest

from tests.workers.kernel.test_general_flows import flow_error
from workers.model.block_decomposition import split

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


@pytest.mark.parametrize("n", [2, 3, 5])
def test_free_masses_joined_by_springs_have_one_rigid_mode_exactly(n: int) -> None:
    """Their stiffness is singular; the computed eigenvalue is not 0, but rounding."""
    rng = np.random.default_rng(n)
    mass = np.eye(n) * rng.uniform(0.2, 3.0, (200, 1, n))
    springs = rng.uniform(0.1, 9.0, (200, n - 1))
    between = np.eye(n - 1, n) - np.eye(n - 1, n, 1)  # the elongations
    stiffness = between.T @ (springs[:, :, None] * between)
    modes = split(mass, np.zeros_like(mass), stiffness)
    assert np.all(modes.rigid == 1)
    assert np.all(np.sum(modes.lam == 0.0, axis=1) == 1)


@pytest.mark.parametrize("damping", ["none", "proportional", "coupled"])
def test_a_stiff_machine_keeps_its_digits_over_a_period(damping: str) -> None:
    """A spring a million times as stiff: a unit in the last place of the time it takes is 1.4e-12 of its turns."""
    rng = np.random.default_rng(1)
    for _ in range(4):
        stiffness = np.diag(rng.permutation([1e6, *rng.uniform(0.5, 2.0, 2)])) + 0.3 * np.array(
            [[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]]
        )
        light = {"none": 0.0, "proportional": 1e-9 * stiffness, "coupled": np.diag(1e-4 * rng.random(3)) + 1e-5}
        mass = np.diag(rng.uniform(0.5, 2.0, 3))
        assert flow_error(mass, light[damping] + np.zeros((3, 3)), stiffness, 6.28, energy=True) < 4e-12


def test_damping_that_hardly_couples_the_modes_is_not_left_out() -> None:
    """It leaves the trace, and so the sum of the exponents, as it is, but not the motion."""
    damping = np.array([[0.5, 4e-10], [4e-10, 1e-3]])
    assert flow_error(np.eye(2), damping, np.diag([1.0, 1.3]), 20.0, energy=True) < 1e-13


def test_coupling_within_rounding_of_modes_that_nearly_coincide_leaves_them_apart() -> None:
    """Equal frequencies and damping that couples them by rounding, or by as little as the planes' own rounding."""
    damping = 0.1 * np.eye(3) + 3e-15 * np.array([[0.0, 1.0, -1.0], [1.0, 0.0, 1.0], [-1.0, 1.0, 0.0]])
    found = split(np.eye(3)[None], damping[None], np.eye(3)[None])
    assert not found.inseparable[0] and found.lam[0] == pytest.approx(1.0)
    turned = damping + 1e-10 * np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert not split(np.eye(3)[None], turned[None], np.eye(3)[None]).inseparable[0]


def test_masses_tied_to_nothing_are_refused_and_stop_no_other() -> None:
    """Dashpots that couple them and no springs: every plane is the zero matrix's, and none is independent."""
    masses, damping = np.array([[2.0, 0.3], [0.3, 1.0]]), np.array([[0.4, -0.1], [-0.1, 0.3]])
    with np.errstate(all="ignore"):
        found = split(np.stack([masses, np.eye(2)]), np.stack([damping] * 2), np.stack([np.zeros((2, 2)), np.eye(2)]))
    assert found.inseparable.tolist() == [True, False] and found.rigid.tolist() == [2, 0]
