"""One cell from its start to its class: the adaptive method and the paper's fixed schedule."""

import math
from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from workers.cell import (
    Cell,
    averaged_cell,
    chaotic_cell,
    clearly_positive,
    mean_growth,
    no_impact_cell,
    periodic_cell,
    quasiperiodic_cell,
    undecided_cell,
)
from workers.kernel.averages import Averages, no_averages
from workers.kernel.flight import derivative_bounds
from workers.kernel.stroboscopic import (
    BEYOND,
    FREE,
    LOST,
    MARCH_GAVE_UP,
    MIN_SPEED,
    NOT_FINITE,
    OUT_OF_WORK,
    RUNNING,
    STATUS,
    WORK,
    Motion,
    axes,
    motion_from,
    reset_frame,
)
from workers.model.oscillator import Oscillator
from workers.orbit.map import energy_norm
from workers.orbit.newton import PeriodicOrbit, closest_return, recurrence, settle
from workers.results import (
    BEYOND_STOP,
    CHAOTIC,
    COSTLY_PERIOD,
    ENERGY_OUT_OF_DOUBLES,
    FAILED,
    GAVE_UP,
    INVALID,
    NO_REASON,
    UNDETERMINED,
    WORK_SPENT,
    InvalidError,
)
from workers.results import NOT_FINITE as NO_LONGER_FINITE
from workers.settings import Settings
from workers.stretch import Stretch, run_stretch

Array = NDArray[np.float64]

REASON_OF = {MARCH_GAVE_UP: GAVE_UP, OUT_OF_WORK: COSTLY_PERIOD, NOT_FINITE: NO_LONGER_FINITE}
"""Why a motion cannot go on, by its status."""

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


Solving = Generator[Stretch, int, Cell]
"""A cell being solved: yields each stretch that its motion has to go through, is sent the periods completed."""


def solve_cell(osc: Oscillator, start: Array, settings: Settings) -> Cell:
    """The solution of one cell that starts at physical section state ``start`` (2n,)."""
    cell = solving(osc, start, settings)
    done = None
    while True:
        try:
            done = run_stretch(cell.send(done))  # type: ignore[arg-type]
        except StopIteration as end:
            return end.value


def solving(osc: Oscillator, start: Array, settings: Settings) -> Solving:
    """As solve_cell, one stretch at a time, so that many cells can share a batch."""
    try:
        motion = checked_start(osc, start)
    except InvalidError as error:
        return Cell(regime=INVALID, reason=error.reason)
    periods = settings.max_periods if settings.method == "adaptive" else settings.transient_periods + settings.periods
    motion.tally[WORK] = max(WORK_PER_PERIOD * periods, LEAST_WORK)
    method = _fixed if settings.method == "fixed" else _adaptive
    cell = yield from method(osc, motion, settings)
    if cell.spectrum is not None and settings.exponents != "spectrum":
        cell.spectrum = None
    if settings.exponents == "none":
        cell.largest = cell.error = cell.sum_law_defect = math.nan
    return cell


def checked_start(osc: Oscillator, start: Array, record: int = 0) -> Motion:
    """The motion from physical section state ``start`` (2n,), with room to record so many impacts.

    Raises InvalidError for a state beyond a stop and for a motion whose energy, which deviations are
    measured by, no float can hold.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        motion = motion_from(osc, start, record=record)
        scale = scale_of(osc, motion)
    if motion.contact[0] == BEYOND:
        raise InvalidError(BEYOND_STOP)
    if not math.isfinite(scale):
        raise InvalidError(ENERGY_OUT_OF_DOUBLES)
    return motion


def vectors_for(settings: Settings, osc: Oscillator) -> int:
    """Tangent vectors that the asked exponents need: none, one or all 2n."""
    return {"none": 0, "largest": 1, "spectrum": 2 * len(osc.kick)}[settings.exponents]


def with_frame(motion: Motion, vectors: int) -> Motion:
    """The same motion with so many tangent vectors, along the block axes."""
    frame = axes(len(motion.h))[:vectors].copy()
    return motion._replace(V=frame, growth=np.zeros(vectors), tally=motion.tally)


def restart_counts(osc: Oscillator, motion: Motion) -> None:
    """Count from here on: impacts, slowest impact, time at rest, growth. A frame that lost directions starts anew."""
    if motion.tally[LOST]:
        motion.V[:] = axes(len(motion.h))[: len(motion.V)]
    work, status = motion.tally[WORK], motion.tally[STATUS]
    motion.tally[:] = 0.0
    motion.tally[WORK], motion.tally[STATUS] = work, status
    motion.tally[MIN_SPEED] = math.inf
    reset_frame(osc, motion)
    motion.growth[:] = 0.0


def impact_free(osc: Oscillator, motion: Motion) -> bool:
    """Whether no impact is possible from this section on: the bound of |y| stays inside both stops."""
    reach = derivative_bounds(osc.gap, motion.h)[0] * (1.0 + 1e-12)
    return bool(motion.contact[0] == FREE and reach < osc.b_upper and reach < osc.b_lower)


def scale_of(osc: Oscillator, motion: Motion) -> float:
    """Energy norm that deviations of this motion are measured against: its own and its forced response's."""
    forced = np.array(osc.forced)
    return energy_norm(osc.gap.lam, motion.h) + energy_norm(osc.gap.lam, np.hypot(forced[..., 0], forced[..., 1]))


