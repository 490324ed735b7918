"""Cells in progress, many at a time: motions, budgets, results so far."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from workers.cell.interval import batch_of, begin, has_ended, run
from workers.kernel.motion import LOST, NOTHING_COUNTED, WORK
from workers.model.machines import feeds, loses_nothing
from workers.model.oscillator import Array, Mask, Oscillator, Reasons, Rows, at_rows
from workers.orbit.newton import no_orbits
from workers.results import INVALID, NO_REASON
from workers.settings import Settings

Results = dict[str, NDArray[Any]]
"""Result arrays (N, ...) by name."""

RETURNS = 64
"""Minimum number of states at sections t = k T that are stored of each motion, for any ``max_period``."""

FAR = 1e6
"""Size from which on a growing motion counts as unbounded, relative to its start, its forced motion and the stops,
which are negligible then."""

STEPS, SAME_STEP = 16, 1e-7
"""Number of periods over which a runaway motion gains speed in equal steps; maximum relative deviation of these steps,
and their minimum share of the sum."""

CLOSING_DISTANCE, SAME_CYCLE = 1e-8, 1e-6
"""Maximum distances, relative to the motion. CLOSING_DISTANCE: from a state on a cycle to its image after one turn, and
from a motion to the cycle that it is on. SAME_CYCLE: between states, and between periods, of one cycle solved twice."""

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
    """Averages over the motions of N cells: growth of their tangent vectors, and impacts.

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
    """Return the energy norms (...) of states (..., n, 2) of decoupled equations; ``metric`` (..., n) weights h^2."""
    return np.asarray(np.sqrt(np.sum(metric * h[..., 0] ** 2 + h[..., 1] ** 2, axis=-1)))


def sizes(oscillators: Oscillator, h: Array) -> Array:
    """Return the sizes (N,) of motions, each a sum of energy norms.

    The sum is that of the states h (N, n, 2) of decoupled equations, of forced motion, and of displacements to the
    stops.
    """
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
    """A limit cycle, a periodic motion of its own length, of a machine without a force.

    period   period of the cycle
    section  (p, 2n) states at the passages of its rarest event
    events   (m, 2n) states just after each of its events
    numbers  (m,) numbers of the modes after the events; a mode is a set of linear equations between two events
    """

    period: float
    section: Array
    events: Array
    numbers: NDArray[np.int64]

    def contains_states(self, states: Array, numbers: NDArray[np.int64]) -> bool:
        """Return True if a motion is on the cycle: one of its states after events is a state of the cycle.

        states   (K, 2n) states of the motion just after its events
        numbers  (K,) numbers of its modes, sets of linear equations, after these events
        """
        near = self._away(states[:, None]) <= CLOSING_DISTANCE
        return bool(np.any(near & (numbers[:, None] == self.numbers)))

    def is_through(self, state: Array, period: float) -> bool:
        """Return True if a cycle of this period through a state (2n,), just after an event, is this cycle."""
        return bool(self._away(state).min() <= SAME_CYCLE and abs(period - self.period) <= SAME_CYCLE * self.period)

    def _away(self, states: Array) -> Array:
        """Return the distances (..., m) of states (..., 2n) from the cycle, at its states after events, per size."""
        x, v = np.split(np.abs(self.events), 2, axis=1)
        omega = 2.0 * np.pi / self.period
        size = max(x.max(), v.max() / omega)
        x, v = np.split(np.abs(states - self.events), 2, axis=-1)
        return np.asarray(np.maximum(x.max(axis=-1), v.max(axis=-1) / omega) / size)


