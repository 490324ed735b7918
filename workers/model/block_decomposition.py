"""Decomposition of linear oscillators into blocks: undamped modes, or invariant planes.

An oscillator M x'' + C x' + K x becomes blocks h'' + 2 eta h' + lam h. M is invertible, C and K are arbitrary. With
symmetric matrices and classical damping the undamped modes stay modes, and are the blocks. Otherwise the real Schur
form splits the state space into planes, one for each pair of eigenvalues.
"""

import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.model.invariant_planes import SINGULAR, condition_of, planes_of, refine_planes
from workers.model.memoize import memoize_arrays
from workers.model.oscillator import Array, Mask

COUPLED = 1e-13
"""Coupling of modes by the damping, relative to the largest damping, above which it exceeds rounding."""

LIGHT = 1e-9
"""Coupling of modes by the damping up to which the modes are taken as blocks if invariant planes nearly coincide. Such
a coupling changes less than the rounding of the planes does."""

GRADED = 1e3
"""Ratio of squared frequencies above which modes are refined, since rounding of the largest shows in the smallest."""

FREE = 8.0 * np.finfo(np.float64).eps
"""Squared frequency per coordinate, relative to the largest, below which a mode counts as rigid: rounding of zero.
Damping below it, likewise, counts as none.
"""

INSEPARABLE = 1e5
"""Condition number of the rows of invariant planes above which planes are inseparable. Machines are exempt if M, C and
K are symmetric, and C and K feed in no energy. Below it the flow has a relative error of about 3e-16 times the
condition, 1e-9 at 2e5. Rounding keeps the condition of equal planes near 1e8."""

REFINED = 100.0
"""Condition number of the rows of invariant planes up to which refinement pays. Refinement removes an error, but adds
rounding that grows as the square of the condition."""

NEIGHBOUR = 1e-3
"""Mixing of two modes up to which refinement removes it."""


class BlockDecomposition(NamedTuple):
    """N oscillators of n coordinates as blocks; a block of eta < 0 or lam < 0 grows.

    eta, lam                (N, n) damping and stiffness of each block h'' + 2 eta h' + lam h
    to_blocks, to_physical  (N, 2n, 2n) transformations from (x, x') to (h_1, h_1', h_2, ...), and back
    rigid                   (N,) number of modes without stiffness
    inseparable             (N,) mask of oscillators whose planes nearly coincide, so that no such blocks exist
    """

    eta: Array
    lam: Array
    to_blocks: Array
    to_physical: Array
    rigid: NDArray[np.int64]
    inseparable: Mask


@memoize_arrays
def split(mass: Array, damping: Array, stiffness: Array) -> BlockDecomposition:
    """Return oscillators with these matrices (N, n, n) as decoupled equations h'' + 2 eta h' + lam h, the blocks.

    The blocks of an oscillator depend on its own matrices only, to the bit.
    """
    N, n = mass.shape[:2]
    matrices, modal = (mass, stiffness), symmetric(mass) & symmetric(stiffness)
    if not np.all(modal):  # placeholders, overwritten below
        mass, stiffness = (np.where(modal[:, None, None], of, np.eye(n)) for of in matrices)
    lam, modes = _refined(mass, stiffness, *undamped_modes(mass, stiffness))
    largest = np.max(np.abs(lam), axis=1, initial=0.0)
    lam = np.where(np.abs(lam) <= FREE * n * largest[:, None], 0.0, lam)
    between = np.ascontiguousarray(modes.swapaxes(1, 2)) @ damping @ modes
    eta = np.diagonal(between, axis1=1, axis2=2) / 2.0
    size = np.max(np.abs(between), axis=(1, 2), initial=0.0)
    off_diagonal = np.abs(between) * (1.0 - np.eye(n))
    coupled = np.max(off_diagonal, axis=(1, 2), initial=0.0) > COUPLED * size
    passive = np.all(lam >= 0.0, axis=1)
    doubtful = np.flatnonzero(passive & (coupled | np.any(eta < 0.0, axis=1)))
    passive[doubtful] = resists(damping[doubtful])
    none = (eta <= FREE * n * size[:, None]) & (passive[:, None] | (eta >= -_rounding(n, size, largest)[:, None]))
    weighted = np.ascontiguousarray(modes.swapaxes(1, 2)) @ mass
    blocks = BlockDecomposition(
        eta=np.where(none, 0.0, eta),
        lam=lam,
        to_blocks=interleaved(weighted),
        to_physical=np.ascontiguousarray(interleaved(modes.swapaxes(1, 2)).swapaxes(1, 2)),
        rigid=np.sum(lam == 0.0, axis=1),
        inseparable=np.zeros(N, dtype=np.bool_),
    )
    known = np.isfinite(between).all(axis=(1, 2)) & modal
    for r in np.flatnonzero(coupled & known).tolist():
        _split_planes(blocks, r, lam[r], between[r], modes[r], weighted[r], bool(passive[r]))
    mass, stiffness = matrices
    for r in np.flatnonzero(~known).tolist():
        if not modal[r] or np.isfinite([mass[r], damping[r], stiffness[r]]).all():
            _split_any(blocks, r, mass[r], damping[r], stiffness[r])
    return blocks


