"""The schedules by which cells come to their class: the adaptive one and the paper's fixed one.

They are kept in arrays, a row a cell, and what is due is done at once for all cells for which it is due. What becomes
of a cell does not depend on the others.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from workers.cells import Cells, Rows, clearly_positive
from workers.kernel.cells import impact_free, start_motions
from workers.kernel.motion import BEYOND, WORK
from workers.model.oscillator import Oscillator
from workers.orbit.newton import far_from_closing
from workers.results import BEYOND_STOP, CHAOTIC, ENERGY_OUT_OF_DOUBLES, INVALID, NO_REASON, UNDETERMINED
from workers.settings import Settings

Array = NDArray[np.float64]

WORK_PER_PERIOD, LEAST_WORK = 200, 1_000_000
"""Evaluations allowed to a cell: so many for each period of its budget, but not less than the second number.
Ordinary cells take 5 to 40 a period; R near 1 can take 10^5, and a cell must not cost minutes."""

FIRST_STRETCH = 32
"""Periods before a cell is first looked at; each further stretch is as long as all before it."""

TANGENT_AFTER = 256
"""Periods without a sign of periodicity after which tangent vectors are carried along."""

WARM_UP = 64
"""Periods in which the tangent frame turns into the right directions before its growth counts."""

FARTHEST = 1e9
"""From so many times the tolerance on it does not matter how far off the error is: no budget has the periods."""

TORUS_LIMIT = 1e-5
"""Largest modulus of the weighted averages of two stretches that counts as an exponent zero."""

TORUS_RETURN = 1e-5
"""Return within max_period, relative to the motion's scale, up to which a motion may be an orbit closing slowly."""


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
    kept = settings.max_period + 1
    longest = settings.max_periods if settings.method == "adaptive" else settings.periods
    cells = Cells(oscillators, settings, found, min(kept, longest))
    motions = cells.batch.motions
    built = np.flatnonzero(reasons == NO_REASON)
    scales = start_motions(oscillators, motions, starts, built)
    reasons = reasons.copy()
    reasons[~np.isfinite(scales)] = ENERGY_OUT_OF_DOUBLES
    reasons[motions.contact[:, 0] == BEYOND] = BEYOND_STOP
    invalid = np.flatnonzero(reasons != NO_REASON)
    cells.put(invalid, regime=INVALID, reason=reasons[invalid])
    periods = settings.max_periods if settings.method == "adaptive" else settings.transient_periods + settings.periods
    motions.tally[:, WORK] = work_allowed(periods)
    schedule = _fixed if settings.method == "fixed" else _adaptive
    with np.errstate(all="ignore"):
        schedule(cells, np.flatnonzero(reasons == NO_REASON))


def _adaptive(cells: Cells, ready: Rows) -> None:
    """Look at ever longer stretches until the class is certain or the budget spent.

    Each stretch may end in a proof of no impact or of a stable orbit. Meanwhile, once that looks unlikely,
    tangent vectors are averaged: clearly positive ends at the asked tolerance; zero on two stretches is a torus.
    A tenth of the budget is kept for the proof of an orbit.
    """
    N = len(cells.used)
    stretch = np.full(N, FIRST_STRETCH)
    averaged_next = np.zeros(N, dtype=np.int64)  # periods to go once the frame has warmed up
    weighted = np.full(N, np.nan)
    waiting = np.zeros(N, dtype=np.bool_)
    while len(ready) or waiting.any():
        waiting[_next_stretch(cells, ready, stretch, averaged_next)] = True
        through = cells.run(np.flatnonzero(waiting))
        warm = cells.framed[through] & ~cells.averaging[through]
        _begin_averages(cells, through[warm], averaged_next)
        waiting[through[~warm]] = False
        ready = _look(cells, through[~warm], stretch, weighted)


