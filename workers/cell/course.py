"""The adaptive schedule: each cell is followed until its class is certain, and what looks chaotic is watched.

A cell goes through stages. In each it looks for a stable orbit at the end of every stretch of periods.

SEARCHING  Its motion forgets where it began: some relaxation times, at least LEAST_TRANSIENT periods.
WARMING    Tangent vectors turn into the right directions.
AVERAGING  Their growth is averaged. Clearly positive, and known to half of the accuracy that is asked for (in periods):
           chaotic so far. Zero on two stretches: a torus. Clearly negative: a long orbit is sought.
WATCHING   What looks chaotic goes on without tangent vectors for most of the time that it has to survive.
           Then it is averaged again: where the two averages agree they are one, otherwise the motion has changed, and
           the later one takes the place of the earlier.

``max_periods`` bounds what decides the class; a cell that looks chaotic may cost ``survival`` periods more. A tenth of
max_periods is kept for the proof of an orbit.
"""

import math

import numpy as np

from workers.cell.cells import CLEAR, LONG_PERIOD, NEAR, RETURNS, Array, Cells, Mask, Rows, clearly_positive
from workers.cell.exponents import impact_count
from workers.cell.outcome import (
    put,
    put_aperiodic,
    put_chaotic,
    put_impact_free,
    put_periodic,
    put_quasiperiodic,
    put_resting,
    put_stopped,
    put_undecided,
)
from workers.kernel.cells import impact_free
from workers.model.oscillator import COLUMN, Oscillator
from workers.orbit.newton import far_from_closing
from workers.results import NO_REASON, NOT_RELAXED, NOT_STATIONARY

SEARCHING, WARMING, AVERAGING, WATCHING = range(4)

FIRST_STRETCH = 32
"""Periods before a cell is first looked at; each further stretch is as long as all before it."""

LEAST_TRANSIENT, RELAXATIONS, LARGEST_SHARE = 256, 3.0, 0.25
"""The transient: so many periods at least, so many relaxation times, but not more than this share of max_periods."""

NEAR_LATER = 1e-3
"""NEAR after the first stretch: by then motion has had time to come nearer, and chaos often returns within NEAR itself,
where each try costs."""

WARM_UP = 64
"""Periods in which the tangent frame turns into the right directions before its growth counts."""

FIRST_AVERAGE = 192
"""Periods averaged before the average is first looked at."""

FARTHEST = 1e9
"""From so many times the tolerance on it does not matter how far off the error is: no budget has the periods."""

LONG_MEMORY, LEAST_PART = 5.0, 1.0 / 32.0
"""Chaos has to survive for all of ``survival`` beside a stable orbit that is known, and where its energy relaxes in so
many periods or more. Elsewhere for a part that falls as the square of that time, but for the second part at least: that
is about how the share of chaos that settles falls, which scripts/bench_relaxation.py measures."""

LEAST_WATCH = 256
"""Periods of the shortest stretch of watching; each further one is half as long as what was survived before."""

CHANGED = 3.0
"""Standard errors by which two averages of one motion do not differ."""

TORUS_LIMIT = 1e-5
"""Largest modulus of the weighted averages of two stretches that counts as an exponent zero."""

TORUS_RETURN = 1e-5
"""Nearest of the last RETURNS returns, relative to the motion's scale, that may be an orbit closing slowly."""


def solve_adaptively(cells: Cells, ready: Rows) -> None:
    """Take these cells through their stages and write their results."""
    Course(cells).take(ready)


def relaxation_periods(oscillators: Oscillator, rows: Rows, hits: Array) -> Array:
    """Forcing periods in which the energy of these motions falls by a factor e, without the force.

    1 / (2 eta T + (1 - R^2) hits / 2n): eta of the slowest mode between impacts; hits, the impacts per period, take
    their part of one of the 2n squares that the energy is a sum of. May be infinite.
    """
    slowest = oscillators.gap.blocks[rows][..., COLUMN.slow].min(axis=-1)
    freedoms = 2.0 * oscillators.gap_row.shape[1]
    rate = 2.0 * slowest * oscillators.period[rows] + (1.0 - oscillators.R[rows] ** 2) * hits / freedoms
    return np.asarray(1.0 / rate)


def part_to_survive(relaxation: Array) -> Array:
    """The part of ``survival`` for which chaos of these relaxation times is watched, beside no orbit that is known."""
    return np.clip((relaxation / LONG_MEMORY) ** 2, LEAST_PART, 1.0)


