"""An entry of the gallery: a published work, its numbers, and the same numbers from impact-atlas."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isnan
from pathlib import Path
from typing import Any

Value = float | int | str

CLOSED_FORM = "closed form"
"""The basis of a number from a formula derived in the entry's module; ``test_published.py`` checks it separately."""
FINDING = "finding"
"""The basis of a count or a word."""
EXACT = 1e-9
"""Largest difference from a closed form."""


@dataclass(frozen=True)
class Statement:
    """One number or finding of a work, and ours.

    ``basis`` says how the reference is known. A number agrees within ``tolerance``, a count or a word if it is equal.
    ``reason`` explains a difference.
    """

    text: str
    reference: Value
    ours: Value
    tolerance: float = EXACT
    basis: str = ""
    reason: str = ""

    @property
    def agrees(self) -> bool:
        """Whether our value agrees with the reference."""
        if isinstance(self.reference, str | int) or isinstance(self.ours, str | int):
            return self.reference == self.ours
        return abs(self.ours - self.reference) <= self.tolerance

    def record(self) -> dict[str, Any]:
        """The statement as JSON."""
        basis = self.basis or (FINDING if isinstance(self.reference, str | int) else CLOSED_FORM)
        ours = "not found" if isinstance(self.ours, float) and isnan(self.ours) else self.ours
        known = {"text": self.text, "basis": basis, "reference": self.reference, "tolerance": self.tolerance}
        return {**known, "ours": ours, "agrees": self.agrees, "reason": self.reason}


@dataclass(frozen=True)
class PublishedEntry:
    """A published work and its reproduction.

    name        in the command, ``author-year`` and the figure if there are several
    work        authors, journal or book, volume, year, page
    link        address of its DOI or preprint, if certain
    place       figure, table, section or equation; other sources of the numbers
    title       the reproduced result, in a few words
    machine     the machine and its parameters, in a sentence
    example     the packaged spec that shows it, if any
    commands    command lines that show the result without this script
    statements  computes the numbers
    picture     draws the picture, if the entry has one, into a file
    caption     of the picture
    """

    name: str
    work: str
    place: str
    title: str
    machine: str
    statements: Callable[[], Sequence[Statement]]
    link: str = ""
    example: str = ""
    commands: tuple[str, ...] = ()
    picture: Callable[[Path], None] | None = None
    caption: str = ""

    def run(self) -> dict[str, Any]:
        """The entry as JSON, with its numbers computed again."""
        texts = {key: getattr(self, key) for key in ("work", "link", "place", "title", "machine", "example", "caption")}
        found = [statement.record() for statement in self.statements()]
        return {"name": self.name, **texts, "commands": list(self.commands), "statements": found}
