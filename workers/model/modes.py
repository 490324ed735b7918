"""Blocks h'' + 2 eta h' + lam h of linear oscillators M x'' + C x' + K x: classical modes, or invariant planes.

Damping is classical where the undamped modes stay modes: then they are the blocks. Else the real Schur form splits the
state space into planes, one for each pair of eigenvalues.
"""

import math
from collections.abc import Callable
from contextlib import suppress
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.oscillator import Array

COUPLED = 1e-13
"""Coupling of the modes by the damping, relative to the largest damping, that is more than rounding."""

LIGHT = 1e-9
"""Coupling below which modes stay the blocks where planes nearly coincide: it changes less than rounding of these does.
Negative damping below it is none."""

GRADED = 1e3
"""Ratio of squared frequencies from which on modes are refined: rounding of the largest one shows in the least."""

FREE = 8.0 * np.finfo(np.float64).eps
"""Squared frequency, relative to the largest one and for each coordinate, below which a mode is rigid; likewise damping
below which it is undamped: what rounding leaves of zero."""

SINGULAR = 1e-10
"""Determinant, relative to its size, below which a plane's coordinates are no h and h'; its inverse bounds how much
larger than its eigenvalues' the entries of the transformation may be."""

NEIGHBOUR = 1e-3
"""Mixing of two modes up to which refinement takes it off."""


class Modes(NamedTuple):
    """N oscillators of n coordinates as blocks.

    eta, lam (N, n); to_blocks and to_physical (N, 2n, 2n) between (x, x') and (h_1, h_1', h_2, ...).
    rigid (N,): how many modes have no stiffness. unstable, inseparable (N,): where there are no such blocks, because
    motion grows, or because their planes nearly coincide.
    """

    eta: Array
    lam: Array
    to_blocks: Array
    to_physical: Array
    rigid: NDArray[np.int64]
    unstable: NDArray[np.bool_]
    inseparable: NDArray[np.bool_]


def split(mass: Array, damping: Array, stiffness: Array) -> Modes:
    """The blocks of these oscillators (N, n, n); each depends on its own matrices only, to the bit."""
    N, n = mass.shape[:2]
    lam, modes = _refined(mass, stiffness, *undamped_modes(mass, stiffness))
    largest = np.max(np.abs(lam), axis=1, initial=0.0)
    lam = np.where(np.abs(lam) <= FREE * n * largest[:, None], 0.0, lam)
    modal = np.ascontiguousarray(modes.swapaxes(1, 2)) @ damping @ modes
    eta = np.diagonal(modal, axis1=1, axis2=2) / 2.0
    size = np.max(np.abs(modal), axis=(1, 2), initial=0.0)
    beside = np.abs(modal) * (1.0 - np.eye(n))
    coupled = np.max(beside, axis=(1, 2), initial=0.0) > COUPLED * size
    unstable = np.any(lam < 0.0, axis=1) | np.any(eta < -LIGHT * size[:, None], axis=1)
    weighted = np.ascontiguousarray(modes.swapaxes(1, 2)) @ mass
    found = Modes(
        eta=np.where(eta <= FREE * n * size[:, None], 0.0, eta),
        lam=lam,
        to_blocks=interleaved(weighted),
        to_physical=np.ascontiguousarray(interleaved(modes.swapaxes(1, 2)).swapaxes(1, 2)),
        rigid=np.sum(lam == 0.0, axis=1),
        unstable=unstable,
        inseparable=np.zeros(N, dtype=np.bool_),
    )
    for r in np.flatnonzero(coupled & ~unstable & np.isfinite(modal).all(axis=(1, 2))).tolist():
        _split_planes(found, r, lam[r], modal[r], modes[r], weighted[r])
    return found


def stacked(act: Callable[..., Any], shape: tuple[int, ...], *matrices: Array) -> Any:
    """numpy.linalg's function of many matrices; NaN (of this shape) for those that alone it refuses."""
    with suppress(np.linalg.LinAlgError):
        return act(*matrices)
    found = np.full(shape, np.nan)
    for k, one in enumerate(zip(*matrices, strict=True)):
        with suppress(np.linalg.LinAlgError):
            found[k] = act(*one)
    return found


def undamped_modes(mass: Array, stiffness: Array) -> tuple[Array, Array]:
    """Squared frequencies and mass-normalised modes: modes.T M modes = I, modes.T K modes = diag(lam)."""
    shape = mass.shape
    half = stacked(np.linalg.cholesky, shape, mass)
    scaled = stacked(np.linalg.solve, shape, half, stiffness).swapaxes(1, 2)
    both = stacked(_values_and_vectors, (shape[0], shape[1] + 1, shape[1]),
                   stacked(np.linalg.solve, shape, half, np.ascontiguousarray(scaled)))  # fmt: skip
    modes = stacked(np.linalg.solve, shape, half.swapaxes(1, 2), np.ascontiguousarray(both[:, 1:]))
    return np.ascontiguousarray(both[:, 0]), np.ascontiguousarray(modes)


