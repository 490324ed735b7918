"""Stability of an orbit: the map of one turn as flights and saltations, its multipliers and exponents."""

import numpy as np
from numpy.typing import NDArray

from workers.continuation.equations import Impacts, Itinerary, at_impacts
from workers.continuation.linear import ModalOscillator
from workers.continuation.pulses import flights

Array = NDArray[np.float64]


def saltations(lin: ModalOscillator, v: Array, a: Array) -> Array:
    """S (N, K, 2n, 2n) of impacts at velocity v and acceleration a (N, K): physics of one gap coordinate.

    S = I - (1 + R) [k (cA) + (A k) c - (a / v) k c].
    """
    N, n = lin.eta.shape
    row = lin.c.reshape(N, 1, 2 * n)
    kick = lin.k.reshape(N, 1, 2 * n)
    row1 = np.stack([-lin.lam * lin.c[..., 1], lin.c[..., 0] - 2.0 * lin.eta * lin.c[..., 1]], -1).reshape(N, 1, 2 * n)
    kick1 = np.stack([lin.k[..., 1], -lin.lam * lin.k[..., 0] - 2.0 * lin.eta * lin.k[..., 1]], -1)
    kick1 = kick1.reshape(N, 1, 2 * n)
    bent = row1 - (a / v)[..., None] * row
    outer = kick[..., :, None] * bent[..., None, :] + kick1[..., :, None] * row[..., None, :]
    return np.eye(2 * n) - (1.0 + lin.R)[:, None, None, None] * outer


def pieces(lin: ModalOscillator, itinerary: Itinerary, points: Impacts) -> Array:
    """The factors (N, m, 2n, 2n) of the map of a turn from just after its first impact: a flight and the next impact.

    Without impacts one flight. The last factor changes sign for symmetric orbits.
    """
    span = itinerary.span(lin)[:, None]
    if not itinerary.sides:
        return itinerary.sign * flights(lin, span)
    _, v, a = at_impacts(lin, itinerary, points)
    following = np.concatenate([points.t[:, 1:], points.t[:, :1] + span], axis=1)
    factors = np.roll(saltations(lin, v, a), -1, axis=1) @ flights(lin, following - points.t)
    factors[:, -1] *= itinerary.sign
    return factors


def turn_map(lin: ModalOscillator, itinerary: Itinerary, points: Impacts) -> Array:
    """DP (N, 2n, 2n) over a turn; of symmetric orbits D_G = -DP over half the orbit: its square is DP."""
    factors = pieces(lin, itinerary, points)
    total = factors[:, 0]
    for i in range(1, factors.shape[1]):
        total = factors[:, i] @ total
    return total


def multipliers(lin: ModalOscillator, itinerary: Itinerary, points: Impacts) -> NDArray[np.complex128]:
    """Multipliers (N, 2n) of a turn, those of D_G for symmetric orbits, of largest modulus first; inf where v = 0."""
    with np.errstate(all="ignore"):
        maps = turn_map(lin, itinerary, points)
    found = np.full(maps.shape[:2], np.inf, dtype=np.complex128)
    finite = np.isfinite(maps).all(axis=(1, 2))
    found[finite] = np.linalg.eigvals(maps[finite])
    return np.take_along_axis(found, np.argsort(-np.abs(found), axis=1, kind="stable"), axis=1)


def exponents(lin: ModalOscillator, itinerary: Itinerary, points: Impacts) -> Array:
    """Lyapunov exponents (N, 2n) per forcing period, largest first: ln|multipliers|, whatever their spread.

    The eigenvalues of the cyclic matrix of the factors of a turn are the roots of the multipliers: none is lost
    beside another as in the product of the factors.
    """
    factors = pieces(lin, itinerary, points)
    N, m, size = factors.shape[:3]
    cyclic = np.zeros((N, m * size, m * size))
    for i in range(m):
        after = (i + 1) % m
        cyclic[:, after * size : (after + 1) * size, i * size : (i + 1) * size] = factors[:, i]
    with np.errstate(divide="ignore"):
        logs = -np.sort(-np.log(np.abs(np.linalg.eigvals(cyclic))), axis=1)
    periods = itinerary.periods * (0.5 if itinerary.symmetric else 1.0)
    return np.asarray(logs.reshape(N, size, m).sum(2) / periods)


def pair_near(values: NDArray[np.complex128], total: Array) -> tuple[Array, Array]:
    """Sum and product (N,) of that pair of multipliers (N, 2n) whose sum is next to ``total`` (N,), its product to 1.

    Both are smooth where the pair is real and double too, unlike the multipliers themselves.
    """
    i, j = np.triu_indices(values.shape[1], 1)
    with np.errstate(invalid="ignore"):  # infinite ones, where an impact has no speed
        sums, products = values[:, i] + values[:, j], values[:, i] * values[:, j]
    distance = np.abs(sums - total[:, None]) + np.abs(products - 1.0)
    pick = np.argmin(np.where(np.isfinite(distance), distance, np.inf), axis=1)[:, None]
    sums, products = np.take_along_axis(sums, pick, 1), np.take_along_axis(products, pick, 1)
    return sums[:, 0].real, products[:, 0].real
