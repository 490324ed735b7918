"""Cells being solved, many at a time: their motions, what they have used, and what was averaged of them."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.kernel.cells import mean_growth, reset_frames, restart_counts
from workers.kernel.motion import MAX_SPEED, MIN_SPEED, TALLIES, motions_at
from workers.model.oscillator import COLUMN, Oscillator, taken
from workers.orbit.newton import no_orbits, settle_each
from workers.settings import Settings
from workers.stretch import batch_of, ended, run, without_frames

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

    growth (N, m) sums of all vectors, tally (N, TALLIES) counts over the same periods.
    """

    mean: Array
    error: Array
    periods: Array
    growth: Array
    tally: Array


class Cells:
    """N cells and where each of them is; its motion, periods and averages are those of the batch.

    framed     whether tangent vectors are carried along; averaging: and their growth counts
    used       periods that the cell has cost
    flown      periods that its motion has gone through; since: how many of them before it looked chaotic
    earlier    the average that was closed before the one under way; of no periods where there is none
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
        self.earlier = Average(np.zeros(N), np.zeros(N), np.zeros(N), np.zeros((N, vectors)), np.zeros((N, TALLIES)))

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
        """Count and average from here on."""
        restart_counts(self.oscillators.gap.metric, self.batch.motions, cells)
        self.batch.levels[cells], self.batch.weighted[cells] = 0.0, 0.0

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
        motions = taken(self.bare.motions, cells)
        batch = batch_of(taken(self.oscillators, cells), motions, LONG_PERIOD + 1)
        batch.periods[:] = LONG_PERIOD + 1
        every, spent = np.arange(len(cells)), np.zeros(len(cells), dtype=np.int64)
        run(batch, every)
        orbits = no_orbits(len(cells), motions.h.shape[1])
        through = every[batch.done == batch.periods]
        settled = np.zeros(len(cells), dtype=np.bool_)
        near = np.full(len(cells), NEAR)
        settled[through] = settle_each(
            batch.oscillators, batch.motions, batch.sections, batch.done, near, LONG_PERIOD,
            budget[cells] - batch.done, through, orbits, spent,
        )  # fmt: skip
        self.used[cells] += batch.done + spent
        for mine, theirs in zip(self.orbits, orbits, strict=True):
            mine[cells[settled]] = theirs[settled]
        self.orbits.near[cells] |= orbits.near
        return settled

    def has_rival(self, cells: Rows) -> Mask:
        """Of which of these cells a stable orbit is known beside the motion.

        Where |Y| stays inside the stops, every mode is damped and no load moves a rigid one, motion without impact is
        one. Another is an orbit that a near return led to, and that the motion left again.
        """
        gap, oscillators = self.oscillators.gap, self.oscillators
        reach = np.minimum(oscillators.b_upper, oscillators.b_lower)[cells]
        block = gap.block[cells]
        damped = np.all((block[..., COLUMN.eta] > 0.0) & (block[..., COLUMN.load] == 0.0), axis=-1)
        found: Mask = self.orbits.near[cells] | (damped & (np.asarray(gap.amplitude)[cells] < reach))
        return found

    # Averages

    def growth(self, cells: Rows) -> tuple[Array, Array, Array]:
        """Mean growth per period of the first vector, its standard error, periods averaged; of the average under way.

        None is under way where growth does not count.
        """
        mean, error, count = mean_growth(self.batch.levels, cells)
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

    def whole_average(self, cells: Rows) -> Average:
        """The earlier average of these cells and the one under way as one."""
        mean, error, count = self.growth(cells)
        e, motions = taken(self.earlier, cells), self.batch.motions
        under_way = (count > 0.0) & (np.isfinite(error) | (e.periods == 0.0))  # or too short to have an error
        count = np.where(under_way, count, 0.0)
        mean, error = np.where(under_way, mean, 0.0), np.where(under_way, error, 0.0)
        total = e.periods + count
        growth = np.where(under_way[:, None], motions.growth[cells], 0.0) + e.growth
        tally = np.where(under_way[:, None], motions.tally[cells], 0.0) + e.tally
        slowest = np.where(under_way, motions.tally[cells, MIN_SPEED], np.inf)
        tally[:, MIN_SPEED] = np.minimum(slowest, np.where(e.periods > 0.0, e.tally[:, MIN_SPEED], np.inf))
        fastest = np.where(under_way, motions.tally[cells, MAX_SPEED], 0.0)
        tally[:, MAX_SPEED] = np.maximum(fastest, e.tally[:, MAX_SPEED])
        return Average(
            mean=(e.mean * e.periods + mean * count) / total,
            error=np.hypot(e.error * e.periods, error * count) / total,
            periods=total,
            growth=growth,
            tally=tally,
        )


def clearly_positive(mean: Array, error: Array, count: Array) -> Mask:
    """Which mean growths are certainly positive."""
    return (mean > CLEAR * error) & (mean * count > GROWN)
