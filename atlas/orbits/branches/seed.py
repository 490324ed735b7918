"""The orbit from which a branch starts: the proven orbit of a cell, solved here or stored in an atlas."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from atlas.errors import InputError
from atlas.query.cell import StoredCell
from atlas.spec.spec import given_settings, validate_parameters
from atlas.spec.system import must_offer, parse_system
from workers import Settings
from workers.model.system import DEFAULT, System
from workers.results import CYCLE_PERIOD, NO_IMPACT, PERIODIC, REASON, REGIME, in_words

if TYPE_CHECKING:
    import xarray as xr

    from workers.continuation import Orbit


@dataclass(frozen=True, eq=False)
class BranchSeed:
    """A periodic orbit of a system, from which a branch starts.

    system  the system
    values  value of each of its parameters
    orbit   the orbit
    """

    system: System
    values: Mapping[str, float]
    orbit: "Orbit"


def seed_of_point(
    parameters: Mapping[str, Any], system: str | Mapping[str, Any] | System = DEFAULT, settings: Settings | None = None
) -> BranchSeed:
    """Solve a cell with the given parameters and return its orbit. Parameters that are left out have their default
    values.

    Raise InputError for invalid parameters, and if the cell's motion is not periodic.
    """
    from workers.tile import solve_tile

    record = parse_system(system)
    values = validate_parameters(record, parameters)
    arrays = solve_tile(record, values, given_settings(settings))
    return seed_of({name: array[()] for name, array in arrays.items()}, record, values)


def seed_of_cell(ds: "xr.Dataset", point: Mapping[str, float]) -> BranchSeed:
    """Return the stored orbit of the cell nearest to a point of an atlas; errors are as in ``seed_of_point``.

    In an atlas of all attractors the orbit is the selected one, by default the one with the largest share.
    """
    cell = StoredCell.nearest(ds, point)
    stored = ["regime", "reason", "period", "symmetric", "state"]
    stored += [CYCLE_PERIOD.name] if cell.system.definition.unforced else []
    missing = [name for name in stored if name not in cell.row and name != REASON.name]
    if missing:
        raise InputError(f"a branch needs the variable {missing[0]!r} of a cell, which this atlas does not have")
    results = {name: cell.row[name].values[()] for name in stored if name in cell.row}
    return seed_of(results, cell.system, validate_parameters(cell.system, cell.parameters))


def seed_of(cell: Mapping[str, Any], record: System, values: dict[str, float]) -> BranchSeed:
    """Return the orbit of a cell from the cell's results by name. Raise InputError, naming the cell's regime, if it has
    none.
    """
    from atlas.orbits.stored_orbits import NEEDED, orbits_of
    from workers.continuation import family_of
    from workers.continuation.equilibria import equilibrium_of

    must_offer(record, "branches", unforced=True)
    regime = int(cell[REGIME.name])
    if regime not in (PERIODIC, NO_IMPACT):
        why = in_words(cell).get(REASON.name)
        regime_text = record.regime.meaning(regime).text + (f" ({why})" if why else "")
        raise InputError(f"this cell is {regime_text}: a branch starts from a periodic cell")
    unforced = record.definition.unforced
    if unforced and regime == NO_IMPACT:
        try:
            return BranchSeed(record, values, equilibrium_of(record, values, cell["state"]))
        except ValueError as error:
            raise InputError(f"this cell: {error}") from None
    row = {name: np.asarray(cell[name])[None] for name in (*NEEDED, *((CYCLE_PERIOD.name,) if unforced else ()))}
    (orbit,) = orbits_of(family_of(record, values, ()), np.zeros((1, 0)), row)
    if isinstance(orbit, str):
        raise InputError(f"this cell: {orbit}")
    return BranchSeed(record, values, orbit)
