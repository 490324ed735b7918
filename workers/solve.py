"""One cell from its start to its class: the adaptive method and the paper's fixed schedule."""

import math
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workers.exponents import free_exponents, impact_count, sum_law_holds, sum_of_exponents
from workers.kernel.averages import COUNT, MEAN, Averages, no_averages, standard_error
from workers.kernel.flight import derivative_bounds
from workers.kernel.stroboscopic import (
    BEYOND,
    FREE,
    LOST,
    LOWER,
    MARCH_GAVE_UP,
    MIN_SPEED,
    NOT_FINITE,
    OUT_OF_WORK,
    RUNNING,
    STATUS,
    STUCK,
    UPPER,
    WORK,
    Motion,
    axes,
    blocks_to_physical,
    motion_at,
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
    NO_IMPACT,
    NO_REASON,
    PERIODIC,
    QUASIPERIODIC,
    UNDETERMINED,
    WORK_SPENT,
    InvalidError,
)
from workers.results import NOT_FINITE as NO_LONGER_FINITE
from workers.settings import Settings
from workers.stretch import Stretch, run_periods, run_stretch

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

CLEAR = 4.0
"""Standard errors above zero from which an exponent is called positive."""

GROWN = 15.0
"""Total log-growth from which a positive exponent counts: a deviation of rounding has become visible."""

FARTHEST = 1e9
"""From so many times the tolerance on it does not matter how far off the error is: no budget has the periods."""

TORUS_LIMIT = 1e-5
"""Largest modulus of the weighted averages of two stretches that counts as an exponent zero."""

TORUS_RETURN = 1e-5
"""Return within max_period, relative to the motion's scale, up to which a motion may be an orbit closing slowly."""


