"""All attractors of a cell that was clicked: those that the store has, else found on the cluster from many starts."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from atlas.explore.known import Cell
from atlas.explore.patch import solve_patch
from atlas.explore.patches import Question
from atlas.explore.subject import Arrays, Subject
from atlas.query.attractors import attractors_listed
from atlas.query.queries import at
from workers.results import ATTRACTOR


@dataclass(frozen=True)
class KeptAttractors:
    """The attractors of a cell that are kept, the largest share first, each by its numbers in words.

    found       how many there are, also beyond those kept
    starts      initial states solved; undecided: those of them whose attractor is not known
    unseen      an attractor of that share is missed in one cell of twenty
    own         place of the one that the cell's own initial state reaches; -1 for none of them
    stored      whether the atlas has them; else they were found now
    trouble     why there are none
    """

    each: tuple[dict[str, Any], ...] = ()
    found: int = 0
    starts: int = 0
    undecided: int = 0
    unseen: float = 1.0
    own: int = -1
    stored: bool = False
    trouble: str = ""


def known_attractors(subject: Subject, cell: Cell) -> KeptAttractors | None:
    """The attractors of a cell of an atlas that has all of them, or why they cannot be found; None where they can."""
    if not subject.searched:
        return KeptAttractors(trouble='all attractors are found by the method "adaptive" only')
    if subject.every is None or not cell.of_atlas:
        return None
    found = at(subject.every, {axis.name: cell.parameters[axis.name] for axis in subject.spec.axes})
    return _answer(found["coexisting"], found, stored=True)


def attractors_asked(subject: Subject, cell: Cell) -> Question[KeptAttractors]:
    """All attractors of a cell to be found."""
    plane, x, y = subject.point(cell.parameters)
    patch = replace(subject.grid(plane, (x,), (y,)), starts=subject.starts)
    return Question(solve_patch, patch, partial(_found, subject), cells=1)


def _found(subject: Subject, arrays: Arrays) -> KeptAttractors:
    """The attractors of the one cell of these results."""
    variables = subject.system.variables(subject.settings, attractors=True)
    cell = {variable.name: arrays[variable.name][0] for variable in variables}
    many = [variable.name for variable in variables if ATTRACTOR in variable.extra]
    return _answer(attractors_listed(cell, many), cell, stored=False)


def _answer(each: list[dict[str, Any]], numbers: dict[str, Any], stored: bool) -> KeptAttractors:
    return KeptAttractors(
        tuple(each), int(numbers["attractors"]), int(numbers["starts"]), int(numbers["undecided"]),
        float(numbers["unseen_share"]), int(numbers["own"]), stored,
    )  # fmt: skip
