"""The known attractors of one cell: each motion is assigned to a known attractor or to a new one."""

import numpy as np

from workers.attractors.attractor import STABLE, Attractor
from workers.attractors.matching import is_same_attractor, nearest, states_along, states_of_turn
from workers.attractors.search import MotionSearch
from workers.cell.exponents import free_exponents
from workers.kernel.motion import axes
from workers.model.mode_table import is_symmetric
from workers.model.oscillator import Oscillator, take_one
from workers.orbit.attraction import shrinking_norm
from workers.orbit.map import iterate, jacobian_of
from workers.results import LOCKING, NO_IMPACT

FIRST = np.zeros(1, dtype=np.int64)
"""Index of a machine that is alone in a batch."""

LONGEST_KNOWN = 32
"""Longest orbit, in periods, with which motions are compared. Motions on longer orbits are solved in full before they
are compared.
"""


class CellAttractors:
    """The known attractors of one cell.

    oscillator  the machine, as the only row of a batch
    symmetric   True if the machine is its own mirror image half a period later
    attractors  known attractors, in the order in which they were found
    undecided   numbers of the initial states without a known attractor
    """

    def __init__(self, oscillator: Oscillator) -> None:
        self.oscillator = oscillator
        self.symmetric = bool(is_symmetric(oscillator)[0])
        self.attractors: list[Attractor] = []
        self.undecided: list[int] = []

    def assign(self, start: int, search: MotionSearch, r: int) -> Attractor | None:
        """Return the attractor, known or new, that motion r reaches; None if it is unknown.

        start   number of the initial state
        search  search with motion r
        r       row of the motion in ``search``
        """
        known = search.recognised_attractor(r)
        if known is None:
            new = attractor_of(self.oscillator, search, r)
            if new is None:
                self.undecided.append(start)
                return None
            known, search.distance[r] = self.find_same(new)
            if known is None:
                self._add(new)
                new.starts.append(start)
                return new
        known.starts.append(start)
        if known.reference is not None:
            known.last.append(search.last(r))
            known.pooled += 1
            known.distance = max(known.distance, float(search.distance[r]))
            known.seen += int(search.compared[r])
        return known

    def find_same(self, new: Attractor) -> tuple[Attractor | None, float]:
        """Return the known attractor equal to a new one, None if there is none, and their distance in standard errors.

        Orbits are compared exactly, and other motion by statistics. All motion that locks onto a stop is one attractor,
        since it follows the same release.
        """
        if new.regime == LOCKING:
            return next(iter(self.of_same_regime(new)), None), np.nan
        if new.reference is None:
            return next(
                (known for known in self.attractors if is_same_attractor(self.oscillator, known, new)), None
            ), np.nan
        return nearest(self.of_same_regime(new), new.reference)

    def image(self, attractor: Attractor) -> Attractor | None:
        """Return the mirror image of one of the attractors, which may be the attractor itself; None if it is unknown.

        All motion without impact counts as one attractor, except in machines with more elements than one rigid contact.
        """
        alone = attractor.regime == NO_IMPACT and self.symmetric and not self.oscillator.has_modes
        return attractor if alone or attractor.result["symmetric"] else attractor.mirror

    def of_same_regime(self, attractor: Attractor) -> list[Attractor]:
        """Return the known attractors of the same regime."""
        return [known for known in self.attractors if known.regime == attractor.regime]

    def _add(self, new: Attractor) -> None:
        """Add an attractor, and pair it with a known orbit if that orbit is its mirror image."""
        for known in self.attractors if self.symmetric and new.reference is None else []:
            if is_same_attractor(self.oscillator, known, new, half=True):
                known.mirror, new.mirror = new, known
        self.attractors.append(new)


def attractor_of(oscillator: Oscillator, search: MotionSearch, r: int) -> Attractor | None:
    """Return the attractor of motion r, which was solved in full, without a comparison with other motions.

    It is an orbit or motion without impact with a proof, or chaos or a torus with its statistics. For a motion that
    locks onto a stop it is the class alone. Return None if the attractor is unknown.
    """
    regime, orbits, reference = int(search.regime[r]), search.cells.orbits, search.reference.get(r)
    new = Attractor(regime, search.result(r), int(search.cells.mode[r]), reference=reference)
    if reference is not None:
        new.last, new.seen = [search.last(r)], int(new.result["survived"]) + int(search.compared[r])
        return new
    if regime == LOCKING:
        return new
    if regime not in STABLE:
        return None
    new.cycle = search.cells.cycles.get(r)
    if new.cycle:
        new.period = int(new.result["period"])
        new.orbit = states_along(oscillator, new.cycle, new.result["state"], new.mode)
        return new
    if regime == NO_IMPACT and not oscillator.has_modes:
        new.h, new.period, largest = np.zeros_like(orbits.h[r]), 1, float(free_exponents(oscillator)[0, 0])
    else:
        new.h, new.period, new.shift = orbits.h[r].copy(), int(orbits.period[r]), float(orbits.shift[r])
        largest = float(orbits.exponents[r, 0])
    new.orbit = states_of_turn(oscillator, new)
    if largest < 0.0 and new.period <= LONGEST_KNOWN:
        none, steps_and_half = (np.zeros(0), np.zeros((0, 0))), (new.period, np.bool_(False))
        osc, frame = take_one(oscillator, 0), axes(len(new.h))
        turn = oscillator.with_modes(
            lambda _: iterate(osc, new.h, new.mode, frame.copy(), *none, *steps_and_half), FIRST
        )
        jacobian, contraction = jacobian_of(turn.V), -float(np.expm1(largest * new.period))
        norm = shrinking_norm(osc.gap.blocks, jacobian, contraction)
        if np.isfinite(norm).all():
            new.jacobian, new.contraction, new.norm = jacobian, contraction, norm
    return new