@dataclass
class Cell:
    """What is known of one cell: the result variables (see results.py)."""

    largest: float = math.nan
    error: float = math.nan
    spectrum: Array | None = None
    average: Array | float | None = None
    sum_law_defect: float = math.nan
    regime: int = UNDETERMINED
    period: int = 0
    impacts_upper: int = 0
    impacts_lower: int = 0
    impacts_per_period: float = math.nan
    symmetric: bool = False
    sticks: bool = False
    stuck_fraction: float = math.nan
    min_impact_speed: float = math.nan
    periods_used: int = 0
    state: Array | None = None
    section: Array | None = None
    reason: int = NO_REASON


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
            return _no_impact(osc, motion, settings, used)
        length = min(stretch, settings.max_periods - settings.max_periods // 10 - used)
        if length <= 0:
            return _undecided(osc, motion, settings, used, averages)
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
            return _periodic(osc, orbit, settings, used)
        stretch = used
        if averages is None:
            continue
        mean, error, count = _mean(averages)
        if _clearly_positive(mean, error, count):
            if error <= settings.tolerance:
                return _chaotic(osc, motion, settings, used, averages)
            missing = count * (min(error / settings.tolerance, FARTHEST) ** 2 - 1.0)
            stretch = int(min(used, max(1.05 * missing, 256)))
        previous, weighted = weighted, float(averages.weighted[0] / averages.weighted[1])
        flat = max(abs(previous), abs(weighted)) < TORUS_LIMIT and not weighted < -10.0 * abs(weighted - previous)
        if flat and closest_return(osc, sections) > TORUS_RETURN * scale_of(osc, motion):
            return _quasiperiodic(osc, motion, settings, used, averages, weighted, abs(weighted - previous))


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
    cell = _averaged(osc, motion, settings, used, averages)
    if impact_free(osc, motion):
        known = _no_impact(osc, motion, settings, used)
    else:
        orbit, spent = _settled(osc, motion, sections, settings, settings.max_periods)
        cell.periods_used += spent
        if orbit is None:
            mean, error, count = _mean(averages)
            cell.regime = CHAOTIC if _clearly_positive(mean, error, count) else UNDETERMINED
            return cell
        known = _periodic(osc, orbit, settings, cell.periods_used)
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
        cell = _undecided(osc, motion, settings, used, averages)
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


def _mean(averages: Averages) -> tuple[float, float, int]:
    """Mean growth per period of the first vector, its standard error, periods averaged."""
    levels = averages.levels
    return float(levels[0, MEAN]), float(standard_error(levels)), int(levels[0, COUNT])


def _clearly_positive(mean: float, error: float, count: int) -> bool:
    return mean > CLEAR * error and mean * count > GROWN


def _no_impact(osc: Oscillator, motion: Motion, settings: Settings, used: int) -> Cell:
    exponents = free_exponents(osc)
    steady = motion_at(np.zeros_like(motion.h) if osc.trace > 0.0 else motion.h)
    return Cell(
        largest=float(exponents[0]),
        error=abs(float(exponents[0])) * 1e-15,
        spectrum=exponents,
        sum_law_defect=float(np.sum(exponents)) - sum_of_exponents(osc, 0.0),
        regime=NO_IMPACT,
        period=1,
        impacts_per_period=0.0,
        stuck_fraction=0.0,
        periods_used=used,
        state=blocks_to_physical(osc, steady),
        section=_sections(osc, steady, settings, 1),
    )


def _periodic(osc: Oscillator, orbit: PeriodicOrbit, settings: Settings, used: int) -> Cell:
    """A proved orbit: one turn of it counts impacts and rest; its exponents are the Floquet exponents."""
    turn = motion_at(orbit.h, orbit.contact)
    run_periods(osc, turn, orbit.period)
    sticks = bool(turn.tally[STUCK] > 0.0)
    hits = impact_count(turn) / orbit.period
    if not hits and not sticks:
        return _no_impact(osc, turn, settings, used + orbit.period)
    exponents = orbit.exponents
    holds = sum_law_holds(osc, turn)
    start = motion_at(orbit.h, orbit.contact)
    return Cell(
        largest=float(exponents[0]),
        error=orbit.error,
        spectrum=exponents,
        sum_law_defect=float(np.sum(exponents)) - sum_of_exponents(osc, hits) if holds else math.nan,
        regime=PERIODIC,
        period=orbit.period,
        impacts_upper=-1 if sticks else int(turn.tally[UPPER]),
        impacts_lower=-1 if sticks else int(turn.tally[LOWER]),
        impacts_per_period=math.nan if sticks else hits,
        symmetric=orbit.symmetric,
        sticks=sticks,
        stuck_fraction=float(turn.tally[STUCK]) / (orbit.period * osc.period),
        min_impact_speed=_slowest(turn),
        periods_used=used + orbit.period,
        state=blocks_to_physical(osc, start),
        section=_sections(osc, start, settings, orbit.period),
    )


def _averaged(osc: Oscillator, motion: Motion, settings: Settings, used: int, averages: Averages | None) -> Cell:
    """What averages show of a motion, its class left open. Counts and growth must span the same periods."""
    cell = Cell(periods_used=used, state=blocks_to_physical(osc, motion))
    count = 0
    if averages is not None and motion.growth.size and averages.levels[0, COUNT] > 0.0:
        cell.largest, cell.error, count = _mean(averages)
        reset_frame(osc, motion)
        cell.spectrum = np.sort(motion.growth / count)[::-1]
        cell.average = cell.spectrum.copy() if settings.exponents == "spectrum" else cell.largest
    elif settings.method == "fixed" and used > settings.transient_periods:
        count = used - settings.transient_periods
    if count:
        sticks = bool(motion.tally[STUCK] > 0.0)
        cell.sticks = sticks
        cell.stuck_fraction = float(motion.tally[STUCK]) / (count * osc.period)
        hits = impact_count(motion) / count
        cell.impacts_per_period = math.nan if sticks else hits
        cell.min_impact_speed = _slowest(motion)
        if motion.growth.size == motion.h.size and sum_law_holds(osc, motion):
            cell.sum_law_defect = float(np.sum(motion.growth)) / count - sum_of_exponents(osc, hits)
    cell.section = _sections(osc, motion, settings, 0)
    return cell


def _chaotic(osc: Oscillator, motion: Motion, settings: Settings, used: int, averages: Averages) -> Cell:
    cell = _averaged(osc, motion, settings, used, averages)
    cell.regime = CHAOTIC
    return cell


def _quasiperiodic(
    osc: Oscillator, motion: Motion, settings: Settings, used: int, averages: Averages, weighted: float, spread: float
) -> Cell:
    cell = _averaged(osc, motion, settings, used, averages)
    cell.regime, cell.largest, cell.error = QUASIPERIODIC, weighted, spread
    if cell.spectrum is not None:
        cell.spectrum[0] = weighted
    return cell


def _undecided(osc: Oscillator, motion: Motion, settings: Settings, used: int, averages: Averages | None) -> Cell:
    """The budget is spent: chaotic with its true error if that is clear, else undetermined."""
    cell = _averaged(osc, motion, settings, used, averages)
    if averages is not None and _clearly_positive(*_mean(averages)):
        cell.regime = CHAOTIC
    else:
        cell.error = math.nan
    return cell


def _slowest(motion: Motion) -> float:
    """Slowest impact counted; NaN without impacts, 0 where the mass came to rest."""
    slowest = float(motion.tally[MIN_SPEED])
    return slowest if math.isfinite(slowest) else math.nan


def _sections(osc: Oscillator, motion: Motion, settings: Settings, period: int) -> Array | None:
    """The next K physical section states (K, 2n) of a motion; an orbit of known period is repeated.

    NaN from where the motion cannot be followed to the next section.
    """
    K = settings.section_samples
    if K == 0:
        return None
    ahead = motion_at(motion.h, int(motion.contact[0]))
    states = []
    for _ in range(min(K, period) if period else K):
        reached = ahead.tally[STATUS] == RUNNING
        states.append(blocks_to_physical(osc, ahead) if reached else np.full(ahead.h.size, math.nan))
        if reached:
            run_periods(osc, ahead, 1)
    return np.array([states[k % len(states)] for k in range(K)])
