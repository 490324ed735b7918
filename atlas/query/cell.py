"""The specification of one cell of an atlas: everything needed to solve the cell again."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from atlas.errors import InputError
from atlas.query.attractors import select_dominant
from atlas.query.queries import nearest_cell
from atlas.query.window import axis_names
from atlas.spec.system import stored_spec, system_of
from workers import Settings
from workers.model.system import System

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class CellSpec:
    """The specification of a cell.

    system      system of the cell
    parameters  value of each parameter, the initial state included
    settings    settings of the solver
    """

    system: System
    parameters: Mapping[str, float]
    settings: Settings


def read_cell_spec(ds: "xr.Dataset", point: Mapping[str, float]) -> CellSpec:
    """Return the specification of the cell nearest to a point.

    In an atlas of all attractors, the initial state lies on the selected attractor, by default the one with the largest
    share. The cell's own initial state may reach another attractor. Raise InputError as ``queries.nearest_cell`` does,
    and if the dataset lacks the spec of its atlas.
    """
    ds = select_dominant(ds)
    cell, who = nearest_cell(ds, point), "this dataset has no record of how it was solved"
    system = system_of(ds.attrs, who)
    try:
        settings = Settings(**stored_spec(ds.attrs)["solve"])
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{who}: the table [solve] of its spec is missing or unknown to this version") from None
    values = values_of(ds, system, cell)
    if "attractors" in ds and "state" in ds:
        state = ds["state"].sel({name: cell[name] for name in axis_names(ds)}).values
        if np.isfinite(state).all():
            values |= dict(zip(system.states, state.tolist(), strict=True))
    return CellSpec(system, values, settings)


def values_of(ds: "xr.Dataset", system: System, cell: Mapping[str, Any]) -> dict[str, float]:
    """Return the parameters of a cell, as ``queries.nearest_cell`` returns it: from axes, from columns, or fixed."""
    names = [parameter.name for parameter in system.parameters if parameter.name in ds.coords]
    return {name: float(cell[name] if name in cell else ds[name]) for name in names}
