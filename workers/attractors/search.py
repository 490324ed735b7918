"""The search for attractors: motions are compared with known attractors, and solved in full if they reach none."""

import math
from collections.abc import Mapping
from itertools import islice
from typing import Any

import numpy as np

from workers.attractors import matching
from workers.attractors.attractor import STATISTICAL, Attractor
from workers.attractors.matching import (
    KnownOrbits,
    batch_moments,
    nearest,
    orbits_reached,
    periods_along,
    periods_to_settle,
)
from workers.cell.autonomous import AutonomousSchedule, convert_to_time, course_of
from workers.cell.cell_batch import CellBatch
from workers.cell.event_trail import trails
from workers.cell.measures import explain, measure, measure_energy
from workers.cell.observables import observe
from workers.cell.outcome import end_impact_free, end_stopped
from workers.cell.schedule import NEAR_LATER
from workers.kernel.cell_loops import physical_states
from workers.model.oscillator import Array, Mask, Oscillator, Reasons, Rows
from workers.model.system import System
from workers.settings import Settings
from workers.tile import MAX_SECTION_BYTES, result_arrays

WATCH_INTERVAL = 1024
"""Maximum number of periods for which a watched motion is simulated before it is looked at again."""

MAX_MOTIONS, MIN_MOTIONS = 4096, 64
"""Maximum and minimum number of motions searched together; the memory for their stored states decides between them."""


def motions_at_once(settings: Settings, size: int) -> int:
    """Return the number of motions of ``size`` state components that are searched together."""
    room = MAX_SECTION_BYTES // (8 * size * (settings.max_period + settings.section_samples + 1))
    return int(np.clip(room, MIN_MOTIONS, MAX_MOTIONS))


class KnownAttractors:
    """The known attractors of many cells; a motion is compared with the attractors of its own cell.

    attractors  all attractors, cell by cell; a label is an index into this list
    places      labels of the stable orbits in ``orbits``, in their order
    references  chaos and tori by cell
    cycles      cycles of machines without a force by cell
    orbits      orbits in the form for compiled kernels
    """

    def __init__(self, oscillators: Oscillator, of_cells: list[list[Attractor]]) -> None:
        n = oscillators.gap_row.shape[1]
        self.attractors = [attractor for attractors in of_cells for attractor in attractors]
        ends = np.cumsum([0, *map(len, of_cells)])
        self.places = np.flatnonzero([attractor.jacobian is not None for attractor in self.attractors])
        self.references = [[a for a in attractors if a.reference is not None] for attractors in of_cells]
        self.cycles = [[a for a in attractors if a.cycle is not None] for attractors in of_cells]
        compared, of_cell = [self.attractors[k] for k in self.places], np.searchsorted(self.places, ends)
        self.orbits = KnownOrbits(
            first=of_cell[:-1],
            last=of_cell[1:],
            h=np.array([a.h for a in compared]).reshape(-1, n, 2),
            period=np.array([a.period for a in compared], dtype=np.int64),
            jacobian=np.array([a.jacobian for a in compared], dtype=np.float64).reshape(-1, 2 * n, 2 * n),
            contraction=np.array([a.contraction for a in compared], dtype=np.float64),
            norm=np.array([a.norm for a in compared], dtype=np.float64).reshape(-1, 2 * n, 2 * n),
        )


