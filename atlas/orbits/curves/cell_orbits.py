"""The periodic orbits of the cells of an atlas, continued to parameters of other cells and from points of curves."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from atlas.orbits.curves.plane import Cells, CurvePlane
from atlas.orbits.orbit_table import Array, Mask
from atlas.orbits.stored_orbits import StoredOrbits
from workers.continuation import Orbit
from workers.continuation.equilibria import code_of, equilibrium_near, is_equilibrium
from workers.continuation.orbit_equality import is_same_orbit
from workers.continuation.orbits import group_indices

CEASES, PERSISTS, IS = range(3)
"""What becomes of a cell's orbit when it is continued to the parameters of another cell.

CEASES: it does not exist there, or is unstable. PERSISTS: it exists and attracts. IS: it is the orbit of that other
cell.
"""


class CellOrbits(StoredOrbits):
    """The periodic orbits of the cells of a two-parameter atlas, solved by Newton's method."""

    def __init__(self, plane: CurvePlane) -> None:
        super().__init__(plane)
        self.plane = plane

    def _stands(self, orbit: Orbit, cell: int) -> int:
        """Return what becomes of an equilibrium at a cell's parameters: CEASES, PERSISTS, or IS if the cell is at rest
        there.
        """
        equilibrium = equilibrium_near(self.family, self.plane.values(np.array([cell]))[0], code_of(orbit))
        if equilibrium is None or equilibrium.unstable:
            return CEASES
        return IS if self.are_still(np.array([cell]))[0] else PERSISTS

    def omega(self, values: Array) -> Array:
        """Return the forcing frequency (N,) at points (N, 2)."""
        return np.asarray(self.family.model(values).omega)

    def fates(self, pairs: Cells) -> NDArray[np.int64]:
        """Return what becomes of a cell's orbit at another cell's parameters, for each pair of cells (N, 2).

        The result is PERSISTS if the first cell's orbit exists and attracts at the second cell's parameters, IS if it
        also is the second cell's orbit, otherwise CEASES. The orbit is continued by Newton's method, half way first.
        Crossings of the stops, computed with error bounds, decide whether it is admissible.
        """
        verdicts = np.full(len(pairs), CEASES)
        regions = self.plane.regions[pairs]
        for rows, orbits in self.group_by_itinerary(pairs[:, 0]):
            if self.are_still(pairs[rows[0], :1])[0]:
                verdicts[rows] = [
                    self._stands(orbit, int(pairs[row, 1])) for row, orbit in zip(rows, orbits, strict=True)
                ]
                continue
            start_values, end_values = (self.plane.values(pairs[rows, k]) for k in (0, 1))
            reached = self.continue_orbits(orbits, start_values, end_values, steps=2, attracting=True)
            verdicts[rows[reached.converged]] = PERSISTS
            for k, row in enumerate(rows):
                if (
                    reached.converged[k]
                    and regions[row, 0] == regions[row, 1]
                    and self._is_of(pairs[row, 1], reached.orbit(k))
                ):
                    verdicts[row] = IS
        return verdicts

    def fate_at(self, orbit: Orbit, values: Array, cell: int) -> int:
        """Return what becomes of an orbit at parameters (2,) when it is continued to a cell's parameters.

        The result is CEASES or PERSISTS, or IS if it becomes the cell's own orbit.
        """
        if is_equilibrium(orbit, self.plane.system):
            return self._stands(orbit, cell)
        reached = self.continue_orbits([orbit], values[None], self.plane.values(np.array([cell])), attracting=True)
        if not reached.converged[0]:
            return CEASES
        return IS if self._is_of(cell, reached.orbit(0)) else PERSISTS

    def _is_of(self, cell: int, orbit: Orbit) -> bool:
        cell_orbit, values = self.orbit_of_row(int(cell)), self.plane.values(np.array([cell]))
        return cell_orbit is not None and is_same_orbit(cell_orbit, orbit, float(self.omega(values)[0]))

    def belong_to_cells(self, cells: Cells, points: Sequence[Orbit], values: Array) -> Mask:
        """Return the mask (N,) of orbits that become the orbit of a given cell when they are continued to its
        parameters.

        cells (N,)      the cell of each orbit
        points          the N orbits
        values (N, 2)   parameters of the orbits
        """
        belongs = np.zeros(len(cells), dtype=bool)
        omega = self.omega(self.plane.values(cells)) if len(cells) else np.zeros(0)
        for rows in group_indices(orbit.itinerary for orbit in points):
            if is_equilibrium(points[rows[0]], self.plane.system):
                belongs[rows] = self.are_still(cells[rows])
                continue
            orbits = [points[row] for row in rows]
            reached = self.continue_orbits(orbits, values[rows], self.plane.values(cells[rows]))
            self.find(cells[rows[reached.converged]])
            for k, row in enumerate(rows):
                of_cell = self.orbit_of_row(int(cells[row])) if reached.converged[k] else None
                belongs[row] = of_cell is not None and is_same_orbit(of_cell, reached.orbit(k), omega[row])
        return belongs