def _adaptive(osc: Oscillator, motion: Motion, settings: Settings) -> Solving:
    """Look at ever longer stretches until the class is certain or the budget spent.

    Each stretch may end in a proof of no impact or of a stable orbit. Meanwhile, once that looks unlikely,
    tangent vectors are averaged: clearly positive ends at the asked tolerance; zero on two stretches is a torus.
    A tenth of the budget is kept for the proof of an orbit.
    """
    no_sections = np.empty((0, *motion.h.shape))
    vectors = vectors_for(settings, osc)
    used, stretch = 0, FIRST_STRETCH
    averages: Averages | None = None
    weighted = math.nan
    while True:
        if impact_free(osc, motion):
            return no_impact_cell(osc, motion, settings, used)
        length = min(stretch, settings.max_periods - settings.max_periods // 10 - used)
        if length <= 0:
            return undecided_cell(osc, motion, settings, used, averages)
        if averages is None and vectors and used >= TANGENT_AFTER and length > WARM_UP:
            motion = with_frame(motion, vectors)
            averages = no_averages()
            used += yield Stretch(osc, motion, WARM_UP, no_averages(), no_sections)
            length -= WARM_UP
            restart_counts(osc, motion)
        sections = np.empty((min(length, settings.max_period + 1), *motion.h.shape))
        used += yield Stretch(osc, motion, length, averages, sections)
        stopped = _stopped(osc, motion, settings, used, averages)
        if stopped is not None:
            return stopped
        orbit, spent = _settled(osc, motion, sections, settings, settings.max_periods - used)
        used += spent
        if orbit is not None:
            return periodic_cell(osc, orbit, settings, used)
        stretch = used
        if averages is None:
            continue
        mean, error, count = mean_growth(averages)
        if clearly_positive(mean, error, count):
            if error <= settings.tolerance:
                return chaotic_cell(osc, motion, settings, used, averages)
            missing = count * (min(error / settings.tolerance, FARTHEST) ** 2 - 1.0)
            stretch = int(min(used, max(1.05 * missing, 256)))
        previous, weighted = weighted, float(averages.weighted[0] / averages.weighted[1])
        flat = max(abs(previous), abs(weighted)) < TORUS_LIMIT and not weighted < -10.0 * abs(weighted - previous)
        if flat and closest_return(osc, sections) > TORUS_RETURN * scale_of(osc, motion):
            return quasiperiodic_cell(osc, motion, settings, used, averages, weighted, abs(weighted - previous))


def _fixed(osc: Oscillator, motion: Motion, settings: Settings) -> Solving:
    """The paper's schedule: a transient, then plain averages over so many periods.

    The averages of a cell whose orbit is proved may span chaos that came before it: they are kept as ``average``, and
    its exponents are the exact ones.
    """
    sections = np.empty((min(settings.periods, settings.max_period + 1), *motion.h.shape))
    motion = with_frame(motion, vectors_for(settings, osc))
    averages = no_averages()
    used = yield Stretch(osc, motion, settings.transient_periods, no_averages(), sections[:0])
    stopped = _stopped(osc, motion, settings, used, None)
    if stopped is not None:
        return stopped
    restart_counts(osc, motion)
    used += yield Stretch(osc, motion, settings.periods, averages, sections)
    stopped = _stopped(osc, motion, settings, used, averages)
    if stopped is not None:
        return stopped
    cell = averaged_cell(osc, motion, settings, used, averages)
    if impact_free(osc, motion):
        known = no_impact_cell(osc, motion, settings, used)
    else:
        orbit, spent = _settled(osc, motion, sections, settings, settings.max_periods)
        cell.periods_used += spent
        if orbit is None:
            mean, error, count = mean_growth(averages)
            cell.regime = CHAOTIC if clearly_positive(mean, error, count) else UNDETERMINED
            return cell
        known = periodic_cell(osc, orbit, settings, cell.periods_used)
    known.average, known.sum_law_defect = cell.average, cell.sum_law_defect
    known.state, known.section = cell.state, cell.section
    return known


def _stopped(osc: Oscillator, motion: Motion, settings: Settings, used: int, averages: Averages | None) -> Cell | None:
    """The cell whose motion cannot go on, else None: failed, or undecided where its work is spent."""
    status = int(motion.tally[STATUS])
    if status == RUNNING and not np.all(np.isfinite(motion.h)):
        status = NOT_FINITE
    if status == RUNNING:
        if motion.tally[WORK] >= 0.0:
            return None
        cell = undecided_cell(osc, motion, settings, used, averages)
        cell.reason = WORK_SPENT if cell.regime == UNDETERMINED else NO_REASON
        return cell
    regime = UNDETERMINED if status == OUT_OF_WORK else FAILED
    return Cell(regime=regime, periods_used=used, reason=REASON_OF[status])


def _settled(
    osc: Oscillator, motion: Motion, sections: Array, settings: Settings, budget: int
) -> tuple[PeriodicOrbit | None, int]:
    """The stable orbit that the motion falls into, if its last sections recur, and the periods spent to see."""
    scale = scale_of(osc, motion)
    symmetric_gap = osc.b_upper == osc.b_lower
    spent = 0
    for p in recurrence(osc, sections, scale, settings.max_period):
        for half in (True, False):
            if half and not (symmetric_gap and p % 2):
                continue
            per_period = 2 if half else 1
            orbit, steps = settle(osc, motion, p, half, scale, (budget - spent) * per_period)
            spent += -(-steps // per_period)
            if orbit is not None:
                return orbit, spent
    return None, spent
