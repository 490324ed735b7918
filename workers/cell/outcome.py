"""Results of cells as arrays: of orbits, of impact-free motion and of averages.

Each function writes the requested result variables of some cells.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers import results
from workers.cell.averages import clearly_positive, combined_average, counts
from workers.cell.cell_batch import CellBatch, GrowthAverage
from workers.cell.exponents import (
    free_exponents,
    impact_count,
    kaplan_yorke,
    rests_on_stop,
    sum_law_holds,
    sum_of_exponents,
)
from workers.cell.interval import sections_from, stop_reasons
from workers.cell.ranges import FOLLOWED, free_range, impact_range, steady_state
from workers.kernel import motion
from workers.kernel.cell_loops import impact_free, physical_states, reset_frames
from workers.model.hybrid_modes import OPEN, code_of
from workers.model.oscillator import Array, Mask, Oscillator, Rows, at_rows
from workers.orbit.escape import escaping
from workers.orbit.linear import GROWS, STAYS, UNKNOWN, contact_free, linear_orbits
from workers.orbit.newton import PeriodicOrbits, no_orbits

REGIME_OF = np.array([reason.regime for reason in results.REASONS])
"""Regime of a cell that ends for a reason, such as a failure, by the code of the reason."""


def write_results(cells: CellBatch, rows: Rows, **values: Any) -> None:
    """Write result variables of these cells, given by name, if the settings ask for them.

    Cells whose regime is written have ended.
    """
    for name, value in values.items():
        if name in cells.results:
            cells.results[name][rows] = value
    if "regime" in values:
        cells.is_active[rows] = False


def end_stopped(cells: CellBatch, rows: Rows) -> Rows:
    """Write the results of cells whose motion cannot continue, by their reason; return the other cells.

    A cell that has spent its evaluations is judged by its average, see ``put_by_average``.
    """
    reasons = stop_reasons(cells.batch.motions, rows)
    away = cells.is_running_away(rows) | cells.are_far(rows) & np.isin(reasons, (results.NO_REASON, results.NOT_FINITE))
    reasons = np.where(away, np.int8(results.RUNS_AWAY), reasons)
    off = cells.fly_off(rows) & (reasons == results.NO_REASON)
    reasons = np.where(off, np.int8(results.FLIES_OFF), reasons)
    spent = reasons == results.WORK_SPENT
    failed = (reasons != results.NO_REASON) & ~spent
    put_by_average(cells, rows[spent], results.WORK_SPENT)
    why, some = reasons[failed], rows[failed]
    write_results(cells, some, regime=REGIME_OF[why], periods_used=cells.periods_used[some], reason=why)
    return rows[~(failed | spent)]


def end_impact_free(cells: CellBatch, rows: Rows) -> Rows:
    """Write the results of cells whose motion cannot impact any more; return the other cells."""
    motions = cells.batch.motions
    growing = rows[cells.oscillators.growth[rows] > 0.0]
    if len(growing):
        gone = growing[escaping(cells.oscillators, motions, growing)]
        write_results(
            cells, gone, regime=results.FAILED, periods_used=cells.periods_used[gone], reason=results.RUNS_AWAY
        )
        rows = rows[cells.is_active[rows]]
    if cells.oscillators.has_modes:
        return _end_linear(cells, rows)
    free = impact_free(cells.oscillators, motions, rows)
    put_impact_free(cells, rows[free], motions.h[rows[free]])
    return rows[~free]


def _end_linear(cells: CellBatch, rows: Rows) -> Rows:
    """Write the results of cells whose linear equations change with phases alone; return the other cells.

    See ``orbit.linear``. Growing motion is unbounded, since nothing limits it.
    """
    _, _, frictions = cells.oscillators.table.machines.sizes
    if frictions or cells.drifts or not len(rows):
        return rows
    motions = cells.batch.motions
    spent = np.zeros_like(cells.periods_used)
    verdicts = np.full(len(cells.periods_used), UNKNOWN)

    def look(some: Rows) -> None:
        verdicts[some] = linear_orbits(cells.oscillators, motions, some, cells.orbits, spent)

    free = rows[contact_free(cells.oscillators, motions, rows)]
    if len(free):
        cells.oscillators.with_modes(look, free)
    cells.periods_used[rows] += spent[rows]
    put_periodic(cells, rows[verdicts[rows] == STAYS])
    grows = rows[verdicts[rows] == GROWS]
    write_results(cells, grows, regime=results.FAILED, periods_used=cells.periods_used[grows], reason=results.RUNS_AWAY)
    return rows[verdicts[rows] == UNKNOWN]


def put_impact_free(cells: CellBatch, rows: Rows, h: Array) -> None:
    """Write the results of cells that move without impact, from states h (N, n, 2) of their decoupled equations on."""
    if not len(rows):
        return
    oscillators = at_rows(cells.oscillators, rows)
    steady, exponents = steady_state(oscillators, h), free_exponents(oscillators)
    tally, error = np.tile(motion.NOTHING_COUNTED, (len(rows), 1)), np.abs(exponents[:, 0]) * 1e-15
    mirrored = (oscillators.symmetric > 0.0) & np.all(steady == 0.0, axis=(1, 2))
    orbits = no_orbits(*h.shape[:2])._replace(h=steady, exponents=exponents, tally=tally, error=error)
    orbits = orbits._replace(symmetric=mirrored)
    defect = _defect(oscillators, np.sum(exponents, axis=1), tally, 0.0)
    reach = free_range(oscillators, steady)
    _put_orbits(cells, rows, oscillators, orbits, regime=results.NO_IMPACT, sum_law_defect=defect, peak_to_peak=reach)


def _end_on_active_stops(cells: CellBatch, rows: Rows) -> Rows:
    """Write the results of cells that stay on a rigid stop with R > 1, where every hop grows; return the others.

    They have rested there from their start on, since no impact ends at rest.
    """
    numbers = cells.batch.motions.mode[rows, 0]
    if cells.oscillators.has_modes:
        machines = cells.oscillators.table.machines
        (_, C, F), active = machines.sizes, (machines.R > 1.0) & (machines.soft == 0.0)
        stays = np.zeros(len(rows), dtype=np.bool_)
        for i in np.flatnonzero(active[rows].any(axis=1)).tolist():
            states = np.array(code_of(int(numbers[i]), C, F, *machines.segments).contacts)
            stays[i] = np.any(active[rows[i]] & (states != OPEN))
    else:
        stays = (cells.oscillators.R[rows] > 1.0) & (numbers != motion.FLIGHT)
    if stays.any():
        put_averaged(cells, rows[stays])
        write_results(cells, rows[stays], regime=results.UNDETERMINED, error=math.nan, reason=results.AT_EQUILIBRIUM)
    return rows[~stays]


def put_periodic(cells: CellBatch, rows: Rows) -> None:
    """Write the results of cells with proved orbits. Impacts and rest are those of one turn; exponents are Floquet's.

    The error of the largest exponent is that of rounding, but at least the deviation of the sum of all exponents from
    its exact value: if a stiff machine hits a stop slowly under a large load, the rounding error of one more turn is
    too small. Exponents of minus infinity are exact.
    """
    rows = _end_on_active_stops(cells, rows)
    orbits = at_rows(cells.orbits, rows)
    orbits = orbits._replace(exponents=orbits.exponents[:, : cells.directions - cells.drifts])
    cells.periods_used[rows] += orbits.period
    sticks = orbits.tally[:, motion.STUCK] > 0.0
    free = (impact_count(orbits.tally) == 0.0) & ~sticks
    if cells.oscillators.has_modes:
        machines = cells.oscillators.table.machines
        springs, contacts = (np.sum(machines.counted[:1] == kind) for kind in (0.0, 1.0))
        linear = contacts > 0 or (machines.sizes[2] == 0 and springs == 0)
        free &= (springs == 0) | (orbits.period == 1)  # springs make orbits of many periods without contact
        if cells.unforced:  # without a cycle, exact recurrence is standstill, also on a stop
            free, linear = np.array([r not in cells.cycles for r in rows.tolist()], dtype=np.bool_), True
            orbits.tally[free, motion.MIN_SPEED] = math.inf
        regime = np.where(free & linear, results.NO_IMPACT, results.PERIODIC)
    else:
        if free.any():
            put_impact_free(cells, rows[free], orbits.h[free])
            rows, sticks, orbits = rows[~free], sticks[~free], at_rows(orbits, np.flatnonzero(~free))
        regime = np.full(len(rows), results.PERIODIC)
    if not len(rows):
        return
    oscillators, tally, largest = at_rows(cells.oscillators, rows), orbits.tally, orbits.exponents[:, 0]
    total = np.sum(orbits.exponents, axis=1)
    if oscillators.has_modes:
        complete = tally[:, motion.LOST] == cells.drifts
        defect = np.where(complete, total - tally[:, motion.CONTRACTION] / orbits.period, math.nan)
    else:
        defect = _defect(oscillators, total, tally, impact_count(tally) / orbits.period)
    error = np.fmax(orbits.error, np.abs(defect))
    orbits = orbits._replace(error=np.where(np.isneginf(largest), 0.0, error))
    reach = impact_range(oscillators, tally, orbits.h, orbits.mode, orbits.period)
    _put_orbits(cells, rows, oscillators, orbits, regime=regime, sum_law_defect=defect, peak_to_peak=reach)
    if cells.unforced:  # motion without loss swings for ever
        states = physical_states(oscillators, motion.motions_at(orbits.h, orbits.mode), np.arange(len(rows)))
        moves = np.any(states[:, cells.directions // 2 :] != 0.0, axis=1) & (regime == results.NO_IMPACT)
        swings = rows[moves & cells.conservative[rows]]
        write_results(cells, swings, regime=results.REGULAR, period=0, largest=0.0, spectrum=0.0)


def _put_orbits(cells: CellBatch, rows: Rows, oscillators: Oscillator, orbits: PeriodicOrbits, **more: Any) -> None:
    """Write the results of the orbits of these cells, and ``more`` results; ``oscillators`` has a row per cell."""
    exponents, tally, period = orbits.exponents, orbits.tally, orbits.period
    impacts = np.where(rests_on_stop(tally)[:, None], -1.0, tally[:, [motion.UPPER, motion.LOWER]])
    write_results(
        cells,
        rows,
        largest=exponents[:, 0],
        error=orbits.error,
        spectrum=exponents,
        kaplan_yorke=kaplan_yorke(exponents),
        period=period,
        impacts_upper=impacts[:, 0],
        impacts_lower=impacts[:, 1],
        symmetric=orbits.symmetric,
        periods_used=cells.periods_used[rows],
        **more,
    )
    put_contacts(cells, rows, tally, period, impact_count(tally) / period)
    put_states(cells, rows, oscillators, orbits.h, orbits.mode, period)


def put_averaged(cells: CellBatch, rows: Rows) -> None:
    """Write what the averages of these cells give: exponents, impacts, rest and states. The regime is not written.

    Impacts are counted over the periods of the averages, for the law of the sum of exponents. Rests and speeds are
    counted over all periods since: a rest during watching belongs to the motion.
    """
    if not len(rows):
        return
    motions = cells.batch.motions
    reset_frames(cells.oscillators.gap.blocks, motions, rows[cells.averaging[rows]])
    average, _ = combined_average(cells, rows)
    counted = np.flatnonzero(average.periods > 0.0)
    some, average = rows[counted], at_rows(average, counted)
    tally, periods = counts(cells, some)
    oscillators, followed = at_rows(cells.oscillators, some), np.full(len(some), FOLLOWED)
    if cells.vectors:
        put_growth(cells, some, tally, average)
    reach = impact_range(oscillators, tally, motions.h[some], motions.mode[some], followed)
    write_results(cells, some, peak_to_peak=reach)
    put_contacts(cells, some, tally, periods, average.impacts / average.periods)
    write_results(cells, rows, periods_used=cells.periods_used[rows])
    put_states(cells, rows, at_rows(cells.oscillators, rows), motions.h[rows], motions.mode[rows], 0 * rows)


def put_contacts(cells: CellBatch, rows: Rows, tally: Array, periods: Rows, hits: Array) -> None:
    """Write the results of rest and impacts of these cells.

    tally    (N, TALLIES) counts of impacts, rests and speeds
    periods  (N,) periods of these counts
    hits     (N,) impacts per period

    An impact at speed v loses gap_mass (1 - R^2) v^2 / 2. The impact that completes a chatter to rest loses gap_mass
    v^2 / 2, as all remaining impacts of the chatter together. The factor gap_mass is explained at OscillatorScalars.
    """
    impacts, sticks, rests = impact_count(tally), tally[:, motion.STUCK] > 0.0, rests_on_stop(tally)
    gap_mass = cells.oscillators.gap_mass[rows]
    slowest, fastest = tally[:, motion.MIN_SPEED], tally[:, motion.MAX_SPEED]
    write_results(
        cells,
        rows,
        sticks=sticks,
        drift_per_period=tally[:, motion.PROGRESS] / periods if cells.drifts else math.nan,
        stuck_fraction=np.minimum(tally[:, motion.STUCK] / (periods * cells.oscillators.period[rows]), 1.0),
        impacts_per_period=np.where(rests, math.nan, hits),
        min_impact_speed=np.where(np.isfinite(slowest), slowest, math.nan),
        mean_impact_speed=np.where(rests | (impacts == 0.0), math.nan, tally[:, motion.SPEEDS] / impacts),
        max_impact_speed=np.where(fastest > 0.0, fastest, math.nan),
        impact_energy=np.where(fastest > 0.0, 0.5 * gap_mass * tally[:, motion.LOSS] / periods, 0.0),
    )


def put_growth(cells: CellBatch, rows: Rows, tally: Array, average: GrowthAverage) -> None:
    """Write the exponents of these cells from an average.

    tally    (N, TALLIES) counts of the motions
    average  growth of the tangent vectors

    Directions that the whole motion has lost, by ``tally``, are lost even if they are not lost in the average.
    """
    spectrum = -np.sort(-average.growth / average.periods[:, None], axis=1)
    spectrum[np.arange(spectrum.shape[1]) >= cells.directions - tally[:, motion.LOST, None]] = -math.inf
    all_exponents = cells.settings.exponents == "spectrum"
    write_results(
        cells, rows, largest=average.mean, error=average.error, average=spectrum if all_exponents else average.mean
    )
    if all_exponents:
        total, hits = np.sum(average.growth, axis=1) / average.periods, average.impacts / average.periods
        defect = _defect(at_rows(cells.oscillators, rows), total, tally, hits)
        defect = np.where(cells.conservative[rows], total, defect)
        write_results(cells, rows, spectrum=spectrum, kaplan_yorke=kaplan_yorke(spectrum), sum_law_defect=defect)


def put_chaotic(cells: CellBatch, rows: Rows, reason: NDArray[np.int8] | int = results.NO_REASON) -> None:
    """Write the results of cells that look chaotic to the end. A ``reason`` explains why an average is uncertain.

    If no exponents are requested, these cells are called aperiodic: no stable orbit is known.
    """
    put_averaged(cells, rows)
    regime = results.CHAOTIC if cells.vectors else results.APERIODIC
    write_results(cells, rows, regime=regime, reason=reason, survived=cells.survived_periods(rows))


def put_quasiperiodic(cells: CellBatch, rows: Rows, weighted: Array, spread: Array) -> None:
    """Write the results of cells on tori.

    weighted  (K,) their largest exponent, a weighted average of the growth
    spread    (K,) its error
    """
    put_averaged(cells, rows)
    write_results(cells, rows, regime=results.QUASIPERIODIC, largest=weighted, error=spread)
    if "spectrum" in cells.results:
        spectrum = cells.results["spectrum"][rows]
        cells.results["spectrum"][rows, 0] = weighted
        spectrum[:, 0] = 0.0  # rounding must not decide the dimension of a torus
        write_results(cells, rows, kaplan_yorke=kaplan_yorke(-np.sort(-spectrum, axis=1)))


def put_regular(cells: CellBatch, rows: Rows, error: Array | float = 0.0) -> None:
    """Write the results of regular motion of machines that lose nothing, whose exponents are all 0.

    ``error`` is the largest exponent that the motion so far may hide.
    """
    put_averaged(cells, rows)
    dimension = float(cells.directions - cells.drifts)
    write_results(cells, rows, regime=results.REGULAR, largest=0.0, error=error, spectrum=0.0, kaplan_yorke=dimension)


def put_by_average(
    cells: CellBatch,
    rows: Rows,
    unclear: int = results.PERIODS_SPENT,
    clear: NDArray[np.int8] | int = results.NO_REASON,
    recurs: Mask | bool = True,
) -> None:
    """Write the results of cells that end with their averages: chaos if it is clear, else undetermined.

    unclear  code of the reason of undetermined cells
    clear    code of the reason of cells whose chaos is clear
    recurs   mask of cells whose motion recurs

    If only the difference of two averages makes chaos unclear, the reason is that it is not stationary. Motion that
    does not recur is no chaos, see ``recurrence``.
    """
    if not len(rows):
        return
    combined, plain = combined_average(cells, rows)
    chaotic, clearly = (clearly_positive(combined.mean, error, combined.periods) for error in (plain, combined.error))
    chaotic, recurs = chaotic & recurs, np.broadcast_to(recurs, rows.shape)
    unclear_reasons = np.where(recurs, np.int8(unclear), np.int8(results.NEVER_RECURS))
    reasons = np.where(clearly, clear, np.int8(results.NOT_STATIONARY))
    put_chaotic(cells, rows[chaotic], reasons[chaotic])
    put_averaged(cells, rows[~chaotic])
    write_results(cells, rows[~chaotic], regime=results.UNDETERMINED, error=math.nan, reason=unclear_reasons[~chaotic])


def put_states(cells: CellBatch, rows: Rows, oscillators: Oscillator, h: Array, mode: Rows, period: Rows) -> None:
    """Write the states of these cells in physical coordinates, and the states at K sections t = k T from there on.

    oscillators  the machines, a row for each cell
    h            (N, n, 2) states of the decoupled equations
    mode         (N, 1) numbers of the modes, sets of linear equations
    period       (N,) periods of orbits, 0 without an orbit

    An orbit repeats its section states. States are NaN after the motion cannot be followed.
    """
    motions, every = motion.motions_at(h, mode), np.arange(len(rows))
    cells.mode[rows] = mode[:, 0]
    write_results(cells, rows, state=physical_states(oscillators, motions, every))
    K = cells.settings.section_samples
    if K:
        lengths = np.where(period > 0, np.minimum(period, K), K)
        states = sections_from(oscillators, motions, lengths)
        write_results(cells, rows, section=states[every[:, None], np.arange(K) % lengths[:, None]])


def _defect(oscillators: Oscillator, total: Array, tally: Array, hits: Array | float) -> Array:
    """Return a sum of exponents minus its exact value; NaN if the law of the sum does not hold.

    total  (N,) sum of the exponents per period
    tally  (N, TALLIES) counts of the motions
    hits   (N,) impacts per period

    See exponents.sum_law_holds.
    """
    return np.where(sum_law_holds(tally), total - sum_of_exponents(oscillators, hits), math.nan)
