"""Branches from one cell: the request is checked, then followed."""

from typing import TYPE_CHECKING

from atlas.argument_checks import is_integer, validate_flag, validate_interval
from atlas.errors import InputError, check_names
from atlas.orbits.branches.seed import BranchSeed
from atlas.spec.axis import admitted
from workers.model.observables import Observable

if TYPE_CHECKING:
    from atlas.orbits.branches.tree import BranchTree

MAX_BRANCHES = 20
"""Branches that are followed from one cell, that of the cell included."""
MAX_IMPACTS = 64
"""Impacts of the orbits that are followed where they leave."""


def tree_from(
    seed: BranchSeed, along: str, window: tuple[float, float], switch: bool = False, limit: int = MAX_BRANCHES
) -> "BranchTree":
    """The branch of a cell's orbit in one parameter; ``switch`` adds branches that begin on it; ``limit`` in all.

    Raises InputError for a parameter that does not exist or that no orbit depends on, for a window that does not
    rise, is not valid or does not hold the cell, and where the orbit cannot be followed.
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
    """The observable of this name; InputError if the cell's machine does not have it."""
    if observe is None:
        return None
    try:
        return Observable.parse(observe, seed.system.definition)
    except ValueError as error:
        raise InputError(f"observe: {error}") from None


def checked_window(seed: BranchSeed, along: str, window: tuple[float, float]) -> tuple[float, float]:
    """The ends of the parameter, which must rise, be valid, and hold the cell."""
    record = seed.system
    check_names("parameter", [along], [p.name for p in record.parameters])
    if along in record.states:
        raise InputError(f"{along} is an initial state: orbits do not depend on it; follow them along a parameter")
    low, high = (admitted(record.parameter(along), end) for end in validate_interval("window", window))
    if not low < high:
        raise InputError(f"{along} from {low:g} to {high:g}: must rise")
    if not low <= seed.values[along] <= high:
        raise InputError(f"{along} from {low:g} to {high:g}: does not hold the cell's own, {seed.values[along]:g}")
    return low, high
