"""``solve_attractors``: all attractors of every cell that its initial states reach, with their shares.

A cell's own initial state is solved as by ``solve_tile``. The others follow in waves, each as large as all waves before
it, so that most of them meet known attractors. A motion that falls into a known attractor is finished (see
``matching``); any other motion is solved in full. A cell is finished early if half of its initial states all reach one
attractor.

Apparent chaos is watched for all of ``survival``, see ``Settings``, if any initial state of the cell has found a stable
orbit. The periods of all motions on one attractor count together. If one motion leaves it, it is a transient: each
motion belongs to the attractor on which it ends, or is undecided.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workers.attractors.attractor import STABLE, STATISTICAL, Attractor
from workers.attractors.cell_attractors import CellAttractors
from workers.attractors.initial_states import AttractorSettings, initial_states, unseen_share, wilson
from workers.attractors.matching import mirror_states, nearest
from workers.attractors.search import KnownAttractors, MotionSearch, motions_at_once
from workers.cell.cell_batch import Results
from workers.model.oscillator import Array, Rows, at_rows
from workers.model.system import System, find_system
from workers.results import APERIODIC, CHAOTIC, INVALID, NO_REASON
from workers.settings import Settings
from workers.tile import initial_state, solve_parts

WATCHED_AGAIN = 8
"""Divisor of ``survival``: the remaining motions of a transient are each watched for this part of it."""


def solve_attractors(
    system: str | System,
    params: Mapping[str, ArrayLike],
    settings: Settings | None = None,
    starts: AttractorSettings | None = None,
) -> Results:
    """Return all attractors of every cell, as arrays of the parameters' broadcast shape.

    system, params, settings  as for ``solve_tile``; the method must be "adaptive"
    starts                    the initial states, and the number of attractors kept

    Every result but the cost has one more dimension ``attractor`` after the broadcast shape, of length ``starts.keep``;
    the attractor with the largest share comes first. Unused entries hold no result, regime PENDING. A cell that is
    invalid, or has no decided initial state, has the result of its own initial state in the first entry.
    ``System.variables(settings, attractors=True)`` has the variables. Raise the errors of ``solve_tile``, and
    ValueError for the method "fixed".
    """
    record, settings, starts = find_system(system), settings or Settings(), starts or AttractorSettings()
    if settings.method == "fixed":
        raise ValueError('method: found "fixed", must be "adaptive" to find all attractors')
    for name, _, _ in starts.box:
        if name not in record.states:
            raise KeyError(f"box: found {name}, must be a component of the state: {', '.join(record.states)}")

    def solve_part(params: dict[str, Array], arrays: Results) -> None:
        coexistence = CoexistenceSearch(record, params, settings, starts)
        coexistence.solve()
        coexistence.write(arrays)

    at_once = max(1, motions_at_once(settings, len(record.states)) // max(map(len, starts.waves())))
    variables = record.variables(settings, attractors=True)
    return solve_parts(record, params, settings, variables, at_once, solve_part, attractors=starts.keep)


class CoexistenceSearch:
    """The search for all attractors of N cells with parameters (N,), and the attractors found so far.

    states        (N, starts, 2n) physical initial states of the cells
    cells         known attractors of each cell
    periods_used  (N,) forcing periods simulated
    starts_tried  (N,) number of initial states that have a motion
    own_search    search from the cells' own initial states
    """

    def __init__(
        self, system: System, params: Mapping[str, Array], settings: Settings, starts: AttractorSettings
    ) -> None:
        self.record, self.params = system, params
        self.oscillators, self.reasons = system.build_many(params)
        self.settings, self.starts = settings, starts
        with np.errstate(all="ignore"):
            self.states = initial_states(starts, self.oscillators, system, initial_state(system, params))
        self.cells = [CellAttractors(at_rows(self.oscillators, np.array([c]))) for c in range(len(self.reasons))]
        self.periods_used, self.starts_tried = np.zeros((2, len(self.cells)), dtype=np.int64)

    def solve(self) -> None:
        """Solve the initial states wave by wave, then watch whether apparent chaos lasts."""
        going = np.arange(len(self.cells))
        for wave in self.starts.waves():
            self._solve_wave(going, wave)
            enough = (self.starts_tried >= self.starts.enough) & (wave.stop >= self.starts.enough)
            one = np.array([len(cell.attractors) == 1 and not cell.undecided for cell in self.cells])
            going = np.flatnonzero((self.reasons == NO_REASON) & ~(one & enough))
        self._watch()
        self._pair()

    def search(
        self, owner: Rows, states: Array, mode: Rows | None = None, regimes: tuple[int, ...] = STABLE + STATISTICAL
    ) -> MotionSearch:
        """Return a search, to be run, in which N motions are compared with the known attractors of their cells.

        owner    (N,) cells of the motions
        states   (N, 2n) physical states
        mode     (N,) numbers of the modes, sets of linear equations, of motions that continue earlier ones
        regimes  regimes of the attractors that are compared
        """
        known = KnownAttractors(
            self.oscillators, [[a for a in cell.attractors if a.regime in regimes] for cell in self.cells]
        )
        oscillators, reasons = at_rows(self.oscillators, owner), self.reasons[owner]
        params = {name: values[owner] for name, values in self.params.items()}
        return MotionSearch(self.record, params, oscillators, reasons, states, self.settings, known, owner, mode)

    def _solve_wave(self, cells: Rows, wave: range) -> None:
        owner, number = np.repeat(cells, len(wave)), np.tile(np.array(wave), len(cells))
        exists = np.isfinite(self.states[owner, number]).all(axis=1) | (number == 0)
        owner, number = owner[exists], number[exists]
        if not len(owner):
            return
        search = self.search(owner, self.states[owner, number])
        search.solve()
        if wave.start == 0:
            self.own_search = search
        moving = np.flatnonzero((search.label >= 0) | (search.regime != INVALID))
        np.add.at(self.starts_tried, owner[moving], 1)
        self._put(search, number, moving)

    def _put(self, search: MotionSearch, number: Rows, rows: Rows) -> None:
        """Assign the motions ``rows`` to their attractors, in the order of the initial states.

        The cost of all motions of the search is counted.
        """
        np.add.at(self.periods_used, search.owner, search.cells.periods_used)
        for r in rows.tolist():
            self.cells[search.owner[r]].assign(int(number[r]), search, r)

    def _watch(self) -> None:
        """Watch apparent chaos beside a stable orbit until it has survived, or ends.

        The remaining motions of a transient are watched once more.
        """
        for last in (False, True):
            watches = [
                (c, attractor, self._missing(cell, attractor, last))
                for c, cell in enumerate(self.cells)
                for attractor in cell.attractors
            ]
            suspects = [(c, suspect, missing) for c, suspect, missing in watches if missing > 0]
            if not suspects:
                return
            suspect_index = np.repeat(np.arange(len(suspects)), [len(suspect.starts) for _, suspect, _ in suspects])
            owner = np.array([c for c, _, _ in suspects])[suspect_index]
            periods = np.array([-(-missing // len(suspect.starts)) for _, suspect, missing in suspects])[suspect_index]
            number = np.concatenate([suspect.starts for _, suspect, _ in suspects])
            search = self.search(
                owner, *_stacked([state for _, suspect, _ in suspects for state in suspect.last]), STABLE
            )
            search.watch(periods)
            ended = (search.label >= 0) | np.isin(search.regime, STABLE)
            for k, (c, suspect, _) in enumerate(suspects):
                suspect.seen += int(search.cells.periods_flown[suspect_index == k].sum())
                self._part(
                    self.cells[c], suspect, number, search, np.flatnonzero((suspect_index == k) & ~ended), last=last
                )
            self._put(search, number, np.flatnonzero(ended))

    def _missing(self, cell: CellAttractors, suspect: Attractor, last: bool) -> int:
        """Return the number of periods for which an attractor is still to be watched."""
        if suspect.regime not in (CHAOTIC, APERIODIC) or not any(a.regime in STABLE for a in cell.attractors):
            return 0
        if last:
            return self.settings.survival // WATCHED_AGAIN * len(suspect.starts) if suspect.transient else 0
        return self.settings.survival - suspect.seen

    def _part(
        self, cell: CellAttractors, suspect: Attractor, number: Rows, search: MotionSearch, stay: Rows, last: bool
    ) -> None:
        """Mark the attractor ``suspect`` as a transient if some of its motions have left it.

        cell    attractors of the cell
        number  numbers of the initial states of all motions in ``search``
        search  the motions that were watched
        stay    rows of the motions that are still on the attractor
        last    True for the last watch

        Motions that stay become undecided if this is the last watch and the attractor is a transient. The attractor is
        removed then, and also if no motion stays.
        """
        suspect.transient |= len(stay) < len(suspect.starts)
        suspect.starts, suspect.last = number[stay].tolist(), [search.last(r) for r in stay]
        if suspect.transient and (last or not len(stay)):
            cell.attractors.remove(suspect)
            cell.undecided += suspect.starts

    def _pair(self) -> None:
        """Pair each chaos or torus with its mirror image, by the statistics of mirrored motions."""
        alone = [
            (c, attractor)
            for c, cell in enumerate(self.cells)
            for attractor in cell.attractors
            if cell.symmetric and attractor.reference is not None and len(cell.of_same_regime(attractor)) > 1
        ]
        if not alone:
            return
        owner = np.array([c for c, _ in alone])
        images = mirror_states(
            at_rows(self.oscillators, owner), *_stacked([attractor.last[0] for _, attractor in alone])
        )
        search = self.search(owner, *images, ())
        going, means = search.sample(search.cells.unfinished)
        np.add.at(self.periods_used, owner, search.cells.periods_used)
        for r, of_image in zip(going, means, strict=True):
            c, attractor = alone[r]
            attractor.mirror, _ = nearest(self.cells[c].of_same_regime(attractor), of_image)
        for _, attractor in alone:
            if attractor.mirror is not None and attractor.mirror.mirror is not attractor:
                attractor.mirror = None

    def write(self, arrays: Results) -> None:
        """Write the results of these cells into ``arrays``."""
        for c, cell in enumerate(self.cells):
            ranked = sorted(cell.attractors, key=lambda a: a.order)
            stored, unstored = ranked[: self.starts.keep], ranked[self.starts.keep :]
            arrays["periods_used"][c] = self.periods_used[c]
            arrays["attractors"][c], arrays["starts"][c] = len(ranked), self.starts_tried[c]
            arrays["undecided"][c], arrays["starts_unstored"][c] = (
                len(cell.undecided),
                sum(len(a.starts) for a in unstored),
            )
            if self.starts_tried[c]:
                arrays["unseen_share"][c] = unseen_share(self.starts_tried[c])
            if not stored:
                _write(arrays, c, 0, self.own_search.result(c))
            for k, attractor in enumerate(stored):
                more = _of_share(len(attractor.starts), int(self.starts_tried[c])) | {
                    "exact": attractor.regime in STABLE,
                    "starts_by_statistics": attractor.pooled,
                    "statistical_distance": attractor.distance if attractor.pooled else np.nan,
                    "survived": attractor.seen
                    if attractor.regime in (CHAOTIC, APERIODIC)
                    else attractor.result["survived"],
                    "mirror": next((i for i, a in enumerate(stored) if a is cell.image(attractor)), -1),
                }
                _write(arrays, c, k, attractor.result | more)
                if 0 in attractor.starts:
                    arrays["own_attractor"][c] = k


def _of_share(hits: int, tried: int) -> dict[str, Any]:
    """Return the share of an attractor that ``hits`` of ``tried`` initial states reach, its error and its interval."""
    (below, above), (low, high) = wilson(hits, tried, 1.0), wilson(hits, tried)
    return {"share": hits / tried, "share_error": 0.5 * (above - below), "share_low": low, "share_high": high}


def _stacked(states: list[tuple[Array, int]]) -> tuple[Array, Rows]:
    """Return physical states (N, 2n), and numbers (N,) of the linear equations that hold there, as arrays.

    ``states`` has pairs of a state and such a number.
    """
    return np.stack([state for state, _ in states]), np.array([mode for _, mode in states], dtype=np.int64)


def _write(arrays: dict[str, NDArray[Any]], cell: int, index: int, result: Mapping[str, Any]) -> None:
    for name, value in result.items():
        if name != "periods_used":
            arrays[name][cell, index] = value
