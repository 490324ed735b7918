"""Impact Atlas: maps of chaos in vibro-impact oscillators.

An atlas:

Spec                 describes an atlas
Settings             decide how a cell is solved
System               a machine, from its definition
RunOptions           options of a run, which decide no number
plan                 estimates the cost
run                  computes an atlas into a store
status               reports the progress
open                 returns the store as an xarray Dataset, whose ``.atlas`` answers queries and draws
extend               computes a larger or finer atlas
retry                computes an atlas with some cells solved again
verify               checks that a store is complete and sound
pack                 makes a store one file
find_curves          finds the exact curves that bound the regions of a plane, within the budget of ``CurveSettings``
label_attractors     labels all attractors by branch, from cell to cell
measure_attractors   measures the stability of the attractors of an atlas

Without a store:

point        solves one cell
attractors   finds all attractors of a cell
stability    measures the stability of the attractors of a cell
saddles      finds the unstable orbits between the basins of a cell
portrait     draws the motion of a cell
branch       follows the orbit of a cell along a parameter
solve_tile   solves arrays of parameters
time_history returns a motion in time as a table, with forces and events
trace        returns the section states and the impacts of a motion

``errors`` has the exceptions.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from atlas.accessing import register_accessor

if TYPE_CHECKING:
    from atlas import errors
    from atlas.api import (
        CurveSettings,
        RunOptions,
        Settings,
        Spec,
        System,
        attractors,
        branch,
        extend,
        open,
        pack,
        plan,
        point,
        portrait,
        retry,
        run,
        saddles,
        stability,
        status,
        verify,
    )
    from atlas.cell.time_history import time_history
    from atlas.service.curves import find_curves
    from atlas.service.labels import label_attractors
    from atlas.service.measures import measure_attractors
    from workers import solve_tile, trace

    __version__: str

__all__ = [
    "CurveSettings",
    "RunOptions",
    "Settings",
    "Spec",
    "System",
    "__version__",
    "attractors",
    "branch",
    "errors",
    "extend",
    "find_curves",
    "label_attractors",
    "measure_attractors",
    "open",
    "pack",
    "plan",
    "point",
    "portrait",
    "retry",
    "run",
    "saddles",
    "solve_tile",
    "stability",
    "status",
    "time_history",
    "trace",
    "verify",
]


_WITH_NUMBA = {
    "solve_tile": "workers",
    "trace": "workers",
    "time_history": "atlas.cell.time_history",
    "find_curves": "atlas.service.curves",
    "label_attractors": "atlas.service.labels",
    "measure_attractors": "atlas.service.measures",
}
"""Modules of the public names whose import loads Numba. All other public names are in ``atlas.api``, which does not."""


register_accessor()


def __getattr__(name: str) -> Any:
    """Load a public name at its first use, so that ``import atlas`` itself takes no time."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name == "__version__":
        from importlib.metadata import version

        return version("impact-atlas")
    if name in _WITH_NUMBA:
        return getattr(import_module(_WITH_NUMBA[name]), name)
    from atlas import api

    return getattr(api, name)


def __dir__() -> list[str]:
    """Return the public names for ``dir(atlas)``, without modules that happen to be loaded."""
    return __all__
