"""Findings of a stress run: cells drawn, counts, and cells with trouble."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from tests.support.oracle.model import Cell as Machine

Params = dict[str, float]

LISTED = 20
"""Most cells listed per kind of trouble."""


@dataclass(frozen=True, eq=False)
class RandomCell:
    """A cell: its number among its kind, system and parameters as solve_tile takes them, and the same for the oracle.

    ``gap`` is the gap row, ``upper`` and ``lower`` the stops; ``trace`` that of M^-1 C.
    """

    number: int
    system: str | Mapping[str, Any]
    params: Params
    machine: Machine
    states: tuple[str, ...]
    gap: tuple[float, ...]
    upper: float
    lower: float
    trace: float

    @property
    def order(self) -> tuple[bool, int]:
        """Position of the cell in a list."""
        return isinstance(self.system, str), self.number

    @property
    def start(self) -> list[float]:
        """The initial state: displacements, then velocities."""
        return [self.params[name] for name in self.states]

    @property
    def kind(self) -> str:
        """The packaged two-mass oscillator, or a random system."""
        return self.system if isinstance(self.system, str) else "systems"

    @property
    def clearance(self) -> float:
        """Half the distance of the stops; for a single one, its distance from 0."""
        half = (self.upper - self.lower) / 2.0
        return half if math.isfinite(half) else min(abs(self.upper), abs(self.lower))

    def position(self, state: Any) -> float:
        """The gap coordinate of a state (displacements first), summed in order."""
        y = 0.0
        for share, x in zip(self.gap, state, strict=False):
            y += share * float(x)
        return y

    def beyond(self, y: float) -> float:
        """Distance of a position beyond a stop; negative between them."""
        return max(y - self.upper, self.lower - y)

    def facts(self) -> dict[str, Any]:
        """All that is needed to solve it again alone: ``solve_tile(system, parameters)``."""
        return {"cell": self.number, "system": self.system, "parameters": self.params}


@dataclass
class StressFindings:
    """Findings over a number of cells. Each listed cell is (what, cell)."""

    cells: int = 0
    impacting: int = 0
    sticking: int = 0
    outside: int = 0
    seconds: float = 0.0
    kinds: Counter[str] = field(default_factory=Counter)
    regimes: Counter[str] = field(default_factory=Counter)
    invalid: Counter[str] = field(default_factory=Counter)
    uncertain: Counter[str] = field(default_factory=Counter)
    stopped: Counter[str] = field(default_factory=Counter)
    listed: dict[str, list[tuple[str, RandomCell]]] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    worst: dict[str, tuple[float, RandomCell]] = field(default_factory=dict)
    checked: Counter[str] = field(default_factory=Counter)
    samples: dict[str, list[float]] = field(default_factory=dict)

    def record_trouble(self, kind: str, what: str, cell: RandomCell) -> None:
        """Count a trouble and list its cell while there is room."""
        self.counts[kind] += 1
        cells = self.listed.setdefault(kind, [])
        if len(cells) < LISTED:
            cells.append((what, cell))

    def record(self, kind: str, value: float, cell: RandomCell) -> None:
        """Keep the largest value of a kind."""
        if kind not in self.worst or value > self.worst[kind][0]:
            self.worst[kind] = (value, cell)

    def sample(self, kind: str, value: float) -> None:
        """Add a value to a distribution."""
        self.samples.setdefault(kind, []).append(value)

    def add(self, other: "StressFindings") -> None:
        """Add the findings over other cells."""
        for name in ("cells", "impacting", "sticking", "outside", "seconds"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        for name in ("kinds", "regimes", "invalid", "uncertain", "stopped", "counts", "checked"):
            getattr(self, name).update(getattr(other, name))
        for kind, cells in other.listed.items():
            self.listed[kind] = sorted(self.listed.get(kind, []) + cells, key=lambda one: one[1].order)[:LISTED]
        for kind, worst in other.worst.items():
            self.record(kind, *worst)
        for kind, values in other.samples.items():
            self.samples.setdefault(kind, []).extend(values)
