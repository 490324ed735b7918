"""What becomes of cells, written as arrays: the results of orbits, of impact-free motion and of averages.

Each function writes those result variables that are asked for, of some of the cells.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.cell.cells import Array, Average, Cells, Mask, Rows, clearly_positive
from workers.cell.exponents import free_exponents, impact_count, kaplan_yorke, sum_law_holds, sum_of_exponents
from workers.cell.ranges import FOLLOWED, free_range, impact_range
from workers.cell.stretch import batch_of, run
from workers.kernel.cells import physical_states, reset_frames
from workers.kernel.impact import COMPLETION
from workers.kernel.motion import (
    LOSS,
    LOST,
    LOWER,
    MARCH_GAVE_UP,
    MAX_SPEED,
    MIN_SPEED,
    NOT_FINITE,
    OUT_OF_WORK,
    RUNNING,
    SPEEDS,
    STARTED_BEYOND,
    STATUS,
    STUCK,
    UPPER,
    WORK,
    WORK_OF_A_TRIAL,
    motions_at,
)
from workers.model.oscillator import Oscillator, taken
from workers.results import (
    APERIODIC,
    BEYOND_STOP,
    CHAOTIC,
    COSTLY_PERIOD,
    GAVE_UP,
    NO_IMPACT,
    NO_REASON,
    PERIODIC,
    QUASIPERIODIC,
    REASONS,
    RESTED,
    UNDETERMINED,
    WORK_SPENT,
)
from workers.results import NOT_FINITE as NO_LONGER_FINITE

REASON_OF = {
    MARCH_GAVE_UP: GAVE_UP,
    OUT_OF_WORK: COSTLY_PERIOD,
    NOT_FINITE: NO_LONGER_FINITE,
    STARTED_BEYOND: BEYOND_STOP,
}
"""Why a motion cannot go on, by its status."""

CHATTER_CUT = COMPLETION**3
"""What the jump to rest at the end of a chatter changes an exponent by, relative to one more than itself: of third
order in what is cut. At most half of this in 630 random orbits followed ten thousand times closer to rest."""


def put(cells: Cells, rows: Rows, **values: Any) -> None:
    """Write result variables of these cells, those that are asked for."""
    for name, value in values.items():
        if name in cells.found:
            cells.found[name][rows] = value


def put_stopped(cells: Cells, rows: Rows) -> Mask:
    """Write the results of those cells whose motion cannot go on: of their reason, or undecided, their work spent."""
    tally = cells.batch.motions.tally[rows]
    status = tally[:, STATUS].astype(np.int64)
    finite = np.isfinite(cells.batch.motions.h[rows]).all(axis=(1, 2))
    status[(status == RUNNING) & ~finite] = NOT_FINITE
    broke = (status == RUNNING) & (tally[:, WORK] < 0.0)
    put_undecided(cells, rows[broke], WORK_SPENT)
    for code, reason in REASON_OF.items():
        failed = rows[status == code]
        put(cells, failed, regime=REASONS[reason].regime, periods_used=cells.used[failed], reason=reason)
    return np.asarray((status != RUNNING) | broke)


def orbit_error(largest: Array, rounding: Array, defect: Array, sticks: Array) -> Array:
    """Error of the largest exponents of orbits: rounding, what misses the sum law, and chatter that is cut short.

    Exponents of minus infinity are exact.
    """
    chatter = np.where(sticks, CHATTER_CUT * (1.0 + np.abs(largest)), 0.0)
    return np.where(np.isneginf(largest), 0.0, np.fmax(np.maximum(rounding, chatter), np.abs(defect)))


def put_impact_free(cells: Cells, rows: Rows, h: Array) -> None:
    """Write the results of cells that move without impact, from block states h on."""
    if not len(rows):
        return
    oscillators = taken(cells.oscillators, rows)
    exponents = free_exponents(oscillators)
    total = np.sum(exponents, axis=1)
    steady = _steady(oscillators, h)
    put(
        cells,
        rows,
        largest=exponents[:, 0],
        error=np.abs(exponents[:, 0]) * 1e-15,
        spectrum=exponents,
        kaplan_yorke=kaplan_yorke(exponents),
        sum_law_defect=total - sum_of_exponents(oscillators, 0.0),
        regime=NO_IMPACT,
        period=1,
        impacts_per_period=0.0,
        impact_energy=0.0,
        peak_to_peak=free_range(oscillators, steady),
        stuck_fraction=0.0,
        periods_used=cells.used[rows],
    )
    contact, period = np.zeros((len(rows), 1), dtype=np.int64), np.ones(len(rows), dtype=np.int64)
    put_states(cells, rows, oscillators, steady, contact, period)


def _steady(oscillators: Oscillator, h: Array) -> Array:
    """Where block states h (N, n, 2) go without impact: a damped rigid mode comes to rest, what is undamped goes on."""
    eta, lam = oscillators.gap.eta, oscillators.gap.lam
    with np.errstate(divide="ignore", invalid="ignore"):
        end = np.where(lam == 0.0, h[..., 0] + h[..., 1] / (2.0 * eta), 0.0)
    damped = (eta > 0.0)[..., None]
    return np.where(damped, np.stack([end, np.zeros_like(end)], axis=-1), h)


def put_periodic(cells: Cells, rows: Rows) -> None:
    """Write the results of proved orbits: one turn counts impacts and rest; the exponents are Floquet's.

    Their error is at least what their sum misses of its exact value: where a stiff machine hits a stop slowly under a
    large load, rounding takes more than one more turn shows.
    """
    orbits = cells.orbits
    cells.used[rows] += orbits.period[rows]
    tally, period = orbits.tally[rows], orbits.period[rows]
    sticks = tally[:, STUCK] > 0.0
    hits = impact_count(tally) / period
    free = (hits == 0.0) & ~sticks
    put_impact_free(cells, rows[free], orbits.h[rows[free]])
    rows, tally, period, sticks, hits = (x[~free] for x in (rows, tally, period, sticks, hits))
    if not len(rows):
        return
    oscillators, exponents = taken(cells.oscillators, rows), orbits.exponents[rows]
    defect = _defect(oscillators, np.sum(exponents, axis=1), tally, hits)
    put(
        cells,
        rows,
        largest=exponents[:, 0],
        error=orbit_error(exponents[:, 0], orbits.error[rows], defect, sticks),
        spectrum=exponents,
        kaplan_yorke=kaplan_yorke(exponents),
        sum_law_defect=defect,
        regime=PERIODIC,
        period=period,
        impacts_upper=np.where(sticks, -1.0, tally[:, UPPER]),
        impacts_lower=np.where(sticks, -1.0, tally[:, LOWER]),
        impacts_per_period=np.where(sticks, math.nan, hits),
        symmetric=orbits.symmetric[rows],
        sticks=sticks,
        stuck_fraction=tally[:, STUCK] / (period * oscillators.period),
        peak_to_peak=impact_range(oscillators, tally, orbits.h[rows], orbits.contact[rows], period),
        periods_used=cells.used[rows],
    )
    put_speeds(cells, rows, tally, period)
    put_states(cells, rows, oscillators, orbits.h[rows], orbits.contact[rows], period)


def put_averaged(cells: Cells, rows: Rows) -> None:
    """Write what averages show of these cells, their class left open.

    Impacts are counted over the periods of the averages, as their sum law has it; rests and speeds over all periods
    since: a rest that only the watch has seen is one of the motion.
    """
    if not len(rows):
        return
    motions = cells.batch.motions
    if cells.vectors:
        reset_frames(cells.oscillators.gap.metric, motions, rows[cells.averaging[rows]])
    average = cells.whole_average(rows)
    counted = average.periods > 0.0
    some, count, tally = rows[counted], average.periods[counted], average.tally[counted]
    whole, periods = cells.counts(some)
    if cells.vectors:
        put_growth(cells, some, whole, taken(average, np.flatnonzero(counted)))
    sticks = whole[:, STUCK] > 0.0
    put(
        cells,
        some,
        sticks=sticks,
        stuck_fraction=whole[:, STUCK] / (periods * cells.oscillators.period[some]),
        impacts_per_period=np.where(sticks, math.nan, impact_count(tally) / count),
        peak_to_peak=impact_range(
            taken(cells.oscillators, some), whole, motions.h[some], motions.contact[some], np.full(len(some), FOLLOWED)
        ),
    )
    put_speeds(cells, some, whole, periods)
    put(cells, rows, periods_used=cells.used[rows])
    oscillators, no_period = taken(cells.oscillators, rows), np.zeros(len(rows), dtype=np.int64)
    put_states(cells, rows, oscillators, motions.h[rows], motions.contact[rows], no_period)


def put_speeds(cells: Cells, rows: Rows, tally: Array, periods: Array | Rows) -> None:
    """Write what tallies (N, TALLIES) over so many periods (N,) say of these cells' impact speeds and losses.

    An impact at speed v loses gap_mass (1 - R^2) v^2 / 2; one that completes a chatter to rest loses gap_mass v^2 / 2,
    as all those that are left of the chatter do together. See Oscillator.gap_mass.
    """
    hits, sticks = impact_count(tally), tally[:, STUCK] > 0.0
    put(
        cells,
        rows,
        min_impact_speed=np.where(np.isfinite(tally[:, MIN_SPEED]), tally[:, MIN_SPEED], math.nan),
        mean_impact_speed=np.where(sticks | (hits == 0.0), math.nan, tally[:, SPEEDS] / hits),
        max_impact_speed=np.where(tally[:, MAX_SPEED] > 0.0, tally[:, MAX_SPEED], math.nan),
        impact_energy=0.5 * cells.oscillators.gap_mass[rows] * tally[:, LOSS] / periods,
    )


def put_growth(cells: Cells, rows: Rows, whole: Array, average: Average) -> None:
    """Write the exponents that an average shows of these cells.

    Directions that are lost by the counts of the ``whole`` motion are lost, though not in the average.
    """
    count = average.periods
    spectrum = -np.sort(-average.growth / count[:, None], axis=1)
    size = 2 * cells.oscillators.gap_row.shape[1]
    spectrum[np.arange(spectrum.shape[1]) >= size - whole[:, LOST, None]] = -math.inf
    put(
        cells,
        rows,
        largest=average.mean,
        error=average.deviation,
        average=spectrum if cells.settings.exponents == "spectrum" else average.mean,
    )
    total = np.sum(average.growth, axis=1) / count
    hits = impact_count(average.tally) / count
    if cells.settings.exponents == "spectrum":
        put(cells, rows, spectrum=spectrum, kaplan_yorke=kaplan_yorke(spectrum))
        put(cells, rows, sum_law_defect=_defect(taken(cells.oscillators, rows), total, whole, hits))


def put_chaotic(cells: Cells, rows: Rows, reason: NDArray[np.int8] | int = NO_REASON) -> None:
    """Write the results of cells whose largest exponent is positive; a reason says why its average is uncertain."""
    put_averaged(cells, rows)
    put(cells, rows, regime=CHAOTIC, reason=reason, survived=cells.flown[rows] - cells.since[rows])


def put_aperiodic(cells: Cells, rows: Rows) -> None:
    """Write the results of cells without a stable orbit, so far as is known, whose exponents were not asked for."""
    put_averaged(cells, rows)
    put(cells, rows, regime=APERIODIC, survived=cells.flown[rows] - cells.since[rows])


def put_quasiperiodic(cells: Cells, rows: Rows, weighted: Array, spread: Array) -> None:
    """Write the results of tori, their largest exponent from weighted averages."""
    put_averaged(cells, rows)
    put(cells, rows, regime=QUASIPERIODIC, largest=weighted, error=spread)
    if "spectrum" in cells.found:
        cells.found["spectrum"][rows, 0] = weighted
        # Rounding must not decide whether a torus has a dimension: its first exponent is zero.
        spectrum = cells.found["spectrum"][rows]
        spectrum[:, 0] = 0.0
        put(cells, rows, kaplan_yorke=kaplan_yorke(-np.sort(-spectrum, axis=1)))


def put_undecided(cells: Cells, rows: Rows, reason: int = NO_REASON) -> None:
    """Write the results of cells that cannot go on: chaotic with their true error if clear."""
    if not len(rows):
        return
    average = cells.whole_average(rows)
    chaotic = clearly_positive(average.mean, average.deviation, average.periods)
    put_chaotic(cells, rows[chaotic])
    put_averaged(cells, rows[~chaotic])
    put(cells, rows[~chaotic], regime=UNDETERMINED, error=math.nan, reason=reason)


def put_resting(cells: Cells, rows: Rows, survived: Rows) -> None:
    """Write the results of cells whose one mass has rested after so many periods, and repeats nobody knows when."""
    if cells.vectors:
        cells.lose_all(rows)
    put_averaged(cells, rows)
    put(cells, rows, regime=UNDETERMINED, reason=RESTED, survived=survived)


def put_states(cells: Cells, rows: Rows, oscillators: Oscillator, h: Array, contact: Rows, period: Rows) -> None:
    """Write the physical state of these cells, given in blocks, and the sections from it on.

    The next K states, those of an orbit of known ``period`` repeated. NaN from where the motion cannot be followed.
    """
    motions, every = motions_at(h, contact), np.arange(len(rows))
    cells.contact[rows] = contact[:, 0]
    put(cells, rows, state=physical_states(oscillators, motions, every))
    K = cells.settings.section_samples
    if K == 0:
        return
    batch = batch_of(oscillators, motions)
    counts = np.where(period > 0, np.minimum(period, K), K)
    states = np.full((len(rows), int(np.max(counts, initial=0)), 2 * h.shape[1]), math.nan)
    for k in range(states.shape[1]):
        going = every[(k < counts) & (motions.tally[:, STATUS] == RUNNING)]
        states[going, k] = physical_states(oscillators, motions, going)
        batch.periods[:], batch.done[:], motions.tally[:, WORK] = 1, 0, WORK_OF_A_TRIAL
        run(batch, going)
    put(cells, rows, section=states[every[:, None], np.arange(K) % counts[:, None]])


def _defect(oscillators: Oscillator, total: Array, tally: Array, hits: Array) -> Array:
    """A sum of exponents minus its exact value; NaN where that law does not hold, see exponents.sum_law_holds."""
    holds = sum_law_holds(tally)
    exact = sum_of_exponents(oscillators, hits)
    return np.where(holds, np.where(holds, total, 0.0) - exact, math.nan)
