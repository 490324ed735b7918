"""Cells in progress, many at a time: motions, budgets, results so far."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.cell.stretch import batch_of, begin, ended, run
from workers.kernel.motion import LOST, NOTHING_COUNTED, WORK
from workers.model.oscillator import Array, Mask, Oscillator, Reasons, Rows, at_rows
from workers.orbit.newton import no_orbits
from workers.results import INVALID, NO_REASON
from workers.settings import Settings

Results = dict[str, NDArray[Any]]
"""Result arrays (N, ...) by name."""

RETURNS = 64
"""Least number of returns of a motion known of each cell, for any ``max_period``."""

FAR = 1e6
"""Size of a growing motion from which on it counts as unbounded, relative to its start, its forced motion and the
stops, which are negligible then."""

STEPS, SAME_STEP = 16, 1e-7
"""Periods over which a runaway motion gains speed in equal steps; the relative deviation of these steps, and their
least share of the sum."""

ONCE_ROUND, SAME_CYCLE = 1e-8, 1e-6
"""Largest distances, relative to the motion: of a state on a cycle from its image once round, and of a motion on the
cycle; of states, and of periods, of one cycle solved twice."""

WORK_PER_PERIOD, LEAST_WORK = 200, 1_000_000
"""Evaluations allowed to a cell per period of its budget, and the least for all together. Ordinary cells take 5 to 40 a
period; R near 1 can take 10^5, and a cell must not cost minutes."""


def work_allowed(periods: int) -> int:
    """Evaluations allowed to a cell over its budget of periods."""
    return max(WORK_PER_PERIOD * periods, LEAST_WORK)


class Average(NamedTuple):
    """An average of N cells.

    mean, error  (N,) growth of the first tangent vector per period, and its standard error
    periods      (N,) averaged; growth (N, m) sums of all vectors, impacts (N,), over the same periods
    """

    mean: Array
    error: Array
    periods: Array
    growth: Array
    impacts: Array


def energy_norms(metric: Array, h: Array) -> Array:
    """Energy norms (...) of block states (..., n, 2), the metric (..., n)."""
    return np.asarray(np.sqrt(np.sum(metric * h[..., 0] ** 2 + h[..., 1] ** 2, axis=-1)))


def sizes(oscillators: Oscillator, h: Array) -> Array:
    """Energy norms (N,) of block states h (N, n, 2) plus those of forced motion and displacements to stops."""
    own, n, metric = oscillators, h.shape[1], oscillators.gap.metric
    rows, stops, _ = own.contacts
    reach = np.max(np.where(np.isfinite(stops), np.abs(stops), 0.0), axis=-1)
    x = rows * (reach / np.maximum(np.vecdot(rows, rows), 1e-300))[..., None]
    there = (own.to_blocks[:, None, :, :n] @ x[..., None]).reshape(*x.shape[:2], n, 2)
    at_stops = np.sum(energy_norms(metric[:, None], there), axis=1)
    return energy_norms(metric, h) + energy_norms(metric, own.gap.swing) + at_stops


class CellCycle(NamedTuple):
    """A cycle of a machine without a force.

    Its period; its states (p, 2n) at its rarest event; and its states (m, 2n) just after each of its events, with the
    numbers (m,) of its modes from there on.
    """

    period: float
    section: Array
    events: Array
    numbers: NDArray[np.int64]

    def passes(self, states: Array, numbers: NDArray[np.int64]) -> bool:
        """Whether a motion in these states (K, 2n) just after events, in modes (K,) from there on, is on the cycle."""
        near = self._away(states[:, None]) <= ONCE_ROUND
        return bool(np.any(near & (numbers[:, None] == self.numbers)))

    def is_through(self, state: Array, period: float) -> bool:
        """Whether this is the cycle of a period through a state (2n,) just after an event: the same set of states."""
        return bool(self._away(state).min() <= SAME_CYCLE and abs(period - self.period) <= SAME_CYCLE * self.period)

    def _away(self, states: Array) -> Array:
        """Distances (..., m) of states (..., 2n) from the states after its events, relative to the cycle's size."""
        x, v = np.split(np.abs(self.events), 2, axis=1)
        omega = 2.0 * np.pi / self.period
        size = max(x.max(), v.max() / omega)
        x, v = np.split(np.abs(states - self.events), 2, axis=-1)
        return np.asarray(np.maximum(x.max(axis=-1), v.max(axis=-1) / omega) / size)


