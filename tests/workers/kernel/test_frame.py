"""The tangent frame: Gram-Schmidt in the energy product, with logarithms."""

import numpy as np
import pytest

from workers.kernel.lanes.frames import normalise_pass, project_pass, transfer_pass
from workers.kernel.lanes.layout import BLOCK_SIZE, LANE, LANE_SIZE, STRIDE, VECTOR_WIDTH, padded_blocks
from workers.kernel.lanes.two_blocks import VECTOR, VECTORS, orthonormalise_frames, transfer_frames
from workers.kernel.tangent import inner, orthonormalise
from workers.model.oscillator import make_blocks

LAM = (0.7, 3.1)
BLOCKS = make_blocks(np.zeros(2), np.array(LAM))


def weighted(V: np.ndarray) -> np.ndarray:
    """Vectors (m, 2n) whose plain inner product is the energy product of V (m, n, 2)."""
    return (V * np.column_stack([np.sqrt(LAM), np.ones(2)])).reshape(len(V), -1)


def test_the_energy_product_is_that_of_undamped_flight() -> None:
    """Undamped flow is a rotation in it: q' = v, v' = -lam q keeps lam q^2 + v^2."""
    rng = np.random.default_rng(1)
    u, w = rng.normal(size=(2, 2, 2))
    t = 0.83
    moved = []
    for z in (u, w):
        out = np.empty((2, 2))
        for j, lam in enumerate(LAM):
            s = np.sqrt(lam)
            out[j] = np.array([[np.cos(s * t), np.sin(s * t) / s], [-s * np.sin(s * t), np.cos(s * t)]]) @ z[j]
        moved.append(out)
    before, after = np.array([u, w]), np.array(moved)
    assert inner(BLOCKS, after, 0, after, 1) == pytest.approx(inner(BLOCKS, before, 0, before, 1), rel=1e-13)


def test_a_frame_is_orthonormal_with_the_growth_of_a_qr_factorisation() -> None:
    """Truth: numpy's QR of the weighted vectors."""
    rng = np.random.default_rng(2)
    for m in (1, 2, 4):
        V = rng.normal(size=(m, 2, 2)) * np.exp(rng.normal(size=(m, 1, 1)))
        growth = rng.normal(size=m)
        R = np.linalg.qr(weighted(V).T)[1]
        expected = growth + np.log(np.abs(np.diag(R)))
        orthonormalise(BLOCKS, V, growth, np.zeros((0, 0)), 4)
        assert weighted(V) @ weighted(V).T == pytest.approx(np.eye(m), abs=1e-14)
        assert growth == pytest.approx(expected, rel=1e-13)


def test_a_zero_vector_within_a_frame_is_a_lost_direction_and_leaves_the_others_alone() -> None:
    V = np.random.default_rng(3).normal(size=(3, 2, 2))
    V[1] = 0.0
    two, growth, alone = V[[0, 2]].copy(), np.zeros(3), np.zeros(2)
    orthonormalise(BLOCKS, V, growth, np.zeros((0, 0)), 4)
    orthonormalise(BLOCKS, two, alone, np.zeros((0, 0)), 4)
    assert growth[1] == -np.inf and np.all(V[1] == 0.0)
    assert np.array_equal(V[[0, 2]], two) and np.array_equal(growth[[0, 2]], alone)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 8])
def test_frames_side_by_side_are_made_orthonormal_as_each_alone(n: int) -> None:
    """Of full rank, and of the ranks that sticking (2n - 2) and R = 0 (2n - 1) leave, whose last vectors are zero."""
    rng = np.random.default_rng(5)
    N, m, wide = VECTOR_WIDTH, 2 * n, padded_blocks(n)
    rank = np.array([m, m - 1, m - 2] * N, dtype=float)[:N]
    lam = rng.uniform(0.5, 4.0, size=(n, N))
    V = rng.normal(size=(N, m, n, 2)) * (np.arange(m) < rank[:, None])[..., None, None]
    weights, together, growths = np.zeros((wide, 2, STRIDE)), np.zeros((m, wide, 2, STRIDE)), np.zeros((m, STRIDE))
    weights[:n, 0, :N], together[:, :n, :, :N] = lam, np.moveaxis(V, 0, -1)
    partial = np.zeros(2 * STRIDE)
    flat = together.reshape(m, -1)
    with np.errstate(all="ignore"):
        for k in range(m):
            normalise_pass(weights.ravel(), rank, k, flat[k], growths[k], partial, N)
            for later in range(k + 1, m):
                project_pass(weights.ravel(), flat[k], flat[later], partial, N)
    for i in range(N):
        growth = np.zeros(m)
        orthonormalise(make_blocks(np.zeros(n), lam[:, i]), V[i], growth, np.zeros((0, 0)), int(rank[i]))
        assert together[:, :n, :, i] == pytest.approx(V[i], abs=1e-13)
        assert growths[:, i] == pytest.approx(growth, abs=1e-13)