def _refined(mass: Array, stiffness: Array, lam: Array, modes: Array) -> tuple[Array, Array]:
    """Modes whose squared frequencies have errors of their own size, not of the largest one's.

    modes (I + X), first order in R = I - modes.T M modes and S = modes.T K modes, with X_ij = (S_ij + lam_j R_ij) /
    (lam_j - lam_i), or R_ij / 2 where these are too near; twice, since neighbours take X to more than first order.
    (Ogita & Aishima, Japan J. Indust. Appl. Math. 35 (2018) 1007)
    """
    n = lam.shape[1]
    largest = np.max(np.abs(lam), axis=1, initial=0.0)
    elastic = lam > FREE * n * largest[:, None]
    ratio = largest / np.min(lam, axis=1, where=elastic, initial=np.inf)
    rows = np.flatnonzero((ratio > GRADED) & np.isfinite(modes).all(axis=(1, 2)))
    lam, modes = lam.copy(), modes.copy()
    for _ in range(2 if len(rows) else 0):
        found = modes[rows]
        turned = np.ascontiguousarray(found.swapaxes(1, 2))
        R, S = np.eye(n) - turned @ mass[rows] @ found, turned @ stiffness[rows] @ found
        values = np.diagonal(S, axis1=1, axis2=2) / (1.0 - np.diagonal(R, axis1=1, axis2=2))
        gap, off = values[:, None, :] - values[:, :, None], S + values[:, None, :] * R
        near = np.eye(n, dtype=np.bool_) | (np.abs(off) > NEIGHBOUR * np.abs(gap))
        lam[rows], modes[rows] = values, found + found @ np.where(near, 0.5 * R, off / np.where(near, 1.0, gap))
    return lam, modes


def _values_and_vectors(matrix: Array) -> Array:
    """Eigenvalues and, below them, eigenvectors of symmetric matrices."""
    values, vectors = np.linalg.eigh(matrix)
    return np.concatenate([values[..., None, :], vectors], axis=-2)


def interleaved(rows: Array) -> Array:
    """Rows (N, n, n) for displacements and for velocities alike, as rows (h_1, h_1', ...) of (x, x')."""
    N, n = rows.shape[:2]
    both = np.zeros((N, 2 * n, 2 * n))
    both[:, 0::2, :n] = both[:, 1::2, n:] = rows
    return both


def _split_planes(found: Modes, r: int, lam: Array, damping: Array, modes: Array, weighted: Array) -> None:
    """Write the blocks of oscillator r, whose damping (n, n) couples its undamped modes.

    A rigid mode that no damping reaches is split off first: its double eigenvalue zero has one eigenvector only.
    """
    n = len(lam)
    size = np.max(np.abs(damping))
    idle = int(lam[0] == 0.0 and np.max(np.abs(damping[0])) <= COUPLED * size)
    inner, coupled = lam[idle:], damping[idle:, idle:]
    k = n - idle
    fastest = max(math.sqrt(np.max(inner)), float(np.max(np.abs(coupled))))
    unit = math.ldexp(1.0, -math.frexp(fastest)[1])  # a power of two: no number of a mode is lost in another's rounding
    w = np.where(inner > 0.0, np.sqrt(np.maximum(inner, 0.0)) * unit, 1.0)  # of (w q, q') neither outweighs the other
    A = np.zeros((2 * k, 2 * k))
    A[:k, k:], A[k:, k:] = np.diag(w), -coupled * unit
    A[k:, :k] = -np.diag(np.where(inner > 0.0, w, 0.0))
    eta, stiffness, planes = _refined_planes(A, *_planes(A))
    condition = _condition(planes)
    planes[:, :k] *= w
    coupling = np.max(np.abs(damping) * (1.0 - np.eye(n)))
    if coupling <= min(LIGHT, FREE * n * condition) * size:
        return
    eta, stiffness = eta / unit, stiffness / unit / unit
    planes[0::2, k:] *= unit  # rows of h and h', of displacements and velocities
    planes[1::2, :k] /= unit
    to_blocks = np.zeros((2 * n, 2 * n))  # of modal displacements and velocities
    for j in range(idle):
        to_blocks[2 * j, j] = to_blocks[2 * j + 1, n + j] = 1.0
    to_blocks[2 * idle :, idle:n], to_blocks[2 * idle :, n + idle :] = planes[:, :k], planes[:, k:]
    if inner[0] == 0.0:
        stiffness[np.argmin(stiffness)] = 0.0
    found.eta[r, :idle], found.lam[r, :idle] = 0.0, 0.0
    found.eta[r, idle:], found.lam[r, idle:] = np.maximum(eta, 0.0), stiffness
    found.to_blocks[r] = to_blocks @ np.kron(np.eye(2), weighted)
    found.inseparable[r] = not condition < 1.0 / SINGULAR
    found.unstable[r] |= bool(np.any(eta < -LIGHT * size) or np.any(stiffness < 0.0))
    if not found.inseparable[r]:
        found.to_physical[r] = np.kron(np.eye(2), modes) @ np.linalg.inv(to_blocks)


