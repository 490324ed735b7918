"""Cells in progress, many at a time: motions, budgets, results so far."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.cell.interval import batch_of, begin, has_ended, run
from workers.kernel.motion import LOST, NOTHING_COUNTED, WORK
from workers.model.hybrid_machines import loses_nothing
from workers.model.oscillator import Array, Mask, Oscillator, Reasons, Rows, at_rows
from workers.orbit.newton import no_orbits
from workers.results import INVALID, NO_REASON
from workers.settings import Settings

Results = dict[str, NDArray[Any]]
"""Result arrays (N, ...) by name."""

RETURNS = 64
"""Minimum number of returns of a motion that are known for each cell, for any ``max_period``."""

FAR = 1e6
"""Size from which on a growing motion counts as unbounded, relative to its start, its forced motion and the stops,
which are negligible then."""

STEPS, SAME_STEP = 16, 1e-7
"""Number of periods over which a runaway motion gains speed in equal steps; maximum relative deviation of these steps,
and their minimum share of the sum."""

CLOSING_DISTANCE, SAME_CYCLE = 1e-8, 1e-6
"""Maximum distances, relative to the motion. CLOSING_DISTANCE: of a state on a cycle from its image after one turn, and
of a motion on the cycle. SAME_CYCLE: of states, and of periods, of one cycle solved twice."""

UNDAMPED = 1e-14
"""Damping of a mode of vibration, as a share of the highest frequency, that is due to rounding in gyroscopic machines.
"""

WORK_PER_PERIOD, MIN_WORK = 200, 1_000_000
"""Number of evaluations allowed to a cell per period of its budget, and minimum for all periods together.

