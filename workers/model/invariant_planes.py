"""Invariant planes of a linear flow z' = A z, as coordinates (h, h') with h'' + 2 eta h' + lam h = 0."""

import math
from contextlib import suppress
from itertools import permutations

import numpy as np

from workers.model.oscillator import Array

SINGULAR = 1e-10
"""Relative determinant below which coordinates of a plane cannot be h and h'. Its inverse bounds the entries of the
transformation relative to its eigenvalues.
"""


def condition_of(planes: Array) -> float:
    """Return the condition number of the rows of planes, scaled to length 1: it is large if planes nearly coincide.

    It is infinite if a number is not finite.
    """
    unit = planes / np.linalg.norm(planes, axis=1, keepdims=True)
    return float(np.linalg.cond(unit)) if np.isfinite(unit).all() else math.inf


def planes_of(A: Array, grows: bool = False) -> tuple[Array, Array, Array]:
    """Return eta and lam (n,) of the planes of z' = A z, and the rows (2n, 2n) of their coordinates (h, h') on z.

    The rows W of a plane, orthonormal, satisfy W A = B W. With ``grows`` motion may grow. The eigenvectors of a double
    real eigenvalue with a plane of eigenvectors are then each paired with an eigenvector of another eigenvalue.
    """
    from scipy.linalg import schur  # imported here: it takes longer than all other imports of most machines
    from scipy.linalg.lapack import dtrsen

    T, Q = schur(A.T, output="real")
    n = len(A) // 2
    eta, lam, rows = np.empty(n), np.empty(n), np.full((2 * n, 2 * n), np.nan)
    for j, pair in enumerate(_pairs(T)):
        select = np.zeros(2 * n, dtype=np.int32)
        select[list(pair)] = 1
        sorted_form, vectors = dtrsen(select, T, Q, job="N")[:2]
        eta[j], lam[j], rows[2 * j : 2 * j + 2] = _coordinates(vectors[:, :2].T, sorted_form[:2, :2].T, grows)
    return _planes_of_vectors(A) if grows and np.isnan(rows).any() else (eta, lam, rows)


def _coordinates(W: Array, B: Array, full_row: bool) -> tuple[float, float, Array]:
    """Return eta and lam of a plane W A = B W, and the weights (2, 2n) of z in its coordinates h and h'.

    h = alpha W z with the unit vector alpha that makes h and h' = alpha B W z most independent. The weights are scaled
    so that the velocity part of those of h' has unit length. With ``full_row`` all weights of h' have unit length,
    since the velocity part may be zero. The weights are NaN if no alpha makes h and h' independent.
    """
    mixed = 0.5 * (B[1, 1] - B[0, 0])
    values, vectors = np.linalg.eigh(np.array([[B[0, 1], mixed], [mixed, -B[1, 0]]]))
    best, n = int(np.argmax(np.abs(values))), W.shape[1] // 2
    rows = np.full(W.shape, np.nan)
    if abs(values[best]) > SINGULAR * np.max(np.abs(B)):  # else a double eigenvalue with a plane of eigenvectors
        alpha = vectors[:, best]
        h, rate = alpha @ W, alpha @ B @ W
        scale = 1.0 / np.linalg.norm(rate if full_row else rate[n:])
        rows[0], rows[1] = scale * h, scale * rate
    return -0.5 * np.trace(B), np.linalg.det(B), rows


def _planes_of_vectors(A: Array) -> tuple[Array, Array, Array]:
    """Return ``planes_of`` from eigenvectors.

    Real eigenvectors are sorted by eigenvalue, and each is paired with the one half of their number further on.
    """
    values, vectors = np.linalg.eig(A.T)
    reals = sorted(np.flatnonzero(values.imag == 0.0).tolist(), key=lambda k: (values[k].real, k))
    half, n = len(reals) // 2, len(A) // 2
    pairs = [
        _coordinates(vectors[:, [i, k]].real.T, np.diag(values[[i, k]].real), full_row=True)
        for i, k in zip(reals[:half], reals[half:], strict=True)
    ]
    for k in np.flatnonzero(values.imag > 0.0).tolist():
        a, b = values[k].real, values[k].imag
        W, B = np.array([vectors[:, k].real, vectors[:, k].imag]), np.array([[a, -b], [b, a]])
        pairs.append(_coordinates(W, B, full_row=True))
    eta, lam, rows = zip(*pairs, strict=True)
    return np.array(eta), np.array(lam), np.reshape(rows, (2 * n, 2 * n))


def refine_planes(A: Array, eta: Array, lam: Array, planes: Array) -> tuple[Array, Array, Array]:
    """Return planes whose eta and lam have errors relative to themselves, not to the largest: one Newton step.

    P A P^-1 = B + E, with B the blocks [[0, 1], [-lam, -2 eta]]. The rows (I + X) P are first order in E if X_ij B_j -
    B_i X_ij = E_ij for i != j. B_i + E_ii is then the matrix of the plane, and h' is b11 h + b12 h'.
    """
    n = len(eta)
    if not condition_of(planes) < 1.0 / SINGULAR:
        return eta, lam, planes
    B = np.zeros((n, 2, 2))
    B[:, 0, 1], B[:, 1, 0], B[:, 1, 1] = 1.0, -lam, -2.0 * eta
    E = (planes @ A @ np.linalg.inv(planes)).reshape(n, 2, n, 2).swapaxes(1, 2)  # [i, j] is the block of both
    E[np.arange(n), np.arange(n)] -= B
    B += E[np.arange(n), np.arange(n)]
    X, unit = np.zeros((n, n, 2, 2)), np.eye(2)
    for i, j in permutations(range(n), 2):
        with suppress(np.linalg.LinAlgError):  # of planes with equal motion
            X[i, j] = np.linalg.solve(np.kron(unit, B[j].T) - np.kron(B[i], unit), E[i, j].ravel()).reshape(2, 2)
        X[i, j] = np.where(np.max(np.abs(X[i, j])) < 1.0, X[i, j], 0.0)  # nearly equal planes: no more than rounding
    rows = planes + X.swapaxes(1, 2).reshape(2 * n, 2 * n) @ planes
    h = rows[0::2]
    rows[1::2] = B[:, 0, :1] * h + B[:, 0, 1:] * rows[1::2]
    return -0.5 * np.trace(B, axis1=1, axis2=2), np.linalg.det(B), rows


def _pairs(T: Array) -> list[tuple[int, int]]:
    """Return the diagonal positions, in a real Schur form, of the two eigenvalues of each plane.

    Complex pairs come first. Real eigenvalues follow in order, neighbours with the smallest relative gap first, since
    nearly equal ones must stay together.
    """
    pairs = [(i, i + 1) for i in np.flatnonzero(np.diagonal(T, -1)).tolist()]
    reals = sorted(set(range(len(T))).difference(*pairs), key=lambda position: (T[position, position], position))
    while reals:
        values = np.array([T[position, position] for position in reals])
        gaps = np.diff(values) / np.maximum(np.maximum(np.abs(values[1:]), np.abs(values[:-1])), 1e-300)
        k = int(np.argmin(gaps))
        pairs.append((reals[k], reals[k + 1]))
        del reals[k : k + 2]
    return pairs
