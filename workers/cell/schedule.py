"""The adaptive schedule: simulate each cell until its regime is certain, and watch apparent chaos.

A cell goes through the stages searching, warming up, averaging, watching, and averaging again. The simulation is
divided into intervals of forcing periods. At the end of each interval, except while warming up, the solver looks for a
stable periodic orbit and decides the next stage.

``max_periods`` limits the periods spent on deciding the regime, ``survival`` the further periods of watching apparent
chaos. A tenth of ``max_periods`` is reserved for proving an orbit.
"""

import math
from collections.abc import Callable

import numpy as np

from workers.cell import averages, outcome
from workers.cell.averages import clearly_positive, current_average, periods_for, shears
from workers.cell.cell_batch import RETURNS, CellBatch
from workers.cell.exponents import impact_count
from workers.cell.orbits import LONG_PERIOD, NEAR_RETURN, end_on_long_orbits, end_on_orbits, has_coexisting_orbit
from workers.cell.recurrence import Recurrence
from workers.kernel.motion import CONTRACTION
from workers.model.oscillator import COLUMN, Array, Mask, Oscillator, Rows
from workers.orbit.newton import far_from_closing
from workers.results import LOCKING, NO_REASON, NOT_RELAXED, NOT_STATIONARY, RESTED

SEARCHING, WARMING, AVERAGING, WATCHING = range(4)

FIRST_INTERVAL = 32
"""Forcing periods of the first interval; each further interval is as long as all before it."""

MIN_TRANSIENT, RELAXATIONS, MAX_TRANSIENT_SHARE = 256, 3.0, 0.25
"""The transient: minimum number of periods, number of relaxation times, and maximum share of max_periods."""

NEAR_LATER = 1e-3
"""Maximum distance of a state from an earlier one, as NEAR_RETURN, after the first interval. The motion has had time to
come nearer, and chaos often returns within NEAR_RETURN itself, at the cost of a trial each time."""

WARM_UP = 64
"""Number of periods in which tangent vectors align before their growth counts."""

FIRST_AVERAGE = 192
"""Periods averaged before the average is first judged."""

LONG_MEMORY, MIN_SURVIVAL_SHARE = 5.0, 1.0 / 32.0
"""Relaxation time of the energy, in periods, from which on chaos is watched for all of ``survival``; minimum share.

Chaos with a known stable orbit is also watched for all of ``survival``. Otherwise the share is (relaxation /
LONG_MEMORY)^2, at least MIN_SURVIVAL_SHARE. The share of transient chaos falls about like that: measured in 16,000
cells over all parameters."""

MIN_WATCH = 256
"""Minimum number of periods of an interval of watching; each further one is half as long as the survival before it."""

TORUS_LIMIT = 1e-5
"""Largest modulus of a weighted average of growth that counts as zero; two intervals must show it."""

REGULAR_PERIODS = 3000
"""Minimum number of periods of the second of two intervals in each of which tangent vectors of a machine that loses
nothing grow by less than e, so that the motion is regular. Chaos with an exponent above 1 / periods would grow more."""

TORUS_RETURN = 1e-5
"""Minimum distance of the last RETURNS returns on a torus, relative to the motion's scale. With a nearer return the
motion may be an orbit that closes slowly."""


def relaxation_periods(oscillators: Oscillator, rows: Rows, hits: Array, contraction: Array | None = None) -> Array:
    """Return the forcing periods in which the energy of these motions falls by a factor e without the force.

    oscillators  N machines
    rows         rows of the motions
    hits         impacts per period
    contraction  change per period of the logarithm of volume in state space; unused for one rigid contact alone

    1 / (2 eta T + (1 - R^2) hits / 2n): eta of the slowest mode of vibration between impacts; an impact reduces one of
    the 2n squares in the energy, with R > 1 none. The result may be infinite. If a motion grows, eta is the smallest
    rate of growth or decay. For other machines than those with one rigid contact, ``contraction`` shows, in place of R,
    the loss by all contacts and frictions: without impacts at most one square per period.
    """
    period, freedoms = oscillators.period[rows], 2.0 * oscillators.gap_row.shape[1]
    if oscillators.has_modes:
        slowest, events = oscillators.gap.eta[rows, 0], np.where(hits > 0.0, hits, 1.0)
        beyond = 0.0 if contraction is None else np.minimum(contraction + oscillators.trace[rows] * period, 0.0)
        return np.asarray(1.0 / (2.0 * slowest * period - events * np.expm1(beyond / events) / freedoms))
    slow, fast = (np.abs(oscillators.gap.blocks[rows][..., column]) for column in (COLUMN.slow, COLUMN.fast))
    least = np.minimum(*(np.where(rate > 0.0, rate, np.inf) for rate in (slow, fast))).min(axis=-1)
    slowest = np.where(oscillators.growth[rows] > 0.0, least, slow.min(axis=-1))
    lost = np.maximum(1.0 - oscillators.R[rows] ** 2, 0.0)
    return np.asarray(1.0 / (2.0 * slowest * period + lost * hits / freedoms))