def _condition(planes: Array) -> float:
    """How nearly planes coincide, whose rows these are: the condition of the matrix of rows of unit length."""
    unit = planes / np.linalg.norm(planes, axis=1, keepdims=True)
    return float(np.linalg.cond(unit)) if np.isfinite(unit).all() else math.inf


def _planes(A: Array) -> tuple[Array, Array, Array]:
    """eta and lam (n,) of the planes of z' = A z and the rows (2n, 2n) that take z to their coordinates (h, h').

    The rows W of a plane, orthonormal, satisfy W A = B W; h = alpha W z with the unit vector alpha that makes
    h and h' = alpha B W z most independent, scaled so that h' has a velocity row of unit length.
    """
    from scipy.linalg import schur  # here, since it takes longer to import than all else that most machines need
    from scipy.linalg.lapack import dtrsen

    T, Q = schur(A.T, output="real")
    n = len(A) // 2
    eta, lam, rows = np.empty(n), np.empty(n), np.full((2 * n, 2 * n), np.nan)
    for j, pair in enumerate(_pairs(T)):
        select = np.zeros(2 * n, dtype=np.int32)
        select[list(pair)] = 1
        moved, vectors = dtrsen(select, T, Q, job="N")[:2]
        W, B = vectors[:, :2].T, moved[:2, :2].T
        eta[j], lam[j] = -0.5 * np.trace(B), np.linalg.det(B)
        mixed = 0.5 * (B[1, 1] - B[0, 0])
        values, vectors = np.linalg.eigh(np.array([[B[0, 1], mixed], [mixed, -B[1, 0]]]))
        best = int(np.argmax(np.abs(values)))
        if not abs(values[best]) > SINGULAR * np.max(np.abs(B)):
            continue  # twice the same eigenvalue with a plane of eigenvectors
        alpha = vectors[:, best]
        h, rate = alpha @ W, alpha @ B @ W
        scale = 1.0 / np.linalg.norm(rate[n:])
        rows[2 * j], rows[2 * j + 1] = scale * h, scale * rate
    return eta, lam, rows


def _refined_planes(A: Array, eta: Array, lam: Array, planes: Array) -> tuple[Array, Array, Array]:
    """Planes whose eta and lam have errors of their own size, not of the largest one's: one step of Newton's method.

    With P A P^-1 = B + E, B the blocks [[0, 1], [-lam, -2 eta]], the rows (I + X) P are first order in E where
    X_ij B_j - B_i X_ij = E_ij for i != j; B_i + E_ii is then the plane's, which b11 h + b12 h' takes to h'.
    """
    n = len(eta)
    if not _condition(planes) < 1.0 / SINGULAR:
        return eta, lam, planes
    B = np.zeros((n, 2, 2))
    B[:, 0, 1], B[:, 1, 0], B[:, 1, 1] = 1.0, -lam, -2.0 * eta
    E = (planes @ A @ np.linalg.inv(planes)).reshape(n, 2, n, 2).swapaxes(1, 2)  # [i, j] is the block of both
    E[np.arange(n), np.arange(n)] -= B
    B += E[np.arange(n), np.arange(n)]
    X, unit = np.zeros((n, n, 2, 2)), np.eye(2)
    for i, j in permutations(range(n), 2):
        X[i, j] = np.linalg.solve(np.kron(unit, B[j].T) - np.kron(B[i], unit), E[i, j].ravel()).reshape(2, 2)
    found = planes + X.swapaxes(1, 2).reshape(2 * n, 2 * n) @ planes
    h = found[0::2]
    found[1::2] = B[:, 0, :1] * h + B[:, 0, 1:] * found[1::2]
    return -0.5 * np.trace(B, axis1=1, axis2=2), np.linalg.det(B), found


def _pairs(T: Array) -> list[tuple[int, int]]:
    """Positions on the diagonal of a real Schur form of the eigenvalues of each plane.

    Complex pairs; real ones sorted, neighbours of the smallest relative gap first, since nearly equal ones have to stay
    together.
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
