"""The periodic orbits of stored cells, solved from the stored results.

An orbit is recorded by simulating one period from the stored state. Newton's method then solves together all orbits
that have one itinerary, the sequence of impacts and other events.
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
"""Names of the stored results from which an orbit is solved, besides parameters; without a force also CYCLE_PERIOD."""


class StoredOrbits:
    """The periodic orbits of a store's cells or attractors, each solved once, and continued to other parameters."""

    def __init__(self, rows: OrbitTable) -> None:
        self.rows = rows
        self.family: Family = family_of(rows.system, rows.fixed, rows.axes)
        self._known: dict[int, Orbit | None] = {}

    def family_along(self, axis: int, values: Array) -> Family:
        """Return the family of orbits with one free parameter, that of the axis with index ``axis``.

        All other axes have their values (axes,) at a point.
        """
        table = self.rows
        others = {
            name: float(value) for name, value in zip(table.axes, values, strict=True) if name != table.axes[axis]
        }
        return family_of(table.system, {**table.fixed, **others}, (table.axes[axis],))

    def orbit_of_row(self, row: int) -> Orbit | None:
        """Return the orbit of a row; None if the row is not periodic or Newton's method finds no orbit, for example for
        R = 0.
        """
        if row not in self._known:
            self.find([row])
        return self._known[row]

    def find(self, rows: Iterable[int]) -> None:
        """Solve for the orbits of rows and keep them. Many rows in one call are faster than many calls."""
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
        """Return the mask of rows of an unforced machine that are at rest, so that the orbit is an equilibrium."""
        return np.asarray((self.rows.regime[rows] == NO_IMPACT) & self.rows.system.definition.unforced)

    def _equilibrium(self, row: int) -> Orbit | None:
        """Return the equilibrium at which the machine of a row rests; None if friction holds it there."""
        table, (values,) = self.rows, self.rows.values(np.array([row]))
        parameters = {**table.fixed, **dict(zip(table.axes, values.tolist(), strict=True))}
        try:
            return equilibrium_of(table.system, parameters, table.state[row])
        except ValueError:
            return None

    def group_by_itinerary(self, rows: Rows) -> Iterator[tuple[Rows, list[Orbit]]]:
        """Group rows by the itinerary of their orbits, the sequence of impacts and other events.

        Yield, for each group, the indices into ``rows`` and the orbits. Rows without an orbit are left out.
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
        """Continue orbits with one itinerary from parameters (N, axes) to others by Newton's method.

        orbits           N orbits with the same sequence of impacts and other events
        from_parameters  parameters (N, axes) of the orbits
        to_parameters    parameters (N, axes) to reach, in ``steps`` equal steps
        attracting       True to accept only orbits that attract

        The mask ``converged`` of the result marks orbits that are found and accepted. It is False throughout if the
        parameters of one of the orbits on the way admit no machine.
        """
        reached = start = many_of(orbits, from_parameters)
        try:
            for share in np.arange(1, steps + 1) / steps:
                reached = continued_to(self.family, reached, (1.0 - share) * from_parameters + share * to_parameters)
            return reached._replace(converged=attract(self.family, reached)) if attracting else reached
        except (NoOscillatorError, ValueError):
            return start._replace(converged=np.zeros(len(orbits), dtype=np.bool_))


def orbits_of(family: Family, points: Array, cells: Mapping[str, NDArray[Any]]) -> list[Orbit | str]:
    """Return the exact orbit of each of N periodic cells, or the reason in words if there is none, for example for R =
    0.

    family            system with its free and fixed parameters
    points (N, free)  values of the family's free parameters
    cells             the stored results NEEDED by name: (N,), states (N, 2n)

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
    """Refine approximate orbits at their points (N, free) by Newton's method, to rounding errors.

    An entry becomes a reason in words if there is no orbit. Entries that are reasons are returned as they are.
    """
    solved = list(orbits)
    for rows in group_indices(orbit.itinerary if isinstance(orbit, Orbit) else None for orbit in orbits):
        same = [orbit for k in rows.tolist() if isinstance(orbit := orbits[k], Orbit)]
        for k, orbit in zip(rows.tolist(), _by_newton(family, same, points[rows]), strict=True):
            solved[k] = orbit
    return solved


def _by_newton(family: Family, orbits: list[Orbit], points: Array) -> list[Orbit | str]:
    """Do the work of ``_exact`` for orbits that all have the same sequence of impacts and other events."""
    try:
        near = continued_to(family, many_of(orbits, points), points)
    except ValueError as error:
        if len(orbits) == 1:
            return [str(error)]
        return [one for k, orbit in enumerate(orbits) for one in _by_newton(family, [orbit], points[k : k + 1])]
    return [near.orbit(k) if near.converged[k] else "Newton's method finds no orbit there" for k in range(len(orbits))]
