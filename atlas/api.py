"""The public functions of ``import atlas``, collected from the subpackages and loaded at their first use."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from atlas import errors as errors
from atlas.argument_checks import validate_flag, validate_type
from atlas.cell.point import point as point
from atlas.check.verify import verify as verify
from atlas.orbits.branches.from_cell import MAX_BRANCHES, observed_of, tree_from
from atlas.orbits.branches.seed import seed_of_point
from atlas.orbits.curves.settings import CurveSettings as CurveSettings
from atlas.query.open import Chunks, open_atlas
from atlas.render import portrait as portrait
from atlas.robustness.attractors import attractors as attractors
from atlas.robustness.cell_stability import stability as stability
from atlas.robustness.saddles import saddles as saddles
from atlas.service.extend import extend as extend
from atlas.service.options import RunOptions as RunOptions
from atlas.service.pack import pack as pack
from atlas.service.plan import Plan, make_plan
from atlas.service.probe import add_probe
from atlas.service.retry import retry as retry
from atlas.service.run import run as run
from atlas.service.status import StoreStatus, read_status
from atlas.spec.spec import Spec as Spec
from atlas.spec.spec import given_values
from atlas.store.object_backend import Given
from atlas.store.store import open_store
from workers import Settings as Settings
from workers.model.system import DEFAULT
from workers.model.system import System as System

if TYPE_CHECKING:
    import xarray

    from atlas.accessor import PlottableBranches


def open(store: Given, chunks: Chunks = None, storage_options: Mapping[str, Any] | None = None) -> "xarray.Dataset":
    """Return the atlas of a store as an xarray Dataset, whose values are read when used; ``ds.atlas`` is its accessor.

    store             folder, URL, zip file made by ``pack``, obstore store, or any Zarr store object, such as that of
                      an Icechunk session
    chunks            makes Dask arrays of the variables, as in ``xarray.open_dataset``: ``{}`` for the chunks of the
                      store, ``"auto"``, or sizes by dimension; None for no Dask arrays
    storage_options   access to a URL beyond the environment: ``{"endpoint": ..., "anon": True}``

    Raise atlas.errors.InputError if the store is not an atlas.

    >>> import atlas
    >>> ds = atlas.open("plane.zarr")
    >>> ds.atlas.at(omega=3.0, b=0.3)["regime"].item()
    'periodic'
    """
    return open_atlas(store, chunks, storage_options)


def plan(spec: Spec, workers: int | None = None, probe: bool = True) -> Plan:
    """Return the plan of a spec: its cells, tiles, bytes and, with ``probe``, the time, which is measured on a few
    cells.

    ``workers`` is the number of workers of the run, by default one per processor. Raise atlas.errors.InputError if a
    tile is too large for a store.

    >>> import atlas
    >>> found = atlas.plan(atlas.Spec.from_toml("tiny"), probe=False)
    >>> found.tiling.cells, found.tiling.count
    (48, 4)
    """
    validate_flag("probe", probe)
    validate_type("spec", spec, Spec, "an atlas.Spec")
    estimate = make_plan(spec, RunOptions(workers=workers).workers)
    return add_probe(estimate, lambda progress: None) if probe else estimate


def status(store: Given, storage_options: Mapping[str, Any] | None = None) -> StoreStatus:
    """Return the progress of a store: finished tiles and cells, regimes, and the run that writes it.

    The arguments are those of ``open``. Raise atlas.errors.InputError if the store is not an atlas.

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
    """Return the branch of a cell's periodic orbit along one parameter, stable and unstable, with its events.

    The cell is solved first. Its orbit is the solution of equations for its impacts. Pseudo-arclength continuation
    follows the orbit in both directions, until the branch leaves the window or ends. Events are located to 1e-10 or
    better: folds, symmetry breakings, period doublings, Neimark-Sacker points, grazes and lost impacts. For a machine
    without a force the branch is that of a limit cycle, with its period, or of an equilibrium, with its Hopf points.

    parameters        parameters other than the defaults, as a mapping, or by name: ``omega=4.0``
    along             name of the parameter that varies
    window            (low, high) limits of the parameter ``along``
    system            name, definition or ``System`` of the machine
    settings          settings with which the cell is solved
    switch_branches   True to follow also branches from symmetry breakings and period doublings, and further
                      branches from these
    budget            maximum number of branches; ``untried`` of the result lists the events that remain
    observe           an observable, such as "impact_phase:stop", whose values the points and pictures show too

    The result has the pandas frames ``branches``, ``points`` and ``events``, see
    ``atlas.orbits.branches.table.BranchTable``, and a method that draws them: ``.plot("branch.png")``. Raise InputError
    for bad parameters, or if the cell is not periodic.

    >>> import atlas
    >>> found = atlas.branch(omega=4.0, b=0.1, along="b", window=(0.05, 0.15))
    >>> [(kind, round(b, 4)) for kind, b in zip(found.events["kind"], found.events["b"])]
    [('symmetry_breaking', 0.087)]
    """
    from atlas.accessor import PlottableBranches

    seed = seed_of_point(given_values(parameters, named), system, settings)
    observable = observed_of(seed, observe)
    return PlottableBranches.from_tree(tree_from(seed, along, window, switch_branches, budget), observable)