class CellBatch:
    """N cells in progress: their motions, the periods spent on them, their averages and their results.

    Cells with a valid oscillator begin at physical section states ``starts`` (N, 2n). Cells without a motion are
    written invalid at once. The argument ``mode`` (N,) has the modes of motions that continue from these states;
    without it the state decides.

    batch             motions, and the periods of the current interval
    bare              the same motions and periods without tangent vectors
    is_active         (N,) True if the cell has not ended
    has_frame         (N,) True if tangent vectors are carried along
    averaging         (N,) True if the growth of the tangent vectors counts
    periods_used      (N,) periods spent on the cell
    periods_flown     (N,) periods of its motion
    since             (N,) periods of its motion before it began to look chaotic
    began             (N,) periods of its motion before the current average and counts
    first             (N,) periods of its motion before the first average that counts
    previous_average  average before the current one; of 0 periods if there is no such average
    tallied           (N, TALLIES) counts between ``first`` and ``began``
    directions        number of directions of the state, 2n
    drifts            1 if one of them is a coordinate that may drift, which has no exponent
    vectors           number of tangent vectors
    results           result arrays, written when cells end
    mode              (N,) number of the mode of the ``state`` in the results
    orbits            orbits of the cells that were proved to converge to one
    unforced          True for machines without a force, whose periods are natural periods
    cycles            proved limit cycles by row
    conservative      (N,) True for machines that lose nothing, in which no motion attracts
    starts            (N, 2n) physical states at the beginning
    far_norm          (N,) energy norm from which on a growing motion counts as unbounded; infinite for other motions

    A section is an instant t = k T, T the forcing period; a mode is a set of linear equations between two events.
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
        fed = feeds(oscillators.table.machines) if oscillators.has_modes else oscillators.R > 1.0
        grows = np.flatnonzero((oscillators.growth > 0.0) | fed)
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
        """Set the number of periods for which these cells are to be simulated next."""
        self.batch.periods[rows], self.batch.completed[rows] = periods, 0

    def run(self, rows: Rows, *, to_end: bool = False) -> Rows:
        """Simulate these cells further; return the cells that have reached the end of their intervals of periods.

        With ``to_end`` all cells are simulated to the end.
        """
        framed = self.has_frame[rows]
        for batch, some in ((self.batch, rows[framed]), (self.bare, rows[~framed])):
            run(batch, some, to_end=to_end)
        through = rows[has_ended(self.batch)[rows]]
        self.periods_used[through] += self.batch.completed[through]
        self.periods_flown[through] += self.batch.completed[through]
        return through

    def known_section_count(self) -> Rows:
        """Return the number (N,) of states at sections t = k T that are stored of the last interval of each cell."""
        return np.minimum(self.batch.periods, self.batch.sections.shape[1])

    def known_sections(self, r: int) -> Array:
        """Return the stored states (K, n, 2) of cell r at the sections t = k T of its last interval.

        They are states of decoupled equations.
        """
        sections = self.batch.sections[r]
        return sections[len(sections) - int(self.known_section_count()[r]) :]

    def known_states(self, r: int) -> Array:
        """Return the stored states (K, 2n) of cell r at the sections t = k T of its last interval.

        They are displacements and velocities.
        """
        return np.asarray(self.known_sections(r).reshape(-1, self.directions) @ self.oscillators.to_physical[r].T)

    def survived_periods(self, rows: Rows) -> Rows:
        """Return the number of periods for which these cells have looked chaotic."""
        return self.periods_flown[rows] - self.since[rows]

    def is_running_away(self, rows: Rows) -> Mask:
        """Return the mask of cells whose drifting coordinate gains the same speed in each period.

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
        """Return the mask of cells in which a free part moves on forever, by equal steps, with no stop ahead.

        The part has no stiffness, and nothing else changes from one section t = k T to the next.
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
        """Return the mask of cells whose growing motion is so large, or infinite, that nothing seems to limit it."""
        far = np.isfinite(self.far_norm[rows])
        some = rows[far]
        size = energy_norms(self.oscillators.gap.metric[some], self.batch.motions.h[some])
        far[far] = ~(size <= self.far_norm[some])
        return np.asarray(far)

    def budget(self) -> Rows:
        """Return the number of periods that may still be spent on each cell."""
        return self.settings.max_periods + self.settings.survival - self.periods_used

    def is_at_rest(self, rows: Rows) -> Mask:
        """Return the mask of cells whose only mass has rested on a stop, so that the motion has lost all deviations."""
        lost = np.maximum(self.tallied[rows, LOST], self.batch.motions.tally[rows, LOST])
        return np.asarray(lost >= self.directions)
