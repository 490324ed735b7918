"""Motions compared with known attractors, and solved in full where they reach none."""

import math
from collections.abc import Mapping
from itertools import islice
from typing import Any

import numpy as np

from workers.attractors import same
from workers.attractors.record import STATISTICAL, Attractor
from workers.attractors.same import (
    KnownOrbits,
    batch_moments,
    nearest,
    orbits_reached,
    periods_along,
    periods_to_settle,
)
from workers.cell.cells import Cells
from workers.cell.course import NEAR_LATER
from workers.cell.cycles import CycleCourse, course_of, tell_in_time
from workers.cell.measuring import measure
from workers.cell.observing import observe
from workers.cell.outcome import end_impact_free, end_stopped
from workers.kernel.cells import physical_states
from workers.model.oscillator import Array, Mask, Oscillator, Reasons, Rows
from workers.model.system import System
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
    """The attractors of many cells, each motion to be compared with the attractors of its own cell.

    attractors   all of them, cell by cell; a label is a place in this list
    places       labels of the orbits that motions are compared with, in the order of ``orbits``
    references   the chaos and the tori of each cell; cycles: those of machines without a force
    """

    def __init__(self, oscillators: Oscillator, of_cells: list[list[Attractor]]) -> None:
        n = oscillators.gap_row.shape[1]
        self.attractors = [each for attractors in of_cells for each in attractors]
        ends = np.cumsum([0, *map(len, of_cells)])
        self.places = np.flatnonzero([each.jacobian is not None for each in self.attractors])
        self.references = [[a for a in attractors if a.reference is not None] for attractors in of_cells]
        self.cycles = [[a for a in attractors if a.cycle is not None] for attractors in of_cells]
        some, of_cell = [self.attractors[k] for k in self.places], np.searchsorted(self.places, ends)
        self.orbits = KnownOrbits(
            first=of_cell[:-1],
            last=of_cell[1:],
            h=np.array([a.h for a in some]).reshape(-1, n, 2),
            period=np.array([a.period for a in some], dtype=np.int64),
            jacobian=np.array([a.jacobian for a in some], dtype=np.float64).reshape(-1, 2 * n, 2 * n),
            contraction=np.array([a.contraction for a in some], dtype=np.float64),
            norm=np.array([a.norm for a in some], dtype=np.float64).reshape(-1, 2 * n, 2 * n),
        )


