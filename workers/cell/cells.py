"""Cells being solved, many at a time: their motions, what they have used, and what was averaged of them."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.cell.stretch import batch_of, ended, run, without_frames
from workers.kernel.cells import mean_growth, reset_frames, restart_counts
from workers.kernel.motion import LOST, MAX_SPEED, MIN_SPEED, TALLIES, motions_at
from workers.model.oscillator import COLUMN, Oscillator, taken
from workers.orbit.newton import no_orbits, settle_each
from workers.orbit.rest import rest_to_rest
from workers.settings import Settings

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
"""Which cells."""
Mask = NDArray[np.bool_]

CLEAR = 4.0
"""Standard errors above zero from which an exponent is called positive."""

GROWN = 15.0
"""Total log-growth from which a positive exponent counts: a deviation of rounding has become visible."""

NEAR = 1e-2
"""Distance of a return, relative to the motion's scale, from which on it may be one to a stable orbit."""

RETURNS = 64
"""Returns of a motion that are known of each cell at least, whatever ``max_period``."""

LONG_PERIOD, LONG_AT_ONCE = 1000, 64
"""Longest orbit looked for where an average says that there is one; cells whose sections are kept for that together."""


class Average(NamedTuple):
    """What was averaged of N cells: mean growth of the first vector and its standard error (N,), over ``periods`` (N,).

    growth (N, m) sums of all vectors, tally (N, TALLIES) counts over the same periods. apart (N,): the standard error
    by the difference of the two averages that it consists of, 0 where it is one: far apart in time, each may
    be too short to see how slowly the motion changes.
    """

    mean: Array
    error: Array
    periods: Array
    growth: Array
    tally: Array
    apart: Array

    @property
    def deviation(self) -> Array:
        """The error that results give: the larger of both."""
        return np.maximum(self.error, self.apart)