class MotionSearch:
    """N motions compared with the known attractors of their cells, and their outcomes.

    cells      the motions, with the results of those solved in full
    owner      (N,) cells of the motions
    regime     (N,) regimes, PENDING for recognised motions
    label      (N,) labels of the known attractors reached, -1 if there is none
    arrival    (N,) periods until a motion is within a hundredth of its scale of a known orbit, -1 if it reached none
    distance   (N,) distances in standard errors from the attractors assigned by statistics
    reference  statistics (k, 4n), means over batches of states, of motions on new chaos or tori, by row
    compared   (N,) periods on the attractor after its class was known

    The motions have parameters (N,) and begin at physical states (N, 2n). Motions that continue earlier ones also have
    the numbers (N,) of their modes, sets of linear equations. Motions with a reason have no oscillator. A motion ends
    when it falls into a known orbit. After its transient it is compared with the known chaos and tori of its cell, if
    there are any.
    """

    def __init__(
        self,
        system: System,
        params: Mapping[str, Array],
        oscillators: Oscillator,
        reasons: Reasons,
        states: Array,
        settings: Settings,
        known: KnownAttractors,
        owner: Rows,
        mode: Rows | None = None,
    ) -> None:
        N = len(owner)
        self.record, self.params, self.variables = system, params, system.variables(settings)
        arrays = result_arrays(self.variables, settings, N, len(system.states), exponents=system.exponents)
        self.cells = CellBatch(oscillators, reasons, states, settings, arrays, mode, system.definition.unforced)
        self.course = course_of(self.cells, self._is_known, self._leaves)
        self.known, self.owner, self.regime = known, owner, arrays["regime"]
        self.label, self.arrival = np.full((2, N), -1)
        self.distance = np.full(N, np.nan)
        self.reference: dict[int, Array] = {}
        self.compared = np.zeros(N, dtype=np.int64)
        self.to_compare = np.zeros(N, dtype=np.bool_)

    def result(self, r: int) -> dict[str, Any]:
        """Return the results of motion r by name."""
        return {name: values[r].copy() for name, values in self.cells.results.items()}

    def recognised_attractor(self, r: int) -> Attractor | None:
        """Return the known attractor that motion r has reached, None if there is none."""
        return self.known.attractors[self.label[r]] if self.label[r] >= 0 else None

    def last(self, r: int) -> tuple[Array, int]:
        """Return the last physical state of motion r, and the number of its mode, the linear equations that hold."""
        motions = self.cells.batch.motions
        return physical_states(self.cells.oscillators, motions, np.array([r]))[0], int(motions.mode[r, 0])

    @np.errstate(all="ignore")
    def solve(self, references: bool = True) -> None:
        """Simulate the motions until they reach their attractors.

        ``references`` adds the statistics of new chaos and tori.
        """
        self.course.run()
        self._compare()
        if references:
            self._refer()
        self._measure()

    @np.errstate(all="ignore")
    def watch(self, periods: Rows) -> None:
        """Simulate the motions for ``periods`` (N,); each is recognised, comes to an orbit, or stays PENDING."""
        rows, flown = self.cells.unfinished, self.cells.periods_flown
        while len(rows):
            rows = self._advance(rows, np.minimum(periods[rows] - flown[rows], WATCH_INTERVAL))
            rows = rows[flown[rows] < periods[rows]]
        self._measure()

    @np.errstate(all="ignore")
    def sample(self, rows: Rows, batches: int = matching.REFERENCE) -> tuple[Rows, Array]:
        """Simulate motions over some batches of periods; return the motions that reach no orbit, and statistics.

        The statistics (rows, batches, 4n) are means, over each batch, of the states at t = k T and of their squares,
        see ``matching``.
        """
        means = np.full((len(self.owner), batches, 2 * self.cells.directions), np.nan)
        for k in range(batches if len(rows) else 0):
            rows = self._advance(rows, matching.BATCH, look=not self.cells.unforced or k == batches - 1)
            means[rows, k] = batch_moments(self.cells.batch.sections, rows, matching.BATCH)
        self.compared[rows] += batches * matching.BATCH
        return rows, means[rows]

    def _is_known(self, rows: Rows) -> Mask:
        """Return the mask of motions that fall into a known orbit or are on a known cycle, and set their labels."""
        cells, orbits = self.cells, self.known.orbits
        blocks, sections, counts = cells.oscillators.gap.blocks, cells.batch.sections, cells.known_section_count()
        orbit = orbits_reached(blocks, sections, counts, rows, self.owner, orbits)
        reached = orbit >= 0
        self.label[rows[reached]] = self.known.places[orbit[reached]]
        for r, period in zip(rows[reached], orbits.period[orbit[reached]], strict=True):
            known = sections[r, sections.shape[1] - counts[r] :]
            self.arrival[r] = periods_to_settle(blocks[r], known, cells.periods_flown[r], period)
        if isinstance(self.course, AutonomousSchedule):
            reached[~reached] = [self._is_on_cycle(self.course, r) for r in rows[~reached].tolist()]
        return np.asarray(reached)

    def _is_on_cycle(self, course: AutonomousSchedule, r: int) -> bool:
        """Return True if a motion passes an event of a known cycle of its cell, to CLOSING_DISTANCE, within a turn.

        The motion then gets the label of the cycle.
        """
        cells, cycles = self.cells, self.known.cycles[self.owner[r]]
        longest = max((known.cycle.period for known in cycles if known.cycle), default=0.0)
        turn = math.ceil(longest / cells.oscillators.period[r]) + 1 if cycles else 0
        for trail in islice(trails(cells, r), turn):
            states, numbers = trail.states_after
            for known in cycles:
                if known.cycle and known.cycle.contains_states(states, numbers):
                    self.label[r] = self.known.attractors.index(known)
                    sections = cells.known_sections(r)
                    self.arrival[r] = periods_along(
                        cells.oscillators.gap.blocks[r], sections, cells.periods_flown[r], known.orbit
                    )
                    return True
        return False

    def _leaves(self, rows: Rows) -> Mask:
        """Return the mask of motions to be compared with known chaos or tori: there is one in their cell."""
        self.to_compare[rows] = [len(self.known.references[c]) > 0 for c in self.owner[rows]]
        return self.to_compare[rows]

    def _advance(self, rows: Rows, periods: Rows | int, look: bool = True) -> Rows:
        """Advance these motions by some periods, and return the motions that can continue.

        With ``look``, motions that have reached an orbit end. Without a force, ``look`` simulates them event by event,
        which takes longer than their periods.
        """
        cells, least = self.cells, self.cells.settings.max_periods
        cells.set_interval(rows, periods)
        rows = end_impact_free(cells, rows)
        cells.run(rows, to_end=True)
        rows = end_stopped(cells, rows)
        if not look:
            return rows
        return self.course.end_on_orbits(rows, np.maximum(cells.budget(), least), np.full(len(self.owner), NEAR_LATER))

    def _compare(self) -> None:
        """Assign motions to the known chaos or torus that they are on, and continue the others."""
        rows, known = np.flatnonzero(self.to_compare), self.known
        for batches in (matching.FIRST_LOOK, matching.SECOND_LOOK):
            rows, means = self.sample(rows, batches)
            for r, of_motion in zip(rows, means, strict=True):
                attractor, away = nearest(known.references[self.owner[r]], of_motion)
                if attractor is not None:
                    self.label[r], self.distance[r] = known.attractors.index(attractor), away
            rows = rows[self.label[rows] < 0]
        self.compared[rows] = 0
        self.course.watched[rows] += (
            matching.FIRST_LOOK + matching.SECOND_LOOK
        ) * matching.BATCH  # these periods decide nothing
        self.cells.is_active[rows] = True
        self.course.observe(rows)
        self.course.run()

    def _measure(self) -> None:
        """Write the results that only this system has, such as measures, of motions of a known class.

        If there is no force, all results are converted to units of time.
        """
        explain(self.cells, self.record.definition, self.params)
        measure(self.cells, self.record.definition, self.params)
        measure_energy(self.cells)
        observe(self.cells, self.record.definition, self.params)
        if self.cells.unforced:
            convert_to_time(self.cells, self.variables)

    def _refer(self) -> None:
        """Continue the motions on unknown chaos or tori to collect their statistics.

        A motion that comes to an orbit meanwhile belongs to the orbit.
        """
        arrays = self.cells.results
        before = {name: values.copy() for name, values in arrays.items()}
        new = np.flatnonzero((self.label < 0) & np.isin(self.regime, STATISTICAL))
        for variable in self.variables:
            arrays[variable.name][new] = variable.fill
        self.cells.has_frame[new] = False
        going, means = self.sample(new)
        for name, values in arrays.items():
            values[going] = before[name][going]
        self.reference = dict(zip(going.tolist(), means, strict=True))
