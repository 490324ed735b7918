"""Averages over the motions of cells: the current average, the earlier one, and both combined.

An average has the growth of tangent vectors, from which exponents follow, and counts of impacts and rests.
"""

import numpy as np

from workers.cell.cell_batch import CellBatch, GrowthAverage
from workers.cell.exponents import impact_count
from workers.kernel.averages import COUNT, MEAN
from workers.kernel.cell_loops import reset_frames, standard_errors
from workers.kernel.motion import LOST, MAX_SPEED, MIN_SPEED, NOTHING_COUNTED, STATUS, TALLIES, WORK, cosine_vectors
from workers.model.oscillator import Array, Mask, Rows, at_rows

CLEAR = 4.0
"""Number of standard errors above zero from which on an exponent counts as positive."""

GROWN = 15.0
"""Total log-growth from which on a positive exponent counts: a deviation of rounding size has become visible."""

CHANGED = 3.0
"""Maximum difference of two averages of the same motion, in standard errors."""

NEVER_RESTARTED = np.isin(np.arange(TALLIES), (WORK, STATUS))
"""Mask of the columns of a motion's counts that are counted from its start to its end."""

SHEAR_LIMIT, SHEAR = 3e-4, 0.02
"""Maximum mean growth that may be due to shear, and maximum relative deviation from the law of shear: see ``shears``.
"""

FARTHEST = 1e9
"""Maximum ratio of an error to its target: no budget has the periods for a larger one."""


def clearly_positive(mean: Array, error: Array, periods: Array) -> Mask:
    """Return the mask of cells whose mean growth per period, known to ``error``, is certainly positive.

    ``periods`` is the number of periods of each mean.
    """
    return (mean > CLEAR * error) & (mean * periods > GROWN)