class Cells:
    """N cells and where each of them is; its motion, periods and averages are those of the batch.

    framed     whether tangent vectors are carried along; averaging: and their growth counts
    used       periods that the cell has cost
    flown      periods that its motion has gone through; since: how many of them before it looked chaotic
    earlier    the average that was closed before the one under way; of no periods where there is none
    tallied    (N, TALLIES) what was counted before the counts under way began; counted: over so many periods
    found      result arrays by name (N, ...), written as the cells are done; contact (N,) that of their ``state``
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
        self.flown = np.zeros(N, dtype=np.int64)
        self.since = np.zeros(N, dtype=np.int64)
        self.contact = np.zeros(N, dtype=np.int64)
        self.orbits = no_orbits(N, n)
        self.earlier = Average(
            np.zeros(N), np.zeros(N), np.zeros(N), np.zeros((N, vectors)), np.zeros((N, TALLIES)), np.zeros(N)
        )
        self.tallied = np.zeros((N, TALLIES))
        self.counted = np.zeros(N, dtype=np.int64)
        self._restarted = np.zeros(N, dtype=np.int64)
        self.forget_counts(np.arange(N))

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
        self.flown[through] += self.batch.done[through]
        return through

    def restart(self, cells: Rows) -> None:
        """Average from here on, and count on."""
        self.tallied[cells], self.counted[cells] = self.counts(cells)
        self._restarted[cells] = self.flown[cells]
        restart_counts(self.oscillators.gap.metric, self.batch.motions, cells)
        self.batch.levels[cells], self.batch.weighted[cells] = 0.0, 0.0

    def counts(self, cells: Rows) -> tuple[Array, Rows]:
        """What was counted of these cells since forget_counts, (cells, TALLIES), and over how many periods."""
        under_way = self.flown[cells] - self._restarted[cells]
        return together(self.tallied[cells], self.batch.motions.tally[cells]), self.counted[cells] + under_way

    def forget_counts(self, cells: Rows) -> None:
        """Forget what was counted before the counts under way."""
        self.tallied[cells], self.tallied[cells, MIN_SPEED], self.counted[cells] = 0.0, np.inf, 0

    def at_rest(self, cells: Rows) -> Mask:
        """Of which of these cells no direction is left, since their one mass has rested; see ``counts``."""
        found: Mask = self.counts(cells)[0][:, LOST] >= self._directions
        return found

    @property
    def _directions(self) -> int:
        return 2 * self.batch.motions.h.shape[1]

    # Orbits

    def kept(self) -> NDArray[np.int64]:
        """How many sections of its stretch are known of each cell."""
        return np.minimum(self.batch.periods, self.batch.sections.shape[1])

    def settle(self, cells: Rows, budget: NDArray[np.int64], near: Array) -> Mask:
        """Which of these cells fall into a stable orbit, found within a budget (N,) of periods; see ``orbits``.

        One is looked for where the motion has returned within ``near`` (N,) of its scale.
        """
        spent = np.zeros(len(self.used), dtype=np.int64)
        longest = self.settings.max_period
        motions, sections = self.bare.motions, self.batch.sections
        settled: Mask = settle_each(
            self.oscillators, motions, sections, self.kept(), near, longest, budget, cells, self.orbits, spent
        )
        self.used[cells] += spent[cells]
        return settled

    def settle_long(self, cells: Rows, budget: NDArray[np.int64]) -> Mask:
        """As ``settle``, for orbits of up to LONG_PERIOD periods: the motions go on by as many to see them close.

        Cells whose budget (N,) does not allow for that are not tried.
        """
        settled = np.zeros(len(cells), dtype=np.bool_)
        tried = np.flatnonzero(budget[cells] > LONG_PERIOD + 1)
        for first in range(0, len(tried), LONG_AT_ONCE):
            some = tried[first : first + LONG_AT_ONCE]
            settled[some] = self._settle_long(cells[some], budget)
        return settled

    def _settle_long(self, cells: Rows, budget: NDArray[np.int64]) -> Mask:
        """Motions at rest are looked at after a rest, where rounding has grown least."""
        batch = batch_of(taken(self.oscillators, cells), taken(self.bare.motions, cells), LONG_PERIOD + 1)
        batch.periods[:] = LONG_PERIOD + 1
        resting = self.at_rest(cells)
        every, spent, kept = np.arange(len(cells)), np.zeros(len(cells), dtype=np.int64), batch.done.copy()
        run(batch, every[~resting])
        kept[batch.done == batch.periods] = LONG_PERIOD + 1
        gone = rest_to_rest(batch.oscillators, batch.motions, every[resting], batch.sections, kept)
        through = every[kept > 0]
        orbits = no_orbits(len(cells), batch.motions.h.shape[1])
        settled = np.zeros(len(cells), dtype=np.bool_)
        settled[through] = settle_each(
            batch.oscillators, batch.motions, batch.sections, kept, np.full(len(cells), NEAR), LONG_PERIOD,
            budget[cells] - batch.done - gone, through, orbits, spent,
        )  # fmt: skip
        self.used[cells] += batch.done + gone + spent
        for mine, theirs in zip(self.orbits, orbits, strict=True):
            mine[cells[settled]] = theirs[settled]
        self.orbits.near[cells] |= orbits.near
        return settled

    def has_coexisting_orbit(self, cells: Rows) -> Mask:
        """Of which of these cells a stable orbit is known beside the motion.

        Where |Y| stays inside the stops, every mode is damped and no load moves a rigid one, motion without impact is
        one. Another is an orbit that a near return led to, and that the motion left again. One mass that a stop
        can hold at some phase of the force has another: what follows a release repeats with the next rest.
        """
        gap, oscillators = self.oscillators.gap, self.oscillators
        reach = np.minimum(oscillators.b_upper, oscillators.b_lower)[cells]
        block = gap.blocks[cells]
        damped = np.all((block[..., COLUMN.eta] > 0.0) & (block[..., COLUMN.load] == 0.0), axis=-1)
        found: Mask = self.orbits.near[cells] | (damped & (np.asarray(gap.amplitude)[cells] < reach))
        return found | ((self._directions == 2) & self._can_rest(cells))

    def _can_rest(self, cells: Rows) -> Mask:
        """Of which of these cells the load presses the mass on a stop at some phase of the force."""
        held, o = self.oscillators.held, self.oscillators
        load, push = np.asarray(held.mode.amplitude)[cells], held.push[cells]
        upper = np.isfinite(np.asarray(o.b_upper)[cells]) & (load + push[:, 0] > 0.0)
        lower = np.isfinite(np.asarray(o.b_lower)[cells]) & (load - push[:, 1] > 0.0)
        pressed: Mask = (upper | lower) & (np.asarray(o.R)[cells] < 1.0)
        return pressed

    # Averages

    def growth(self, cells: Rows) -> tuple[Array, Array, Array]:
        """Mean growth per period of the first vector, its standard error, periods averaged; of the average under way.

        None is under way where growth does not count. Where no direction is left the mean is exact.
        """
        mean, error, count = mean_growth(self.batch.levels, cells)
        nothing = self.batch.motions.tally[cells, LOST] >= self._directions
        mean, error = np.where(nothing, -np.inf, mean), np.where(nothing, 0.0, error)
        count = count if self.vectors else self.flown[cells] - self.since[cells]
        return mean, error, np.where(self.averaging[cells], count, 0.0)

    def close(self, cells: Rows) -> None:
        """Keep the average under way as the earlier one, in its place."""
        reset_frames(self.oscillators.gap.metric, self.batch.motions, cells)
        e, motions = self.earlier, self.batch.motions
        e.mean[cells], e.error[cells], e.periods[cells] = self.growth(cells)
        e.growth[cells], e.tally[cells] = motions.growth[cells], motions.tally[cells]

    def forget(self, cells: Rows) -> None:
        """Take the earlier average of these cells for none."""
        for field in self.earlier:
            field[cells] = 0.0
        self.forget_counts(cells)

    def lose_all(self, cells: Rows) -> None:
        """Take the averages of these cells for what follows when no direction is left: -inf, all of them."""
        self.close(cells[self.averaging[cells] & (self.earlier.periods[cells] == 0.0)])
        self.averaging[cells] = False
        self.earlier.mean[cells], self.earlier.error[cells], self.earlier.growth[cells] = -np.inf, 0.0, -np.inf

    def whole_average(self, cells: Rows) -> Average:
        """The earlier average of these cells and the one under way as one."""
        mean, error, count = self.growth(cells)
        e, motions = taken(self.earlier, cells), self.batch.motions
        under_way = (count > 0.0) & (np.isfinite(error) | (e.periods == 0.0))  # or too short to have an error
        count = np.where(under_way, count, 0.0)
        mean, error = np.where(under_way, mean, 0.0), np.where(under_way, error, 0.0)
        total = e.periods + count
        growth = np.where(under_way[:, None], motions.growth[cells], 0.0) + e.growth
        tally = together(np.where(under_way[:, None], motions.tally[cells], 0.0), e.tally)
        both = (count > 0.0) & (e.periods > 0.0)
        return Average(
            mean=(e.mean * e.periods + mean * count) / total,
            error=np.hypot(e.error * e.periods, error * count) / total,
            periods=total,
            growth=growth,
            tally=tally,
            apart=np.where(both, np.abs(mean - e.mean) * np.sqrt(count * e.periods) / total, 0.0),
        )


def together(tally: Array, more: Array) -> Array:
    """The counts (N, TALLIES) of two stretches of motion as one."""
    both = tally + more
    both[:, MIN_SPEED] = np.minimum(tally[:, MIN_SPEED], more[:, MIN_SPEED])
    both[:, MAX_SPEED] = np.maximum(tally[:, MAX_SPEED], more[:, MAX_SPEED])
    both[:, LOST] = np.maximum(tally[:, LOST], more[:, LOST])
    return both


def clearly_positive(mean: Array, error: Array, count: Array) -> Mask:
    """Which mean growths are certainly positive."""
    return (mean > CLEAR * error) & (mean * count > GROWN)