def symmetric(matrices: Array) -> Mask:
    """Return the mask (N,) of symmetric matrices among matrices (N, n, n)."""
    return np.asarray(np.all(matrices == matrices.swapaxes(1, 2), axis=(1, 2)))


def resists(damping: Array) -> Mask:
    """Return the mask (N,) of matrices (N, n, n) that are symmetric and positive semidefinite to rounding."""
    values = apply_stacked(np.linalg.eigvalsh, damping.shape[:2], damping)
    least, largest = np.min(values, axis=1, initial=np.inf), np.max(np.abs(values), axis=1, initial=0.0)
    return np.asarray(symmetric(damping) & (least >= -FREE * damping.shape[1] * largest))


def _rounding(n: int, damping: Any, stiffness: Any) -> Any:
    """Return the size up to which a growth rate counts as the rounding of zero.

    n          number of coordinates
    damping    size of the damping
    stiffness  size of the squared frequencies
    """
    return FREE * n * np.maximum(damping, np.sqrt(stiffness))


def apply_stacked(act: Callable[..., Any], shape: tuple[int, ...], *matrices: Array) -> Any:
    """Apply a function of numpy.linalg to many matrices.

    act       the function
    shape     shape of the result
    matrices  stacks of matrices

    The result is NaN for matrices that the function rejects.
    """
    with suppress(np.linalg.LinAlgError):
        return act(*matrices)
    results = np.full(shape, np.nan)
    for k, one in enumerate(zip(*matrices, strict=True)):
        with suppress(np.linalg.LinAlgError):
            results[k] = act(*one)
    return results


def undamped_modes(mass: Array, stiffness: Array) -> tuple[Array, Array]:
    """Return squared frequencies and mass-normalised modes: modes.T M modes = I, modes.T K modes = diag(lam)."""
    shape = mass.shape
    half = apply_stacked(np.linalg.cholesky, shape, mass)
    scaled = apply_stacked(np.linalg.solve, shape, half, stiffness).swapaxes(1, 2)
    both = apply_stacked(_values_and_vectors, (shape[0], shape[1] + 1, shape[1]),
                   apply_stacked(np.linalg.solve, shape, half, np.ascontiguousarray(scaled)))  # fmt: skip
    modes = apply_stacked(np.linalg.solve, shape, half.swapaxes(1, 2), np.ascontiguousarray(both[:, 1:]))
    return np.ascontiguousarray(both[:, 0]), np.ascontiguousarray(modes)


def _refined(mass: Array, stiffness: Array, lam: Array, modes: Array) -> tuple[Array, Array]:
    """Return squared frequencies and modes whose errors are relative to each frequency, not to the largest.

    The refined modes are modes (I + X), first order in R = I - modes.T M modes and S = modes.T K modes. X_ij = (S_ij +
    lam_j R_ij) / (lam_j - lam_i), or R_ij / 2 for nearly equal frequencies. The step is applied twice, since neighbours
    make X larger than first order. Source: Ogita & Aishima, Japan J. Indust. Appl. Math. 35 (2018) 1007.
    """
    n = lam.shape[1]
    largest = np.max(np.abs(lam), axis=1, initial=0.0)
    elastic = np.abs(lam) > FREE * n * largest[:, None]
    ratio = largest / np.min(np.abs(lam), axis=1, where=elastic, initial=np.inf)
    rows = np.flatnonzero((ratio > GRADED) & np.isfinite(modes).all(axis=(1, 2)))
    lam, modes = lam.copy(), modes.copy()
    for _ in range(2 if len(rows) else 0):
        some = modes[rows]
        turned = np.ascontiguousarray(some.swapaxes(1, 2))
        R, S = np.eye(n) - turned @ mass[rows] @ some, turned @ stiffness[rows] @ some
        values = np.diagonal(S, axis1=1, axis2=2) / (1.0 - np.diagonal(R, axis1=1, axis2=2))
        gap, off = values[:, None, :] - values[:, :, None], S + values[:, None, :] * R
        near = np.eye(n, dtype=np.bool_) | (np.abs(off) > NEIGHBOUR * np.abs(gap))
        lam[rows], modes[rows] = values, some + some @ np.where(near, 0.5 * R, off / np.where(near, 1.0, gap))
    return lam, modes


def _values_and_vectors(matrix: Array) -> Array:
    """Return the eigenvalues of symmetric matrices and, below them, the eigenvectors."""
    values, vectors = np.linalg.eigh(matrix)
    return np.concatenate([values[..., None, :], vectors], axis=-2)


def interleaved(rows: Array) -> Array:
    """Return the matrices (N, 2n, 2n) from (x, x') to (h_1, h_1', h_2, ...), if h = A x with A = ``rows`` (N, n, n)."""
    N, n = rows.shape[:2]
    both = np.zeros((N, 2 * n, 2 * n))
    both[:, 0::2, :n] = both[:, 1::2, n:] = rows
    return both