def shears(previous: Array, now: Array, apart: Array) -> Mask:
    """Return the mask of cells whose mean growth in two intervals is due to shear, so that the exponent is zero.

    previous, now  mean growth per period in the earlier and the later interval, weighted averages
    apart          periods between the midpoints of the intervals

    Without loss the frequencies of a torus depend on its amplitude. A disturbance then grows in proportion to time. Its
    logarithm grows by 1 / (t - c) per period, so 1 / now - 1 / previous = apart for any c.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        linear = np.abs(1.0 / now - 1.0 / previous - apart) < SHEAR * apart
    return np.asarray(linear & (now > 0.0) & (now < SHEAR_LIMIT))


def periods_for(periods: Array, error: Array, target: Array | float) -> Array:
    """Return the number of periods after which the error of an average will have fallen to ``target``.

    The error is ``error`` after ``periods`` periods, and falls with the square root of their number.
    """
    return np.asarray(periods * np.minimum(error / target, FARTHEST) ** 2)


def current_average(cells: CellBatch, rows: Rows) -> GrowthAverage:
    """Return the current average of these cells; its number of periods is 0 while growth does not count yet.

    An average without tangent vectors has only counts of impacts. If all deviations have died out, since a mass rests
    on a stop, the mean is -inf and exact.
    """
    motions, levels = cells.batch.motions, cells.batch.levels
    periods = levels[rows, 0, COUNT] if cells.vectors else cells.periods_flown[rows] - cells.began[rows]
    lost = motions.tally[rows, LOST] >= cells.directions
    if cells.vectors:
        lost |= motions.growth[rows, 0] == -np.inf
    return GrowthAverage(
        mean=np.where(lost, -np.inf, levels[rows, 0, MEAN]),
        error=np.where(lost, 0.0, standard_errors(levels, rows)),
        periods=np.where(cells.averaging[rows], periods, 0.0),
        growth=motions.growth[rows],
        impacts=impact_count(motions.tally[rows]),
    )


def combined_average(cells: CellBatch, rows: Rows) -> tuple[GrowthAverage, Array]:
    """Return the earlier and the current average of these cells as one average, and its error for stationary motion.

    The error of the combined average is at least the standard error from the difference of the two averages: far apart
    in time, each may be too short to show slow changes of the motion. The second result is the error without that
    minimum.
    """
    now, e = current_average(cells, rows), at_rows(cells.previous_average, rows)
    counts = (now.periods > 0.0) & (np.isfinite(now.error) | (e.periods == 0.0))  # otherwise too short for an error
    mean, error, count, growth, impacts = (np.where(counts, field.T, 0.0).T for field in now)
    total = e.periods + count
    both = (count > 0.0) & (e.periods > 0.0)
    apart = np.where(both, np.abs(mean - e.mean) * np.sqrt(count * e.periods) / total, 0.0)
    plain = np.hypot(e.error * e.periods, error * count) / total
    combined = GrowthAverage(
        mean=(e.mean * e.periods + mean * count) / total,
        error=np.maximum(plain, apart),
        periods=total,
        growth=growth + e.growth,
        impacts=impacts + e.impacts,
    )
    return combined, plain


def has_changed(cells: CellBatch, rows: Rows) -> Mask:
    """Return the mask of cells whose motion has changed: their two averages differ by more than the errors allow."""
    now, e = current_average(cells, rows), at_rows(cells.previous_average, rows)
    return np.asarray(np.abs(now.mean - e.mean) > CHANGED * np.hypot(now.error, e.error))


def close(cells: CellBatch, rows: Rows) -> None:
    """Store the current average of these cells as their earlier one, in place; a new average may begin."""
    reset_frames(cells.oscillators.gap.blocks, cells.batch.motions, rows)
    for earlier, now in zip(cells.previous_average, current_average(cells, rows), strict=True):
        earlier[rows] = now


def restart_first(cells: CellBatch, rows: Rows) -> None:
    """Make the current average of these cells their first one, in place; the earlier average and counts are dropped."""
    for field in cells.previous_average:
        field[rows] = 0.0
    cells.tallied[rows], cells.first[rows] = NOTHING_COUNTED, cells.began[rows]


def lose_all(cells: CellBatch, rows: Rows) -> None:
    """Set the averages of these cells, in place, to those without any tangent vector left: growth -inf, error 0."""
    close(cells, rows[cells.averaging[rows] & (cells.previous_average.periods[rows] == 0.0)])
    cells.averaging[rows] = False
    cells.previous_average.mean[rows], cells.previous_average.error[rows], cells.previous_average.growth[rows] = (
        -np.inf,
        0.0,
        -np.inf,
    )


def counts(cells: CellBatch, rows: Rows) -> tuple[Array, Rows]:
    """Return the counts (rows, TALLIES) of these cells since the first average that counts, and their periods (rows,).

    The counts are those of impacts, rests, speeds and work; the columns are named in kernel/motion.py.
    """
    before, now = cells.tallied[rows], cells.batch.motions.tally[rows]
    both = before + now
    both[:, MIN_SPEED] = np.minimum(before[:, MIN_SPEED], now[:, MIN_SPEED])
    for column in (MAX_SPEED, LOST):
        both[:, column] = np.maximum(before[:, column], now[:, column])
    return both, cells.periods_flown[rows] - cells.first[rows]


def begin(cells: CellBatch, rows: Rows) -> None:
    """Begin an average of these cells, in place: the growth of their tangent vectors counts from now on.

    Without an earlier average, impacts and rests count from now on too.
    """
    restart(cells, rows)
    cells.averaging[rows] = True
    restart_first(cells, rows[cells.previous_average.periods[rows] == 0.0])


def restart(cells: CellBatch, rows: Rows) -> None:
    """Restart the average of these cells, in place, and continue their counts of impacts and rests.

    Tangent vectors of motions that lost a direction are set anew.
    """
    motions, batch = cells.batch.motions, cells.batch
    cells.tallied[rows], _ = counts(cells, rows)
    cells.began[rows] = cells.periods_flown[rows]
    motions.V[rows[motions.tally[rows, LOST] > cells.drifts]] = cosine_vectors(motions.h.shape[1])[: cells.vectors]
    motions.tally[rows] = np.where(NEVER_RESTARTED, motions.tally[rows], NOTHING_COUNTED)
    reset_frames(cells.oscillators.gap.blocks, motions, rows)
    motions.growth[rows], batch.levels[rows], batch.weighted[rows] = 0.0, 0.0, 0.0
