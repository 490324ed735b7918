"""Motions that are compared with known attractors, and solved in full where they reach none of them."""

import numpy as np

from workers.attractors import same
from workers.attractors.record import STATISTICAL, Attractor, Found
from workers.attractors.same import KnownOrbits, batch_moments, nearest, orbits_reached, periods_to_settle
from workers.cell.cells import Array, Cells, Mask, Reasons, Rows
from workers.cell.course import NEAR_LATER, Course
from workers.cell.outcome import end_impact_free, end_stopped
from workers.model.oscillator import Oscillator
from workers.results import result_variables
from workers.settings import Settings
from workers.tile import MEMORY_AT_ONCE, result_arrays

WATCHED_AT_ONCE = 1024
"""Periods of a stretch of watching."""

MOST_MOTIONS, LEAST_MOTIONS = 4096, 64
"""Motions under way together: as many as the memory for section states has room for, between these."""


def motions_at_once(settings: Settings, size: int) -> int:
    """How many motions of ``size`` state components are searched for together."""
    room = MEMORY_AT_ONCE // (8 * size * (settings.max_period + settings.section_samples + 1))
    return int(np.clip(room, LEAST_MOTIONS, MOST_MOTIONS))


class Known:
    """The attractors of many cells, each motion to be compared with those of its own cell.

    attractors   all of them, those of a cell one after the other; a label is a place in this list
    places       labels of the orbits that motions are compared with, in the order of ``orbits``
    references   labels of the chaos and the tori of each cell
    """

    def __init__(self, oscillators: Oscillator, of_cells: list[list[Attractor]]) -> None:
        n = oscillators.gap_row.shape[1]
        self.attractors = [each for attractors in of_cells for each in attractors]
        owner = np.repeat(np.arange(len(of_cells)), [len(attractors) for attractors in of_cells])
        self.places = np.array([k for k, a in enumerate(self.attractors) if a.jacobian is not None], dtype=np.int64)
        self.references: list[list[int]] = [[] for _ in of_cells]
        for k, each in enumerate(self.attractors):
            if each.reference is not None:
                self.references[owner[k]].append(k)
        ends = np.searchsorted(owner[self.places], np.arange(len(of_cells) + 1))
        some = [self.attractors[k] for k in self.places]
        self.orbits = KnownOrbits(
            first=ends[:-1],
            last=ends[1:],
            h=np.array([a.h for a in some]).reshape(-1, n, 2),
            period=np.array([a.period for a in some], dtype=np.int64),
            jacobian=np.array([a.jacobian for a in some], dtype=np.float64).reshape(-1, 2 * n, 2 * n),
            contraction=np.array([a.contraction for a in some], dtype=np.float64),
            norm=np.array([a.norm for a in some], dtype=np.float64).reshape(-1, 2 * n, 2 * n),
        )


