"""The attractors that are known of cells, as motions are compared with them."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from workers.attractors.same import KnownOrbits, distance, orbits_reached, turn
from workers.cell.cells import Array, Cells, Rows
from workers.kernel.cells import physical_states, start_motions
from workers.kernel.motion import motions_at
from workers.model.oscillator import COLUMN, Oscillator, many_of, one_of
from workers.orbit.attraction import shrinking_norm
from workers.orbit.section import moved
from workers.results import NO_IMPACT

if TYPE_CHECKING:
    from workers.attractors.search import Found

LONGEST_KNOWN = 32
"""Longest orbit that motions are compared with: longer ones are found anew, and seen to be the same then."""


@dataclass(eq=False)
class Attractor:
    """An attractor of a cell: its results by variable, and the initial states, by number, that reach it.

    contact              that of the state among the results
    h, period            of an orbit: the block coordinates of that state; jacobian, contraction of its turn, norm in
                         which that shrinks
    orbit                (p, n, 2) its states at t = (k + shift) T, where it was proved
    reference            (k, 4n) of any other: its batches, see ``identity``
    last                 physical states, with their contacts, at which the motions of its initial states were left, in
                         their order
    lumped, distance     initial states put to it by statistics; the largest distance among them
    pooled               periods for which they were seen on it, all together
    transient            whether one of them has left it
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
    lumped: int = 0
    distance: float = 0.0
    pooled: int = 0
    transient: bool = False

    @property
    def order(self) -> tuple[int, int]:
        """What attractors of a cell are sorted by: those of larger share first, then those that were found first."""
        return -len(self.starts), min(self.starts)

    def image(self, symmetric: bool) -> "Attractor | None":
        """Its mirror image, itself where it is its own; None where none is known. ``symmetric``: the machine is."""
        own = bool(self.result["symmetric"]) or (self.regime == NO_IMPACT and symmetric)
        return self if own else self.mirror

    def join(self, start: int, found: "Found", r: int) -> None:
        """An initial state's motion was recognised to reach it."""
        if self.reference is None:
            self.starts.append(start)
        else:
            self.pool(start, float(found.distance[r]), found, r)

    def pool(self, start: int, away: float, found: "Found", r: int) -> None:
        """An initial state's motion was put to it by statistics, ``away`` standard errors from it."""
        self.starts.append(start)
        self.last.append(found.left(r))
        self.lumped += 1
        self.distance = max(self.distance, away)
        self.pooled += int(found.flown_after[r])


def attractor_of_orbit(oscillators: Oscillator, cell: int, found: "Found", r: int) -> Attractor:
    """The attractor that a motion has been proved to fall into: an orbit, or motion without impact."""
    orbits, regime = found.orbits, int(found.arrays["regime"][r])
    new = Attractor(regime, found.result(r), int(found.contact[r]))
    new.h, new.period, new.shift = orbits.h[r].copy(), int(orbits.period[r]), float(orbits.shift[r])
    largest = float(orbits.exponents[r, 0])
    if regime == NO_IMPACT:
        new.h, new.period, new.shift = np.zeros_like(new.h), 1, 0.0
        rates = oscillators.gap.blocks[cell][:, COLUMN.slow]
        largest = -float(rates.min() * oscillators.period[cell])
    new.orbit = states_at(oscillators, cell, new, new.shift, new.period)[: new.period]
    if largest < 0.0 and new.period <= LONGEST_KNOWN:
        _, _, jacobian = turn(oscillators, cell, new.h, new.contact, new.period, np.bool_(False))
        contraction = -float(np.expm1(largest * new.period))
        norm = shrinking_norm(oscillators.gap.metric[cell], jacobian, contraction)
        if np.isfinite(norm).all():
            new.jacobian, new.contraction, new.norm = jacobian, contraction, norm
    return new


