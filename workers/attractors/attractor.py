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
"""Regimes in which one motion represents the attractor: an orbit, or the class of motion that locks onto a stop."""
ON_ATTRACTOR = (*SHOWN, *STATISTICAL)


@dataclass(eq=False)
class Attractor:
    """An attractor of a cell, which is a machine at one point of a map.

    regime            code of the regime
    result            results by the names of the variables
    mode              number of the mode, a set of linear equations, of the state in ``result``
    starts            numbers of the initial states that reach it
    h, period         of an orbit: (n, 2) the state in ``result`` in decoupled coordinates, and the period
    jacobian          Jacobian of one turn of the orbit
    contraction       1 - |mu|, mu the largest multiplier
    norm              norm in which the Jacobian shrinks deviations
    shift             time at which the orbit was proved: at sections t = (k + shift) T, T the forcing period
    orbit             (p, n, 2) states at t = (k + shift) T like h; of a cycle (ALONG, n, 2) states all along it
    cycle             limit cycle of a machine without a force, else None
    mirror            its mirror image, None if unknown or the attractor itself
    reference         (k, 4n) statistics of chaos and tori, means over batches of states, see ``matching``
    last              last physical states of the motions on it, each with the number of its mode
    pooled, distance  number of initial states assigned by statistics, and the largest distance among them
    seen              forcing periods of all motions on it together
    transient         True if a motion has left it
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
        """Sorting key of the attractors of a cell: the largest share first, then the first initial state."""
        return -len(self.starts), min(self.starts)