class Search:
    """N motions, each compared with the known attractors of its cell, ``owner`` (N,), and what they come to.

    They are of a system with parameters (N,) each. They begin at physical states (N, 2n), with contacts (N,) if they go
    on from there; those with a reason have no oscillator. Their course ends where they fall into a known orbit. Those
    whose transients are over leave it where chaos or a torus is known of their cell, to be compared with that.

    cells        with the results of the motions that were solved in full
    regime       of each motion, PENDING where it was recognised
    label        place of the known attractor that each has reached, -1 for none
    arrival      periods until it was within a hundredth of its scale on a known orbit, -1 where it reached none
    distance     in standard errors from the attractor that it was assigned to by statistics
    reference    of motions on a new chaos or torus, their batches
    compared     periods on the attractor after its class was known
    """

    def __init__(
        self,
        record: System,
        params: Mapping[str, Array],
        oscillators: Oscillator,
        reasons: Reasons,
        states: Array,
        settings: Settings,
        known: Known,
        owner: Rows,
        contact: Rows | None = None,
    ) -> None:
        N = len(owner)
        self.record, self.params, self.variables = record, params, record.variables(settings)
        arrays = result_arrays(self.variables, settings, N, len(record.states), exponents=record.exponents)
        self.cells = Cells(oscillators, reasons, states, settings, arrays, contact, record.definition.unforced)
        self.course = course_of(self.cells, self._is_known, self._leaves)
        self.known, self.owner, self.regime = known, owner, arrays["regime"]
        self.label, self.arrival = np.full((2, N), -1)
        self.distance = np.full(N, np.nan)
        self.reference: dict[int, Array] = {}
        self.compared = np.zeros(N, dtype=np.int64)
        self.to_compare = np.zeros(N, dtype=np.bool_)

    def result(self, r: int) -> dict[str, Any]:
        """The results of one motion."""
        return {name: values[r].copy() for name, values in self.cells.found.items()}

    def recognised(self, r: int) -> Attractor | None:
        """The known attractor that one motion has reached."""
        return self.known.attractors[self.label[r]] if self.label[r] >= 0 else None

    def last(self, r: int) -> tuple[Array, int]:
        """The physical state that one motion has come to, and its contact."""
        motions = self.cells.batch.motions
        return physical_states(self.cells.oscillators, motions, np.array([r]))[0], int(motions.contact[r, 0])

    @np.errstate(all="ignore")
    def solve(self, references: bool = True) -> None:
        """Take the motions to their attractors; with ``references`` also to the statistics of a new chaos or torus."""
        self.course.take()
        self._compare()
        if references:
            self._refer()
        self._measure()

    @np.errstate(all="ignore")
    def watch(self, periods: Rows) -> None:
        """Take them on for ``periods`` (N,): recognised, on an orbit, or on as they were, regime PENDING."""
        rows, flown = self.cells.ready, self.cells.flown
        while len(rows):
            rows = self._advance(rows, np.minimum(periods[rows] - flown[rows], WATCHED_AT_ONCE))
            rows = rows[flown[rows] < periods[rows]]
        self._measure()

    @np.errstate(all="ignore")
    def sample(self, rows: Rows, batches: int = same.REFERENCE) -> tuple[Rows, Array]:
        """Those of these motions that go on for this many batches, on no orbit; and the batches (rows, batches, 4n)."""
        means = np.full((len(self.owner), batches, 2 * self.cells.directions), np.nan)
        for k in range(batches if len(rows) else 0):
            rows = self._advance(rows, same.BATCH, look=not self.cells.unforced or k == batches - 1)
            means[rows, k] = batch_moments(self.cells.batch.sections, rows, same.BATCH)
        self.compared[rows] += batches * same.BATCH
        return rows, means[rows]

    def _is_known(self, rows: Rows) -> Mask:
        """Which of these motions fall into a known orbit, or are on a known cycle; they have its label."""
        cells, orbits = self.cells, self.known.orbits
        blocks, sections, kept = cells.oscillators.gap.blocks, cells.batch.sections, cells.kept()
        found = orbits_reached(blocks, sections, kept, rows, self.owner, orbits)
        reached = found >= 0
        self.label[rows[reached]] = self.known.places[found[reached]]
        for r, period in zip(rows[reached], orbits.period[found[reached]], strict=True):
            known = sections[r, sections.shape[1] - kept[r] :]
            self.arrival[r] = periods_to_settle(blocks[r], known, cells.flown[r], period)
        if isinstance(self.course, CycleCourse):
            reached[~reached] = [self._is_on_cycle(self.course, r) for r in rows[~reached].tolist()]
        return np.asarray(reached)

    def _is_on_cycle(self, course: CycleCourse, r: int) -> bool:
        """Whether a motion is on a known cycle of its cell, to ONCE_ROUND: it passes one of its events in a turn."""
        cells, cycles = self.cells, self.known.cycles[self.owner[r]]
        longest = max((each.cycle.period for each in cycles if each.cycle), default=0.0)
        turn = math.ceil(longest / cells.oscillators.period[r]) + 1 if cycles else 0
        for trail in islice(course.trails(r), turn):
            states, numbers = trail.after
            for each in cycles:
                if each.cycle and each.cycle.passes(states, numbers):
                    self.label[r] = self.known.attractors.index(each)
                    kept = cells.batch.sections[r, cells.batch.sections.shape[1] - cells.kept()[r] :]
                    self.arrival[r] = periods_along(cells.oscillators.gap.blocks[r], kept, cells.flown[r], each.orbit)
                    return True
        return False

    def _leaves(self, rows: Rows) -> Mask:
        """Of whose cell chaos or a torus is known."""
        self.to_compare[rows] = [len(self.known.references[c]) > 0 for c in self.owner[rows]]
        return self.to_compare[rows]

    def _advance(self, rows: Rows, periods: Rows | int, look: bool = True) -> Rows:
        """Take these motions on by some periods; those that can go on, on no orbit so far as one is to be looked for.

        A cycle without a force is followed event by event to be found, which takes longer than its periods.
        """
        cells, least = self.cells, self.cells.settings.max_periods
        cells.aim(rows, periods)
        rows = end_impact_free(cells, rows)
        cells.run(rows, to_end=True)
        rows = end_stopped(cells, rows)
        if not look:
            return rows
        return self.course.end_on_orbits(rows, np.maximum(cells.budget(), least), np.full(len(self.owner), NEAR_LATER))

    def _compare(self) -> None:
        """Assign motions to the chaos or the torus that they are on; continue with those that are on none."""
        rows, known = np.flatnonzero(self.to_compare), self.known
        for batches in (same.FIRST_LOOK, same.SECOND_LOOK):
            rows, means = self.sample(rows, batches)
            for r, of_motion in zip(rows, means, strict=True):
                found, away = nearest(known.references[self.owner[r]], of_motion)
                if found is not None:
                    self.label[r], self.distance[r] = known.attractors.index(found), away
            rows = rows[self.label[rows] < 0]
        self.compared[rows] = 0
        self.course.watched[rows] += (same.FIRST_LOOK + same.SECOND_LOOK) * same.BATCH  # they were to decide nothing
        self.cells.going[rows] = True
        self.course.observe(rows)
        self.course.take()

    def _measure(self) -> None:
        """Write their machine's own results for motions of a known class, without a force all in units of time."""
        measure(self.cells, self.record.definition, self.params)
        observe(self.cells, self.record.definition, self.params)
        if self.cells.unforced:
            tell_in_time(self.cells, self.variables)

    def _refer(self) -> None:
        """Go on with those motions that are on a chaos or torus that is not known, to tell what it is by.

        One that comes to an orbit meanwhile is on that.
        """
        arrays = self.cells.found
        before = {name: values.copy() for name, values in arrays.items()}
        new = np.flatnonzero((self.label < 0) & np.isin(self.regime, STATISTICAL))
        for variable in self.variables:
            arrays[variable.name][new] = variable.fill
        self.cells.framed[new] = False
        going, means = self.sample(new)
        for name, values in arrays.items():
            values[going] = before[name][going]
        self.reference = dict(zip(going.tolist(), means, strict=True))
