"""The norm in which deviations from an orbit shrink, and what falls into an orbit by it."""

import math

import numpy as np
import pytest

from workers.model.oscillator import make_blocks
from workers.orbit.attraction import falls_into, shrinking_norm


def blocks_of(metric: np.ndarray) -> np.ndarray:
    """Undamped blocks in which states have this metric."""
    return make_blocks(np.zeros_like(metric), metric)


def naive_norm(metric: np.ndarray, J: np.ndarray, contraction: float) -> np.ndarray:
    """P = sum_{k < K} (A^k)' A^k in energy coordinates, A = J / q, q = 1 - contraction / 2, K = 2^m with |A^K| <= 1."""
    w = np.array([factor for m in metric for factor in (math.sqrt(m), 1.0)])
    A, K = w[:, None] * J / w / (1.0 - 0.5 * contraction), 1
    while np.linalg.norm(np.linalg.matrix_power(A, K)) > 1.0:
        K *= 2
    powers = [np.linalg.matrix_power(A, k) for k in range(K)]
    return w[:, None] * sum(power.T @ power for power in powers) * w


def contracting(rng: np.random.Generator, n: int, modulus: float, skew: float) -> np.ndarray:
    """A matrix (2n, 2n) with this spectral radius, whose eigenvectors are the more alike the larger ``skew``."""
    size = 2 * n
    J = np.diag(rng.uniform(-1.0, 1.0, size)) + skew / n * np.triu(rng.normal(size=(size, size)), 1)
    J[0, 0] = 1.0
    turned = np.linalg.qr(rng.normal(size=(size, size)))[0]
    return modulus * turned @ J @ turned.T


@pytest.mark.parametrize("n", [1, 2, 8])
@pytest.mark.parametrize("modulus", [1e-12, 0.1, 0.81, 0.99])
def test_the_norm_is_the_sum_that_defines_it(n: int, modulus: float) -> None:
    rng = np.random.default_rng(n)
    for skew in (0.0, 0.3, 1.0):
        metric, J = 10.0 ** rng.uniform(-2, 2, n), contracting(rng, n, modulus, skew)
        P = shrinking_norm(blocks_of(metric), J, 1.0 - modulus)
        naive = naive_norm(metric, J, 1.0 - modulus)
        assert np.allclose(P, naive, rtol=1e-6, atol=1e-10 * np.abs(naive).max())


@pytest.mark.parametrize("n", [1, 2, 8])
@pytest.mark.parametrize("modulus", [0.0, 1e-9, 0.3, 0.81, 0.99, 1.0 - 1e-7])
@pytest.mark.parametrize("skew", [0.0, 0.3, 1.0])
def test_in_its_norm_the_jacobian_shrinks_all_deviations(n: int, modulus: float, skew: float) -> None:
    """By q = (1 + |mu|) / 2 at least; truth: random deviations, and those that J stretches most."""
    rng = np.random.default_rng(3 * n)
    J = contracting(rng, n, modulus, skew)
    J[:, -1] = 0.0  # a direction that is lost
    modulus = float(np.abs(np.linalg.eigvals(J)).max())
    metric = 10.0 ** rng.uniform(-2, 2, n)
    P, q = shrinking_norm(blocks_of(metric), J, 1.0 - modulus), 0.5 * (1.0 + modulus)
    deviations = np.concatenate([rng.normal(size=(300, 2 * n)), np.linalg.svd(J)[2]])
    squares, images = (np.einsum("ki,ij,kj->k", x, P, x) for x in (deviations, deviations @ J.T))
    assert np.all(squares > 0.0)
    assert np.all(images <= q**2 * squares * (1.0 + 1e-9))


def test_there_is_no_such_norm_where_deviations_do_not_shrink() -> None:
    metric = np.ones(1)
    for J in (
        np.diag([1.0, 0.5]),
        np.diag([1.1, 0.5]),
        np.full((2, 2), math.nan),
        np.array([[0.0, 1e200], [1e200, 0.0]]),
    ):
        assert np.isnan(shrinking_norm(blocks_of(metric), J, 1e-12)).all()
        P = shrinking_norm(blocks_of(metric), J, 1e-12)
        assert not falls_into(P, J, 1e-12, np.zeros((1, 2)), np.full((1, 2), 1e-9), np.zeros((1, 2)))


def test_motion_falls_in_where_less_than_half_of_the_contraction_is_not_explained() -> None:
    """Truth: the definition, with numpy."""
    rng = np.random.default_rng(0)
    seen = []
    for _ in range(200):
        metric, J, contraction = 10.0 ** rng.uniform(-1, 1, 2), contracting(rng, 2, 0.7, 1.0), 0.3
        P = naive_norm(metric, J, contraction)
        fixed, d, r = rng.normal(size=(3, 4))
        d *= np.sqrt(r @ P @ r) / (0.5 * contraction * np.sqrt(d @ P @ d))
        d *= rng.choice([0.99, 1.01])
        inside = np.sqrt(r @ P @ r) < 0.5 * contraction * np.sqrt(d @ P @ d)
        h, image = fixed + d, fixed + J @ d + r
        norm = shrinking_norm(blocks_of(metric), J, contraction)
        found = falls_into(norm, J, contraction, *(x.reshape(2, 2) for x in (fixed, h, image)))
        assert found == inside
        seen.append(found)
    assert 50 < sum(seen) < 150