class Course:
    """Where the cells are on their course.

    One that knows more of them than their motions can say which of them are done: see ``recognise`` and ``leaves``.

    stage      of each cell; stretch: periods that it is to go next
    memory     periods that its transient should take, NaN until known; transient: those that it takes
    began      periods that its motion had gone through when the average under way began; first: when the first of
               those began that count
    watched    periods of watching
    weighted   the weighted average of its last stretch
    """

    def __init__(self, cells: Cells) -> None:
        N = len(cells.used)
        self.cells, self.settings = cells, cells.settings
        self.stage = np.full(N, SEARCHING)
        self.stretch = np.full(N, FIRST_STRETCH)
        self.memory = np.full(N, math.nan)
        self.transient = np.full(N, LEAST_TRANSIENT)
        self.began = np.zeros(N, dtype=np.int64)
        self.first = np.zeros(N, dtype=np.int64)
        self.watched = np.zeros(N, dtype=np.int64)
        self.weighted = np.full(N, math.nan)

    def take(self, ready: Rows) -> None:
        """Take these cells through their stages and write their results."""
        waiting = np.zeros(len(self.cells.used), dtype=np.bool_)
        while len(ready) or waiting.any():
            waiting[self.begin(ready)] = True
            through = self.cells.run(np.flatnonzero(waiting))
            waiting[through] = False
            ready = self.look(through)

    def recognise(self, rows: Rows) -> Rows:
        """Those of these cells, at the end of a stretch, that go on: here all of them."""
        return rows

    def leaves(self, rows: Rows) -> Mask:
        """Which of these cells, whose transients are over, do not go on: here none of them."""
        return np.zeros(len(rows), dtype=np.bool_)

    def begin(self, ready: Rows) -> Rows:
        """Give each cell its next stretch; those that have one."""
        cells = self.cells
        free = impact_free(cells.oscillators, cells.batch.motions, ready)
        put_impact_free(cells, ready[free], cells.batch.motions.h[ready[free]])
        ready = ready[~free]
        length = np.minimum(self.stretch[ready], self._left(ready))
        self._finish(ready[length <= 0])
        ready, length = ready[length > 0], length[length > 0]
        cells.aim(ready, length)
        return ready

    def look(self, through: Rows) -> Rows:
        """See what the stretch has shown of each cell; those that have to go on."""
        cells = self.cells
        watching = through[self.stage[through] == WATCHING]
        self.watched[watching] += cells.batch.done[watching]
        through = through[~put_stopped(cells, through)]
        warm = self.stage[through] == WARMING
        self._average(through[warm])
        rest = self.recognise(through[~warm])
        near = np.where(cells.flown <= FIRST_STRETCH, NEAR, NEAR_LATER)
        settled = cells.settle(rest, self.settings.max_periods + self.settings.survival - cells.used, near)
        put_periodic(cells, rest[settled])
        rest = rest[~settled]
        resting = cells.at_rest(rest) & (self.stage[rest] != SEARCHING)
        self._end_at_rest(rest[resting])
        rest = rest[~resting]
        searching, averaging, watching = (rest[self.stage[rest] == s] for s in (SEARCHING, AVERAGING, WATCHING))
        going = self._search_on(searching)
        return np.concatenate([through[warm], going, self._judge(averaging), self._watch_on(watching)])

    def _left(self, rows: Rows) -> Rows:
        """Periods that these cells' motions may still go in the stage they are in."""
        decide = self.settings.deciding_periods - (self.cells.used[rows] - self.watched[rows])
        return np.where(self.stage[rows] == WATCHING, self._watchable(rows), decide)

    def _watchable(self, rows: Rows) -> Rows:
        """Periods for which these cells may still be watched: what proofs have taken of both budgets is gone."""
        left = self.settings.max_periods + self.settings.survival - self.cells.used[rows]
        return np.minimum(self.settings.survival - self.watched[rows], left)

    def _finish(self, rows: Rows) -> None:
        """Write what is known of cells that do not go on."""
        average = self.cells.whole_average(rows)
        clear = clearly_positive(average.mean, average.deviation, average.periods)
        relaxed = ~(self.first[rows] < self.memory[rows])
        put_chaotic(self.cells, rows[clear], np.where(relaxed[clear], NO_REASON, NOT_RELAXED))
        put_undecided(self.cells, rows[~clear])

    # Searching

    def _search_on(self, rows: Rows) -> Rows:
        """Go on, or warm up where the motion has forgotten where it began; those that have to go on."""
        cells = self.cells
        flown = cells.flown[rows]
        new = rows[(flown >= LEAST_TRANSIENT) & np.isnan(self.memory[rows])]
        hits = impact_count(cells.batch.motions.tally[new]) / cells.flown[new]
        self.memory[new] = RELAXATIONS * relaxation_periods(cells.oscillators, new, hits)
        most = max(LARGEST_SHARE * self.settings.max_periods, LEAST_TRANSIENT)
        self.transient[new] = np.clip(self.memory[new], LEAST_TRANSIENT, most)
        self.stretch[rows] = np.minimum(flown, np.maximum(self.transient[rows] - flown, 1))
        over = flown >= self.transient[rows]
        cells.since[rows[over]] = cells.flown[rows[over]]
        left = over.copy()
        left[over] = self.leaves(rows[over])
        self.observe(rows[over & ~left])
        return rows[~left]

    def observe(self, rows: Rows) -> None:
        """Average these cells from here on, whose transients are over, or watch them where there are no exponents."""
        cells = self.cells
        if cells.vectors:
            self._warm_up(rows)
        else:
            cells.restart(rows)
            cells.forget_counts(rows)
            cells.averaging[rows] = True
            self.stage[rows] = WATCHING
            self._aim_watch(rows)

    # Watching

    def _required(self, rows: Rows) -> Rows:
        """Periods that chaos in these cells has to survive."""
        part = part_to_survive(self.memory[rows] / RELAXATIONS)
        part[self.cells.has_coexisting_orbit(rows)] = 1.0
        return (part * self.settings.survival).astype(np.int64)

    def _to_watch(self, rows: Rows) -> Rows:
        """Periods for which these cells are still to be watched, so far as ``survival`` allows."""
        missing = self._required(rows) - (self.cells.flown[rows] - self.cells.since[rows])
        return np.minimum(missing, self._watchable(rows))

    def _missing(self, rows: Rows) -> Rows:
        """Periods for which these cells are still to be watched before an average as long as the last one."""
        return self._to_watch(rows) - self.cells.earlier.periods[rows].astype(np.int64)

    def _aim_watch(self, rows: Rows) -> None:
        """The next stretch of watching: long enough for a long orbit to return in it."""
        survived = self.cells.flown[rows] - self.cells.since[rows]
        least = max(LEAST_WATCH, self.settings.max_period + 1)
        self.stretch[rows] = np.maximum(np.minimum(survived // 2, self._missing(rows)), least)

    def _watch(self, rows: Rows) -> None:
        """Close the average of these cells and watch them, or go on to the next average if there is no need to."""
        self.cells.close(rows)
        missing = self._missing(rows) > 0
        self._average(rows[~missing])  # the frame is as it was
        rest = rows[missing]
        self.cells.framed[rest], self.cells.averaging[rest], self.stage[rest] = False, False, WATCHING
        self._aim_watch(rest)

    def _watch_on(self, rows: Rows) -> Rows:
        """Watch on or average again; those that have to go on."""
        missing = self._missing(rows) > 0
        self._aim_watch(rows[missing])
        if self.cells.vectors:
            self._warm_up(rows[~missing])
            return rows
        put_aperiodic(self.cells, rows[~missing])
        return rows[missing]

    def _end_at_rest(self, rows: Rows) -> None:
        """Write the results of cells whose one mass has rested: those of its orbit, or that it is not chaotic."""
        cells = self.cells
        settled = cells.settle_long(rows, self.settings.max_periods + self.settings.survival - cells.used)
        put_periodic(cells, rows[settled])
        rows = rows[~settled]
        survived = cells.flown[rows] - cells.batch.done[rows] - cells.since[rows]
        put_resting(cells, rows, np.maximum(survived, 0))

    # Averaging

    def _warm_up(self, rows: Rows) -> None:
        self.cells.restart(rows)
        self.cells.framed[rows] = True
        self.stage[rows], self.stretch[rows] = WARMING, WARM_UP

    def _average(self, rows: Rows) -> None:
        """Growth counts from here on; a second average is to be as long as the first should have been."""
        cells = self.cells
        cells.restart(rows)
        cells.averaging[rows] = True
        self.stage[rows], self.began[rows], self.weighted[rows] = AVERAGING, cells.flown[rows], math.nan
        alone = rows[cells.earlier.periods[rows] == 0.0]
        self.first[alone] = cells.flown[alone]
        cells.forget_counts(alone)
        wanted = _periods_for(cells.earlier.periods[rows], cells.earlier.error[rows], self._half)
        self.stretch[rows] = np.maximum(np.minimum(wanted, 2.0 * cells.earlier.periods[rows]), FIRST_AVERAGE)

    @property
    def _half(self) -> float:
        """Standard error of an average over half of the periods that the tolerance takes."""
        return math.sqrt(2.0) * self.settings.tolerance

    def _judge(self, rows: Rows) -> Rows:
        """What the average under way shows of these cells; those that have to go on."""
        second = self.cells.earlier.periods[rows] > 0.0
        return np.concatenate([self._judge_first(rows[~second]), self._judge_second(rows[second])])

    def _judge_first(self, rows: Rows) -> Rows:
        """Half of the accuracy, in periods, is enough to call a cell chaotic; so is half of the budget."""
        cells = self.cells
        mean, error, count = cells.growth(rows)
        positive = clearly_positive(mean, error, count)
        half_spent = cells.used[rows] - self.watched[rows] >= self.settings.deciding_periods // 2
        chaotic = positive & ((error <= self._half) | half_spent)
        self._watch(rows[chaotic])
        missing = np.where(positive, _periods_for(count, error, self._half) - count, math.inf)
        self._average_on(rows[~chaotic], missing[~chaotic])
        return np.concatenate([rows[chaotic], self._find_order(rows[~chaotic])])

    def _judge_second(self, rows: Rows) -> Rows:
        """Both averages together are to have the accuracy asked for unless they differ, and chaos to have survived.

        What is positive is to be clearly so.
        """
        whole = self.cells.whole_average(rows)
        _, error, _ = self.cells.growth(rows)
        least = np.where(whole.mean > 0.0, whole.mean / CLEAR, math.inf)
        accuracy = np.minimum(self.settings.tolerance, least)
        wanted = _periods_for(whole.periods, whole.deviation, accuracy) - whole.periods
        watch = self._to_watch(rows)
        precise = (self._changed(rows) | (whole.deviation <= accuracy)) & (error <= 2.0 * self._half)
        enough = (precise & (watch <= 0)) | (self._left(rows) <= 0)
        self._average_on(rows[~enough], np.maximum(wanted, watch)[~enough])
        return np.concatenate([rows[~enough], self._compare(rows[enough])])

    def _average_on(self, rows: Rows, missing: Array) -> None:
        """The next stretch of an average that takes so many periods more: at most as long as what there is of it."""
        longest = self.cells.flown[rows] - self.began[rows]
        self.stretch[rows] = np.minimum(longest, np.maximum(1.05 * missing, WARM_UP))

    def _compare(self, rows: Rows) -> Rows:
        """Finish cells whose two averages agree; where motion has changed the later one counts. Those that go on."""
        cells = self.cells
        changed = self._changed(rows)
        self._finish(rows[~changed])
        rows = rows[changed]
        before, (mean, error, count) = cells.earlier.mean[rows], cells.growth(rows)
        cells.forget(rows)
        self.first[rows] = self.began[rows]
        out = self._left(rows) <= 0
        positive = clearly_positive(mean, error, count)
        put_undecided(cells, rows[out & ~positive])
        uncertain = out & positive
        put_chaotic(cells, rows[uncertain], NOT_STATIONARY)
        put(cells, rows[uncertain], error=np.maximum(error, np.abs(mean - before))[uncertain])
        again = rows[~out & positive]
        cells.since[again] = self.began[again]
        self._watch(again)
        self.stretch[rows[~out & ~positive]] = count[~out & ~positive]
        return rows[~out]

    def _changed(self, rows: Rows) -> Mask:
        """Of which of these cells the two averages differ."""
        mean, error, _ = self.cells.growth(rows)
        before, deviation = self.cells.earlier.mean[rows], self.cells.earlier.error[rows]
        found: Mask = np.abs(mean - before) > CHANGED * np.hypot(error, deviation)
        return found

    def _find_order(self, rows: Rows) -> Rows:
        """Look for tori and, where the exponent is clearly negative, for long orbits; those that have to go on."""
        cells = self.cells
        previous = self.weighted[rows]
        now = cells.batch.weighted[rows, 0] / cells.batch.weighted[rows, 1]
        self.weighted[rows] = now
        spread = np.abs(now - previous)
        flat = (np.maximum(np.abs(previous), np.abs(now)) < TORUS_LIMIT) & ~(now < -10.0 * spread)
        flat[flat] = far_from_closing(
            cells.oscillators.gap.metric, cells.oscillators.swing, cells.batch.motions.h, cells.batch.sections,
            rows[flat], RETURNS, TORUS_RETURN,
        )  # fmt: skip
        put_quasiperiodic(cells, rows[flat], now[flat], spread[flat])
        rows = rows[~flat]
        mean, error, count = cells.growth(rows)
        late = (cells.batch.periods[rows] >= LONG_PERIOD) & (now[~flat] < -TORUS_LIMIT)
        negative = rows[clearly_positive(-mean, error, count) | late]
        settled = cells.settle_long(negative, self.settings.max_periods + self.settings.survival - cells.used)
        put_periodic(cells, negative[settled])
        return np.setdiff1d(rows, negative[settled], assume_unique=True)


def _periods_for(count: Array, error: Array, wanted: Array | float) -> Array:
    """Periods that an average takes whose error is that over ``count`` periods, until it is as small as wanted."""
    return np.asarray(count * np.minimum(error / wanted, FARTHEST) ** 2)
