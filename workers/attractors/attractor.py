"""An attractor of a cell: its results, states and statistics."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from workers.cell.cell_batch import CellCycle
from workers.model.oscillator import Array
from workers.results import APERIODIC, CHAOTIC, LOCKING, NO_IMPACT, PERIODIC, QUASIPERIODIC

STABLE = (NO_IMPACT, PERIODIC)
STATISTICAL = (QUASIPERIODIC, CHAOTIC, APERIODIC)
SHOWN = (*STABLE, LOCKING)
"""Regimes in which one motion shows the attractor: an orbit, or the class of motion that locks onto a stop."""
ON_ATTRACTOR = (*SHOWN, *STATISTICAL)


@dataclass(eq=False)
class Attractor:
    """An attractor of a cell: its results by variable, and the initial states, by number, that reach it.

    contact           contact of the state among the results
    h, period         for an orbit: block coordinates of that state, period
    jacobian, contraction, norm   Jacobian of a turn, 1 - |mu|, and the norm in which the Jacobian shrinks deviations
    orbit             (p, n, 2) its states at t = (k + shift) T, the section of its proof
    cycle             for a machine without a force; orbit then has states (ALONG, n, 2) all along it
    mirror            its mirror image, if known and another attractor
    reference         (k, 4n) for chaos and tori: batches, see ``same``
    last              last physical states, with their contacts, of the motions on it
    pooled, distance  initial states assigned to it by statistics; the largest distance among them
    seen              periods of all motions on it together
    transient         whether a motion has left it
    """

    regime: int
    result: dict[str, Any]
    mode: int
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
        """The sorting key of attractors of a cell: the largest share first, then the first initial state."""
        return -len(self.starts), min(self.starts)
