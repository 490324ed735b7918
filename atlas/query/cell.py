"""One cell of an atlas: its stored results, and everything needed to solve it again."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

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
    """All that is needed to solve a cell again.

    system      system of the cell
    parameters  value of each parameter, the initial state included
    settings    settings of the solver
    """

    system: System
    parameters: Mapping[str, float]
    settings: Settings


@dataclass(frozen=True)
class StoredCell:
    """A cell of an atlas with its results.

    system      system of the cell
    parameters  value of each parameter, the initial state included
    results     results as ``queries.nearest_cell`` returns them
    row         all results as the store has them, read when they are asked for

    In an atlas of all attractors the results are those of the selected attractor, by default of that with the largest
    share.
    """

    system: System
    parameters: dict[str, float]
    results: Mapping[str, Any]
    row: "xr.Dataset"

    @classmethod
    def nearest(cls, ds: "xr.Dataset", point: Mapping[str, float], who: str = "") -> Self:
        """Return the cell of a dataset that is nearest to a point, given by its value on each axis.

        Raise InputError as ``queries.nearest_cell`` does. Raise InputError also, with ``who`` before the message, if
        the dataset lacks the spec of its atlas.
        """
        ds = select_dominant(ds)
        cell, system = nearest_cell(ds, point), system_of(ds.attrs, who)
        names = [parameter.name for parameter in system.parameters if parameter.name in ds.coords]
        values = {name: float(cell[name] if name in cell else ds[name]) for name in names}
        return cls(system, values, cell, ds.sel({name: cell[name] for name in axis_names(ds)}))


def read_cell_spec(ds: "xr.Dataset", point: Mapping[str, float]) -> CellSpec:
    """Return what is needed to solve again the cell nearest to a point, given by its value on each axis.

    In an atlas of all attractors, the initial state lies on the selected attractor, by default the one with the largest
    share. The cell's own initial state may reach another attractor. Raise InputError as ``queries.nearest_cell`` does,
    and if the dataset lacks the spec of its atlas.
    """
    who = "this dataset has no record of how it was solved"
    cell = StoredCell.nearest(ds, point, who)
    try:
        settings = Settings(**stored_spec(ds.attrs)["solve"])
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{who}: the table [solve] of its spec is missing or unknown to this version") from None
    state = cell.row["state"].values if "attractors" in cell.row and "state" in cell.row else np.full(1, np.nan)
    initial_state = dict(zip(cell.system.states, state.tolist(), strict=True)) if np.isfinite(state).all() else {}
    return CellSpec(cell.system, cell.parameters | initial_state, settings)
