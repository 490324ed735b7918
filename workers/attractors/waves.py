"""``solve_attractors``: all attractors of every cell that its initial states reach, with their shares.

A cell's own initial state is solved as ``solve_tile`` does it. The others follow in waves, each of as many as came
before, so that most of them meet known attractors: a motion that falls into a known attractor is done
(see ``same``), any other one is solved in full. A cell is done early where half of its initial states all reach
one attractor.

Apparent chaos is watched for all of ``survival``, see ``Settings``, if any initial state of the cell has found a stable
orbit. The periods of all motions on one attractor count together. If one motion leaves it, it is a transient: each
motion belongs to the attractor on which it ends, or is undecided.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workers.attractors.cell import CellAttractors
from workers.attractors.record import STABLE, STATISTICAL, Attractor
from workers.attractors.same import mirrored, nearest
from workers.attractors.search import Known, Search, motions_at_once
from workers.attractors.starts import Starts, initial_states, unseen_share, wilson
from workers.cell.cells import Results
from workers.model.oscillator import Array, Rows, taken
from workers.model.system import System, find_system
from workers.results import APERIODIC, CHAOTIC, INVALID, NO_REASON
from workers.settings import Settings
from workers.tile import initial_state, solve_parts

WATCHED_AGAIN = 8
"""What is left of a transient is watched for this part of ``survival``, each motion of it."""


def solve_attractors(
    system: str | System,
    params: Mapping[str, ArrayLike],
    settings: Settings | None = None,
    starts: Starts | None = None,
) -> Results:
    """All attractors of every cell, as arrays of the parameters' broadcast shape; as solve_tile else.

    Every result but the cost has one more dimension ``attractor`` after that shape, of ``starts.keep``: the attractor
    with the largest share first. Where there are fewer the rest is as without a result, regime PENDING. A cell that is
    invalid, or of which no initial state is decided, has the result of its own initial state in the first place.
    ``System.variables(settings, attractors=True)`` has the variables.
    Raises ValueError also for the method "fixed".
    """
    record, settings, starts = find_system(system), settings or Settings(), starts or Starts()
    if settings.method == "fixed":
        raise ValueError('method: found "fixed", all attractors are found by the method "adaptive" only')
    for name, _, _ in starts.box:
        if name not in record.states:
            raise KeyError(f"box: {name} is no component of the state; they are {', '.join(record.states)}")

    def solve_part(params: dict[str, Array], found: Results) -> None:
        coexistence = Coexistence(record, params, settings, starts)
        coexistence.solve()
        coexistence.write(found)

    at_once = max(1, motions_at_once(settings, len(record.states)) // max(map(len, starts.waves())))
    variables = record.variables(settings, attractors=True)
    return solve_parts(record, params, settings, variables, at_once, solve_part, attractors=starts.keep)


class Coexistence:
    """N cells of these parameters (N,) each, and the attractors that are known of them.

    used (N,) forcing periods, tried (N,) initial states that have a motion; own: the search from the cells' own
    """

    def __init__(self, record: System, params: Mapping[str, Array], settings: Settings, starts: Starts) -> None:
        self.record, self.params = record, params
        self.oscillators, self.reasons = record.build_many(params)
        self.settings, self.starts = settings, starts
        with np.errstate(all="ignore"):
            self.states = initial_states(starts, self.oscillators, record, initial_state(record, params))
        self.cells = [CellAttractors(taken(self.oscillators, np.array([c]))) for c in range(len(self.reasons))]
        self.used, self.tried = np.zeros((2, len(self.cells)), dtype=np.int64)

    def solve(self) -> None:
        """Solve the initial states wave by wave, then see whether what looks chaotic lasts."""
        going = np.arange(len(self.cells))
        for wave in self.starts.waves():
            self._solve_wave(going, wave)
            enough = (self.tried >= self.starts.enough) & (wave.stop >= self.starts.enough)
            one = np.array([len(cell.attractors) == 1 and not cell.undecided for cell in self.cells])
            going = np.flatnonzero((self.reasons == NO_REASON) & ~(one & enough))
        self._watch()
        self._pair()

    def search(
        self, owner: Rows, states: Array, contact: Rows | None = None, regimes: tuple[int, ...] = STABLE + STATISTICAL
    ) -> Search:
        """Motions of cells ``owner`` (N,) from physical states (N, 2n), compared with the attractors of these regimes.

        contact (N,) is that of motions that go on from there.
        """
        known = Known(self.oscillators, [[a for a in cell.attractors if a.regime in regimes] for cell in self.cells])
        oscillators, reasons = taken(self.oscillators, owner), self.reasons[owner]
        params = {name: values[owner] for name, values in self.params.items()}
        return Search(self.record, params, oscillators, reasons, states, self.settings, known, owner, contact)

    def _solve_wave(self, cells: Rows, wave: range) -> None:
        owner, number = np.repeat(cells, len(wave)), np.tile(np.array(wave), len(cells))
        there = np.isfinite(self.states[owner, number]).all(axis=1) | (number == 0)
        owner, number = owner[there], number[there]
        if not len(owner):
            return
        search = self.search(owner, self.states[owner, number])
        search.solve()
        if wave.start == 0:
            self.own = search
        moving = np.flatnonzero((search.label >= 0) | (search.regime != INVALID))
        np.add.at(self.tried, owner[moving], 1)
        self._put(search, number, moving)

    def _put(self, search: Search, number: Rows, rows: Rows) -> None:
        """Put these motions to their attractors, in the order of the initial states, by number; count what all cost."""
        np.add.at(self.used, search.owner, search.cells.used)
        for r in rows.tolist():
            self.cells[search.owner[r]].put(int(number[r]), search, r)

    def _watch(self) -> None:
        """Watch what looks chaotic beside a stable orbit until it has survived, or ends.

        What is left of a transient is watched once more.
        """
        for last in (False, True):
            every = [(c, a, self._missing(cell, a, last)) for c, cell in enumerate(self.cells) for a in cell.attractors]
            suspects = [(c, each, missing) for c, each, missing in every if missing > 0]
            if not suspects:
                return
            of = np.repeat(np.arange(len(suspects)), [len(each.starts) for _, each, _ in suspects])
            owner = np.array([c for c, _, _ in suspects])[of]
            periods = np.array([-(-missing // len(each.starts)) for _, each, missing in suspects])[of]
            number = np.concatenate([each.starts for _, each, _ in suspects])
            search = self.search(owner, *_stacked([state for _, each, _ in suspects for state in each.last]), STABLE)
            search.watch(periods)
            ended = (search.label >= 0) | np.isin(search.regime, STABLE)
            for k, (c, each, _) in enumerate(suspects):
                each.seen += int(search.cells.flown[of == k].sum())
                self._part(self.cells[c], each, number, search, np.flatnonzero((of == k) & ~ended), last=last)
            self._put(search, number, np.flatnonzero(ended))

    def _missing(self, cell: CellAttractors, each: Attractor, last: bool) -> int:
        """Periods for which an attractor is still to be watched."""
        if each.regime not in (CHAOTIC, APERIODIC) or not any(a.regime in STABLE for a in cell.attractors):
            return 0
        if last:
            return self.settings.survival // WATCHED_AGAIN * len(each.starts) if each.transient else 0
        return self.settings.survival - each.seen

    def _part(
        self, cell: CellAttractors, each: Attractor, number: Rows, search: Search, stay: Rows, last: bool
    ) -> None:
        """Take an attractor for a transient where not all of its motions stay; those that do may be nowhere at last."""
        each.transient |= len(stay) < len(each.starts)
        each.starts, each.last = number[stay].tolist(), [search.last(r) for r in stay]
        if each.transient and (last or not len(stay)):
            cell.attractors.remove(each)
            cell.undecided += each.starts

    def _pair(self) -> None:
        """Pair chaos and tori with their mirror images: batches of each motion's mirror image tell them."""
        alone = [
            (c, each)
            for c, cell in enumerate(self.cells)
            for each in cell.attractors
            if cell.symmetric and each.reference is not None and len(cell.alike(each)) > 1
        ]
        if not alone:
            return
        owner = np.array([c for c, _ in alone])
        images = mirrored(taken(self.oscillators, owner), *_stacked([each.last[0] for _, each in alone]))
        search = self.search(owner, *images, ())
        going, means = search.sample(search.cells.ready)
        np.add.at(self.used, owner, search.cells.used)
        for r, of_image in zip(going, means, strict=True):
            c, each = alone[r]
            each.mirror, _ = nearest(self.cells[c].alike(each), of_image)
        for _, each in alone:
            if each.mirror is not None and each.mirror.mirror is not each:
                each.mirror = None

    def write(self, found: Results) -> None:
        """Write the result arrays of these cells."""
        for c, cell in enumerate(self.cells):
            ranked = sorted(cell.attractors, key=lambda a: a.order)
            shown, left = ranked[: self.starts.keep], ranked[self.starts.keep :]
            found["periods_used"][c] = self.used[c]
            found["attractors"][c], found["starts"][c] = len(ranked), self.tried[c]
            found["undecided"][c], found["left"][c] = len(cell.undecided), sum(len(a.starts) for a in left)
            if self.tried[c]:
                found["unseen_share"][c] = unseen_share(self.tried[c])
            if not shown:
                _write(found, c, 0, self.own.result(c))
            for k, each in enumerate(shown):
                more = _of_share(len(each.starts), int(self.tried[c])) | {
                    "exact": each.regime in STABLE,
                    "lumped": each.pooled,
                    "lumped_distance": each.distance if each.pooled else np.nan,
                    "survived": each.seen if each.regime in (CHAOTIC, APERIODIC) else each.result["survived"],
                    "mirror": next((i for i, a in enumerate(shown) if a is each.image(cell.symmetric)), -1),
                }
                _write(found, c, k, each.result | more)
                if 0 in each.starts:
                    found["own"][c] = k


def _of_share(hits: int, tried: int) -> dict[str, Any]:
    """The share of an attractor that this many of all initial states reach, with its error and its interval."""
    (below, above), (low, high) = wilson(hits, tried, 1.0), wilson(hits, tried)
    return {"share": hits / tried, "share_error": 0.5 * (above - below), "share_low": low, "share_high": high}


def _stacked(states: list[tuple[Array, int]]) -> tuple[Array, Rows]:
    """Physical states (N, 2n) and contacts (N,) as arrays."""
    return np.stack([state for state, _ in states]), np.array([contact for _, contact in states], dtype=np.int64)


def _write(found: dict[str, NDArray[Any]], cell: int, place: int, result: Mapping[str, Any]) -> None:
    for name, value in result.items():
        if name != "periods_used":
            found[name][cell, place] = value
