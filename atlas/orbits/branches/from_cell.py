"""Branches of periodic orbits that start from the orbit of one cell, after validation of the request."""

from typing import TYPE_CHECKING

from atlas.argument_checks import is_integer, validate_flag, validate_interval
from atlas.errors import InputError, check_names
from atlas.orbits.branches.seed import BranchSeed
from atlas.spec.axis import validate_in_range
from workers.model.observables import Observable

if TYPE_CHECKING:
    from atlas.orbits.branches.tree import BranchTree

MAX_BRANCHES = 20
"""Maximum number of branches that are followed from one cell, the first one included."""
MAX_IMPACTS = 64
"""Maximum number of impacts of the orbits whose branches fork off at bifurcations."""


def tree_from(
    seed: BranchSeed, along: str, window: tuple[float, float], switch: bool = False, limit: int = MAX_BRANCHES
) -> "BranchTree":
    """Return the branch of a cell's orbit in one parameter; with ``switch`` also the branches that fork off.

    seed    the orbit
    along   the parameter
    window  (low, high) limits of the parameter
    switch  True to follow also the branches that begin at bifurcations and other events
    limit   maximum number of branches

    Raise InputError for an unknown parameter, or one on which no orbit depends, and if the orbit cannot be followed.
    Raise InputError also for a window that does not increase, is invalid, or does not contain the cell.
    """
    from atlas.orbits.branches.tree import BranchTree

    low, high = checked_window(seed, along, window)
    validate_flag("switch_branches", switch)
    if not is_integer(limit) or limit < 1:
        raise InputError(f"budget: found {limit!r}, must be a whole number of branches, 1 or more")
    tree = BranchTree(seed.system, seed.values, along, (low, high), limit, MAX_IMPACTS)
    try:
        tree.grow(seed.orbit, seed.values[along], switch)
    except ValueError as error:
        raise InputError(f"this cell's orbit cannot be followed: {error}") from None
    return tree


def observed_of(seed: BranchSeed, observe: str | None) -> Observable | None:
    """Return the observable with this name, None if ``observe`` is None. Raise InputError if the machine does not have
    it.
    """
    if observe is None:
        return None
    try:
        return Observable.parse(observe, seed.system.definition)
    except ValueError as error:
        raise InputError(f"observe: {error}") from None


def checked_window(seed: BranchSeed, along: str, window: tuple[float, float]) -> tuple[float, float]:
    """Return the given limits of the parameter. Raise InputError unless they increase, are valid, and contain the
    cell.
    """
    record = seed.system
    check_names("parameter", [along], [p.name for p in record.parameters])
    if along in record.states:
        raise InputError(f"{along}: found an initial state, on which no orbit depends; use another parameter")
    low, high = (validate_in_range(record.parameter(along), end) for end in validate_interval("window", window))
    if not low < high:
        raise InputError(f"{along}: found {low:g} to {high:g}, must increase")
    if not low <= seed.values[along] <= high:
        raise InputError(f"{along}: found {low:g} to {high:g}, must contain the cell's value {seed.values[along]:g}")
    return low, high