class Search:
    """N motions, each compared with the known attractors of its cell, ``owner`` (N,), and what they have come to.

    They begin at physical states (N, 2n), with contacts (N,) if they go on from there; those with a reason have no
    oscillator. Their course ends where they fall into a known orbit. Those whose transients are over leave it where
    chaos or a torus is known of their cell, to be compared with that.
    """

    def __init__(
        self,
        oscillators: Oscillator,
        reasons: Reasons,
        states: Array,
        settings: Settings,
        known: Known,
        owner: Rows,
        contact: Rows | None = None,
    ) -> None:
        arrays = result_arrays(result_variables(settings), settings, len(owner), states.shape[1])
        self.cells = Cells(oscillators, reasons, states, settings, arrays, contact)
        self.known, self.owner, self.found = known, owner, Found(self.cells)
        self.to_compare = np.zeros(len(owner), dtype=np.bool_)
        self.course = Course(self.cells, self._is_known, self._leaves)

    def solve(self, references: bool = True) -> Found:
        """What the motions come to; with ``references`` also what a new chaos or torus is told by."""
        with np.errstate(all="ignore"):
            self.course.take(self.cells.ready)
            self._compare()
            if references:
                self._refer()
        return self.found

    def watch(self, periods: Rows) -> Found:
        """What they come to in ``periods`` (N,): recognised, on an orbit, or on as they were, regime PENDING."""
        rows, flown = self.cells.ready, self.cells.flown
        with np.errstate(all="ignore"):
            while len(rows):
                rows = self._advance(rows, np.minimum(periods[rows] - flown[rows], WATCHED_AT_ONCE))
                rows = rows[flown[rows] < periods[rows]]
            self.found.keep_last(np.arange(len(self.owner)))
        return self.found

    def sample(self, rows: Rows, batches: int = same.REFERENCE) -> tuple[Rows, Array]:
        """Those of these motions that go on for this many batches, on no orbit; and the batches (rows, batches, 4n)."""
        means = np.full((len(self.owner), batches, 2 * self.cells.directions), np.nan)
        with np.errstate(all="ignore"):
            for k in range(batches if len(rows) else 0):
                rows = self._advance(rows, same.BATCH)
                means[rows, k] = batch_moments(self.cells.batch.sections, rows, same.BATCH)
        self.found.compared[rows] += batches * same.BATCH
        self.found.keep_last(rows)
        return rows, means[rows]

    def _is_known(self, rows: Rows) -> Mask:
        """Which of these motions fall into a known orbit; they have its label."""
        cells, orbits = self.cells, self.known.orbits
        metric, swing, sections = cells.oscillators.gap.metric, cells.oscillators.swing, cells.batch.sections
        found = orbits_reached(metric, swing, sections, cells.kept(), rows, self.owner, orbits)
        reached = found >= 0
        rows, found = rows[reached], found[reached]
        self.found.label[rows] = self.known.places[found]
        self.found.arrival[rows] = periods_to_settle(
            metric, swing, sections, cells.kept(), rows, cells.flown, orbits.period[found]
        )
        return np.asarray(reached)

    def _leaves(self, rows: Rows) -> Mask:
        """Of whose cell chaos or a torus is known."""
        self.to_compare[rows] = [bool(self.known.references[c]) for c in self.owner[rows]]
        return self.to_compare[rows]

    def _advance(self, rows: Rows, periods: Rows | int) -> Rows:
        """Take these motions on by some periods; those on no orbit that can go on."""
        cells, least = self.cells, self.cells.settings.max_periods
        cells.aim(rows, periods)
        rows = end_impact_free(cells, rows)
        cells.run(rows, to_end=True)
        rows = end_stopped(cells, rows)
        return self.course.end_on_orbits(rows, np.maximum(cells.budget(), least), np.full(len(self.owner), NEAR_LATER))

    def _compare(self) -> None:
        """Put motions to the chaos or the torus that they are on; go on with those that are on none of them."""
        rows, found, known = np.flatnonzero(self.to_compare), self.found, self.known
        for batches in (same.FIRST_LOOK, same.SECOND_LOOK):
            rows, means = self.sample(rows, batches)
            for r, of_motion in zip(rows, means, strict=True):
                labels = known.references[self.owner[r]]
                place, away = nearest([known.attractors[k] for k in labels], of_motion)
                if away <= same.DIFFERENT:
                    found.label[r], found.distance[r] = labels[place], away
            rows = rows[found.label[rows] < 0]
        found.compared[rows] = 0
        self.course.watched[rows] += (same.FIRST_LOOK + same.SECOND_LOOK) * same.BATCH  # they were to decide nothing
        self.course.observe(rows)
        self.course.take(rows)

    def _refer(self) -> None:
        """Go on with those motions that are on a chaos or torus that is not known, to tell what it is by.

        One that comes to an orbit meanwhile is on that.
        """
        arrays = self.cells.found
        before = {name: values.copy() for name, values in arrays.items()}
        new = np.flatnonzero((self.found.label < 0) & np.isin(self.found.regime, STATISTICAL))
        for variable in result_variables(self.cells.settings):
            arrays[variable.name][new] = variable.fill
        self.cells.framed[new] = False
        going, means = self.sample(new)
        for name, values in arrays.items():
            values[going] = before[name][going]
        for r, of_motion in zip(going, means, strict=True):
            self.found.reference[r] = of_motion
