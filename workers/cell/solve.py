"""Computation of cells from parameters to results, by the adaptive schedule or that of Li & Tan (2011).

A schedule decides how long each cell is simulated. Its state is arrays with one row per cell, and each step is done for
all its cells at once. The results of a cell do not depend on the other cells.
"""

import numpy as np

from workers.cell import averages
from workers.cell.autonomous import course_of
from workers.cell.cell_batch import CellBatch
from workers.cell.orbits import NEAR_RETURN, end_on_orbits
from workers.cell.outcome import end_impact_free, end_stopped, put_averaged, put_chaotic, write_results
from workers.cell.recurrence import Recurrence
from workers.cell.schedule import none_of
from workers.model.oscillator import Rows
from workers.results import NEVER_RECURS, PERIODS_SPENT, UNDETERMINED


def solve(cells: CellBatch) -> None:
    """Compute the results of cells, by the schedule of their settings."""
    with np.errstate(all="ignore"):
        if cells.settings.method == "adaptive":
            course_of(cells).run()
        else:
            _solve_fixed(cells)


def _solve_fixed(cells: CellBatch) -> None:
    """Compute the results of cells by the schedule of Li & Tan (2011): a transient, then plain averages.

    The averages are over ``Settings.periods``. Those of a cell with a proved orbit may include earlier chaos. They are
    kept as ``average``; the exponents of the cell are the exact ones.
    """
    settings, recurrence = cells.settings, Recurrence(len(cells.periods_used))
    cells.has_frame[:] = True
    ready = _through(cells, cells.unfinished, settings.transient_periods)
    recurrence.update(cells, ready, none_of(ready))
    cells.since[ready] = cells.periods_flown[ready]
    averages.begin(cells, ready)
    ready = _through(cells, ready, settings.periods)
    recurrence.update(cells, ready, np.full(len(ready), settings.transient_periods > 0))
    put_averaged(cells, ready)
    names = {"average", "sum_law_defect", "state", "section"} & cells.results.keys()
    averaged = {name: cells.results[name].copy() for name in names}
    rest = end_impact_free(cells, ready)
    rest = end_on_orbits(
        cells,
        rest,
        np.full_like(cells.periods_used, settings.max_periods),
        np.full(len(cells.periods_used), NEAR_RETURN),
    )
    known = np.setdiff1d(ready, rest)
    write_results(cells, known, **{name: values[known] for name, values in averaged.items()})
    mean, error, periods, _, _ = averages.current_average(cells, rest)
    recurs = recurrence.recurred[rest]
    chaotic = averages.clearly_positive(mean, error, periods) & recurs
    put_chaotic(cells, rest[chaotic])
    unclear, reason = rest[~chaotic], np.where(recurs, np.int8(PERIODS_SPENT), np.int8(NEVER_RECURS))[~chaotic]
    write_results(cells, unclear, regime=UNDETERMINED, periods_used=cells.periods_used[unclear], reason=reason)


def _through(cells: CellBatch, ready: Rows, periods: int) -> Rows:
    """Simulate these cells for this number of periods, and return the cells that can continue."""
    cells.set_interval(ready, periods)
    cells.run(ready, to_end=True)
    return end_stopped(cells, ready)
