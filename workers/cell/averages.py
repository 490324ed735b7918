"""Averages and counts of cells: the average in progress, the earlier one, and both as one."""

import numpy as np

from workers.cell.cells import Average, Cells
from workers.cell.exponents import impact_count
from workers.kernel.averages import COUNT, MEAN
from workers.kernel.cells import reset_frames, standard_errors
from workers.kernel.motion import LOST, MAX_SPEED, MIN_SPEED, NOTHING_COUNTED, STATUS, TALLIES, WORK, slanted
from workers.model.oscillator import Array, Mask, Rows, taken

CLEAR = 4.0
"""Standard errors above zero from which an exponent is called positive."""

GROWN = 15.0
"""Total log-growth from which a positive exponent counts: a deviation of rounding has become visible."""

CHANGED = 3.0
"""Standard errors by which two averages of one motion do not differ."""

NEVER_RESTARTED = np.isin(np.arange(TALLIES), (WORK, STATUS))
"""What a motion counts from its start to its end."""

SHEAR_LIMIT, SHEAR = 3e-4, 0.02
"""Mean growth below which it may be that of shear, and the share by which it may differ from that: see ``shears``."""

FARTHEST = 1e9
"""Ratio of error to tolerance above which its size does not matter: no budget has the periods."""


def clearly_positive(mean: Array, error: Array, periods: Array) -> Mask:
    """Which mean growths over this many periods are certainly positive."""
    return (mean > CLEAR * error) & (mean * periods > GROWN)


def shears(previous: Array, now: Array, apart: Array) -> Mask:
    """Which weighted mean growths of two stretches, whose middles lie ``apart`` periods, are those of shear.

    Without loss the frequencies of a torus depend on its amplitude: a disturbance grows in proportion to the time, its
    logarithm by 1 / (t - c) a period, and 1 / now - 1 / previous = apart whatever c is. The exponent is zero.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        linear = np.abs(1.0 / now - 1.0 / previous - apart) < SHEAR * apart
    return np.asarray(linear & (now > 0.0) & (now < SHEAR_LIMIT))


def periods_for(periods: Array, error: Array, wanted: Array | float) -> Array:
    """Periods until an average that has this error after these periods is known to the wanted error."""
    return np.asarray(periods * np.minimum(error / wanted, FARTHEST) ** 2)


def under_way(cells: Cells, rows: Rows) -> Average:
    """The average under way of these cells; of no periods where growth does not count.

    Without tangent vectors it has the impacts alone. Where all directions are lost the mean is exact.
    """
    motions, levels = cells.batch.motions, cells.batch.levels
    periods = levels[rows, 0, COUNT] if cells.vectors else cells.flown[rows] - cells.began[rows]
    lost = motions.tally[rows, LOST] >= cells.directions
    if cells.vectors:
        lost |= motions.growth[rows, 0] == -np.inf
    return Average(
        mean=np.where(lost, -np.inf, levels[rows, 0, MEAN]),
        error=np.where(lost, 0.0, standard_errors(levels, rows)),
        periods=np.where(cells.averaging[rows], periods, 0.0),
        growth=motions.growth[rows],
        impacts=impact_count(motions.tally[rows]),
    )


def whole_average(cells: Cells, rows: Rows) -> tuple[Average, Array]:
    """The earlier average of these cells and the one under way as one, with the error that results give.

    It is at least the standard error by the difference of the two averages: far apart in time, each may be too short to
    see how slowly the motion changes. The second result is the error without that, as if motion were stationary.
    """
    now, e = under_way(cells, rows), taken(cells.earlier, rows)
    counts = (now.periods > 0.0) & (np.isfinite(now.error) | (e.periods == 0.0))  # or too short to have an error
    mean, error, count, growth, impacts = (np.where(counts, field.T, 0.0).T for field in now)
    total = e.periods + count
    both = (count > 0.0) & (e.periods > 0.0)
    apart = np.where(both, np.abs(mean - e.mean) * np.sqrt(count * e.periods) / total, 0.0)
    plain = np.hypot(e.error * e.periods, error * count) / total
    whole = Average(
        mean=(e.mean * e.periods + mean * count) / total,
        error=np.maximum(plain, apart),
        periods=total,
        growth=growth + e.growth,
        impacts=impacts + e.impacts,
    )
    return whole, plain


def has_changed(cells: Cells, rows: Rows) -> Mask:
    """Of which of these cells the earlier average and the one under way differ."""
    now, e = under_way(cells, rows), taken(cells.earlier, rows)
    return np.asarray(np.abs(now.mean - e.mean) > CHANGED * np.hypot(now.error, e.error))


def close(cells: Cells, rows: Rows) -> None:
    """Keep the average under way as the earlier one, in its place."""
    reset_frames(cells.oscillators.gap.blocks, cells.batch.motions, rows)
    for earlier, now in zip(cells.earlier, under_way(cells, rows), strict=True):
        earlier[rows] = now


def forget(cells: Cells, rows: Rows) -> None:
    """Take the average under way of these cells for the first, and what was counted before it for nothing."""
    for field in cells.earlier:
        field[rows] = 0.0
    cells.tallied[rows], cells.first[rows] = NOTHING_COUNTED, cells.began[rows]


def lose_all(cells: Cells, rows: Rows) -> None:
    """Take the averages of these cells for what follows when all directions are lost: -inf, all of them."""
    close(cells, rows[cells.averaging[rows] & (cells.earlier.periods[rows] == 0.0)])
    cells.averaging[rows] = False
    cells.earlier.mean[rows], cells.earlier.error[rows], cells.earlier.growth[rows] = -np.inf, 0.0, -np.inf


def counts(cells: Cells, rows: Rows) -> tuple[Array, Rows]:
    """What was counted of these cells since the first average that counts, (rows, TALLIES), and the periods (rows,)."""
    before, now = cells.tallied[rows], cells.batch.motions.tally[rows]
    both = before + now
    both[:, MIN_SPEED] = np.minimum(before[:, MIN_SPEED], now[:, MIN_SPEED])
    for column in (MAX_SPEED, LOST):
        both[:, column] = np.maximum(before[:, column], now[:, column])
    return both, cells.flown[rows] - cells.first[rows]


def begin(cells: Cells, rows: Rows) -> None:
    """The growth of these cells counts from here on; of those without an earlier average, all that is counted."""
    restart(cells, rows)
    cells.averaging[rows] = True
    forget(cells, rows[cells.earlier.periods[rows] == 0.0])


def restart(cells: Cells, rows: Rows) -> None:
    """Average these cells from here on, and count on. Frames that lost directions start anew."""
    motions, batch = cells.batch.motions, cells.batch
    cells.tallied[rows], _ = counts(cells, rows)
    cells.began[rows] = cells.flown[rows]
    motions.V[rows[motions.tally[rows, LOST] > cells.drifts]] = slanted(motions.h.shape[1])[: cells.vectors]
    motions.tally[rows] = np.where(NEVER_RESTARTED, motions.tally[rows], NOTHING_COUNTED)
    reset_frames(cells.oscillators.gap.blocks, motions, rows)
    motions.growth[rows], batch.levels[rows], batch.weighted[rows] = 0.0, 0.0, 0.0
