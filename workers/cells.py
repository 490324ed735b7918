"""Cells being solved, many at a time: their motions, what they have used, and the results as arrays."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.exponents import free_exponents, impact_count, sum_law_holds, sum_of_exponents
from workers.kernel.averages import COUNT
from workers.kernel.cells import mean_growth, physical_states, reset_frames, restart_counts
from workers.kernel.motion import (
    LOWER,
    MARCH_GAVE_UP,
    MIN_SPEED,
    NOT_FINITE,
    OUT_OF_WORK,
    RUNNING,
    STATUS,
    STUCK,
    UPPER,
    WORK,
    WORK_OF_A_TRIAL,
    motions_at,
)
from workers.model.oscillator import Oscillator, each
from workers.orbit.newton import no_orbits, settle_each
from workers.results import (
    CHAOTIC,
    COSTLY_PERIOD,
    FAILED,
    GAVE_UP,
    NO_IMPACT,
    NO_REASON,
    PERIODIC,
    QUASIPERIODIC,
    UNDETERMINED,
    WORK_SPENT,
)
from workers.results import NOT_FINITE as NO_LONGER_FINITE
from workers.settings import Settings
from workers.stretch import batch_of, ended, run, without_frames

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
"""Which cells."""
Mask = NDArray[np.bool_]

REASON_OF = {MARCH_GAVE_UP: GAVE_UP, OUT_OF_WORK: COSTLY_PERIOD, NOT_FINITE: NO_LONGER_FINITE}
"""Why a motion cannot go on, by its status."""

CLEAR = 4.0
"""Standard errors above zero from which an exponent is called positive."""

GROWN = 15.0
"""Total log-growth from which a positive exponent counts: a deviation of rounding has become visible."""


class Cells:
    """N cells and where each of them is; its motion, periods and averages are those of the batch.

    framed  whether tangent vectors are carried along; averaging: and their growth counts
    used    periods
    found   result arrays by name (N, ...), written as the cells are done
    """

    def __init__(self, oscillators: Oscillator, settings: Settings, found: dict[str, NDArray[Any]], kept: int) -> None:
        N, n = oscillators.gap_row.shape
        vectors = {"none": 0, "largest": 1, "spectrum": 2 * n}[settings.exponents]
        self.oscillators, self.settings, self.found = oscillators, settings, found
        self.batch = batch_of(oscillators, motions_at(np.zeros((N, n, 2)), vectors=vectors), kept)
        self.bare = without_frames(self.batch)
        self.framed = np.zeros(N, dtype=np.bool_)
        self.averaging = np.zeros(N, dtype=np.bool_)
        self.used = np.zeros(N, dtype=np.int64)
        self.orbits = no_orbits(N, n)

    @property
    def vectors(self) -> int:
        """Tangent vectors of a frame."""
        return self.batch.motions.V.shape[1]

    def aim(self, cells: Rows, periods: NDArray[np.int64] | int) -> None:
        """Give these cells so many periods to go."""
        self.batch.periods[cells], self.batch.done[cells] = periods, 0

    def run(self, cells: Rows) -> Rows:
        """Take these cells on; those that have ended."""
        framed = self.framed[cells]
        for batch, some in ((self.batch, cells[framed]), (self.bare, cells[~framed])):
            run(batch, some, to_end=False)
        through = cells[ended(self.batch)[cells]]
        self.used[through] += self.batch.done[through]
        return through

    def restart(self, cells: Rows) -> None:
        """Count and average from here on."""
        restart_counts(self.oscillators.gap.lam, self.batch.motions, cells)
        self.batch.levels[cells], self.batch.weighted[cells] = 0.0, 0.0

    def kept(self) -> NDArray[np.int64]:
        """How many sections of its stretch are known of each cell."""
        return np.minimum(self.batch.periods, self.batch.sections.shape[1])

    def settle(self, cells: Rows, budget: NDArray[np.int64]) -> Mask:
        """Which of these cells fall into a stable orbit, found within a budget (N,) of periods; see ``orbits``."""
        spent = np.zeros(len(self.used), dtype=np.int64)
        longest = self.settings.max_period
        motions, sections = self.bare.motions, self.batch.sections
        settled: Mask = settle_each(
            self.oscillators, motions, sections, self.kept(), longest, budget, cells, self.orbits, spent
        )
        self.used[cells] += spent[cells]
        return settled

    def growth(self, cells: Rows) -> tuple[Array, Array, Array]:
        """Mean growth per period of the first vector, its standard error, periods averaged."""
        mean, error, count = mean_growth(self.batch.levels, cells)
        return mean, error, count

    # Results

    def put(self, cells: Rows, **values: Any) -> None:
        """Write result variables of these cells, those that are asked for."""
        for name, value in values.items():
            if name in self.found:
                self.found[name][cells] = value

    def put_stopped(self, cells: Rows) -> Mask:
        """Write the results of those cells whose motion cannot go on: failed, or undecided where its work is spent."""
        tally = self.batch.motions.tally[cells]
        status = tally[:, STATUS].astype(np.int64)
        finite = np.isfinite(self.batch.motions.h[cells]).all(axis=(1, 2))
        status[(status == RUNNING) & ~finite] = NOT_FINITE
        broke = (status == RUNNING) & (tally[:, WORK] < 0.0)
        self.put_undecided(cells[broke], WORK_SPENT)
        for code, reason in REASON_OF.items():
            failed = cells[status == code]
            regime = UNDETERMINED if code == OUT_OF_WORK else FAILED
            self.put(failed, regime=regime, periods_used=self.used[failed], reason=reason)
        return np.asarray((status != RUNNING) | broke)

    def put_impact_free(self, cells: Rows, h: Array) -> None:
        """Write the results of cells that move without impact, from block states h on."""
        if not len(cells):
            return
        oscillators = taken(self.oscillators, cells)
        exponents = free_exponents(oscillators)
        total = np.sum(exponents, axis=1)
        steady = np.where((oscillators.trace > 0.0)[:, None, None], 0.0, h)
        self.put(
            cells,
            largest=exponents[:, 0],
            error=np.abs(exponents[:, 0]) * 1e-15,
            spectrum=exponents,
            sum_law_defect=total - sum_of_exponents(oscillators, 0.0),
            regime=NO_IMPACT,
            period=1,
            impacts_per_period=0.0,
            stuck_fraction=0.0,
            periods_used=self.used[cells],
        )
        self.put_states(cells, steady, np.zeros((len(cells), 1), dtype=np.int64), np.ones(len(cells), dtype=np.int64))

    def put_periodic(self, cells: Rows) -> None:
        """Write the results of proved orbits: one turn counts impacts and rest; the exponents are Floquet's."""
        orbits = self.orbits
        self.used[cells] += orbits.period[cells]
        tally, period = orbits.tally[cells], orbits.period[cells]
        sticks = tally[:, STUCK] > 0.0
        hits = impact_count(tally) / period
        free = (hits == 0.0) & ~sticks
        self.put_impact_free(cells[free], orbits.h[cells[free]])
        cells, tally, period, sticks, hits = (x[~free] for x in (cells, tally, period, sticks, hits))
        exponents = orbits.exponents[cells]
        self.put(
            cells,
            largest=exponents[:, 0],
            error=orbits.error[cells],
            spectrum=exponents,
            sum_law_defect=self.defect(cells, np.sum(exponents, axis=1), tally, hits),
            regime=PERIODIC,
            period=period,
            impacts_upper=np.where(sticks, -1.0, tally[:, UPPER]),
            impacts_lower=np.where(sticks, -1.0, tally[:, LOWER]),
            impacts_per_period=np.where(sticks, math.nan, hits),
            symmetric=orbits.symmetric[cells],
            sticks=sticks,
            stuck_fraction=tally[:, STUCK] / (period * self.oscillators.period[cells]),
            min_impact_speed=slowest(tally),
            periods_used=self.used[cells],
        )
        self.put_states(cells, orbits.h[cells], orbits.contact[cells], period)

    def defect(self, cells: Rows, total: Array, tally: Array, hits: Array) -> Array:
        """A sum of exponents minus its exact value; NaN where that law does not hold, see exponents.sum_law_holds."""
        holds = sum_law_holds(tally)
        exact = sum_of_exponents(taken(self.oscillators, cells), hits)
        return np.where(holds, np.where(holds, total, 0.0) - exact, math.nan)

    def put_averaged(self, cells: Rows) -> None:
        """Write what averages show of these cells, their class left open: counts and growth over the same periods."""
        if not len(cells):
            return
        motions = self.batch.motions
        averaged = self.averaging[cells] & (self.batch.levels[cells, 0, COUNT] > 0.0)
        with_growth = cells[averaged] if self.vectors else cells[:0]
        reset_frames(self.oscillators.gap.lam, motions, with_growth)
        if len(with_growth):
            mean, error, count = self.growth(with_growth)
            spectrum = -np.sort(-motions.growth[with_growth] / count[:, None], axis=1)
            average = spectrum if self.settings.exponents == "spectrum" else mean
            self.put(with_growth, largest=mean, error=error, average=average)
            if self.settings.exponents == "spectrum":
                tally = motions.tally[with_growth]
                hits = impact_count(tally) / count
                total = np.sum(motions.growth[with_growth], axis=1) / count
                self.put(with_growth, spectrum=spectrum, sum_law_defect=self.defect(with_growth, total, tally, hits))
        counted = (
            self.batch.levels[cells, 0, COUNT] if self.vectors else self.used[cells] - self.settings.transient_periods
        )
        counts = np.where(self.averaging[cells], counted, 0.0)
        some, counts = cells[counts > 0.0], counts[counts > 0.0]
        tally = motions.tally[some]
        sticks = tally[:, STUCK] > 0.0
        self.put(
            some,
            sticks=sticks,
            stuck_fraction=tally[:, STUCK] / (counts * self.oscillators.period[some]),
            impacts_per_period=np.where(sticks, math.nan, impact_count(tally) / counts),
            min_impact_speed=slowest(tally),
        )
        self.put(cells, periods_used=self.used[cells])
        self.put_states(cells, motions.h[cells], motions.contact[cells], np.zeros(len(cells), dtype=np.int64))

    def put_chaotic(self, cells: Rows) -> None:
        """Write the results of cells whose largest exponent is positive."""
        self.put_averaged(cells)
        self.put(cells, regime=CHAOTIC)

    def put_quasiperiodic(self, cells: Rows, weighted: Array, spread: Array) -> None:
        """Write the results of tori, their largest exponent from weighted averages."""
        self.put_averaged(cells)
        self.put(cells, regime=QUASIPERIODIC, largest=weighted, error=spread)
        if "spectrum" in self.found:
            self.found["spectrum"][cells, 0] = weighted

    def put_undecided(self, cells: Rows, reason: int = NO_REASON) -> None:
        """Write the results of cells whose budget is spent: chaotic with their true error if clear."""
        self.put_averaged(cells)
        chaotic = self.averaging[cells] & clearly_positive(*self.growth(cells))
        self.put(cells[chaotic], regime=CHAOTIC)
        self.put(cells[~chaotic], regime=UNDETERMINED, error=math.nan, reason=reason)

    def put_states(self, cells: Rows, h: Array, contact: Rows, period: Rows) -> None:
        """Write the physical state of these cells, given in blocks, and the sections from it on.

        The next K states, those of an orbit of known ``period`` repeated. NaN from where the motion cannot be followed.
        """
        motions, oscillators = motions_at(h, contact), taken(self.oscillators, cells)
        every = np.arange(len(cells))
        self.put(cells, state=physical_states(oscillators, motions, every))
        K = self.settings.section_samples
        if K == 0:
            return
        batch = batch_of(oscillators, motions)
        counts = np.where(period > 0, np.minimum(period, K), K)
        states = np.full((len(cells), int(np.max(counts, initial=0)), 2 * h.shape[1]), math.nan)
        for k in range(states.shape[1]):
            going = every[(k < counts) & (motions.tally[:, STATUS] == RUNNING)]
            states[going, k] = physical_states(oscillators, motions, going)
            batch.periods[:], batch.done[:], motions.tally[:, WORK] = 1, 0, WORK_OF_A_TRIAL
            run(batch, going)
        self.put(cells, section=states[every[:, None], np.arange(K) % counts[:, None]])


def taken(oscillators: Oscillator, cells: Rows) -> Oscillator:
    """The oscillators of these cells."""
    found: Oscillator = each(oscillators, lambda field: field[cells])
    return found


def clearly_positive(mean: Array, error: Array, count: Array) -> Mask:
    """Which mean growths are certainly positive."""
    return (mean > CLEAR * error) & (mean * count > GROWN)


def slowest(tally: Array) -> Array:
    """Slowest impacts counted; NaN without impacts, 0 where the mass came to rest."""
    return np.where(np.isfinite(tally[:, MIN_SPEED]), tally[:, MIN_SPEED], math.nan)
