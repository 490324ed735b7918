"""Stability of a periodic orbit: its Floquet multipliers, the eigenvalues of the map of one turn."""

import numpy as np
from numpy.typing import NDArray

from workers.continuation.legs import MODE
from workers.continuation.shooting import OrbitMotion
from workers.kernel.hybrid.state import harmonics_at, right_hand_side
from workers.model.oscillator import Array, take_one


def multipliers(motion: OrbitMotion) -> NDArray[np.complex128]:
    """Return the Floquet multipliers (N, 2n) of a turn, the largest modulus first.

    A turn of a symmetric orbit is half of it, followed by mirroring.

    They are infinite if an impact has zero speed, and exactly 0 in lost directions. For a cycle return all (N, 2n - 1)
    but the 1 along it.
    """
    maps: Array = _across(motion) if motion.itinerary.is_cycle else motion.turn.maps
    values = np.full(maps.shape[:2], np.inf, dtype=np.complex128)
    finite = np.isfinite(maps).all(axis=(1, 2))
    values[finite] = np.linalg.eigvals(maps[finite])
    values = np.take_along_axis(values, np.argsort(-np.abs(values), axis=1, kind="stable"), axis=1)
    if motion.n_zero_multipliers:
        values[:, max(0, maps.shape[1] - motion.n_zero_multipliers) :] = 0.0
    return values


def _across(motion: OrbitMotion) -> Array:
    """Return the maps (N, 2n - 1, 2n - 1) of a turn of cycles, for disturbances across the direction f of the motion.

    The whole map takes f to itself, so that these maps have all its other multipliers.
    """
    maps, along = motion.turn.maps, _along(motion)
    size = maps.shape[1]
    across_f = np.empty((len(maps), size - 1, size - 1))
    for r, f in enumerate(along):
        across = np.linalg.svd(f[None])[2][1:]
        across_f[r] = across @ maps[r] @ across.T
    return across_f


def _along(motion: OrbitMotion) -> Array:
    """Return the direction f (N, 2n) of the motion of cycles in state space, just before their first event."""
    mode, f = motion.plan.reached[0, MODE], np.empty_like(motion.start)
    for r, start in enumerate(motion.start):
        right_hand_side(take_one(motion.pieces, r), mode, start, harmonics_at(0.0, motion.pieces.waves.shape[3]), f[r])
    return f


def error_along(motion: OrbitMotion) -> Array:
    """Return the error (N,) of the multiplier 1 along cycles: how far the map of a turn moves f, relative to f.

    The direction f of the motion is its own image in exact arithmetic. The result is an error of the other multipliers
    as well.
    """
    f = _along(motion)
    missed = (motion.turn.maps @ f[..., None])[..., 0] - f
    return np.asarray(np.linalg.norm(missed, axis=1) / np.linalg.norm(f, axis=1))


def pair_near(values: NDArray[np.complex128], total: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return sum and product (N,) of the pair of multipliers (N, 2n) nearest to sum ``total`` and product 1.

    The third result (N, 2) are the indices of the pair. Sum and product are smooth even if the pair is real and double,
    unlike the multipliers themselves.
    """
    pairs = np.stack(np.triu_indices(values.shape[1], 1), axis=1)
    with np.errstate(invalid="ignore"):  # multipliers are infinite if an impact has zero speed
        sums, products = np.sum(values[:, pairs], axis=2), np.prod(values[:, pairs], axis=2)
    distance = np.abs(sums - total[:, None]) + np.abs(products - 1.0)
    pick = np.argmin(np.where(np.isfinite(distance), distance, np.inf), axis=1)
    rows = np.arange(len(pick))
    return sums[rows, pick].real, products[rows, pick].real, pairs[pick]
