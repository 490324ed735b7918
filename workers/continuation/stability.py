"""Stability of an orbit: the map of one turn as flights and saltations, its multipliers."""

from functools import reduce

import numpy as np
from numpy.typing import NDArray

from workers.continuation.equations import ImpactMotion, Motion
from workers.kernel.contact import saltation
from workers.kernel.flow import flow_with_tangent
from workers.kernel.jit import kernel
from workers.kernel.motion import axes
from workers.model.oscillator import Array
from workers.orbit.map import copy_into, jacobian_of


@kernel
def flights(blocks, s, R, ratio):
    """The maps (N, K, 2n, 2n) of flights of durations s (N, K), each with the impact at its end.

    Of blocks (N, n, columns). R (N,), ratio (N, K) = a / v just before it; (N, 0) for no impacts.
    """
    (N, K), n = s.shape, blocks.shape[1]
    found = np.empty((N, K, 2 * n, 2 * n))
    for r, i in np.ndindex(N, K):
        V = axes(n)
        flow_with_tangent(blocks[r], s[r, i], np.zeros((n, 2)), V)
        if ratio.shape[1] > 0:
            saltation(blocks[r], R[r], V, ratio[r, i])
        copy_into(found[r, i], jacobian_of(V))
    return found


def pieces(motion: ImpactMotion) -> Array:
    """The factors (N, m, 2n, 2n) of the map of a turn from just after its first impact: a flight and the next impact.

    Without impacts one flight. The last factor changes sign for symmetric orbits.
    """
    lin, t, span = motion.lin, motion.times, motion.span[:, None]
    _, v, a = np.moveaxis(motion.turn.signals, 1, 0)
    durations = np.concatenate([t[:, 1:], t[:, :1] + span], axis=1) - t if motion.itinerary.sides else span
    factors: Array = flights(lin.gap.blocks, durations, lin.R, np.roll(a / v, -1, axis=1))
    factors[:, -1] *= motion.itinerary.sign
    return factors


def turn_map(motion: Motion) -> Array:
    """DP (N, 2n, 2n) over a turn; of symmetric orbits D_G = -DP over half the orbit: its square is DP."""
    if not isinstance(motion, ImpactMotion):
        return motion.turn_map()
    return reduce(lambda total, factor: factor @ total, np.moveaxis(pieces(motion), 1, 0))


def multipliers(motion: Motion) -> NDArray[np.complex128]:
    """Multipliers (N, 2n) of a turn, those of D_G for symmetric orbits, of largest modulus first; inf where v = 0, and
    exactly 0 in directions that are lost."""
    with np.errstate(all="ignore"):
        maps = turn_map(motion)
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