def _next_stretch(cells: Cells, ready: Rows, stretch: Rows, averaged_next: Rows) -> Rows:
    """Give each cell its next stretch; those that have one."""
    settings = cells.settings
    free = impact_free(cells.oscillators, cells.batch.motions, ready)
    cells.put_impact_free(ready[free], cells.batch.motions.h[ready[free]])
    ready = ready[~free]
    length = np.minimum(stretch[ready], settings.max_periods - settings.max_periods // 10 - cells.used[ready])
    cells.put_undecided(ready[length <= 0])
    ready, length = ready[length > 0], length[length > 0]
    warm_up = ~cells.averaging[ready] & (cells.used[ready] >= TANGENT_AFTER) & (length > WARM_UP)
    if cells.vectors:
        cells.framed[ready[warm_up]] = True
        averaged_next[ready[warm_up]] = length[warm_up] - WARM_UP
        length[warm_up] = WARM_UP
    cells.aim(ready, length)
    return ready


def _begin_averages(cells: Cells, warm: Rows, averaged_next: Rows) -> None:
    """Frames have warmed up: their growth counts from here on."""
    cells.restart(warm)
    cells.averaging[warm] = True
    cells.aim(warm, averaged_next[warm])


def _look(cells: Cells, through: Rows, stretch: Rows, weighted: Array) -> Rows:
    """See what the stretch has shown of each cell; those that have to go on."""
    settings = cells.settings
    through = through[~cells.put_stopped(through)]
    settled = cells.settle(through, settings.max_periods - cells.used)
    cells.put_periodic(through[settled])
    rest = through[~settled]
    stretch[rest] = cells.used[rest]
    averaging = rest[cells.averaging[rest]]
    mean, error, count = cells.growth(averaging)
    positive = clearly_positive(mean, error, count)
    precise = positive & (error <= settings.tolerance)
    cells.put_chaotic(averaging[precise])
    missing = count * (np.minimum(error / settings.tolerance, FARTHEST) ** 2 - 1.0)
    more = averaging[positive]
    stretch[more] = np.minimum(cells.used[more], np.maximum(1.05 * missing[positive], 256.0)).astype(np.int64)
    previous = weighted[averaging]
    weighted[averaging] = cells.batch.weighted[averaging, 0] / cells.batch.weighted[averaging, 1]
    now = weighted[averaging]
    spread = np.abs(now - previous)
    flat = ~precise & (np.maximum(np.abs(previous), np.abs(now)) < TORUS_LIMIT) & ~(now < -10.0 * spread)
    oscillators, batch = cells.oscillators, cells.batch
    flat[flat] = far_from_closing(
        oscillators.gap.lam, oscillators.forced, batch.motions.h, batch.sections, cells.kept(), averaging[flat],
        TORUS_RETURN,
    )  # fmt: skip
    cells.put_quasiperiodic(averaging[flat], now[flat], spread[flat])
    done = np.zeros(len(cells.used), dtype=np.bool_)
    done[averaging[precise | flat]] = True
    return rest[~done[rest]]


def _fixed(cells: Cells, ready: Rows) -> None:
    """The paper's schedule: a transient, then plain averages over so many periods.

    The averages of a cell whose orbit is proved may span chaos that came before it: they are kept as ``average``, and
    its exponents are the exact ones.
    """
    settings = cells.settings
    cells.framed[ready] = True
    ready = _through(cells, ready, settings.transient_periods)
    ready = ready[~cells.put_stopped(ready)]
    cells.restart(ready)
    cells.averaging[ready] = True
    ready = _through(cells, ready, settings.periods)
    ready = ready[~cells.put_stopped(ready)]
    cells.put_averaged(ready)
    free = impact_free(cells.oscillators, cells.batch.motions, ready)
    settled = np.zeros(len(ready), dtype=np.bool_)
    settled[~free] = cells.settle(ready[~free], np.full(len(cells.used), settings.max_periods))
    open_ = ready[~free & ~settled]
    chaotic = clearly_positive(*cells.growth(open_))
    cells.put(open_, regime=np.where(chaotic, CHAOTIC, UNDETERMINED), periods_used=cells.used[open_])
    known = ready[free | settled]
    names = [name for name in ("average", "sum_law_defect", "state", "section") if name in cells.found]
    averaged = {name: cells.found[name][known] for name in names}
    cells.put_impact_free(ready[free], cells.batch.motions.h[ready[free]])
    cells.put_periodic(ready[settled])
    cells.put(known, **averaged)


def _through(cells: Cells, ready: Rows, periods: int) -> Rows:
    """Take these cells through so many periods."""
    cells.aim(ready, periods)
    waiting = ready
    while len(waiting):
        waiting = np.setdiff1d(waiting, cells.run(waiting))
    return ready
