"""Borders, the sets of all edges between the same two regions of cells, and the order in which edges are searched."""

import numpy as np
from numpy.typing import NDArray

from atlas.orbits.curves.plane import Cells, CurvePlane
from workers.results import PENDING

EDGES_PER_STAGE = 48
"""Maximum number of edges between cells that are searched for bifurcations and grazes in one stage."""

EDGES_PER_BORDER = 8
"""Maximum number of edges of one border that are searched in a stage; in the border's first stage one edge is
searched.
"""

FRUITLESS = 3
"""Number of fruitless searches after which a border between a region and cells without a known orbit is given up.

A search is fruitless if it finds no bifurcation and no graze. The border is not given up while more than half of its
searches find one.
"""

OPEN, BASIN, CURVE, TRIED, NONE = range(5)
"""What is known about an edge between two cells.

OPEN: nothing. BASIN: the orbit of one cell exists and attracts in the other cell too. CURVE: a curve of an orbit of one
of the cells passes within one cell. TRIED: searched, without finding such a curve. NONE: both cells have the same
orbit.
"""

BETWEEN, BESIDE, BASINS = range(3)
"""Kinds of borders in order of importance.

BETWEEN: between two regions. BESIDE: between a region and cells without a known orbit. BASINS: only basins of
attraction end there.
"""


class BorderSchedule:
    """The edges between cells of a plane, grouped by border, and the order in which they are searched.

    A border is the set of all edges between the same two regions, or between a region and the cells of one regime that
    are in no region. Regions below ``minimum`` cells do not count as regions. Edges between two cells outside all
    regions are on no border.
    """

    def __init__(self, plane: CurvePlane, minimum: int) -> None:
        self.plane = plane
        self.inside: NDArray[np.bool_] = plane.region_sizes[plane.regions] >= minimum
        numbers = np.where(self.inside, plane.regions, PENDING - plane.regime - 1)
        keys, which = np.unique(np.sort(numbers[plane.edges], axis=1), axis=0, return_inverse=True)
        self.which: Cells = which.ravel()
        self.edges = [np.flatnonzero(self.which == k) for k in range(len(keys)) if keys[k, 1] > 0]
        has_region = keys[:, 1] > 0
        self.number = np.cumsum(has_region) - 1
        self.rank: NDArray[np.int64] = np.where(keys[has_region][:, 0] > 0, BETWEEN, BESIDE)
        self.fruitless = np.zeros(len(self.edges), dtype=np.int64)
        self.n_searched = np.zeros(len(self.edges), dtype=np.int64)

    def choose(self, verdicts: NDArray[np.int64], room: int) -> list[int]:
        """Return at most ``room`` edges to search next: those of the most important borders, evenly spaced along each.

        ``verdicts`` has for each edge what is known about it: OPEN, BASIN, CURVE, TRIED or NONE. A border without an
        OPEN edge, where only basins end, contributes one edge in all.
        """
        choices = []
        for k, edges in enumerate(self.edges):
            rank, candidates = int(self.rank[k]), edges[verdicts[edges] == OPEN]
            if not len(candidates) and not self.n_searched[k]:
                rank, candidates = BASINS, edges[verdicts[edges] == BASIN]
            if len(candidates) and (rank == BETWEEN or self._promising(k)):
                choices.append((rank, -len(candidates), k, candidates))
        first = min((rank for rank, *_ in choices), default=0)
        selected_edges: list[int] = []
        for rank, _, k, candidates in sorted(choices, key=lambda entry: entry[:3]):
            if rank == first:
                count = min(len(candidates), EDGES_PER_BORDER if self.n_searched[k] else 1)
                selected_edges += candidates[(2 * np.arange(count) + 1) * len(candidates) // (2 * count)].tolist()
        return selected_edges[: max(0, min(EDGES_PER_STAGE, room))]

    def record_attempt(self, edge: int, fruitful: bool) -> None:
        """Record that an edge was searched; ``fruitful`` is True if a bifurcation or a graze was found."""
        k = self.number[self.which[edge]]
        self.n_searched[k] += 1
        self.fruitless[k] += not fruitful

    def _promising(self, k: int) -> bool:
        return bool(self.fruitless[k] < FRUITLESS or 2 * self.fruitless[k] < self.n_searched[k])

    def orders(self, edge: Cells) -> tuple[tuple[int, int], ...]:
        """Return the directions, as (from cell, to cell), in which the orbits of an edge's cells are to be followed.

        Only cells in regions are starts. The direction from the orbit with the shorter period, then with fewer impacts,
        comes first.
        """
        plane = self.plane
        directions = [(int(a), int(b)) for a, b in (edge, edge[::-1]) if self.inside[a]]

        def length(direction: tuple[int, int]) -> tuple[int, int, bool]:
            cell = direction[0]
            impacts = int(plane.impacts_upper[cell] + plane.impacts_lower[cell])
            return int(plane.period[cell]), impacts, not plane.symmetric[cell]

        return tuple(sorted(directions, key=length))
