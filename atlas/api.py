"""The functions of ``import atlas``, from the packages below. The package loads this at first use."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from atlas import errors
from atlas.argument_checks import validate_flag, validate_type
from atlas.cell.point import point
from atlas.check.verify import verify
from atlas.orbits.branches.from_cell import MAX_BRANCHES, observed_of, tree_from
from atlas.orbits.branches.seed import seed_of_point
from atlas.orbits.curves.settings import CurveSettings
from atlas.query.open import Chunks, open_atlas
from atlas.render import portrait
from atlas.robustness.attractors import attractors
from atlas.robustness.cell_stability import stability
from atlas.robustness.saddles import saddles
from atlas.service.extend import extend
from atlas.service.options import RunOptions
from atlas.service.pack import pack
from atlas.service.plan import Plan, make_plan
from atlas.service.probe import add_probe
from atlas.service.retry import retry
from atlas.service.run import run
from atlas.service.status import StoreStatus, read_status
from atlas.spec.spec import Spec, given_values
from atlas.store.object_backend import Given
from atlas.store.store import open_store
from workers import Settings
from workers.model.system import DEFAULT, System

if TYPE_CHECKING:
    import xarray

    from atlas.accessor import PlottableBranches

__all__ = [
    "CurveSettings",
    "RunOptions",
    "Settings",
    "Spec",
    "attractors",
    "branch",
    "errors",
    "extend",
    "open",
    "pack",
    "plan",
    "point",
    "portrait",
    "retry",
    "run",
    "saddles",
    "stability",
    "status",
    "verify",
]


def open(store: Given, chunks: Chunks = None, storage_options: Mapping[str, Any] | None = None) -> "xarray.Dataset":
    """The atlas of a store as an xarray Dataset, read from disk as it is used; ``ds.atlas`` is its accessor.

    The store is a folder, a URL, a zip file that ``pack`` made, an obstore store, or any Zarr store object, such as
    that of an Icechunk session. ``storage_options`` configure access to a URL beyond the environment:
    ``{"endpoint": ..., "anon": True}``. ``chunks`` makes Dask arrays of its variables, as in
    ``xarray.open_dataset``: ``{}`` for the store's own chunks, ``"auto"``, or sizes by dimension.
    Raises atlas.errors.InputError where the store is not an atlas.

    >>> import atlas
    >>> ds = atlas.open("plane.zarr")
    >>> ds.atlas.at(omega=3.0, b=0.3)["regime"]
    'periodic'
    """

    return open_atlas(store, chunks, storage_options)


def plan(spec: Spec, workers: int | None = None, probe: bool = True) -> Plan:
    """The cost of a spec: cells, tiles, bytes and, with ``probe``, the time, measured on a few cells.

    ``workers`` is the number of workers of the run, by default one a processor.
    Raises atlas.errors.InputError where a tile is too large for a store.

    >>> import atlas
    >>> found = atlas.plan(atlas.Spec.from_toml("tiny"), probe=False)
    >>> found.tiling.cells, found.tiling.count
    (48, 4)
    """
    validate_flag("probe", probe)
    validate_type("spec", spec, Spec, "an atlas.Spec")
    made = make_plan(spec, RunOptions(workers=workers).workers)
    return add_probe(made, lambda progress: None) if probe else made


def status(store: Given, storage_options: Mapping[str, Any] | None = None) -> StoreStatus:
    """The progress of a store: finished tiles and cells, regimes, and the run on it. Arguments as of ``open``.

    Raises atlas.errors.InputError where the store is not an atlas.

    >>> import atlas
    >>> atlas.status("plane.zarr").fraction
    1.0
    """
    return read_status(open_store(store, storage_options))


def branch(
    parameters: Mapping[str, Any] | None = None,
    /,
    *,
    along: str,
    window: tuple[float, float],
    system: str | Mapping[str, Any] | System = DEFAULT,
    settings: Settings | None = None,
    switch_branches: bool = False,
    budget: int = MAX_BRANCHES,
    observe: str | None = None,
    **named: Any,
) -> "PlottableBranches":
    """The branch of a cell's periodic orbit along one parameter, stable and unstable, with its events.

    ``omega=4.0`` or a mapping gives parameters other than the defaults; the cell is solved first. The orbit, as the
    solution of equations for its impacts, is followed by pseudo-arclength through the (low, high) ``window`` of the
    parameter ``along``, both ways, until it leaves the window or ceases to exist. Events on the way are located to
    1e-10 or better: folds, symmetry breakings, period doublings, Neimark-Sacker points, grazes and lost impacts. Of a
    machine without a force it is that of a cycle, with its period, or of an equilibrium, with its Hopf points. With
    ``switch_branches`` the branches from symmetry breakings and period doublings are followed too, and further branches
    from these, ``budget`` branches in all; ``untried`` of the result lists the events that remain. ``observe`` names an
    observable, such as "impact_phase:stop": the points have its values too, and pictures show it. The result has the
    pandas frames ``branches``, ``points`` and ``events``, see ``branches.table.Branches``, and a method that draws it:
    ``.plot("branch.png")``.
    Raises InputError for bad parameters, and where the cell is not periodic.

    >>> import atlas
    >>> found = atlas.branch(omega=4.0, b=0.1, along="b", window=(0.05, 0.15))
    >>> [(kind, round(b, 4)) for kind, b in zip(found.events["kind"], found.events["b"])]
    [('symmetry_breaking', 0.087)]
    """
    from atlas.accessor import PlottableBranches

    seed = seed_of_point(given_values(parameters, named), system, settings)
    observable = observed_of(seed, observe)
    return PlottableBranches.from_tree(tree_from(seed, along, window, switch_branches, budget), observable)