class Cells:
    """N cells and the stage of each; the batch has their motions and the periods of the current stretch.

    Cells without a reason against their oscillator begin at physical section states ``starts`` (N, 2n); cells without a
    motion are written invalid at once. contact (N,) is the contact of motions that continue from these states; without
    it the state decides.

    going      true if the cell has not ended
    framed     true if tangent vectors are carried along; averaging: and their growth counts
    used       periods spent on the cell
    flown      periods of its motion; since: periods before it looked chaotic, began: before the current average and
               counts, first: before the first average that counts
    earlier    the average before the current one; of no periods if there is none
    tallied    (N, TALLIES) counts between ``first`` and ``began``
    directions of the state, 2n; drifts: 1 if one of them is a coordinate that may drift, which has no exponent;
               vectors: number of tangent vectors
    results    arrays, written when cells end; contact (N,): of the ``state`` among them
    orbits     of the cells that were proved to converge to one
    unforced   true for machines without a force, whose periods are natural ones; cycles: the proved cycle of each
    far        energy norm from which on a growing motion counts as unbounded; infinite for others
    """

    def __init__(
        self,
        oscillators: Oscillator,
        reasons: Reasons,
        starts: Array,
        settings: Settings,
        results: Results,
        mode: Rows | None = None,
        unforced: bool = False,
    ) -> None:
        N, n = oscillators.gap_row.shape
        adaptive = settings.method == "adaptive"
        kept = max(settings.max_period, RETURNS if adaptive else 0) + 1
        self.directions = 2 * n
        self.drifts = oscillators.drifts
        one = 2 if unforced else 1  # without a force one exponent is 0
        self.vectors = {"none": 0, "largest": one, "spectrum": 2 * n - self.drifts}[settings.exponents]
        self.unforced, self.cycles = unforced, dict[int, CellCycle]()
        self.oscillators, self.settings, self.results = oscillators, settings, results
        motions, reasons = begin(oscillators, reasons, starts, mode, self.vectors)
        self.batch = batch_of(oscillators, motions, kept)
        without_frames = motions._replace(V=np.zeros((N, 0, n, 2)), growth=np.zeros((N, 0)))
        self.bare = self.batch._replace(motions=without_frames)
        invalid = reasons != NO_REASON
        results["regime"][invalid], results["reason"][invalid] = INVALID, reasons[invalid]
        self.going = ~invalid
        budgets = (settings.max_periods, settings.survival), (settings.transient_periods, settings.periods)
        motions.tally[:, WORK] = work_allowed(sum(budgets[0 if adaptive else 1]))
        self.framed, self.averaging = np.zeros((2, N), dtype=np.bool_)
        self.used, self.flown, self.since, self.began, self.first, self.mode = np.zeros((6, N), dtype=np.int64)
        self.orbits = no_orbits(N, n)
        self.far = np.full(N, np.inf)
        grows = np.flatnonzero(oscillators.growth > 0.0)
        self.far[grows] = FAR * sizes(at_rows(oscillators, grows), motions.h[grows]) if len(grows) else 0.0
        self.earlier = Average(np.zeros(N), np.zeros(N), np.zeros(N), np.zeros((N, self.vectors)), np.zeros(N))
        self.tallied = np.tile(NOTHING_COUNTED, (N, 1))

    @property
    def ready(self) -> Rows:
        """The cells that have not ended."""
        return np.flatnonzero(self.going)

    def aim(self, rows: Rows, periods: Rows | int) -> None:
        """Give these cells a stretch of this many periods."""
        self.batch.periods[rows], self.batch.done[rows] = periods, 0

    def run(self, rows: Rows, *, to_end: bool = False) -> Rows:
        """Advance these cells, ``to_end`` until the end of each stretch; returns the cells that have reached it."""
        framed = self.framed[rows]
        for batch, some in ((self.batch, rows[framed]), (self.bare, rows[~framed])):
            run(batch, some, to_end=to_end)
        through = rows[ended(self.batch)[rows]]
        self.used[through] += self.batch.done[through]
        self.flown[through] += self.batch.done[through]
        return through

    def kept(self) -> Rows:
        """Number of known sections of each cell's stretch."""
        return np.minimum(self.batch.periods, self.batch.sections.shape[1])

    def survived(self, rows: Rows) -> Rows:
        """Periods for which these cells have looked chaotic."""
        return self.flown[rows] - self.since[rows]

    def run_away(self, rows: Rows) -> Mask:
        """Mask of cells whose drift gains the same speed in each period.

        Without damping the momentum of the drift changes only by load, force and friction.
        """
        sections, kept = self.batch.sections, self.kept()[rows]
        if not self.drifts or sections.shape[1] <= STEPS:
            return np.zeros(len(rows), dtype=np.bool_)
        momentum = sections[rows, -STEPS - 1 :, -1, 0]
        steps, last = np.diff(momentum, axis=1), momentum[:, -1]
        low, high = np.min(np.abs(steps), axis=1), np.max(np.abs(steps), axis=1)
        away = np.all(steps * last[:, None] > 0.0, axis=1) & (low > SAME_STEP * np.abs(last))
        return np.asarray((kept > STEPS) & away & (high - low <= SAME_STEP * high))

    def fly_off(self, rows: Rows) -> Mask:
        """Mask of cells that move on by the same step in each period, at one velocity, with no stop ahead.

        What moves is free: it has no stiffness, and nothing else changes from section to section.
        """
        (contacts, stops, _), n = self.oscillators.contacts, self.oscillators.gap_row.shape[1]
        free = self.oscillators.gap.lam[rows] == 0.0
        off = (self.kept()[rows] > STEPS) & np.any(np.isinf(stops[rows]), axis=(1, 2)) & np.any(free, axis=1)
        rows, free, candidates = rows[off], free[off], np.flatnonzero(off)
        if not len(rows):
            return off
        steps = np.diff(self.batch.sections[rows, -STEPS - 1 :], axis=1)
        least_step = np.where(free, np.abs(steps[..., 0]).min(axis=1), 0.0)  # (K, n)
        uneven = np.where(free, np.ptp(steps[..., 0], axis=1), np.abs(steps[..., 0]).max(axis=1))
        turned = np.abs(steps[..., 1]).max(axis=1) * self.oscillators.period[rows, None]
        along = self.oscillators.to_physical[rows, :n] @ steps[:, -1].reshape(len(rows), 2 * n, 1)
        y = (contacts[rows] @ along)[..., 0]
        ahead = np.where(y > 0.0, stops[rows, :, 1], stops[rows, :, 0])
        size = SAME_STEP * least_step.max(axis=1)
        clear = np.all(np.isinf(ahead) | (np.abs(y) <= size[:, None]), axis=1) & (np.abs(y).max(axis=1) > size)
        off[candidates] = clear & (np.maximum(uneven, turned).max(axis=1) <= size) & (size > 0.0)
        return off

    def are_far(self, rows: Rows) -> Mask:
        """Mask of cells that move so far that nothing seems to hold them, also beyond the range of doubles."""
        far = np.isfinite(self.far[rows])
        some = rows[far]
        size = energy_norms(self.oscillators.gap.metric[some], self.batch.motions.h[some])
        far[far] = ~(size <= self.far[some])
        return np.asarray(far)

    def budget(self) -> Rows:
        """Periods that may still be spent on each cell."""
        return self.settings.max_periods + self.settings.survival - self.used

    def at_rest(self, rows: Rows) -> Mask:
        """Mask of cells that have lost all directions, since their only mass has rested."""
        lost = np.maximum(self.tallied[rows, LOST], self.batch.motions.tally[rows, LOST])
        return np.asarray(lost >= self.directions)