Ordinary cells take 5 to 40 evaluations a period. R near 1 can take 10^5, and a cell must not cost minutes."""


def work_allowed(periods: int) -> int:
    """Return the number of evaluations allowed to a cell over its budget of periods."""
    return max(WORK_PER_PERIOD * periods, MIN_WORK)


class GrowthAverage(NamedTuple):
    """An average of N cells.

    mean, error  (N,) growth of the first tangent vector per period, and its standard error
    periods      (N,) periods averaged
    growth       (N, m) sums of the growth of all vectors over these periods
    impacts      (N,) impacts over these periods
    """

    mean: Array
    error: Array
    periods: Array
    growth: Array
    impacts: Array


def energy_norms(metric: Array, h: Array) -> Array:
    """Return the energy norms (...) of block states (..., n, 2) with metric (..., n)."""
    return np.asarray(np.sqrt(np.sum(metric * h[..., 0] ** 2 + h[..., 1] ** 2, axis=-1)))


def sizes(oscillators: Oscillator, h: Array) -> Array:
    """Return the sum (N,) of energy norms of block states h (N, n, 2), forced motion and displacements to stops."""
    n, metric = h.shape[1], oscillators.gap.metric
    rows, stops, _ = oscillators.contacts
    reach = np.max(np.where(np.isfinite(stops), np.abs(stops), 0.0), axis=-1)
    x = rows * (reach / np.maximum(np.vecdot(rows, rows), 1e-300))[..., None]
    stop_states = (oscillators.to_blocks[:, None, :, :n] @ x[..., None]).reshape(*x.shape[:2], n, 2)
    at_stops = np.sum(energy_norms(metric[:, None], stop_states), axis=1)
    return energy_norms(metric, h) + energy_norms(metric, oscillators.gap.swing) + at_stops


def is_conservative(oscillators: Oscillator) -> Mask:
    """Return the mask (N,) of machines that lose nothing: R = 1, no friction, and no damping beyond rounding."""
    if oscillators.has_modes:
        return loses_nothing(oscillators.table.machines)
    eta, lam = np.abs(oscillators.gap.eta), np.abs(oscillators.gap.lam)
    undamped = eta <= UNDAMPED * np.sqrt(np.max(lam, axis=-1, keepdims=True))
    return np.asarray((oscillators.R == 1.0) & np.all(undamped, axis=-1))


class CellCycle(NamedTuple):
    """A cycle of a machine without a force.

    period   period of the cycle
    section  (p, 2n) states at its rarest event
    events   (m, 2n) states just after each of its events
    numbers  (m,) numbers of its modes from there on
    """

    period: float
    section: Array
    events: Array
    numbers: NDArray[np.int64]

    def contains_states(self, states: Array, numbers: NDArray[np.int64]) -> bool:
        """Return True if a motion is on the cycle.

        ``states`` (K, 2n) are those just after its events, ``numbers`` (K,) its modes from there on.
        """
        near = self._away(states[:, None]) <= CLOSING_DISTANCE
        return bool(np.any(near & (numbers[:, None] == self.numbers)))

    def is_through(self, state: Array, period: float) -> bool:
        """Return True if this is the cycle of a period through a state (2n,) just after an event."""
        return bool(self._away(state).min() <= SAME_CYCLE and abs(period - self.period) <= SAME_CYCLE * self.period)

    def _away(self, states: Array) -> Array:
        """Return the distances (..., m) of states (..., 2n) from the states after events, as shares of the size."""
        x, v = np.split(np.abs(self.events), 2, axis=1)
        omega = 2.0 * np.pi / self.period
        size = max(x.max(), v.max() / omega)
        x, v = np.split(np.abs(states - self.events), 2, axis=-1)
        return np.asarray(np.maximum(x.max(axis=-1), v.max(axis=-1) / omega) / size)


class CellBatch:
    """N cells and the stage of each; ``batch`` has their motions and the periods of the current interval.

    Cells without a reason against their oscillator begin at physical section states ``starts`` (N, 2n). Cells without a
    motion are written invalid at once. The argument ``mode`` (N,) has the modes of motions that continue from these
    states; without it the state decides.

    is_active         (N,) True if the cell has not ended
    has_frame         (N,) True if tangent vectors are carried along
    averaging         (N,) True if their growth counts
    periods_used      (N,) periods spent on the cell
    periods_flown     (N,) periods of its motion
    since             (N,) periods before it looked chaotic
    began             (N,) periods before the current average and counts
    first             (N,) periods before the first average that counts
    previous_average  average before the current one; of 0 periods if there is no such average
    tallied           (N, TALLIES) counts between ``first`` and ``began``
    directions        number of directions of the state, 2n
    drifts            1 if one of them is a coordinate that may drift, which has no exponent
    vectors           number of tangent vectors
    results           result arrays, written when cells end
    mode              (N,) number of the mode of the ``state`` in the results
    orbits            orbits of the cells that were proved to converge to one
    unforced          True for machines without a force, whose periods are natural periods
    cycles            proved cycles by row
    conservative      (N,) True for machines that lose nothing, in which no motion attracts
    starts            (N, 2n) physical states at the beginning
    far_norm          (N,) energy norm from which on a growing motion counts as unbounded; infinite for other motions
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
        n_sections = max(settings.max_period, RETURNS if adaptive else 0) + 1
        self.directions = 2 * n
        self.drifts = oscillators.drifts
        one = 2 if unforced else 1  # without a force one exponent is 0
        self.vectors = {"none": 0, "largest": one, "spectrum": 2 * n - self.drifts}[settings.exponents]
        self.unforced, self.cycles, self.starts = unforced, dict[int, CellCycle](), starts
        self.oscillators, self.settings, self.results = oscillators, settings, results
        self.conservative = is_conservative(oscillators)
        motions, reasons = begin(oscillators, reasons, starts, mode, self.vectors)
        self.batch = batch_of(oscillators, motions, n_sections)
        without_frames = motions._replace(V=np.zeros((N, 0, n, 2)), growth=np.zeros((N, 0)))
        self.bare = self.batch._replace(motions=without_frames)
        invalid = reasons != NO_REASON
        results["regime"][invalid], results["reason"][invalid] = INVALID, reasons[invalid]
        self.is_active = ~invalid
        budgets = (settings.max_periods, settings.survival), (settings.transient_periods, settings.periods)
        motions.tally[:, WORK] = work_allowed(sum(budgets[0 if adaptive else 1]))
        self.has_frame, self.averaging = np.zeros((2, N), dtype=np.bool_)
        self.periods_used, self.periods_flown, self.since, self.began, self.first, self.mode = np.zeros(
            (6, N), dtype=np.int64
        )
        self.orbits = no_orbits(N, n)
        self.far_norm = np.full(N, np.inf)
        grows = np.flatnonzero(oscillators.growth > 0.0)
        self.far_norm[grows] = FAR * sizes(at_rows(oscillators, grows), motions.h[grows]) if len(grows) else 0.0
        self.previous_average = GrowthAverage(
            np.zeros(N), np.zeros(N), np.zeros(N), np.zeros((N, self.vectors)), np.zeros(N)
        )
        self.tallied = np.tile(NOTHING_COUNTED, (N, 1))

    @property
    def unfinished(self) -> Rows:
        """Rows of the cells that have not ended."""
        return np.flatnonzero(self.is_active)

    def set_interval(self, rows: Rows, periods: Rows | int) -> None:
        """Give these cells an interval of this number of periods."""
        self.batch.periods[rows], self.batch.completed[rows] = periods, 0

    def run(self, rows: Rows, *, to_end: bool = False) -> Rows:
        """Advance these cells; return the cells that have reached the end of their intervals.

        With ``to_end`` all cells are advanced to the end.
        """
        framed = self.has_frame[rows]
        for batch, some in ((self.batch, rows[framed]), (self.bare, rows[~framed])):
            run(batch, some, to_end=to_end)
        through = rows[has_ended(self.batch)[rows]]
        self.periods_used[through] += self.batch.completed[through]
        self.periods_flown[through] += self.batch.completed[through]
        return through

    def known_section_count(self) -> Rows:
        """Return the number of known sections of each cell's interval."""
        return np.minimum(self.batch.periods, self.batch.sections.shape[1])

    def known_sections(self, r: int) -> Array:
        """Return the known sections (K, n, 2) of a cell's interval, as block states."""
        sections = self.batch.sections[r]
        return sections[len(sections) - int(self.known_section_count()[r]) :]

    def known_states(self, r: int) -> Array:
        """Return the known sections (K, 2n) of a cell's interval, as physical states."""
        return np.asarray(self.known_sections(r).reshape(-1, self.directions) @ self.oscillators.to_physical[r].T)

    def survived_periods(self, rows: Rows) -> Rows:
        """Return the number of periods for which these cells have looked chaotic."""
        return self.periods_flown[rows] - self.since[rows]

    def is_running_away(self, rows: Rows) -> Mask:
        """Return the mask of cells whose drift gains the same speed in each period.

        Without damping the momentum of the drift changes only by load, force and friction.
        """
        sections, counts = self.batch.sections, self.known_section_count()[rows]
        if not self.drifts or sections.shape[1] <= STEPS:
            return np.zeros(len(rows), dtype=np.bool_)
        momentum = sections[rows, -STEPS - 1 :, -1, 0]
        steps, last = np.diff(momentum, axis=1), momentum[:, -1]
        low, high = np.min(np.abs(steps), axis=1), np.max(np.abs(steps), axis=1)
        away = np.all(steps * last[:, None] > 0.0, axis=1) & (low > SAME_STEP * np.abs(last))
        return np.asarray((counts > STEPS) & away & (high - low <= SAME_STEP * high))

    def fly_off(self, rows: Rows) -> Mask:
        """Return the mask of cells that move by the same step in each period, at one velocity, with no stop ahead.

        The moving part is free: it has no stiffness, and nothing else changes from section to section.
        """
        (contacts, stops, _), n = self.oscillators.contacts, self.oscillators.gap_row.shape[1]
        free = self.oscillators.gap.lam[rows] == 0.0
        off = (
            (self.known_section_count()[rows] > STEPS)
            & np.any(np.isinf(stops[rows]), axis=(1, 2))
            & np.any(free, axis=1)
        )
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
        """Return the mask of cells that move so far that nothing seems to limit them, also beyond doubles."""
        far = np.isfinite(self.far_norm[rows])
        some = rows[far]
        size = energy_norms(self.oscillators.gap.metric[some], self.batch.motions.h[some])
        far[far] = ~(size <= self.far_norm[some])
        return np.asarray(far)

    def budget(self) -> Rows:
        """Return the number of periods that may still be spent on each cell."""
        return self.settings.max_periods + self.settings.survival - self.periods_used

    def is_at_rest(self, rows: Rows) -> Mask:
        """Return the mask of cells that have lost all directions, since their only mass has rested."""
        lost = np.maximum(self.tallied[rows, LOST], self.batch.motions.tally[rows, LOST])
        return np.asarray(lost >= self.directions)