def _split_planes(
    blocks: BlockDecomposition, r: int, lam: Array, damping: Array, modes: Array, weighted: Array, passive: bool
) -> None:
    """Write the decoupled equations of oscillator r into ``blocks``; its damping (n, n) couples its undamped modes.

    lam       (n,) squared frequencies
    damping   (n, n) damping between the modes
    modes     (n, n) modes in columns
    weighted  (n, n) modes.T M
    passive   True if nothing feeds energy into the machine, so that no block grows

    An undamped rigid mode is split off first, since its double eigenvalue zero has only one eigenvector.
    """
    n = len(lam)
    size = np.max(np.abs(damping))
    reached = np.maximum(np.max(np.abs(damping), axis=0), np.max(np.abs(damping), axis=1)) > COUPLED * size
    first = np.argsort((lam != 0.0) | reached, kind="stable")
    lam, damping, modes, weighted = lam[first], damping[np.ix_(first, first)], modes[:, first], weighted[first]
    idle = int(lam[0] == 0.0 and not reached[first[0]])
    inner, coupled = lam[idle:], damping[idle:, idle:]
    k = n - idle
    fastest = max(math.sqrt(np.max(np.abs(inner))), float(np.max(np.abs(coupled))))
    unit = math.ldexp(1.0, -math.frexp(fastest)[1])  # a power of two, so that scaling is exact
    w = np.where(inner != 0.0, np.sqrt(np.abs(inner)) * unit, 1.0)  # balances w q and q' in (w q, q')
    A = np.zeros((2 * k, 2 * k))
    A[:k, k:], A[k:, k:] = np.diag(w), -coupled * unit
    A[k:, :k] = -np.diag(np.sign(inner) * w)
    eta, stiffness, planes = planes_of(A, grows=not passive)
    if passive or condition_of(planes) < REFINED:
        eta, stiffness, planes = refine_planes(A, eta, stiffness, planes)
    condition = condition_of(planes)
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
    if np.any(inner == 0.0):
        stiffness[np.argmin(np.abs(stiffness))] = 0.0
    none = (eta <= 0.0) & (passive | (eta >= -_rounding(n, size, np.max(np.abs(lam))) * condition))
    blocks.eta[r, :idle], blocks.lam[r, :idle] = 0.0, 0.0
    blocks.eta[r, idle:], blocks.lam[r, idle:] = np.where(none, 0.0, eta), stiffness
    blocks.to_blocks[r] = to_blocks @ np.kron(np.eye(2), weighted)
    blocks.inseparable[r] = not condition < (1.0 / SINGULAR if passive else INSEPARABLE)
    if not blocks.inseparable[r]:
        blocks.to_physical[r] = np.kron(np.eye(2), modes) @ np.linalg.inv(to_blocks)


def _split_any(blocks: BlockDecomposition, r: int, mass: Array, damping: Array, stiffness: Array) -> None:
    """Write the decoupled equations of oscillator r, with any matrices (n, n), into ``blocks``.

    They are found from the invariant planes of z' = A z with z = (x, x'). Coordinates are first balanced by powers of
    two, and time is scaled by a power of two. Free motions, K x = 0, have no stiffness.
    """
    from scipy.linalg import matrix_balance  # see invariant_planes.planes_of

    n = len(mass)
    blocks.to_blocks[r] = blocks.to_physical[r] = np.nan
    blocks.eta[r] = blocks.lam[r] = 0.0
    A = np.zeros((2 * n, 2 * n))
    with suppress(np.linalg.LinAlgError):
        A[:n, n:], A[n:, :n], A[n:, n:] = np.eye(n), -np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)
    if not (np.isfinite(A).all() and A[:n, n:].any()):
        return
    A, (scale, _) = matrix_balance(A, permute=False, separate=True)
    unit = math.ldexp(1.0, -math.frexp(float(np.max(np.abs(A))))[1])
    eta, lam, planes = planes_of(A * unit, grows=True)
    if condition_of(planes) < REFINED:
        eta, lam, planes = refine_planes(A * unit, eta, lam, planes)
    condition = condition_of(planes)
    blocks.inseparable[r] = not condition < INSEPARABLE
    if blocks.inseparable[r]:
        return
    values = np.linalg.svd(A[n:, :n], compute_uv=False)
    free = int(np.sum(values <= FREE * n * values[0]))
    lam[np.argsort(np.abs(lam), kind="stable")[:free]] = 0.0
    eta[np.abs(eta) <= FREE * n * condition] = 0.0
    planes[1::2] /= unit
    blocks.eta[r], blocks.lam[r], blocks.rigid[r] = eta / unit, lam / unit / unit, free
    blocks.to_blocks[r], blocks.to_physical[r] = planes / scale, scale[:, None] * np.linalg.inv(planes)
