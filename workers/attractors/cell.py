"""The attractors of one cell, each motion put to one that is known or to a new one."""

import numpy as np

from workers.attractors.record import STABLE, STATISTICAL, Attractor, Found
from workers.attractors.same import DIFFERENT, nearest, same_orbit, states_of_turn, turn
from workers.model.oscillator import COLUMN, Oscillator
from workers.orbit.attraction import shrinking_norm
from workers.results import NO_IMPACT

LONGEST_KNOWN = 32
"""Longest orbit that motions are compared with: longer ones are found anew, and seen to be the same then."""


class CellAttractors:
    """The attractors that are known of one cell, whose oscillator is a record of many.

    undecided    initial states, by number, whose attractor is not known
    """

    def __init__(self, oscillator: Oscillator) -> None:
        self.oscillator = oscillator
        self.symmetric = bool(oscillator.symmetric[0] > 0.0)
        self.attractors: list[Attractor] = []
        self.undecided: list[int] = []

    def put(self, start: int, found: Found, r: int) -> Attractor | None:
        """The attractor, known or new, that motion r reaches, which was solved in full from an initial state.

        None where that is not known.
        """
        regime, reference = int(found.regime[r]), found.reference[r]
        if regime in STABLE:
            new = attractor_of_orbit(self.oscillator, found, r)
            known = self.same(new)
        elif regime in STATISTICAL and reference is not None:
            new = Attractor(regime, found.result(r), int(found.cells.contact[r]), reference=reference)
            new.last, new.seen = [found.last[r]], int(new.result["survived"]) + int(found.compared[r])
            place, found.distance[r] = nearest(self.alike(new), reference)
            known = self.alike(new)[place] if found.distance[r] <= DIFFERENT else None
        else:
            self.undecided.append(start)
            return None
        if known is not None:
            known.add(start, found, r)
            return known
        for each in self.attractors if self.symmetric and regime in STABLE else []:
            if same_orbit(self.oscillator, each, new, half=True):
                each.mirror, new.mirror = new, each
        new.starts.append(start)
        self.attractors.append(new)
        return new

    def same(self, new: Attractor) -> Attractor | None:
        """The known attractor that an orbit, or motion without impact, is."""
        return next((each for each in self.attractors if same_orbit(self.oscillator, each, new)), None)

    def alike(self, attractor: Attractor) -> list[Attractor]:
        """The known attractors of its regime."""
        return [each for each in self.attractors if each.regime == attractor.regime]


def attractor_of_orbit(oscillator: Oscillator, found: Found, r: int) -> Attractor:
    """The attractor that a motion has been proved to fall into: an orbit, or motion without impact."""
    orbits, gap, regime = found.cells.orbits, oscillator.gap, int(found.regime[r])
    new = Attractor(regime, found.result(r), int(found.cells.contact[r]))
    new.h, new.period, new.shift = orbits.h[r].copy(), int(orbits.period[r]), float(orbits.shift[r])
    largest = float(orbits.exponents[r, 0])
    if regime == NO_IMPACT:
        new.h, new.period, new.shift = np.zeros_like(new.h), 1, 0.0
        largest = -float(gap.blocks[0][:, COLUMN.slow].min() * oscillator.period[0])
    new.orbit = states_of_turn(oscillator, new, new.shift, new.period)[: new.period]
    if largest < 0.0 and new.period <= LONGEST_KNOWN:
        _, _, jacobian = turn(oscillator, 0, new.h, new.contact, new.period, np.bool_(False))
        contraction = -float(np.expm1(largest * new.period))
        norm = shrinking_norm(gap.metric[0], jacobian, contraction)
        if np.isfinite(norm).all():
            new.jacobian, new.contraction, new.norm = jacobian, contraction, norm
    return new
