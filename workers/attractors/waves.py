"""``solve_attractors``: all attractors of every cell that its initial states reach, with their shares.

A cell's own initial state is solved as ``solve_tile`` does it. The others follow in waves, each of as many as came
before, so that what is known grows before most of them are spent: a motion that falls into a known attractor is done
(see ``identity``), any other one is solved in full. A cell is done early where half of its initial states all reach
one attractor.

What looks chaotic has to survive for as long as beside a known stable orbit, see ``Settings``, wherever any of the
cell's initial states has found one. The periods of all motions on one attractor count together. If one of them leaves
it, it is a transient: each of them is where it ends, or undecided.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workers.attractors.known import Attractor, Known, attractor_of_orbit, mirrored, states_at
from workers.attractors.same import DIFFERENT, distance, on_orbit
from workers.attractors.search import Found, motions_at_once, sampled, search, watch
from workers.attractors.starts import Starts, initial_states, unseen_share, wilson
from workers.cell.cells import Array, Rows
from workers.kernel.cells import scale_at
from workers.model.oscillator import Oscillator, taken
from workers.model.system import System, find_system
from workers.results import (
    APERIODIC,
    ATTRACTOR,
    CHAOTIC,
    INVALID,
    NO_IMPACT,
    NO_REASON,
    PERIODIC,
    QUASIPERIODIC,
    empty_results,
    result_variables,
)
from workers.settings import Settings
from workers.tile import Solution

STABLE = (NO_IMPACT, PERIODIC)
STATISTICAL = (QUASIPERIODIC, CHAOTIC, APERIODIC)

WATCHED_AGAIN = 8
"""What is left of a transient is watched for this part of ``survival``, each motion of it."""


def solve_attractors(
    system: str | System,
    params: Mapping[str, ArrayLike],
    settings: Settings | None = None,
    starts: Starts | None = None,
) -> Solution:
    """All attractors of every cell, as arrays of the parameters' broadcast shape; as solve_cells else.

    Every result but the cost has one more dimension ``attractor`` after that shape, of ``starts.keep``: the attractor
    with the largest share first. Where there are fewer the rest is as without a result, regime PENDING. A cell that is
    invalid, or of which no initial state is decided, has the result of its own initial state in the first place.
    The variables are those of ``results.result_variables(settings, attractors=True)``.
    Raises ValueError also for the method "fixed".
    """
    record, settings, starts = find_system(system), settings or Settings(), starts or Starts()
    if settings.method == "fixed":
        raise ValueError('method: found "fixed", all attractors are found by the method "adaptive" only')
    for name in params:
        record.parameter(name)
    for name, _, _ in starts.box:
        if name not in record.states:
            raise KeyError(f"box: {name} is no component of the state; they are {', '.join(record.states)}")
    values = [np.asarray(params.get(p.name, p.default), dtype=np.float64) for p in record.parameters]
    shape = np.broadcast_shapes(*(value.shape for value in values))
    flat = {p.name: np.broadcast_to(v, shape).flatten() for p, v in zip(record.parameters, values, strict=True)}
    count, size = int(np.prod(shape)), len(record.states)
    sizes = {ATTRACTOR: starts.keep, "exponent": size, "state": size, "sample": settings.section_samples}
    found = empty_results(result_variables(settings, attractors=True), (count,), sizes)
    at_once = max(1, motions_at_once(settings, size) // max(map(len, starts.waves())))
    for begin in range(0, count, at_once):
        part = slice(begin, begin + at_once)
        here = {name: column[part] for name, column in flat.items()}
        oscillators, reasons = record.build_many(here)
        own = np.stack([here[name] for name in record.states], axis=-1)
        cells = Coexistence(oscillators, reasons, own, settings, starts, record.states)
        cells.solve()
        cells.write({name: array[part] for name, array in found.items()})
    return Solution({name: array.reshape(shape + array.shape[1:]) for name, array in found.items()})


@dataclass
class Tally:
    """What is known of one cell: its attractors, and what became of its initial states.

    used       forcing periods; tried: initial states that have a motion; first: results of the cell's own
    undecided  initial states whose attractor is not known
    """

    attractors: list[Attractor] = field(default_factory=list)
    undecided: list[int] = field(default_factory=list)
    used: int = 0
    tried: int = 0
    first: dict[str, Any] = field(default_factory=dict)


class Coexistence:
    """N cells and the attractors that are known of each."""

    def __init__(
        self,
        oscillators: Oscillator,
        reasons: NDArray[np.int8],
        own: Array,
        settings: Settings,
        starts: Starts,
        names: tuple[str, ...],
    ) -> None:
        self.oscillators, self.reasons, self.settings, self.starts = oscillators, reasons, settings, starts
        with np.errstate(all="ignore"):
            self.states = initial_states(starts, oscillators, names, own)
        self.tallies = [Tally() for _ in range(len(reasons))]

    def solve(self) -> None:
        """Solve the initial states wave by wave, then see whether what looks chaotic lasts."""
        going = np.arange(len(self.reasons))
        for wave in self.starts.waves():
            self._solve_wave(going, wave)
            invalid = (self.reasons != NO_REASON)[going]
            going = going[~invalid & ~np.array([self._is_done(self.tallies[c], wave.stop) for c in going], dtype=bool)]
        self._watch()
        self._pair()

    def _is_done(self, tally: Tally, started: int) -> bool:
        one = len(tally.attractors) == 1 and not tally.undecided
        return one and started >= self.starts.enough and tally.tried >= self.starts.enough

    def _solve_wave(self, cells: Rows, wave: range) -> None:
        owner, number = np.repeat(cells, len(wave)), np.tile(np.array(wave), len(cells))
        there = np.isfinite(self.states[owner, number]).all(axis=1) | (number == 0)
        owner, number = owner[there], number[there]
        if not len(owner):
            return
        known = Known(self.oscillators, [tally.attractors for tally in self.tallies])
        found = search(
            taken(self.oscillators, owner), self.reasons[owner], self.states[owner, number], self.settings, known, owner
        )
        self._assign(owner, number, found, known)

    def _assign(self, owner: Rows, number: Rows, found: Found, known: Known) -> None:
        """Put each motion to its attractor, one that is known or a new one; in the order of the initial states."""
        for r in range(len(owner)):
            tally = self.tallies[owner[r]]
            tally.used += int(found.used[r])
            if number[r] == 0 and not tally.first:
                tally.first = found.result(r)
            regime = int(found.arrays["regime"][r])
            if found.label[r] < 0 and regime == INVALID:
                continue
            if found.again is None or not found.again[r]:
                tally.tried += 1
            if found.label[r] >= 0:
                known.attractors[found.label[r]].join(int(number[r]), found, r)
            else:
                self.put(int(owner[r]), int(number[r]), found, r)

    def put(self, cell: int, start: int, found: Found, r: int) -> None:
        """Put a motion that was solved in full to its attractor, the same as a known one or a new one."""
        regime = int(found.arrays["regime"][r])
        if regime in STABLE:
            self._put_orbit(cell, start, found, r)
        elif regime in STATISTICAL and found.reference[r] is not None:
            self._put_statistical(self.tallies[cell], start, found, r)
        else:
            self.tallies[cell].undecided.append(start)

    def _put_orbit(self, cell: int, start: int, found: Found, r: int) -> None:
        new = attractor_of_orbit(self.oscillators, cell, found, r)
        old = self.same(cell, new)
        if old is not None:
            old.starts.append(start)
            return
        tally = self.tallies[cell]
        for each in tally.attractors if self.oscillators.symmetric[cell] > 0.0 else []:
            if self._meets(cell, each, new, half=True):
                each.mirror, new.mirror = new, each
        new.starts.append(start)
        tally.attractors.append(new)

    def same(self, cell: int, new: Attractor) -> Attractor | None:
        """The known attractor of a cell that an orbit, or motion without impact, is."""
        known = self.tallies[cell].attractors
        return next((each for each in known if self._meets(cell, each, new)), None)

    def _meets(self, cell: int, old: Attractor, new: Attractor, half: bool = False) -> bool:
        """Whether an orbit, or with ``half`` its mirror image, is a known one: on the section where that was proved."""
        if (old.regime, old.period) != (new.regime, new.period):
            return False
        if old.regime == NO_IMPACT and not half:
            return True
        state = states_at(self.oscillators, cell, new, old.shift, int(half), half)[-1]
        metric = self.oscillators.gap.metric[cell]
        return on_orbit(metric, old.orbit, state, float(scale_at(metric, self.oscillators.swing[cell], state)))

    def _put_statistical(self, tally: Tally, start: int, found: Found, r: int) -> None:
        reference = found.reference[r]
        assert reference is not None
        alike = [a for a in tally.attractors if a.regime == int(found.arrays["regime"][r])]
        apart = [distance(a.reference, reference) for a in alike if a.reference is not None]
        if apart and min(apart) <= DIFFERENT:
            old = alike[int(np.argmin(apart))]
            old.pool(start, min(apart), found, r)
            return
        new = Attractor(int(found.arrays["regime"][r]), found.result(r), int(found.contact[r]))
        new.reference, new.last, new.pooled = reference, [found.left(r)], int(found.survived(r))
        new.starts.append(start)
        tally.attractors.append(new)

    def _watch(self) -> None:
        """Watch what looks chaotic beside a stable orbit until it has survived, or ends."""
        for chance in range(2):  # what is left of a transient is watched once more
            owner: list[int] = []
            number: list[int] = []
            states: list[tuple[Array, int]] = []
            periods: list[int] = []
            suspects: list[tuple[int, Attractor]] = []
            for c, tally in enumerate(self.tallies):
                for each in tally.attractors:
                    missing = self._missing(tally, each, chance)
                    if missing > 0:
                        suspects.append((c, each))
                        owner += [c] * len(each.starts)
                        number += each.starts
                        states += each.last
                        periods += [-(-missing // len(each.starts))] * len(each.starts)
            if not suspects:
                return
            known = Known(self.oscillators, [[a for a in t.attractors if a.regime in STABLE] for t in self.tallies])
            rows = np.array(owner)
            found = watch(
                taken(self.oscillators, rows), *_stacked(states), np.array(periods), self.settings, known, rows
            )
            self._settle_suspects(suspects, rows, np.array(number), found, known, last=chance == 1)

    def _missing(self, tally: Tally, each: Attractor, chance: int) -> int:
        """Periods for which an attractor is still to be watched."""
        if each.regime not in (CHAOTIC, APERIODIC) or not any(a.regime in STABLE for a in tally.attractors):
            return 0
        if chance:
            return self.settings.survival // WATCHED_AGAIN * len(each.starts) if each.transient else 0
        return self.settings.survival - each.pooled

    def _settle_suspects(
        self, suspects: list[tuple[int, Attractor]], owner: Rows, number: Rows, found: Found, known: Known, last: bool
    ) -> None:
        """Take what has ended for a transient, and its motions for what they have become."""
        first = 0
        gone: list[int] = []
        for c, each in suspects:
            rows = np.arange(first, first + len(each.starts))
            first += len(rows)
            regime = found.arrays["regime"][rows]
            ended = (found.label[rows] >= 0) | np.isin(regime, STABLE)
            each.pooled += int(found.flown[rows].sum())
            if not ended.any() and not each.transient:
                self.tallies[c].used += int(found.used[rows].sum())
                each.last = [found.left(r) for r in rows.tolist()]
                continue
            each.transient = True
            gone += rows[ended].tolist()
            stay = rows[~ended]
            self.tallies[c].used += int(found.used[stay].sum())
            each.starts, each.last = number[stay].tolist(), [found.left(r) for r in stay.tolist()]
            if last or not len(stay):
                self.tallies[c].attractors.remove(each)
                self.tallies[c].undecided += each.starts
        chosen = np.array(gone, dtype=np.int64)
        if len(chosen):
            self._assign(owner[chosen], number[chosen], found.only(chosen), known)

    def _pair(self) -> None:
        """Pair chaos and tori with their mirror images: batches of each motion's mirror image tell them."""
        alone = [
            (c, each)
            for c, tally in enumerate(self.tallies)
            if self.oscillators.symmetric[c] > 0.0
            for each in tally.attractors
            if each.reference is not None and sum(other.regime == each.regime for other in tally.attractors) > 1
        ]
        if not alone:
            return
        owner = np.array([c for c, _ in alone])
        oscillators = taken(self.oscillators, owner)
        states, contact = mirrored(oscillators, *_stacked([each.last[0] for _, each in alone]))
        known = Known(self.oscillators, [[] for _ in self.tallies])
        found, used = sampled(oscillators, states, contact, self.settings, known, owner)
        for (c, each), batches, cost in zip(alone, found, used.tolist(), strict=True):
            self.tallies[c].used += cost
            alike = [other for other in self.tallies[c].attractors if other.regime == each.regime]
            if batches is None:  # it has settled
                continue
            apart = [distance(other.reference, batches) for other in alike if other.reference is not None]
            if min(apart) <= DIFFERENT:
                each.mirror = alike[int(np.argmin(apart))]
        for _, each in alone:
            if each.mirror is not None and each.mirror.mirror is not each:
                each.mirror = None

    def write(self, found: dict[str, NDArray[Any]]) -> None:
        """Write the result arrays of these cells."""
        for c, tally in enumerate(self.tallies):
            kept = sorted(tally.attractors, key=lambda a: a.order)
            shown, left = kept[: self.starts.keep], kept[self.starts.keep :]
            found["periods_used"][c] = tally.used
            found["attractors"][c], found["starts"][c] = len(kept), tally.tried
            found["undecided"][c], found["left"][c] = len(tally.undecided), sum(len(a.starts) for a in left)
            if tally.tried:
                found["unseen_share"][c] = unseen_share(tally.tried)
            if not shown:
                _put(found, c, 0, tally.first)
                continue
            for k, each in enumerate(shown):
                _put(found, c, k, each.result)
                hits = len(each.starts)
                found["share"][c, k] = hits / tally.tried
                low, high = wilson(hits, tally.tried, 1.0)
                found["share_error"][c, k] = 0.5 * (high - low)
                found["share_low"][c, k], found["share_high"][c, k] = wilson(hits, tally.tried)
                found["exact"][c, k] = each.regime in STABLE
                found["lumped"][c, k] = each.lumped
                if each.lumped:
                    found["lumped_distance"][c, k] = each.distance
                if each.regime in (CHAOTIC, APERIODIC):
                    found["survived"][c, k] = each.pooled
                mirror = each.image(bool(self.oscillators.symmetric[c] > 0.0))
                found["mirror"][c, k] = next((i for i, a in enumerate(shown) if a is mirror), -1)
                if 0 in each.starts:
                    found["own"][c] = k


def _stacked(states: list[tuple[Array, int]]) -> tuple[Array, Rows]:
    """Physical states (N, 2n) and contacts (N,) as arrays."""
    return np.stack([state for state, _ in states]), np.array([contact for _, contact in states], dtype=np.int64)


def _put(found: dict[str, NDArray[Any]], cell: int, place: int, result: Mapping[str, Any]) -> None:
    for name, value in result.items():
        if name != "periods_used":
            found[name][cell, place] = value