def states_at(
    oscillators: Oscillator, cell: int, orbit: Attractor, shift: float, steps: int, half: bool = False
) -> Array:
    """Block states (steps + 1, n, 2) of an orbit at t = shift T, and after each step of the map from there."""
    osc = one_of(oscillators, cell)
    first = moved(osc, orbit.h, orbit.contact, shift)
    there = many_of(osc._replace(tau=osc.tau + 2.0 * np.pi * shift))
    states: Array = turn(there, 0, first.h, int(first.contact[0]), steps, np.bool_(half))[0]
    return states


def mirrored(oscillators: Oscillator, states: Array, contact: Rows) -> tuple[Array, Rows]:
    """Physical states (N, 2n) on the mirror images of N motions through these ones, with their contacts (N,)."""
    N, n = oscillators.gap_row.shape
    motions = motions_at(np.zeros((N, n, 2)))
    rows = np.arange(N)
    start_motions(oscillators, motions, states, rows)
    for r in range(N):
        after, motions.contact[r, 0], _ = turn(oscillators, r, motions.h[r], int(contact[r]), 1, np.bool_(True))
        motions.h[r] = after[1]
    return np.asarray(physical_states(oscillators, motions, rows)), motions.contact[:, 0]


class Known:
    """The attractors of many cells, each motion to be compared with those of its own cell.

    attractors   all of them, those of a cell one after the other; a label is a place in this list
    """

    def __init__(self, oscillators: Oscillator, of_cells: list[list[Attractor]]) -> None:
        self.attractors = [each for attractors in of_cells for each in attractors]
        n = oscillators.gap_row.shape[1]
        orbits: list[int] = []
        first, last = np.zeros(len(of_cells), dtype=np.int64), np.zeros(len(of_cells), dtype=np.int64)
        self.references: list[list[int]] = []
        place = 0
        for c, attractors in enumerate(of_cells):
            first[c] = len(orbits)
            places = range(place, place + len(attractors))
            orbits += [k for k in places if self.attractors[k].jacobian is not None]
            last[c] = len(orbits)
            self.references.append([k for k in places if self.attractors[k].reference is not None])
            place += len(attractors)
        self.places = np.array(orbits, dtype=np.int64)
        some = [self.attractors[k] for k in orbits]
        empty = np.zeros((0, 2 * n, 2 * n))
        self.orbits = KnownOrbits(
            first,
            last,
            np.array([a.h for a in some]).reshape(len(some), n, 2),
            np.array([a.period for a in some], dtype=np.int64),
            np.array([a.jacobian for a in some]) if some else empty,
            np.array([a.contraction for a in some], dtype=np.float64),
            np.array([a.norm for a in some]) if some else empty,
        )

    def reached(self, cells: Cells, rows: Rows, owner: Rows) -> Rows:
        """The label of the known orbit that each of these motions falls into, -1 for none."""
        if not len(self.places) or not len(rows):
            return np.full(len(rows), -1)
        gap = cells.oscillators.gap
        found = orbits_reached(
            gap.metric, cells.oscillators.swing, cells.batch.sections, cells.kept(), rows, owner, self.orbits
        )
        return np.where(found >= 0, self.places[np.maximum(found, 0)], -1)

    def periods(self, labels: Rows) -> Rows:
        """The periods of known orbits."""
        return np.array([self.attractors[k].period for k in labels], dtype=np.int64)

    def has_reference(self, cells: Rows) -> NDArray[np.bool_]:
        """Of which of these cells chaos or a torus is known."""
        return np.array([bool(self.references[c]) for c in cells], dtype=np.bool_)

    def nearest(self, cell: int, batches: Array) -> tuple[int, float]:
        """The label of the chaos or torus of a cell that these batches (k, 4n) are nearest to, and their distance."""
        apart = [(distance(self.reference(k), batches), k) for k in self.references[cell]]
        away, label = min(apart)
        return label, away

    def reference(self, label: int) -> Array:
        """The batches of a chaos or torus."""
        found = self.attractors[label].reference
        assert found is not None
        return found
