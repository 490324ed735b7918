"""The orbits of a plane's cells: from stored results, at other cells, and at points of curves."""

from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from atlas.orbits.curves.plane import Cells, CurvePlane
from atlas.orbits.stored import NEEDED, orbits_of
from workers.continuation import Family, Orbit, family_of
from workers.continuation.equilibria import code_of, equilibrium_near, equilibrium_of, is_equilibrium
from workers.continuation.orbits import alike, attract, continued_to, many_of
from workers.continuation.same import same_orbit
from workers.model.family import NoOscillatorError
from workers.results import CYCLE_PERIOD, NO_IMPACT

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CEASES, PERSISTS, IS = range(3)
"""The fate of a cell's orbit at the parameters of another cell."""


class CellOrbits:
    """The orbits of a plane's cells, each found once; of a cell without one, None."""

    def __init__(self, plane: CurvePlane) -> None:
        self.plane = plane
        self.family: Family = family_of(plane.system, plane.fixed, plane.axes)
        self._known: dict[int, Orbit | None] = {}

    def along(self, axis: int, values: Array) -> Family:
        """The family over one axis, 0 for x, through a point (2,)."""
        names = self.plane.axes
        return family_of(
            self.plane.system, {**self.plane.fixed, names[1 - axis]: float(values[1 - axis])}, (names[axis],)
        )

    def of(self, cell: int) -> Orbit | None:
        """The orbit of a proven cell; None where Newton's method finds none, such as for R = 0."""
        if cell not in self._known:
            self.find(np.array([cell]))
        return self._known[cell]

    def find(self, cells: Cells) -> None:
        """Find the orbits of cells, which is quicker for many at once."""
        plane, found = self.plane, self._known
        wanted = np.array([cell for cell in dict.fromkeys(cells.tolist()) if cell not in found], dtype=np.int64)
        found.update(dict.fromkeys(wanted.tolist()))
        wanted = wanted[plane.proven[wanted]]
        names, still = list(NEEDED), self.are_still(wanted)
        if plane.system.definition.unforced:
            names.append(CYCLE_PERIOD.name)
            found.update((cell, self._equilibrium(cell)) for cell in wanted[still].tolist())
            wanted = wanted[~still]
        orbits = orbits_of(self.family, plane.values(wanted), {name: getattr(plane, name)[wanted] for name in names})
        known = zip(wanted.tolist(), orbits, strict=True)
        found.update((cell, orbit) for cell, orbit in known if isinstance(orbit, Orbit))

    def are_still(self, cells: Cells) -> Mask:
        """Which of these cells stand still, without a force: their orbits are equilibria."""
        return np.asarray((self.plane.regime[cells] == NO_IMPACT) & self.plane.system.definition.unforced)

    def _equilibrium(self, cell: int) -> Orbit | None:
        """The equilibrium of a cell; None where friction holds it."""
        plane, (values,) = self.plane, self.plane.values(np.array([cell]))
        given = {**plane.fixed, **dict(zip(plane.axes, values.tolist(), strict=True))}
        with suppress(ValueError):
            return equilibrium_of(plane.system, given, plane.state[cell])
        return None

    def _stands(self, orbit: Orbit, cell: int) -> int:
        """The fate of an equilibrium at a cell's parameters."""
        found = equilibrium_near(self.family, self.plane.values(np.array([cell]))[0], code_of(orbit))
        if found is None or found.unstable:
            return CEASES
        return IS if self.are_still(np.array([cell]))[0] else PERSISTS

    def omega(self, values: Array) -> Array:
        """The forcing frequency (N,) at points (N, 2)."""
        return np.asarray(self.family.model(values).omega)

    def persist(self, pairs: Cells) -> NDArray[np.int64]:
        """Of each pair (N, 2), whether the orbit of the first cell exists and attracts at the second one's parameters:
        CEASES, PERSISTS, or IS where it is the orbit of the second cell.

        By Newton's method from one to the other, half way first; admissible by certified crossings.
        """
        found = np.full(len(pairs), CEASES)
        regions = self.plane.regions[pairs]
        for rows, orbits in self._grouped(pairs[:, 0]):
            if self.are_still(pairs[rows[0], :1])[0]:
                found[rows] = [self._stands(orbit, int(pairs[row, 1])) for row, orbit in zip(rows, orbits, strict=True)]
                continue
            here, there = (self.plane.values(pairs[rows, k]) for k in (0, 1))
            start = many_of(orbits, here)
            try:
                half = continued_to(self.family, start, 0.5 * (here + there))
                taken = continued_to(self.family, half, there)
                attracts = attract(self.family, taken)
            except (NoOscillatorError, ValueError):
                continue
            found[rows[attracts]] = PERSISTS
            for k, row in enumerate(rows):
                if attracts[k] and regions[row, 0] == regions[row, 1] and self._is_of(pairs[row, 1], taken.orbit(k)):
                    found[row] = IS
        return found

    def becomes(self, orbit: Orbit, values: Array, cell: int) -> int:
        """The fate of an orbit at parameters (2,), continued to a cell's parameters: CEASES, PERSISTS, or IS the cell's
        own.
        """
        if is_equilibrium(orbit, self.plane.system):
            return self._stands(orbit, cell)
        there = self.plane.values(np.array([cell]))
        try:
            taken = continued_to(self.family, many_of([orbit], values[None]), there)
            if not attract(self.family, taken)[0]:
                return CEASES
        except (NoOscillatorError, ValueError):
            return CEASES
        return IS if self._is_of(cell, taken.orbit(0)) else PERSISTS

    def _is_of(self, cell: int, orbit: Orbit) -> bool:
        own, values = self.of(int(cell)), self.plane.values(np.array([cell]))
        return own is not None and same_orbit(own, orbit, float(self.omega(values)[0]))

    def belong(self, cells: Cells, points: Sequence[Orbit], values: Array) -> Mask:
        """Whether each orbit (N,), at parameters (N, 2), becomes that of its cell (N,) when it is taken there."""
        found = np.zeros(len(cells), dtype=bool)
        omega = self.omega(self.plane.values(cells)) if len(cells) else np.zeros(0)
        for rows in alike(orbit.itinerary for orbit in points):
            if is_equilibrium(points[rows[0]], self.plane.system):
                found[rows] = self.are_still(cells[rows])
                continue
            start = many_of([points[row] for row in rows], values[rows])
            try:
                taken = continued_to(self.family, start, self.plane.values(cells[rows]))
            except (NoOscillatorError, ValueError):
                continue
            self.find(cells[rows[taken.found]])
            for k, row in enumerate(rows):
                own = self.of(int(cells[row])) if taken.found[k] else None
                found[row] = own is not None and same_orbit(own, taken.orbit(k), omega[row])
        return found

    def _grouped(self, cells: Cells) -> Iterator[tuple[NDArray[np.int64], list[Orbit]]]:
        """Rows of cells whose orbits have one itinerary, with these."""
        self.find(cells)
        orbits = [self.of(int(cell)) for cell in cells]
        for rows in alike(None if orbit is None else orbit.itinerary for orbit in orbits):
            yield rows, [orbit for row in rows if (orbit := orbits[row]) is not None]
