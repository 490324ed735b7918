"""The order in which tiles are solved: first a coarse lattice, then the others by predicted cost, the costliest first.

Costs of tiles differ a hundredfold. If tiles were solved row by row and chaos lay in the last rows, a large cluster
would end up waiting for a costly tile begun last. Neighbouring tiles cost about the same, so the reports of the lattice
predict the other costs for free. A probe of some cells of each tile predicts no better and costs time.
"""

from collections.abc import Iterator

import numpy as np

STRIDE = 4
"""Distance, in tiles along each dimension, between tiles of the first lattice; half of it for the second lattice."""
NEIGHBOURS = 4
"""Number of tiles of known cost from which the cost of another tile is predicted."""


class TileOrder:
    """An iterator over the indices of the unfinished tiles, in the order in which they should be solved.

    Costs of tiles that are recorded during the iteration change the order of the remaining tiles.
    """

    def __init__(self, unfinished: np.ndarray) -> None:
        self._due = unfinished
        self._cost = np.full(unfinished.shape, np.nan)
        self._noted = 0

    def record_cost(self, index: tuple[int, ...], cost: float) -> None:
        """Record the cost of a solved tile, in any unit, from which the costs of other tiles are predicted."""
        self._cost[index] = cost
        self._noted += 1

    def __iter__(self) -> Iterator[tuple[int, ...]]:
        coarse, fine = self._lattice(STRIDE), self._lattice(STRIDE // 2)
        stages = (self._due & coarse, self._due & fine & ~coarse, self._due & ~fine)
        rest = np.concatenate([np.flatnonzero(stage) for stage in stages])
        enough, n_yielded, first = max(1, int(coarse.sum()) // 4), 0, int(stages[0].sum())
        for _ in range(rest.size):
            if self._noted >= enough and first <= 0:  # sorted again whenever twice as many costs are known
                rest, n_yielded, enough = self._costly_first(rest[n_yielded:]), 0, 2 * self._noted
            yield tuple(map(int, np.unravel_index(rest[n_yielded], self._due.shape)))
            n_yielded, first = n_yielded + 1, first - 1

    def _lattice(self, stride: int) -> np.ndarray:
        mask = np.zeros(self._due.shape, dtype=bool)
        mask[tuple(slice(min(STRIDE // 2, (n - 1) // 2) % stride, None, stride) for n in self._due.shape)] = True
        return mask

    def _costly_first(self, places: np.ndarray) -> np.ndarray:
        from scipy.spatial import KDTree

        known = np.isfinite(self._cost)
        points = np.stack(np.unravel_index(places, self._due.shape), axis=-1)
        neighbours = range(1, min(NEIGHBOURS, self._noted) + 1)
        distance, near = KDTree(np.argwhere(known)).query(points, k=neighbours)
        guess = np.average(self._cost[known][near], axis=1, weights=1 / distance)
        return places[np.argsort(-guess, kind="stable")]