def test_whole_frames_of_two_blocks_become_orthonormal_to_the_bits_of_one_vector_at_a_time() -> None:
    """Of all ranks, the vectors beyond which are zero, some of them negative zeros."""
    rng, N = np.random.default_rng(6), 2 * VECTOR_WIDTH
    metric, rank = rng.uniform(0.5, 4.0, VECTOR), rng.integers(0, VECTORS + 1, STRIDE).astype(float)
    one, growths, partial = rng.normal(size=(VECTORS, VECTOR)), rng.normal(size=(VECTORS, STRIDE)), np.zeros(2 * STRIDE)
    lanes = one.reshape(VECTORS, 4, STRIDE)
    lanes *= np.arange(VECTORS)[:, None, None] < rank
    whole, grown = one.copy(), growths.copy()
    with np.errstate(all="ignore"):
        for k in range(VECTORS):
            normalise_pass(metric, rank, k, one[k], growths[k], partial, N)
            for later in range(k + 1, VECTORS):
                project_pass(metric, one[k], one[later], partial, N)
        orthonormalise_frames(metric, rank, whole.ravel(), grown.ravel(), N)
    assert whole.tobytes() == one.tobytes()
    assert grown.tobytes() == growths.tobytes()


def test_whole_frames_of_two_blocks_go_through_flights_and_impacts_to_the_bits_of_one_vector_at_a_time() -> None:
    rng, N = np.random.default_rng(7), 2 * VECTOR_WIDTH
    a, one, partial = (
        rng.normal(size=LANE_SIZE + 2 * BLOCK_SIZE),
        rng.normal(size=(VECTORS, VECTOR)),
        np.zeros(2 * STRIDE),
    )
    a[LANE.flows : LANE.flows + N] = rng.integers(0, 2, N)
    a[LANE.loss : LANE.loss + N] *= rng.integers(0, 2, N)
    whole = one.copy()
    for u in one:
        transfer_pass(a, u, partial, N)
    transfer_frames(a, whole.ravel(), N)
    assert whole.tobytes() == one.tobytes()


def test_triangle_and_growth_keep_the_product_of_all_steps() -> None:
    """V_0 through A_1, ..., A_k is (final frame) exp(growth) triangle. Truth: the plain product."""
    rng = np.random.default_rng(3)
    V = np.eye(4).reshape(4, 2, 2).copy()
    growth, triangle = np.zeros(4), np.eye(4)
    product = np.eye(4)
    for _ in range(7):
        A = rng.normal(size=(4, 4)) + 2 * np.eye(4)
        product = A @ product
        V = (V.reshape(4, 4) @ A.T).reshape(4, 2, 2).copy()
        orthonormalise(BLOCKS, V, growth, triangle, 4)
    rebuilt = V.reshape(4, 4).T @ (np.exp(growth)[:, None] * triangle)
    assert rebuilt == pytest.approx(product, rel=1e-10, abs=1e-10 * np.abs(product).max())
    assert np.allclose(np.diag(triangle), 1.0)
    assert np.all(np.tril(triangle, -1) == 0.0)


def test_logarithms_outlive_what_the_product_cannot_hold() -> None:
    """1000 steps of diag(e^2, e^1, e^-1, e^-3): the product over- and underflows, the logs are exact."""
    V = np.eye(4).reshape(4, 2, 2).copy()
    growth, triangle = np.zeros(4), np.eye(4)
    rates = np.array([2.0, 1.0, -1.0, -3.0])
    for _ in range(1000):
        V *= np.exp(rates).reshape(1, 2, 2)
        orthonormalise(BLOCKS, V, growth, triangle, 4)
    assert growth == pytest.approx(1000 * rates + 0.5 * np.log([LAM[0], 1.0, LAM[1], 1.0]), rel=1e-12)
    assert np.all(np.isfinite(triangle))


def test_lost_directions_are_zero_with_growth_minus_infinity() -> None:
    rng = np.random.default_rng(4)
    V = rng.normal(size=(4, 2, 2))
    growth, triangle = np.zeros(4), np.eye(4)
    orthonormalise(BLOCKS, V, growth, triangle, 2)
    assert np.all(V[2:] == 0.0)
    assert np.all(growth[2:] == -np.inf)
    orthonormalise(BLOCKS, V, growth, triangle, 2)
    assert np.all(np.isfinite(growth[:2]))
    assert np.all(np.isfinite(triangle))
    assert weighted(V[:2]) @ weighted(V[:2]).T == pytest.approx(np.eye(2), abs=1e-14)
