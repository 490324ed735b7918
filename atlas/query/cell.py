"""One cell of an atlas with everything that a second solution needs."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from atlas.errors import InputError
from atlas.query.attractors import select_dominant
from atlas.query.queries import at
from atlas.query.window import axis_names
from atlas.spec.system import stored_spec, system_of
from workers import Settings
from workers.model.system import System

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class CellSpec:
    """A cell's system, the value of each of its parameters, initial state included, and the settings of its solver."""

    system: System
    parameters: Mapping[str, float]
    settings: Settings


def read_cell_spec(ds: "xr.Dataset", point: Mapping[str, float]) -> CellSpec:
    """The cell of an atlas nearest to a point.

    Of an atlas of all attractors its initial state is on the one with the largest share, or on the one selected: the
    cell's own initial state may reach another.
    Raises InputError as ``queries.at`` does, and where the dataset lacks the spec of its atlas.
    """
    ds = select_dominant(ds)
    cell, who = at(ds, point), "this dataset does not say how it was solved"
    system = system_of(ds.attrs, who)
    try:
        settings = Settings(**stored_spec(ds.attrs)["solve"])
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{who}: its spec has no [solve] that this program knows") from None
    values = values_of(ds, system, cell)
    if "attractors" in ds and "state" in ds:
        state = ds["state"].sel({name: cell[name] for name in axis_names(ds)}).values
        if np.isfinite(state).all():
            values |= dict(zip(system.states, state.tolist(), strict=True))
    return CellSpec(system, values, settings)


def values_of(ds: "xr.Dataset", system: System, cell: Mapping[str, Any]) -> dict[str, float]:
    """The parameters that an atlas has for a cell, as ``queries.at`` gives it: on axes, in columns, or fixed."""
    names = [parameter.name for parameter in system.parameters if parameter.name in ds.coords]
    return {name: float(cell[name] if name in cell else ds[name]) for name in names}
