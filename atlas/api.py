"""What ``import atlas`` offers, put together from the packages below it. The package loads this at first use."""

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from atlas import errors
from atlas.branches.branch import MOST, tree_from
from atlas.branches.seed import seed_of_point
from atlas.cell.attractors import attractors
from atlas.cell.point import point
from atlas.check.verify import verify
from atlas.curves.settings import CurveSettings
from atlas.query.open import open_atlas
from atlas.render import portrait
from atlas.service.extend import extend
from atlas.service.options import RunOptions
from atlas.service.pack import pack
from atlas.service.run import run
from atlas.spec.spec import Spec
from atlas.task.retry import Retry
from workers import Settings
from workers.model.system import DEFAULT, System

if TYPE_CHECKING:
    import xarray

    from atlas.accessor import DrawnBranches

__all__ = [
    "CurveSettings",
    "Retry",
    "RunOptions",
    "Settings",
    "Spec",
    "attractors",
    "branch",
    "errors",
    "extend",
    "open",
    "pack",
    "point",
    "portrait",
    "run",
    "verify",
]


def open(store: str | os.PathLike[str]) -> "xarray.Dataset":
    """The atlas of a store as an xarray Dataset, read from disk as it is used; ``ds.atlas`` is its accessor.

    The store is a folder, a URL, or a zip file that ``pack`` made.
    Raises atlas.errors.InputError where the store is not an atlas.

    >>> import atlas
    >>> ds = atlas.open("plane.zarr")
    >>> ds.atlas.at(omega=3.0, b=0.3)["regime"]
    'periodic'
    """
    import atlas.accessor  # noqa: F401  registers it

    return open_atlas(store)


def branch(
    given: Mapping[str, Any] | None = None,
    *,
    along: str,
    window: tuple[float, float],
    system: str | Mapping[str, Any] | System = DEFAULT,
    settings: Settings | None = None,
    leaving: bool = False,
    budget: int = MOST,
) -> "DrawnBranches":
    """The branch of a cell's periodic orbit along one parameter, stable and unstable, with its events; and more.

    ``given`` are the parameters that differ from the defaults; the cell is solved first. The orbit, as the solution of
    equations for its impacts, is followed by pseudo-arclength through the (low, high) ``window`` of the parameter
    ``along``, both ways, until it leaves the window or ceases to exist. Events on the way are located to 1e-10 or
    better: folds, symmetry breakings, period doublings, Neimark-Sacker points, grazes and lost impacts. With
    ``leaving`` the branches that leave at symmetry breakings and period doublings are followed too, and those that
    leave these, ``budget`` branches in all; ``untried`` of the result has the events that were left.
    The result has the pandas frames ``branches``, ``points`` and ``events``, see ``branches.table.Branches``, and draws
    itself: ``.plot("branch.png")``.
    Raises InputError for bad parameters, and where the cell is not periodic or its orbit rests on a stop.

    >>> import atlas
    >>> found = atlas.branch({"omega": 4.0, "b": 0.1}, along="b", window=(0.05, 0.15))
    >>> [(kind, round(b, 4)) for kind, b in zip(found.events["kind"], found.events["b"])]
    [('symmetry_breaking', 0.087)]
    """
    from atlas.accessor import DrawnBranches

    seed = seed_of_point(given or {}, system, settings)
    return DrawnBranches.of(tree_from(seed, along, window, leaving, budget))