def survival_share(relaxation: Array) -> Array:
    """Return the share of ``survival`` periods for which chaos is watched, if no stable orbit is known beside it.

    ``relaxation`` is the number of periods in which energy falls by a factor e.
    """
    return np.clip((relaxation / LONG_MEMORY) ** 2, MIN_SURVIVAL_SHARE, 1.0)


Property = Callable[[Rows], Mask]
"""Predicate on cells: returns the mask of the cells that have a property."""


def none_of(rows: Rows) -> Mask:
    """Return a mask that is False for each of these cells."""
    return np.zeros(len(rows), dtype=np.bool_)


class AdaptiveSchedule:
    """N cells on their way through the stages of the schedule. Each stage is a method, called at an interval's end.

    Watching is simulation without tangent vectors, to see if apparent chaos lasts.

    stage              (N,) SEARCHING, WARMING, AVERAGING or WATCHING
    interval           (N,) length of the next interval: forcing periods until the next decision
    transient_periods  (N,) forcing periods of the transient; NaN until estimated
    watched            (N,) forcing periods spent watching
    weighted           (N,) weighted average of the last interval
    middle, length     (N,) midpoint and length of this interval, in periods
    half               standard error of an average over half of the periods that the tolerance needs
    recurrence         recurrence of the amplitude, see ``Recurrence``

    is_known           predicate on cells at the end of an interval: the motion is recognised, and the cell ends
    must_leave         predicate on cells after their transients: they leave the schedule, to be judged elsewhere
    survival_share_of  function of the relaxation time: share of ``survival`` for which chaos is watched
    """

    def __init__(
        self,
        cells: CellBatch,
        is_known: Property = none_of,
        must_leave: Property = none_of,
        survival_share_of: Callable[[Array], Array] = survival_share,
    ) -> None:
        N = len(cells.periods_used)
        self.cells, self.settings = cells, cells.settings
        self.is_known, self.leaves, self.part = is_known, must_leave, survival_share_of
        self.half = math.sqrt(2.0) * self.settings.tolerance
        self.stage = np.full(N, SEARCHING)
        self.interval = np.full(N, FIRST_INTERVAL)
        self.transient_periods, self.weighted, self.middle, self.length = np.full((4, N), math.nan)
        self.watched = np.zeros(N, dtype=np.int64)
        self.recurrence = Recurrence(N)

    def run(self) -> None:
        """Take the cells that have not ended through their stages, to their results."""
        ready = self.cells.unfinished
        while self.cells.is_active.any():
            self.begin(ready)
            through = self.cells.run(self.cells.unfinished)
            if len(through):
                self.judge(through)
            ready = through[self.cells.is_active[through]]

    def begin(self, ready: Rows) -> None:
        """Begin the next interval of periods of each cell in ``ready``; write its result if no periods are left."""
        ready = outcome.end_impact_free(self.cells, ready)
        length = np.minimum(self.interval[ready], self._left(ready))
        self._end(ready[length <= 0])
        self.cells.set_interval(ready[length > 0], length[length > 0])

    def judge(self, through: Rows) -> None:
        """Decide how each cell in ``through`` continues, since it has reached the end of its interval of periods."""
        cells = self.cells
        rows = outcome.end_stopped(cells, through)
        stage, near = self.stage[rows], np.where(cells.periods_flown <= FIRST_INTERVAL, NEAR_RETURN, NEAR_LATER)
        self.warming(rows[stage == WARMING])
        rows = self.end_on_orbits(rows[stage != WARMING], cells.budget(), near)
        if not len(rows):
            return
        resting = cells.is_at_rest(rows) & (self.stage[rows] != SEARCHING)
        self._end_at_rest(rows[resting])
        rows, stage = rows[~resting], self.stage[rows[~resting]]
        self.recurrence.update(cells, rows, stage != SEARCHING)
        self.searching(rows[stage == SEARCHING])
        self.averaging(rows[stage == AVERAGING])
        self.watching(rows[stage == WATCHING])

    def end_on_orbits(self, rows: Rows, budget: Rows, near: Array) -> Rows:
        """Write the results of cells proved to converge to an orbit; return the cells that continue.

        rows    cells at the end of an interval
        budget  (N,) periods that may be spent on the search for orbits
        near    (N,) distance from a former state, relative to the motion, that counts as a return

        Cells whose motion is recognised end without results. To orbits of machines that lose nothing no motion
        converges.
        """
        known = self.is_known(rows)
        self.cells.is_active[rows[known]] = False
        rows, lossless = rows[~known], self.cells.conservative[rows[~known]]
        others = end_on_orbits(self.cells, rows[~lossless], budget, near)
        return rows[lossless | np.isin(rows, others)]

    def end_on_long_orbits(self, rows: Rows) -> Rows:
        """Write the results of cells proved to converge to a long orbit; return the other cells."""
        return end_on_long_orbits(self.cells, rows)

    def _left(self, rows: Rows) -> Rows:
        """Return the number of periods (rows,) that these cells may still spend in their present stage."""
        decide = self.settings.deciding_periods - (self.cells.periods_used[rows] - self.watched[rows])
        return np.where(self.stage[rows] == WATCHING, self._watchable(rows), decide)

    def _end(self, rows: Rows) -> None:
        """Write the results of cells that have no periods left."""
        unrelaxed = self.cells.first[rows] < self.transient_periods[rows]
        clear = np.where(unrelaxed, np.int8(NOT_RELAXED), np.int8(NO_REASON))
        outcome.put_by_average(self.cells, rows, clear=clear, recurs=self.recurrence.recurred[rows])

    def _end_at_rest(self, rows: Rows) -> None:
        """Write the results of cells whose only mass has rested on a stop: those of an orbit, or of an unknown period.

        Every release starts the same motion, so every disturbance is gone at the next rest.
        """
        cells = self.cells
        rows = self.end_on_long_orbits(rows)
        if cells.vectors:
            averages.lose_all(cells, rows)
        survived = np.maximum(cells.survived_periods(rows) - cells.batch.completed[rows], 0)
        outcome.put_averaged(cells, rows)
        outcome.write_results(cells, rows, regime=LOCKING, reason=RESTED, survived=survived)

    # Searching

    def searching(self, rows: Rows) -> None:
        """Continue the transient of these cells: RELAXATIONS relaxation times, at least MIN_TRANSIENT periods.

        During the transient the motion forgets its initial state. Without loss it never does, and has no transient.
        """
        cells, flown = self.cells, self.cells.periods_flown[rows]
        new = rows[(flown >= MIN_TRANSIENT) & np.isnan(self.transient_periods[rows])]
        tally, periods = cells.batch.motions.tally[new], cells.periods_flown[new]
        hits, contraction = impact_count(tally) / periods, tally[:, CONTRACTION] / periods
        relaxation = relaxation_periods(cells.oscillators, new, hits, contraction)
        self.transient_periods[new] = RELAXATIONS * np.where(cells.conservative[new], 0.0, relaxation)
        most = max(MAX_TRANSIENT_SHARE * self.settings.max_periods, MIN_TRANSIENT)
        transient = np.fmax(np.floor(np.minimum(self.transient_periods[rows], most)), MIN_TRANSIENT)
        self.interval[rows] = np.minimum(flown, np.maximum(transient - flown, 1))
        over = rows[flown >= transient]
        cells.since[over] = cells.periods_flown[over]
        leaves = self.leaves(over)
        cells.is_active[over[leaves]] = False
        self.observe(over[~leaves])

    def observe(self, rows: Rows) -> None:
        """Begin to carry tangent vectors along with these cells, whose transients are over.

        If no exponents are requested, the cells are watched without tangent vectors.
        """
        cells = self.cells
        if cells.vectors:
            averages.restart(cells, rows)
            cells.has_frame[rows] = True
            self.stage[rows], self.interval[rows] = WARMING, WARM_UP
        else:
            averages.begin(cells, rows)
            self._watch(rows, self._missing(rows))

    # Warming

    def warming(self, rows: Rows) -> None:
        """Begin an average of the growth of these cells' tangent vectors, which have aligned by now.

        A second average is as long as the first one should have been.
        """
        cells = self.cells
        if not len(rows):
            return
        averages.begin(cells, rows)
        self.stage[rows], self.weighted[rows] = AVERAGING, math.nan
        earlier = cells.previous_average.periods[rows]
        needed = periods_for(earlier, cells.previous_average.error[rows], self.half)
        self.interval[rows] = np.maximum(np.minimum(needed, 2.0 * earlier), FIRST_AVERAGE)

    # Averaging

    def averaging(self, rows: Rows) -> None:
        """Decide how these cells go on by the averaged growth of their tangent vectors.

        Clearly positive growth, known to half of the requested accuracy (in periods), counts as chaotic so far. Zero
        growth in two intervals is a torus. With clearly negative growth a long orbit is sought.
        """
        second = self.cells.previous_average.periods[rows] > 0.0
        self._judge_first(rows[~second])
        self._judge_second(rows[second])

    def _judge_first(self, rows: Rows) -> None:
        """Decide how cells go on after a look at their first average: they are averaged further, end, or are watched.

        A cell is called chaotic if its growth is clearly positive and accurate, or if half of the budget is spent.
        """
        now = current_average(self.cells, rows)
        positive = clearly_positive(now.mean, now.error, now.periods)
        half_spent = self.cells.periods_used[rows] - self.watched[rows] >= self.settings.deciding_periods // 2
        chaotic = positive & self.recurrence.recurred[rows] & ((now.error <= self.half) | half_spent)
        missing = np.where(positive, periods_for(now.periods, now.error, self.half) - now.periods, math.inf)
        self._average_on(rows[~chaotic], missing[~chaotic])
        self._find_order(rows[~chaotic])
        self._close(rows[chaotic])

    def _judge_second(self, rows: Rows) -> None:
        """Decide how cells go on after a look at their second average: they are averaged further, or end.

        Both averages together must reach the requested accuracy unless they differ, and chaos must have survived. A
        positive exponent must be clearly positive.
        """
        (combined, _), error = averages.combined_average(self.cells, rows), current_average(self.cells, rows).error
        least = np.where(combined.mean > 0.0, combined.mean / averages.CLEAR, math.inf)
        accuracy = np.minimum(self.settings.tolerance, least)
        changed = averages.has_changed(self.cells, rows)
        precise = (changed | (combined.error <= accuracy)) & (error <= 2.0 * self.half) & self.recurrence.recurred[rows]
        watch = self._to_watch(rows)
        enough = (precise & (watch <= 0)) | (self._left(rows) <= 0)
        missing = periods_for(combined.periods, combined.error, accuracy) - combined.periods
        self._average_on(rows[~enough], np.maximum(missing, watch)[~enough])
        self._end(rows[enough & ~changed])
        self._restart_changed(rows[enough & changed])

    def _average_on(self, rows: Rows, missing: Array) -> None:
        """Set the next interval of cells whose average lacks ``missing`` periods: no longer than the average so far."""
        longest = self.cells.periods_flown[rows] - self.cells.began[rows]
        self.interval[rows] = np.minimum(longest, np.maximum(1.05 * missing, WARM_UP))

    def _restart_changed(self, rows: Rows) -> None:
        """Drop the earlier average of cells whose motion has changed since then, and decide how they go on."""
        cells = self.cells
        before, now = cells.previous_average.mean[rows], current_average(cells, rows)
        averages.restart_first(cells, rows)
        positive, out = clearly_positive(now.mean, now.error, now.periods), self._left(rows) <= 0
        outcome.put_by_average(cells, rows[out], clear=NOT_STATIONARY)
        uncertain = out & positive
        outcome.write_results(cells, rows[uncertain], error=np.maximum(now.error, np.abs(now.mean - before))[uncertain])
        chaotic = rows[~out & positive]
        cells.since[chaotic] = cells.began[chaotic]
        self._close(chaotic)
        self.interval[rows[~out & ~positive]] = now.periods[~out & ~positive]

    def _close(self, rows: Rows) -> None:
        """End the average of these cells and watch them; begin the next average at once if no watching is needed."""
        averages.close(self.cells, rows)
        missing = self._missing(rows)
        self.warming(rows[missing <= 0])  # the frame is unchanged
        rows, missing = rows[missing > 0], missing[missing > 0]
        self.cells.has_frame[rows], self.cells.averaging[rows] = False, False
        self._watch(rows, missing)

    def _find_order(self, rows: Rows) -> None:
        """Write the results of tori, of regular motion and, if the exponent is clearly negative, of long orbits."""
        cells, batch = self.cells, self.cells.batch
        previous, now = self.weighted[rows], batch.weighted[rows, 0] / batch.weighted[rows, 1]
        middle = cells.periods_flown[rows] - 0.5 * batch.periods[rows]
        linear = shears(previous, now, middle - self.middle[rows])
        grown = np.maximum(np.abs(previous) * self.length[rows], np.abs(now) * batch.periods[rows])
        bounded = cells.conservative[rows] & (grown < 1.0) & (batch.periods[rows] >= REGULAR_PERIODS)
        self.weighted[rows], self.middle[rows], self.length[rows] = now, middle, batch.periods[rows]
        spread = np.where(linear, now, np.abs(now - previous))
        flat = (np.maximum(np.abs(previous), np.abs(now)) < TORUS_LIMIT) & ~(now < -10.0 * spread)
        error = np.where(flat | linear, np.maximum(np.abs(now), spread), 1.0 / batch.periods[rows])
        flat = (flat | linear | bounded) & self.recurrence.same[rows] & self.recurrence.strikes[rows]
        lossless = cells.conservative[rows]
        outcome.put_regular(cells, rows[flat & lossless], error[flat & lossless])
        rows, now, spread, flat = rows[~lossless], now[~lossless], spread[~lossless], flat[~lossless]
        flat[flat] = self.never_closes(rows[flat])
        outcome.put_quasiperiodic(cells, rows[flat], now[flat], spread[flat])
        rows, now = rows[~flat], now[~flat]
        mean, error, periods, _, _ = current_average(cells, rows)
        late = (batch.periods[rows] >= LONG_PERIOD) & (now < -TORUS_LIMIT)
        self.end_on_long_orbits(rows[clearly_positive(-mean, error, periods) | late])

    def never_closes(self, rows: Rows) -> Mask:
        """Return the mask of cells that have not returned to their present state in RETURNS periods."""
        cells = self.cells
        blocks, h = cells.oscillators.gap.blocks, cells.batch.motions.h
        return np.asarray(far_from_closing(blocks, h, cells.batch.sections, rows, RETURNS, TORUS_RETURN))

    # Watching

    def watching(self, rows: Rows) -> None:
        """Continue apparent chaos without tangent vectors for most of its watch, then average once more.

        Equal averages are combined. Otherwise the motion has changed, and the later average replaces the earlier one.
        Without exponents the cell is aperiodic at the end.
        """
        self.watched[rows] += self.cells.batch.completed[rows]
        missing = self._missing(rows)
        self._watch(rows[missing > 0], missing[missing > 0])
        if self.cells.vectors:
            self.observe(rows[missing <= 0])
        else:
            rows = rows[missing <= 0]
            recurs = self.recurrence.recurred[rows]
            outcome.put_chaotic(self.cells, rows[recurs])
            self._end(rows[~recurs])

    def _watchable(self, rows: Rows) -> Rows:
        """Return the periods for which these cells may still be watched.

        They are what is left of ``survival`` and of the whole budget, which proofs of orbits use too.
        """
        return np.minimum(self.settings.survival - self.watched[rows], self.cells.budget()[rows])

    def _to_watch(self, rows: Rows) -> Rows:
        """Return the periods for which these cells must still be watched to count as chaotic, within ``survival``."""
        part = self.part(self.transient_periods[rows] / RELAXATIONS)
        part[has_coexisting_orbit(self.cells, rows)] = 1.0
        required = (part * self.settings.survival).astype(np.int64)
        return np.minimum(required - self.cells.survived_periods(rows), self._watchable(rows))

    def _missing(self, rows: Rows) -> Rows:
        """Return the periods for which these cells are to be watched until the last average begins.

        That average is as long as the earlier one and belongs to the watch.
        """
        return self._to_watch(rows) - self.cells.previous_average.periods[rows].astype(np.int64)

    def _watch(self, rows: Rows, missing: Rows) -> None:
        """Watch these cells for an interval of the ``missing`` periods, in which a long orbit can return."""
        least = max(MIN_WATCH, self.settings.max_period + 1)
        self.stage[rows] = WATCHING
        self.interval[rows] = np.maximum(np.minimum(self.cells.survived_periods(rows) // 2, missing), least)
