"""What motions have come to, and the attractors that they are on."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.cell.cells import Array, Cells, Rows
from workers.kernel.cells import physical_states
from workers.kernel.motion import FREE
from workers.results import APERIODIC, CHAOTIC, NO_IMPACT, PERIODIC, QUASIPERIODIC

STABLE = (NO_IMPACT, PERIODIC)
STATISTICAL = (QUASIPERIODIC, CHAOTIC, APERIODIC)


class Found:
    """What N motions have come to.

    cells        with the results of those that were solved in full; regime PENDING where a motion was recognised
    label        place of the known attractor that each has reached, -1 for none
    arrival      periods until it was within a hundredth of its scale on a known orbit, -1 where it reached none
    distance     in standard errors from the attractor that it was put to by statistics
    reference    batches of a new chaos or torus, of others None
    compared     periods on the attractor after its class was known
    last         the physical state at which the motion was left, and its contact
    """

    def __init__(self, cells: Cells) -> None:
        N = len(cells.used)
        self.cells = cells
        self.label, self.arrival = np.full((2, N), -1)
        self.distance = np.full(N, np.nan)
        self.reference: list[Array | None] = [None] * N
        self.compared = np.zeros(N, dtype=np.int64)
        self.last: list[tuple[Array, int]] = [(np.full(cells.directions, np.nan), FREE)] * N

    @property
    def regime(self) -> NDArray[np.int8]:
        """The regime of each motion that was solved in full."""
        return self.cells.found["regime"]

    @property
    def settled(self) -> Rows:
        """Periods until each was on its attractor: all that it went through, unless it reached a known orbit."""
        return np.where(self.arrival >= 0, self.arrival, self.cells.flown)

    def result(self, r: int) -> dict[str, Any]:
        """The results of one motion."""
        return {name: values[r].copy() for name, values in self.cells.found.items()}

    def keep_last(self, rows: Rows) -> None:
        """Keep where these motions are, for those that go on from there."""
        motions = self.cells.batch.motions
        for r, state in zip(rows, physical_states(self.cells.oscillators, motions, rows), strict=True):
            self.last[r] = state, int(motions.contact[r, 0])


@dataclass(eq=False)
class Attractor:
    """An attractor of a cell: its results by variable, and the initial states, by number, that reach it.

    contact           that of the state among the results
    h, period         of an orbit: the block coordinates of that state; jacobian, contraction of its turn, norm in
                      which that shrinks
    orbit             (p, n, 2) its states at t = (k + shift) T, where it was proved
    mirror            its mirror image, where that is another one and known
    reference         (k, 4n) of any other: its batches, see ``same``
    last              physical states, with their contacts, at which the motions of its initial states were left
    pooled, distance  initial states put to it by statistics; the largest distance among them
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
    mirror: "Attractor | None" = None
    reference: Array | None = None
    last: list[tuple[Array, int]] = field(default_factory=list)
    pooled: int = 0
    distance: float = 0.0
    seen: int = 0
    transient: bool = False

    @property
    def order(self) -> tuple[int, int]:
        """What attractors of a cell are sorted by: those of larger share first, then those that were found first."""
        return -len(self.starts), min(self.starts)

    def image(self, symmetric: bool) -> "Attractor | None":
        """Its mirror image, itself where it is its own; None where none is known. ``symmetric``: the machine is."""
        own = bool(self.result["symmetric"]) or (self.regime == NO_IMPACT and symmetric)
        return self if own else self.mirror

    def add(self, start: int, found: Found, r: int) -> None:
        """Motion r, from this initial state, is on it: exactly, or by statistics, which count what was seen of it."""
        self.starts.append(start)
        if self.reference is not None:
            self.last.append(found.last[r])
            self.pooled += 1
            self.distance = max(self.distance, float(found.distance[r]))
            self.seen += int(found.compared[r])
