"""Branches through all periodic cells of a one-parameter sweep, each followed once, and the branches that fork off."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from atlas.errors import InputError
from atlas.orbits.branches.seed import seed_of
from atlas.orbits.branches.table import pattern
from atlas.orbits.branches.tree import Branch, BranchTree
from atlas.query import machine
from atlas.query.window import axis_names, axis_values, columns
from atlas.spec.system import must_offer, system_of
from workers.continuation import SolutionPoint
from workers.results import CYCLE_PERIOD, PERIODIC, REGIME

if TYPE_CHECKING:
    import xarray as xr

MAX_BRANCHES = 100
"""Maximum number of branches that are followed through a sweep. More could not be distinguished in a picture."""
MAX_IMPACTS = 12
"""Maximum number of impacts of the orbits that are followed.

Orbits with more impacts, mostly late in a cascade, would crowd the picture.
"""
NEAR_BRANCH = 1e-3
"""Distance from a branch, relative to the extent of its states, below which a state is on the branch without further
check.

The branch is interpolated linearly between two points. The error of this interpolation is usually smaller.
"""

_STORED = (REGIME.name, "period", "impacts_upper", "impacts_lower", "symmetric", "state")


def tree_through(sweeps: Sequence["xr.Dataset"]) -> BranchTree:
    """Return the branches of the periodic orbits found in one-parameter sweeps, and the branches that fork off.

    There are up to MAX_BRANCHES branches, of orbits with up to MAX_IMPACTS impacts. No branch is started from a cell
    whose orbit, or its mirror image, is on a branch already. Raise InputError if no parameter is swept, and if an atlas
    has no states.
    """
    ds = sweeps[0]
    system, (along,) = system_of(ds.attrs), axis_names(ds)
    must_offer(system, "branches", unforced=True)
    for other in sweeps[1:]:
        if axis_names(other) != (along,):
            raise InputError(f"branches need sweeps of one parameter, found {along} and {axis_names(other)[0]}")
    if columns(ds) or along in system.states:
        raise InputError(f"branches follow orbits along a parameter that orbits depend on, not {along}")
    stored = (*_STORED, CYCLE_PERIOD.name) if system.definition.unforced else _STORED
    for name in stored:
        if name not in ds:
            raise InputError(f"branches need the variable {name!r} of cells, which this atlas does not have")
    defaults = {p.name: p.default for p in system.parameters}
    fixed = machine.fixed(ds, system)
    low, high = float(axis_values(ds, along).min()), float(axis_values(ds, along).max())
    if low == high:
        raise InputError(f"branches need more than one value of {along}, found {low:g} alone")
    tree: BranchTree | None = None
    for cell in (cell for ds in sweeps for cell in _cells(ds, along, stored)):
        value = float(cell[along])
        if tree is not None and (len(tree.branches) >= MAX_BRANCHES or _is_covered(tree, cell, value)):
            continue
        try:
            seed = seed_of(cell, system, {**defaults, **fixed, along: value})
            tree = tree or BranchTree(system, seed.values, along, (low, high), MAX_BRANCHES, MAX_IMPACTS)
            tree.grow(seed.orbit, value, leaving=True)
        except ValueError:  # not a solution of the equations: a neighbour is tried
            continue
    if tree is None:
        raise InputError(f"no cell here has an orbit to follow: none is periodic with at most {MAX_IMPACTS} impacts")
    return tree


def _cells(ds: "xr.Dataset", along: str, stored: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Yield the periodic cells, as dicts of their results, in the order in which they are tried as starts of branches.

    Runs of neighbouring cells with equal period, impacts and symmetry come in order of length, the longest first. The
    middle cell of a run comes first.
    """
    read = ds[list(stored)].sortby(along).load()
    columns: dict[str, NDArray[Any]] = {name: read[name].values for name in (along, *stored)}
    impacts = columns["impacts_upper"] + columns["impacts_lower"]
    fits = (columns[REGIME.name] == PERIODIC) & (impacts <= MAX_IMPACTS)
    classes = np.stack([np.where(fits, columns[name], -2) for name in _STORED[1:5]], axis=1).tolist()
    runs = [[k for k, _ in run] for _, run in groupby(enumerate(classes), key=lambda numbered: numbered[1])]
    for run in sorted((run for run in runs if fits[run[0]]), key=len, reverse=True):
        middle = run[len(run) // 2]
        for k in [middle, *(k for k in run if k != middle)]:
            yield {name: column[k] for name, column in columns.items()}


def _is_covered(tree: BranchTree, cell: dict[str, Any], value: float) -> bool:
    """Return True if a cell's orbit, or its mirror image, is on a branch of a tree at the cell's parameter value."""
    n, p, q, symmetric = (int(cell[name]) for name in _STORED[1:5])
    state = np.asarray(cell["state"], dtype=np.float64)
    alike = {(n, *impacts, half) for impacts in ((p, q), (q, p)) for half in {symmetric, 1}}
    uncounted = p < 0  # impacts of a sticking orbit are not counted
    same = [
        branch for branch in tree.branches if uncounted or alike & {pattern(one) for one in set(branch.itineraries)}
    ]
    return any(_is_near(branch, state, value) for branch in same) or any(
        tree.is_orbit(state, SolutionPoint(np.array([value]), orbit, np.zeros(0), np.zeros(0, np.complex128), 0))
        for branch in same
        for orbit in branch.orbits_at(tree.family, value)
    )


def _is_near(branch: Branch, state: NDArray[np.float64], value: float) -> bool:
    """Return True if a section state (2d,) at a parameter value lies on a branch or on its mirror image.

    The branch is interpolated between points; NEAR_BRANCH is the tolerance.
    """
    for k, share in branch.crossings(value):
        for sections in (branch.sections, branch.mirrored):
            if sections is not None:
                states = sections[k] + share * (sections[k + 1] - sections[k])
                extent = np.maximum(np.ptp(sections, axis=(0, 1)), 1e-300)
                if np.min(np.max(np.abs(states - state) / extent, axis=1)) < NEAR_BRANCH:
                    return True
    return False
