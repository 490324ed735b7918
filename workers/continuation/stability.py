"""Stability of an orbit: the multipliers of the map of one turn."""

import numpy as np
from numpy.typing import NDArray

from workers.continuation.motion import OrbitMotion
from workers.model.oscillator import Array


def multipliers(motion: OrbitMotion) -> NDArray[np.complex128]:
    """Multipliers (N, 2n) of a turn, those of D_G for symmetric orbits, of largest modulus first; inf where an impact
    has no speed, and exactly 0 in directions that are lost."""
    maps = motion.turn.maps
    found = np.full(maps.shape[:2], np.inf, dtype=np.complex128)
    finite = np.isfinite(maps).all(axis=(1, 2))
    found[finite] = np.linalg.eigvals(maps[finite])
    found = np.take_along_axis(found, np.argsort(-np.abs(found), axis=1, kind="stable"), axis=1)
    if motion.lost:
        found[:, -motion.lost :] = 0.0
    return found


def pair_near(values: NDArray[np.complex128], total: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Sum and product (N,) of that pair of multipliers (N, 2n) whose sum is next to ``total`` (N,), its product to 1.

    Both are smooth where the pair is real and double too, unlike the multipliers themselves. And the places (N, 2) of
    the pair.
    """
    pairs = np.stack(np.triu_indices(values.shape[1], 1), axis=1)
    with np.errstate(invalid="ignore"):  # infinite ones, where an impact has no speed
        sums, products = np.sum(values[:, pairs], axis=2), np.prod(values[:, pairs], axis=2)
    distance = np.abs(sums - total[:, None]) + np.abs(products - 1.0)
    pick = np.argmin(np.where(np.isfinite(distance), distance, np.inf), axis=1)
    each = np.arange(len(pick))
    return sums[each, pick].real, products[each, pick].real, pairs[pick]
