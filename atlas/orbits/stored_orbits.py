"""Stored cells as orbits: the one way from the results of periodic cells to the equations of their impacts.

An orbit is recorded over one turn of the motion from its stored state. Newton's method then solves all orbits of one
itinerary together.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from atlas.orbits.orbit_table import Array, Mask, OrbitTable, Rows
from workers.continuation import Family, Orbit, family_of
from workers.continuation.equilibria import equilibrium_of
from workers.continuation.orbit_from_motion import record_orbit, reduce_symmetry
from workers.continuation.orbits import OrbitBatch, attract, continued_to, group_indices, many_of
from workers.model.family import NoOscillatorError
from workers.results import CYCLE_PERIOD, NO_IMPACT, REGIME

NEEDED = (REGIME.name, "period", "symmetric", "state")
"""Variables from which an orbit is made, besides the cell's parameters; without a force also CYCLE_PERIOD."""


class StoredOrbits:
    """The orbits of rows of a store, each solved once, and followed to other parameters."""

    def __init__(self, rows: OrbitTable) -> None:
        self.rows = rows
        self.family: Family = family_of(rows.system, rows.fixed, rows.axes)
        self._known: dict[int, Orbit | None] = {}

    def family_along(self, axis: int, values: Array) -> Family:
        """Return the family of orbits along one axis, by its index, through a point (axes,)."""
        table = self.rows
        others = {
            name: float(value) for name, value in zip(table.axes, values, strict=True) if name != table.axes[axis]
        }
        return family_of(table.system, {**table.fixed, **others}, (table.axes[axis],))

    def orbit_of_row(self, row: int) -> Orbit | None:
        """Return the orbit of a row; None without a proven one, or if Newton's method finds none, for example for R =
        0.
        """
        if row not in self._known:
            self.find([row])
        return self._known[row]

    def find(self, rows: Iterable[int]) -> None:
        """Solve for the orbits of rows; many rows at once are faster."""
        table, known = self.rows, self._known
        unsolved = np.array([row for row in dict.fromkeys(map(int, rows)) if row not in known], dtype=np.int64)
        known.update(dict.fromkeys(unsolved.tolist()))
        unsolved, names = unsolved[table.proven[unsolved]], [*NEEDED]
        if table.system.definition.unforced:
            names.append(CYCLE_PERIOD.name)
            still = self.are_still(unsolved)
            known.update((row, self._equilibrium(row)) for row in unsolved[still].tolist())
            unsolved = unsolved[~still]
        orbits = orbits_of(
            self.family, table.values(unsolved), {name: getattr(table, name)[unsolved] for name in names}
        )
        pairs = zip(unsolved.tolist(), orbits, strict=True)
        known.update((row, orbit) for row, orbit in pairs if isinstance(orbit, Orbit))

    def are_still(self, rows: Rows) -> Mask:
        """Return the mask of rows that stand still, without a force: their orbits are equilibria."""
        return np.asarray((self.rows.regime[rows] == NO_IMPACT) & self.rows.system.definition.unforced)

    def _equilibrium(self, row: int) -> Orbit | None:
        """Return the equilibrium of a row; None if friction makes it stick."""
        table, (values,) = self.rows, self.rows.values(np.array([row]))
        parameters = {**table.fixed, **dict(zip(table.axes, values.tolist(), strict=True))}
        try:
            return equilibrium_of(table.system, parameters, table.state[row])
        except ValueError:
            return None

    def group_by_itinerary(self, rows: Rows) -> Iterator[tuple[Rows, list[Orbit]]]:
        """Yield the indices of rows whose orbits have one itinerary, with these orbits; rows without an orbit are left
        out.
        """
        self.find(rows)
        orbits = [self.orbit_of_row(int(row)) for row in rows]
        for places in group_indices(None if orbit is None else orbit.itinerary for orbit in orbits):
            yield places, [orbit for index in places if (orbit := orbits[index]) is not None]

    def continue_orbits(
        self,
        orbits: list[Orbit],
        from_parameters: Array,
        to_parameters: Array,
        steps: int = 1,
        attracting: bool = False,
    ) -> OrbitBatch:
        """Return orbits of one itinerary, continued from parameters (N, axes) to others by Newton's method in equal
        steps.

        The mask ``converged`` of the result marks orbits that are found, and with ``attracting`` also attract there. It
        is False throughout if one of the orbits has no machine on the way.
        """
        reached = start = many_of(orbits, from_parameters)
        try:
            for share in np.arange(1, steps + 1) / steps:
                reached = continued_to(self.family, reached, (1.0 - share) * from_parameters + share * to_parameters)
            return reached._replace(converged=attract(self.family, reached)) if attracting else reached
        except (NoOscillatorError, ValueError):
            return start._replace(converged=np.zeros(len(orbits), dtype=np.bool_))


def orbits_of(family: Family, points: Array, cells: Mapping[str, NDArray[Any]]) -> list[Orbit | str]:
    """Return the exact orbit of each of N periodic cells, or in words why there is none, for example for R = 0.

    points (N, free)  values of the family's free parameters
    cells             columns NEEDED as the store has them: (N,), states (N, 2n)

    Motion without impact is its own mirror image in a symmetric machine, even if its row in the store is not marked so.
    Raise NoOscillatorError for a point without a machine.
    """
    if not len(points):
        return []
    machines, still = family.model(points), cells[REGIME.name] == NO_IMPACT
    symmetric = np.where(still, machines.mirrored, cells["symmetric"]).astype(bool)
    lengths = cells[CYCLE_PERIOD.name].tolist() if CYCLE_PERIOD.name in cells else [None] * len(points)
    turns = zip(cells["state"], np.maximum(cells["period"], 1).tolist(), symmetric.tolist(), lengths, strict=True)
    orbits = list[Orbit | str]()
    for k, turn in enumerate(turns):
        try:
            orbits.append(record_orbit(machines.at_rows(np.array([k])), *turn))
        except ValueError as error:
            orbits.append(str(error))
    orbits = _exact(family, orbits, points)
    for k, orbit in enumerate(orbits):
        half = reduce_symmetry(machines.at_rows(np.array([k])), orbit) if isinstance(orbit, Orbit) else orbit
        if half is not orbit:
            (orbits[k],) = _exact(family, [half], points[k : k + 1])
    return orbits


def _exact(family: Family, orbits: Sequence[Orbit | str], points: Array) -> list[Orbit | str]:
    """Return the orbits near these at their points (N, free), to rounding, or why there is none. Reasons are kept."""
    solved = list(orbits)
    for rows in group_indices(orbit.itinerary if isinstance(orbit, Orbit) else None for orbit in orbits):
        same = [orbit for k in rows.tolist() if isinstance(orbit := orbits[k], Orbit)]
        for k, orbit in zip(rows.tolist(), _by_newton(family, same, points[rows]), strict=True):
            solved[k] = orbit
    return solved


def _by_newton(family: Family, orbits: list[Orbit], points: Array) -> list[Orbit | str]:
    """Do the work of ``_exact`` for orbits of one itinerary."""
    try:
        near = continued_to(family, many_of(orbits, points), points)
    except ValueError as error:
        if len(orbits) == 1:
            return [str(error)]
        return [one for k, orbit in enumerate(orbits) for one in _by_newton(family, [orbit], points[k : k + 1])]
    return [near.orbit(k) if near.converged[k] else "Newton's method finds no orbit there" for k in range(len(orbits))]
