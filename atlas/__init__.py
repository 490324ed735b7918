"""Impact Atlas: maps of chaos in vibro-impact oscillators.

``Spec`` describes an atlas, ``Settings`` the solution of a cell; ``run`` computes an atlas into a store, ``open`` gives
the store as an xarray Dataset, whose ``.atlas`` answers questions and draws. ``plan`` estimates the cost, ``status``
reports the progress. ``extend`` computes a larger or finer atlas, ``retry`` an atlas with some cells solved again,
``verify`` checks that a store is complete and sound, ``pack`` makes it one file. ``RunOptions`` has the options of a
run. ``find_curves`` finds the exact curves that bound the regions of a plane, within the budget of ``CurveSettings``;
``label_attractors`` labels all attractors by branch from cell to cell; ``measure_attractors`` measures the stability of
the attractors of an atlas.
Without a store: ``point`` solves one cell, ``attractors`` finds all its attractors, ``stability`` measures their
stability, ``saddles`` finds the unstable orbits between their basins, ``portrait`` draws its motion, ``branch`` follows
its orbit along a parameter, ``solve_tile`` takes arrays of parameters, ``trace`` gives a motion in time.
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
    "trace",
    "verify",
]


_WITH_NUMBA = {
    "solve_tile": "workers",
    "trace": "workers",
    "find_curves": "atlas.service.curves",
    "label_attractors": "atlas.service.labels",
    "measure_attractors": "atlas.service.measures",
}
"""Where those names are that bring Numba with them: apart from the others, which do without."""


register_accessor()


def __getattr__(name: str) -> Any:
    """Load a name at its first use, so that ``import atlas`` itself takes no time."""
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
    """What is public; modules that happen to be loaded are not."""
    return __all__
