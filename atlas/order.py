"""In which order tiles are solved: a few everywhere first, then those that are costly by what these have cost.

Costs of tiles differ a hundredfold. When the last costly one is begun late, a large cluster waits for it alone; row by
row that depends on which corner of the plane the chaos lies in. Neighbours cost much the same, so the receipts of a
coarse lattice predict the rest, for nothing: solving cells beforehand as a probe costs more than it gives
(scripts/bench_scale.py measures all three).
"""

from collections.abc import Iterator

import numpy as np

LATTICE = 4
"""Every how many tiles, along each dimension, one is solved first."""
NEIGHBOURS = 4
"""From how many tiles of known cost another's is guessed."""


class Order:
    """The indices of the tiles due, each once; what is noted in time decides the order of those to come."""

    def __init__(self, due: np.ndarray) -> None:
        self._due = due
        self._cost: dict[tuple[int, ...], float] = {}
        self._noting = True

    def note(self, index: tuple[int, ...], cost: float) -> None:
        """What a tile has cost, in any unit. Once the order is settled it is of no more use, and not kept."""
        if self._noting:
            self._cost[index] = cost

    def __iter__(self) -> Iterator[tuple[int, ...]]:
        first = np.zeros_like(self._due)
        first[tuple(slice(min(LATTICE // 2, (n - 1) // 2), None, LATTICE) for n in self._due.shape)] = True
        yield from _indices(np.flatnonzero(self._due & first), self._due.shape)
        self._noting = False
        yield from _indices(self._costly_first(np.flatnonzero(self._due & ~first)), self._due.shape)

    def _costly_first(self, places: np.ndarray) -> np.ndarray:
        from scipy.spatial import KDTree

        if not self._cost or not places.size:
            return places
        known = np.array(list(self._cost))
        wanted = np.stack(np.unravel_index(places, self._due.shape), axis=-1)
        distance, near = KDTree(known).query(wanted, k=range(1, min(NEIGHBOURS, len(known)) + 1))
        weight = 1 / np.maximum(distance, 0.5)  # a known tile may itself be due, where a run was cut short
        cost = np.fromiter(self._cost.values(), float)[near]
        return places[np.argsort(-(weight * cost).sum(axis=1) / weight.sum(axis=1), kind="stable")]


def _indices(places: np.ndarray, shape: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """Indices of places in the flattened grid, one at a time."""
    for place in places:
        yield tuple(map(int, np.unravel_index(place, shape)))
