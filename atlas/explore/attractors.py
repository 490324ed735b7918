"""All attractors of a cell that was clicked: those that the store has, else found on the cluster from many starts."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

import numpy as np

from atlas.cell.attractors import in_words
from atlas.explore.known import Cell
from atlas.explore.patch import Patch, solve_patch
from atlas.explore.patches import Job, Task
from atlas.explore.subject import Plane, Subject
from atlas.explore.tiles import Arrays
from atlas.query.queries import at
from workers.results import ATTRACTOR

Told = Callable[["Attractors"], None]


@dataclass(frozen=True)
class Attractors:
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


def known_attractors(subject: Subject, cell: Cell) -> Attractors | None:
    """The attractors of a cell of an atlas that has all of them, or why they cannot be found; None where they can."""
    if subject.settings.method == "fixed":
        return Attractors(trouble='all attractors are found by the method "adaptive" only')
    if subject.every is None or not cell.of_atlas:
        return None
    found = at(subject.every, {axis.name: cell.parameters[axis.name] for axis in subject.spec.axes})
    return _answer(found["coexisting"], found, stored=True)


class Asked:
    """Questions that wait for the cluster: one at most for each who asks."""

    def __init__(self, subject: Subject) -> None:
        self._subject = subject
        self._waiting: dict[Hashable, tuple[Question, Told]] = {}

    def ask(self, who: Hashable, cell: Cell, told: Told) -> "Question":
        """Note that somebody wants the attractors of a cell, and nothing else any more."""
        x, y = (cell.parameters[axis.name] for axis in self._subject.spec.axes)
        names = dict(self._subject.plane.parameters)
        question = Question(self, Plane.of({name: cell.parameters[name] for name in names}), x, y)
        self._waiting[who] = question, told
        return question

    def forget(self, who: Hashable) -> None:
        """Note that somebody wants nothing any more."""
        self._waiting.pop(who, None)

    def patch(self, question: "Question") -> Patch:
        """What it takes to answer."""
        subject = self._subject
        (x, y) = (axis.name for axis in subject.spec.axes)
        sides = (x, (question.x,)), (y, (question.y,))
        return Patch(subject.system, dict(question.plane.parameters), subject.settings, *sides, starts=subject.starts)

    def answer(self, question: "Question", arrays: Arrays) -> None:
        """Tell those who wait for it."""
        variables = self._subject.system.variables(self._subject.settings, attractors=True)
        cell = {variable.name: arrays[variable.name][0] for variable in variables}
        many = [variable.name for variable in variables if ATTRACTOR in variable.extra]
        kept = min(int(cell["attractors"]), self._subject.starts.keep)
        listed = [in_words({name: np.asarray(cell[name][k]).tolist() for name in many}) for k in range(kept)]
        self.tell(question, _answer(listed, {name: cell[name] for name in cell.keys() - set(many)}, stored=False))

    def tell(self, question: "Question", found: Attractors) -> None:
        """Tell those who wait for an answer this one."""
        for who, (asked, told) in list(self._waiting.items()):
            if asked == question:
                self._waiting.pop(who, None)
                told(found)


@dataclass(frozen=True)
class Question(Job):
    """A cell whose attractors somebody asks for: a job of the cluster."""

    asked: Asked
    plane: Plane
    x: float
    y: float

    def make(self) -> Task | None:
        """See ``Job``."""
        return solve_patch, self.asked.patch(self)

    def solved(self, argument: Patch, found: Arrays) -> int:
        """See ``Job``."""
        self.asked.answer(self, found)
        return 1

    def failed(self, why: str) -> None:
        """See ``Job``."""
        self.asked.tell(self, Attractors(trouble=why))


def _answer(each: list[dict[str, Any]], numbers: dict[str, Any], stored: bool) -> Attractors:
    return Attractors(
        tuple(each), int(numbers["attractors"]), int(numbers["starts"]), int(numbers["undecided"]),
        float(numbers["unseen_share"]), int(numbers["own"]), stored,
    )  # fmt: skip
