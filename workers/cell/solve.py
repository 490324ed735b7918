"""Cells from their parameters to their results, by one of two schedules: the adaptive one or the paper's fixed one.

Schedules are kept in arrays, a row a cell, and what is due is done at once for all cells for which it is due. What
becomes of a cell does not depend on the others.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.cell.cells import NEAR, RETURNS, Cells, Rows, clearly_positive
from workers.cell.course import solve_adaptively
from workers.cell.outcome import put, put_averaged, put_chaotic, put_impact_free, put_periodic, put_stopped
from workers.kernel.cells import impact_free, start_motions
from workers.kernel.motion import BEYOND, WORK
from workers.model.oscillator import Oscillator
from workers.results import BEYOND_STOP, ENERGY_OUT_OF_DOUBLES, INVALID, NO_REASON, UNDETERMINED
from workers.settings import Settings

Array = NDArray[np.float64]

WORK_PER_PERIOD, LEAST_WORK = 200, 1_000_000
"""Evaluations allowed to a cell: so many for each period of its budget, but not less than the second number.
Ordinary cells take 5 to 40 a period; R near 1 can take 10^5, and a cell must not cost minutes."""


def work_allowed(periods: int) -> int:
    """Evaluations that a cell may cost over so many periods."""
    return max(WORK_PER_PERIOD * periods, LEAST_WORK)


def solve(
    oscillators: Oscillator,
    reasons: NDArray[np.int8],
    starts: Array,
    settings: Settings,
    found: dict[str, NDArray[Any]],
) -> None:
    """Solve N cells from their physical section states ``starts`` (N, 2n); those with a reason have no oscillator.

    Writes the result arrays ``found``, by name, all of which are given with their values for cells without a result.
    """
    cells, ready = begun(oscillators, reasons, starts, settings, found)
    schedule = solve_adaptively if settings.method == "adaptive" else _solve_fixed
    with np.errstate(all="ignore"):
        schedule(cells, ready)


def begun(
    oscillators: Oscillator,
    reasons: NDArray[np.int8],
    starts: Array,
    settings: Settings,
    found: dict[str, NDArray[Any]],
    contact: Rows | None = None,
) -> tuple[Cells, Rows]:
    """The cells of ``solve`` at their starts, and those of them that have a motion; the others are written invalid.

    contact (N,) is that of motions that go on from these states; without it each state shows its own.
    """
    adaptive = settings.method == "adaptive"
    cells = Cells(oscillators, settings, found, max(settings.max_period, RETURNS if adaptive else 0) + 1)
    motions = cells.batch.motions
    built = np.flatnonzero(reasons == NO_REASON)
    scales = start_motions(oscillators, motions, starts, built)
    if contact is not None:
        motions.contact[:, 0] = contact
    reasons = reasons.copy()
    reasons[~np.isfinite(scales)] = ENERGY_OUT_OF_DOUBLES
    reasons[motions.contact[:, 0] == BEYOND] = BEYOND_STOP
    invalid = np.flatnonzero(reasons != NO_REASON)
    put(cells, invalid, regime=INVALID, reason=reasons[invalid])
    budget = (settings.max_periods, settings.survival) if adaptive else (settings.transient_periods, settings.periods)
    motions.tally[:, WORK] = work_allowed(sum(budget))
    return cells, np.flatnonzero(reasons == NO_REASON)


def _solve_fixed(cells: Cells, ready: Rows) -> None:
    """The paper's schedule: a transient, then plain averages over so many periods.

    The averages of a cell whose orbit is proved may span chaos that came before it: they are kept as ``average``, and
    its exponents are the exact ones.
    """
    settings = cells.settings
    cells.framed[ready] = True
    ready = _through(cells, ready, settings.transient_periods)
    ready = ready[~put_stopped(cells, ready)]
    cells.restart(ready)
    cells.forget_counts(ready)
    cells.averaging[ready], cells.since[ready] = True, cells.flown[ready]
    ready = _through(cells, ready, settings.periods)
    ready = ready[~put_stopped(cells, ready)]
    put_averaged(cells, ready)
    free = impact_free(cells.oscillators, cells.batch.motions, ready)
    settled = np.zeros(len(ready), dtype=np.bool_)
    settled[~free] = cells.settle(
        ready[~free], np.full(len(cells.used), settings.max_periods), np.full(len(cells.used), NEAR)
    )
    open_ = ready[~free & ~settled]
    chaotic = clearly_positive(*cells.growth(open_))
    put_chaotic(cells, open_[chaotic])
    put(cells, open_[~chaotic], regime=UNDETERMINED, periods_used=cells.used[open_[~chaotic]])
    known = ready[free | settled]
    names = [name for name in ("average", "sum_law_defect", "state", "section") if name in cells.found]
    averaged = {name: cells.found[name][known] for name in names}
    put_impact_free(cells, ready[free], cells.batch.motions.h[ready[free]])
    put_periodic(cells, ready[settled])
    put(cells, known, **averaged)


def _through(cells: Cells, ready: Rows, periods: int) -> Rows:
    """Take these cells through so many periods."""
    cells.aim(ready, periods)
    waiting = ready
    while len(waiting):
        waiting = np.setdiff1d(waiting, cells.run(waiting))
    return ready
