"""Stability of an orbit: the multipliers of the map of one turn."""

import numpy as np
from numpy.typing import NDArray

from workers.continuation.legs import MODE
from workers.continuation.motion import OrbitMotion
from workers.kernel.hybrid.state import right_hand_side, turned
from workers.model.oscillator import Array, one_of


def multipliers(motion: OrbitMotion) -> NDArray[np.complex128]:
    """Multipliers (N, 2n) of a turn, those of D_G for symmetric orbits, of largest modulus first; inf where an impact
    has no speed, and exactly 0 in directions that are lost. Of a cycle all (N, 2n - 1) but the 1 along it."""
    maps: Array = _across(motion) if motion.itinerary.is_cycle else motion.turn.maps
    found = np.full(maps.shape[:2], np.inf, dtype=np.complex128)
    finite = np.isfinite(maps).all(axis=(1, 2))
    found[finite] = np.linalg.eigvals(maps[finite])
    found = np.take_along_axis(found, np.argsort(-np.abs(found), axis=1, kind="stable"), axis=1)
    if motion.lost:
        found[:, max(0, maps.shape[1] - motion.lost) :] = 0.0
    return found


def _across(motion: OrbitMotion) -> Array:
    """The maps (N, 2n - 1, 2n - 1) of a turn of cycles, of disturbances less their share along the motion f: the map
    takes f to itself, so that these have all its other multipliers."""
    maps, mode = motion.turn.maps, motion.plan.reached[0, MODE]
    size = maps.shape[1]
    found, f = np.empty((len(maps), size - 1, size - 1)), np.empty((1, size))
    for r, start in enumerate(motion.start):
        right_hand_side(one_of(motion.pieces, r), mode, start, turned(0.0, motion.pieces.waves.shape[3]), f[0])
        across = np.linalg.svd(f)[2][1:]
        found[r] = across @ maps[r] @ across.T
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
