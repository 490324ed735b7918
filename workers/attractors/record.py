"""An attractor of a cell: its results, states and statistics."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from workers.cell.cells import CellCycle
from workers.model.oscillator import Array
from workers.results import APERIODIC, CHAOTIC, LOCKING, NO_IMPACT, PERIODIC, QUASIPERIODIC

STABLE = (NO_IMPACT, PERIODIC)
STATISTICAL = (QUASIPERIODIC, CHAOTIC, APERIODIC)
SHOWN = (*STABLE, LOCKING)
"""Whose attractor a motion shows by itself: an orbit, or the class of what locks onto a stop."""
ON_ATTRACTOR = (*SHOWN, *STATISTICAL)


@dataclass(eq=False)
class Attractor:
    """An attractor of a cell: its results by variable, and the initial states, by number, that reach it.

    contact           that of the state among the results
    h, period         of an orbit: the block coordinates of that state; jacobian, contraction of its turn, norm in
                      which that shrinks
    orbit             (p, n, 2) its states at t = (k + shift) T, where it was proved
    cycle             of a machine without a force; orbit then has states (ALONG, n, 2) all along it
    mirror            its mirror image, where that is another one and known
    reference         (k, 4n) of any other: its batches, see ``same``
    last              physical states, with their contacts, at which the motions of its initial states were left
    pooled, distance  initial states assigned to it by statistics; the largest distance among them
    seen              periods for which all of them together were seen on it
    transient         whether one of them has left it
    """

    regime: int
    result: dict[str, Any]
    contact: int
    starts: list[int] = field(default_factory=list)
    h: Array = field(default_factory=lambda: np.zeros((0, 2)))
    period: int = 0
    jacobian: Array | None = None
    contraction: float = 0.0
    norm: Array | None = None
    shift: float = 0.0
    orbit: Array = field(default_factory=lambda: np.zeros((0, 0, 2)))
    cycle: CellCycle | None = None
    mirror: "Attractor | None" = None
    reference: Array | None = None
    last: list[tuple[Array, int]] = field(default_factory=list)
    pooled: int = 0
    distance: float = 0.0
    seen: int = 0
    transient: bool = False

    @property
    def order(self) -> tuple[int, int]:
        """The order of the attractors of a cell: the largest share first, then the first one found."""
        return -len(self.starts), min(self.starts)

    def image(self, symmetric: bool) -> "Attractor | None":
        """Its mirror image, itself where it is its own; None where none is known. ``symmetric``: the machine is."""
        own = bool(self.result["symmetric"]) or (self.regime == NO_IMPACT and symmetric)
        return self if own else self.mirror
